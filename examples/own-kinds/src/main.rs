//! `lightharmony` with the kinds of this crate.

fn main() -> std::process::ExitCode {
    own_kinds::program().run()
}

//! `lightharmony`: inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.

fn main() -> std::process::ExitCode {
    lightharmony::Program::new().run()
}

//! What a test of the table of extremes calls to tell what it measured. One file, compiled into every set
//! of tests that has such rows, since a crate for twenty lines would be a dependency of all of them.

/// Checks a measured value against the bound of row `number` of `docs/evidence/extremes.md`, and tells it to the page
/// where `LIGHTHARMONY_ROWS` names a folder. Call it from a test named `row_07_short_name` whose doc comment
/// has a line `Mutation:` that says which changed line turns it red. `what` says what is measured, with its
/// unit; a test may measure several things. NaN is out of every bound.
#[track_caller]
#[allow(clippy::expect_used, reason = "a page without its values would be worse")]
pub fn row(number: u32, what: &str, measured: f64, bound: f64) {
    assert!(measured <= bound, "row {number}: {what} is {measured}, more than {bound}");
    if let Some(folder) = std::env::var_os("LIGHTHARMONY_ROWS") {
        let path = std::path::Path::new(&folder).join(format!("{number:02}.tsv"));
        let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
        // One write, which the system does not mix with those of other threads and processes.
        let line = format!("{what}\t{measured}\t{bound}\n");
        std::io::Write::write_all(&mut file.expect("the folder is there"), line.as_bytes())
            .expect("has room");
    }
}

//! Reports a measured value as a row of the page of extreme cases. Each test crate that reports such rows includes
//! this file as a module, because twenty lines do not justify a crate.

/// Checks a measured value against the bound of row `number` of `docs/evidence/extremes.md`, and saves it for that
/// page if `LIGHTHARMONY_ROWS` names a folder. Call it from a test that is named in `tests/extremes/rows.tsv` and
/// for which `tests/extremes/mutations.tsv` has a change that makes it fail. `what` names the measured quantity
/// with its unit; a test may measure several. NaN is outside every bound.
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

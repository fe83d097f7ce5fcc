//! Checks that `docs/nodes.md` is the output of `nodes --markdown`. With `UPDATE_GOLDEN=1` the page is written
//! instead.

use crate::Place;

#[test]
fn the_reference_page_is_made_from_the_table_of_kinds() {
    let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/nodes.md");
    let made = String::from_utf8(Place::new("").call(&["nodes", "--markdown"]).stdout).unwrap();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        return std::fs::write(page, made).unwrap();
    }
    let old = std::fs::read_to_string(page).unwrap_or_default();
    for (old, made) in old.lines().zip(made.lines()) {
        assert_eq!(old, made, "UPDATE_GOLDEN=1 cargo test --release --test cli the_reference_page");
    }
    assert_eq!(old.lines().count(), made.lines().count());
}

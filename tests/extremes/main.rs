//! `docs/extremes.md`: a row for each extreme, the tests that hold there, and what they measured.
//!
//! A test belongs to a row by its name, `row_07_short_name`, and names in its doc comment the changed line
//! that turns it red (`Mutation:`), with `(seen red)` once that was tried. The page is made by
//! `tests/extremes/page`; here is checked that it tells of the tests that there are, and that each was tried.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Node, extreme, expectation and the reason of the bound of each row.
const ROWS: &str = include_str!("rows.tsv");

/// A test of a row.
#[derive(Debug)]
struct Test {
    name: String,
    /// Relative to the workspace.
    file: String,
    mutation: String,
}

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The sources below a folder, in order of path.
fn sources(folder: &Path, into: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, into);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            into.push(path);
        }
    }
}

/// The rows and name of a test, from the line `fn row_07_short_name() {`; there may be several numbers.
fn named_rows(line: &str) -> Option<(Vec<usize>, &str)> {
    let name = line.strip_prefix("fn ")?.split('(').next()?;
    let numbers = name.strip_prefix("row_")?.split('_').map_while(|word| word.parse().ok());
    Some((numbers.collect(), name))
}

/// Every test that is named after a row, by row and then by name.
fn tests() -> BTreeMap<usize, Vec<Test>> {
    let mut files = Vec::new();
    for folder in ["cache", "engine", "learned", "nodes", "src", "tests"] {
        sources(&workspace().join(folder), &mut files);
    }
    let mut rows: BTreeMap<usize, Vec<Test>> = BTreeMap::new();
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let file = path.strip_prefix(workspace()).unwrap().to_string_lossy().into_owned();
        let mut doc = String::new();
        for line in text.lines().map(str::trim) {
            if let Some(words) = line.strip_prefix("///") {
                let _ = write!(doc, " {}", words.trim());
            } else if let Some((numbers, name)) = named_rows(line) {
                let mutation = doc.split_once("Mutation:").map(|(_, rest)| rest.trim().to_owned());
                let mutation = mutation.unwrap_or_default();
                for number in numbers {
                    let (name, file, mutation) = (name.to_owned(), file.clone(), mutation.clone());
                    rows.entry(number).or_default().push(Test { name, file, mutation });
                }
                doc.clear();
            } else if !line.starts_with("#[") {
                doc.clear();
            }
        }
    }
    rows
}

/// What the tests of a row measured, the largest of each, with its bound.
fn measured(folder: &Path, row: usize) -> String {
    let text = std::fs::read_to_string(folder.join(format!("{row:02}.tsv"))).unwrap_or_default();
    let value = |line: &str| -> Option<(String, (f64, f64))> {
        let mut cells = line.split('\t');
        let what = cells.next()?.to_owned();
        Some((what, (cells.next()?.parse().ok()?, cells.next()?.parse().ok()?)))
    };
    let mut values: BTreeMap<String, (f64, f64)> = BTreeMap::new();
    for (what, (value, bound)) in text.lines().filter_map(value) {
        let known = values.entry(what).or_insert((value, bound));
        known.0 = known.0.max(value);
    }
    if values.is_empty() {
        return "as asserted".to_owned();
    }
    let cell = |(what, (value, bound)): (&String, &(f64, f64))| {
        format!("{}: {}, {}", what.replace('|', "\\|"), number(*value), number(*bound))
    };
    values.iter().map(cell).collect::<Vec<_>>().join("<br>")
}

fn number(value: f64) -> String {
    match value.abs() {
        v if v == 0.0 || (1e-3..1e6).contains(&v) => {
            let text = format!("{value:.4}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
        _ => format!("{value:.2e}"),
    }
}

fn page(values: impl Fn(usize) -> String) -> String {
    let mut text = "# Numbers at the extremes\n\n\
        Made by `tests/extremes/page`, which runs the tests and writes down what they measured. A value lies within\n\
        its bound or the test fails; where none is measured, the test asserts bits, counts, messages or ranges. The\n\
        mutation is one changed line with which the test was seen to fail.\n\n\
        | row | node | extreme | what holds | tests | measured, bound | why this bound | mutation |\n\
        |---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let tests = tests();
    let cell = |text: &str| text.replace('|', "\\|");
    for (index, row) in ROWS.lines().enumerate() {
        let mut cells = row.split('\t');
        let mut next = || cells.next().unwrap_or_default();
        let (node, extreme, expected, why) = (next(), next(), next(), next());
        let of_row = tests.get(&(index + 1)).map(Vec::as_slice).unwrap_or_default();
        let names: Vec<String> = of_row.iter().map(|t| format!("[`{}`](../{})", t.name, t.file)).collect();
        let mutations: Vec<String> =
            of_row.iter().map(|t| cell(&t.mutation)).filter(|text| !text.is_empty()).collect();
        let _ = writeln!(
            text,
            "| {} | {node} | {} | {} | {} | {} | {} | {} |",
            index + 1,
            cell(extreme),
            cell(expected),
            names.join("<br>"),
            values(index + 1),
            cell(why),
            mutations.join("<br>")
        );
    }
    text
}

#[test]
fn every_row_has_a_test_and_every_test_of_a_row_names_one_that_there_is() {
    let rows = ROWS.lines().count();
    assert_eq!(rows, 69);
    let tests_of = tests();
    let bare: Vec<usize> = (1..=rows).filter(|row| !tests_of.contains_key(row)).collect();
    assert!(bare.is_empty(), "no test is named after rows {bare:?}");
    let without =
        |(row, tests): (&usize, &Vec<Test>)| tests.iter().all(|t| t.mutation.is_empty()).then_some(*row);
    let untold: Vec<usize> = tests_of.iter().filter_map(without).collect();
    assert!(untold.is_empty(), "no test of rows {untold:?} names a mutation");
    let untried =
        tests_of.values().flatten().filter(|t| !t.mutation.is_empty() && !t.mutation.contains("seen red"));
    let untried: Vec<&str> = untried.map(|t| t.name.as_str()).collect();
    assert!(untried.is_empty(), "the mutations of {untried:?} were not seen red");
    let wrong: Vec<String> = tests().split_off(&(rows + 1)).into_values().flatten().map(|t| t.name).collect();
    assert!(wrong.is_empty(), "there are {rows} rows, none for {wrong:?}");
}

/// With `LIGHTHARMONY_ROWS` set the page is written anew, from what is measured there; with `UPDATE_GOLDEN` with the values
/// that it has.
#[test]
fn the_page_tells_of_the_tests_that_there_are() {
    let path = workspace().join("docs/extremes.md");
    let old = std::fs::read_to_string(&path).unwrap();
    let kept = |row: usize| {
        let line = old.lines().find(|line| line.starts_with(&format!("| {row} | ")));
        let cell = line.and_then(|line| line.split(" | ").nth(5)).unwrap_or_default();
        if cell.trim().is_empty() { "as asserted".to_owned() } else { cell.to_owned() }
    };
    let folder = std::env::var_os("LIGHTHARMONY_ROWS");
    let new = match &folder {
        Some(folder) => page(|row| measured(Path::new(folder), row)),
        None => page(kept),
    };
    if folder.is_some() || std::env::var_os("UPDATE_GOLDEN").is_some() {
        return std::fs::write(path, new).unwrap();
    }
    for (old, new) in old.lines().zip(new.lines()) {
        assert_eq!(
            old, new,
            "run tests/extremes/page, or with UPDATE_GOLDEN=1 where nothing new is measured"
        );
    }
    assert_eq!(old.lines().count(), new.lines().count());
}

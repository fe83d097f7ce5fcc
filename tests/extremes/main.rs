//! Checks `docs/evidence/extremes.md`. That page has a row for each extreme case, which lists the tests of the case
//! and the values that they measured.
//!
//! `rows.tsv` has the rows and the names of the tests. `mutations.tsv` lists changes of expressions that make the
//! tests fail; `tests/extremes/mutate.py` applies them. `tests/extremes/page` writes the page. The tests in this
//! file check that the page agrees with the table and the sources, and that the expressions of the mutations still
//! exist.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// The rows. Their columns are the node, the extreme case, the expectation, the reason for the bound, and the names
/// of the tests.
const ROWS: &str = include_str!("rows.tsv");

/// The mutations. Their columns are the test, the file, the expression, and its replacement. If the expression
/// contains `«»`, only the part between these marks is replaced.
const MUTATIONS: &str = include_str!("mutations.tsv");

/// A test of a row.
#[derive(Debug)]
struct Test {
    name: String,
    /// Path of the source file, relative to the workspace.
    file: String,
}

/// A changed expression that a test must detect.
struct Mutation {
    test: &'static str,
    /// Path of the file with the expression, relative to the workspace.
    file: &'static str,
    before: &'static str,
    after: &'static str,
}

impl Mutation {
    fn all() -> impl Iterator<Item = Self> {
        MUTATIONS.lines().map(|line| {
            let mut cells = line.split('\t');
            let mut next = || cells.next().expect("four cells");
            Self { test: next(), file: next(), before: next(), after: next() }
        })
    }

    /// The part of `before` that is replaced.
    fn part(&self) -> &'static str {
        let inner = self.before.split_once('«').and_then(|(_, rest)| rest.split_once('»'));
        inner.map_or(self.before, |(part, _)| part)
    }

    /// The description of the mutation on the page.
    fn described(&self) -> String {
        let file = self.file.rsplit('/').next().unwrap();
        match self.after {
            "" => format!("`{}` left out of `{file}`", self.part()),
            after => format!("`{}` to `{after}` in `{file}`", self.part()),
        }
    }
}

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Adds the source files in a folder and its subfolders to `into`, in order of path.
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

/// The files that contain each test function of the workspace, by the name of the function. If several functions
/// have the same name, their files are all listed.
fn tests() -> BTreeMap<String, Vec<String>> {
    let mut files = Vec::new();
    for folder in ["cache", "engine", "extras", "nodes", "render", "scene", "src", "tests", "trade"] {
        sources(&workspace().join(folder), &mut files);
    }
    let mut found: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let file = path.strip_prefix(workspace()).unwrap().to_string_lossy().into_owned();
        let mut is_test = false;
        for line in text.lines().map(str::trim) {
            match line.strip_prefix("fn ").and_then(|rest| rest.split_once("()")) {
                Some((name, _)) if is_test => {
                    found.entry(name.to_owned()).or_default().push(file.clone());
                    is_test = false;
                }
                _ => {
                    is_test =
                        line == "#[test]" || (is_test && (line.starts_with("#[") || line.starts_with("//")));
                }
            }
        }
    }
    found
}

/// The tests of each row. Rows are numbered from 1 in the order of the table.
fn tests_of_rows() -> BTreeMap<usize, Vec<Test>> {
    let found = tests();
    let test = |name: &str| {
        let files = found.get(name).map(Vec::as_slice).unwrap_or_default();
        assert_eq!(files.len(), 1, "rows.tsv names `{name}`, a test of {files:?}: it must be in one file");
        Test { name: name.to_owned(), file: files[0].clone() }
    };
    let names = |line: &'static str| line.split('\t').nth(4).expect("five cells").split(' ');
    let rows = ROWS.lines().enumerate();
    rows.map(|(index, line)| (index + 1, names(line).map(test).collect())).collect()
}

/// The largest value of each quantity that the tests of a row measured, with its bound, as text.
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
        Made by `tests/extremes/page`, which runs the tests and writes down the values they measured. A value lies within\n\
        its bound or the test fails; a test without a value asserts bits, counts, messages or ranges. A mutation is one\n\
        changed expression that makes a test of the row fail; `tests/extremes/mutate.py` tries all of them\n\
        (`mutations.tsv`).\n\n\
        | row | node | extreme | what holds | tests | measured, bound | why this bound | mutation |\n\
        |---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let tests = tests_of_rows();
    let cell = |text: &str| text.replace('|', "\\|");
    for (index, row) in ROWS.lines().enumerate() {
        let mut cells = row.split('\t');
        let mut next = || cells.next().unwrap_or_default();
        let (node, extreme, expected, why) = (next(), next(), next(), next());
        let of_row = tests.get(&(index + 1)).map(Vec::as_slice).unwrap_or_default();
        let names: Vec<String> = of_row.iter().map(|t| format!("[`{}`](../../{})", t.name, t.file)).collect();
        let of_row_too = |m: &Mutation| of_row.iter().any(|test| test.name == m.test);
        let mutations: Vec<String> =
            Mutation::all().filter(of_row_too).map(|m| cell(&m.described())).collect();
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
fn every_row_names_tests_that_exist() {
    assert_eq!(tests_of_rows().len(), 69);
    let measured = |test: &Test| {
        let text = std::fs::read_to_string(workspace().join(&test.file)).unwrap();
        let body = text.split(&format!("fn {}()", test.name)).nth(1).unwrap_or_default().to_owned();
        let body = body.split("#[test]").next().unwrap_or_default().to_owned();
        let calls =
            body.split(" row(").skip(1).map(|rest| rest.split(',').next().unwrap_or_default().to_owned());
        calls.filter_map(|number| number.trim().parse::<usize>().ok()).collect::<Vec<usize>>()
    };
    for (row, tests) in tests_of_rows() {
        for test in tests {
            let numbers = measured(&test);
            let known =
                |number: &usize| *number == row || ROWS.lines().nth(number - 1).unwrap().contains(&test.name);
            assert!(numbers.iter().all(known), "`{}` measures for rows {numbers:?}", test.name);
        }
    }
}

#[test]
fn every_row_has_a_mutation_of_an_expression_in_the_sources() {
    let bare = |text: &str| text.replace(|c: char| c.is_whitespace() || "«»".contains(c), "");
    let tests_of = tests_of_rows();
    let named: Vec<&str> = tests_of.values().flatten().map(|test| test.name.as_str()).collect();
    for mutation in Mutation::all() {
        let Mutation { test, file, before, .. } = mutation;
        assert!(named.contains(&test), "mutations.tsv names {test}, which is not a test of a row");
        let source = bare(&std::fs::read_to_string(workspace().join(file)).unwrap());
        let times = source.matches(&bare(before)).count();
        assert_eq!(times, 1, "`{before}` of mutations.tsv is {times} times in {file}: follow the source");
    }
    let tried = |tests: &[Test]| tests.iter().any(|test| Mutation::all().any(|m| m.test == test.name));
    let untried: Vec<usize> =
        tests_of.iter().filter(|(_, tests)| !tried(tests)).map(|(row, _)| *row).collect();
    assert!(untried.is_empty(), "mutations.tsv has none for rows {untried:?}");
}

/// The page agrees with the table. If `LIGHTHARMONY_ROWS` names a folder, the page is written with the measured
/// values in that folder. If `UPDATE_GOLDEN` is set, the page is written from the table and keeps its measured
/// values.
#[test]
fn the_page_agrees_with_the_table() {
    let path = workspace().join("docs/evidence/extremes.md");
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
        assert_eq!(old, new, "run tests/extremes/page, or with UPDATE_GOLDEN=1 if nothing new is measured");
    }
    assert_eq!(old.lines().count(), new.lines().count());
}

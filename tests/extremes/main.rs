//! `docs/evidence/extremes.md`: a row for each extreme, the tests that hold there, and what they measured.
//!
//! A test belongs to a row by its name, `row_07_short_name`. `mutations.tsv` has changed expressions that turn them
//! red, which `tests/extremes/mutate.py` tries. The page is made by `tests/extremes/page`; here is checked that it tells
//! of the tests that there are, and that what a mutation changes is still there.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Node, extreme, expectation and the reason of the bound of each row.
const ROWS: &str = include_str!("rows.tsv");

/// Test, file, what stands there, and what it becomes. Where `«»` are in it, what lies between is changed.
const MUTATIONS: &str = include_str!("mutations.tsv");

/// A test of a row.
#[derive(Debug)]
struct Test {
    name: String,
    /// Relative to the workspace.
    file: String,
}

/// One changed expression.
struct Mutation {
    test: &'static str,
    /// Relative to the workspace.
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

    /// What of `before` is changed.
    fn part(&self) -> &'static str {
        let inner = self.before.split_once('«').and_then(|(_, rest)| rest.split_once('»'));
        inner.map_or(self.before, |(part, _)| part)
    }

    /// As the page has it.
    fn told(&self) -> String {
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
    for folder in ["cache", "engine", "extras", "nodes", "src", "tests", "trade"] {
        sources(&workspace().join(folder), &mut files);
    }
    let mut rows: BTreeMap<usize, Vec<Test>> = BTreeMap::new();
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let file = path.strip_prefix(workspace()).unwrap().to_string_lossy().into_owned();
        for (numbers, name) in text.lines().filter_map(|line| named_rows(line.trim())) {
            for number in numbers {
                let test = Test { name: name.to_owned(), file: file.clone() };
                rows.entry(number).or_default().push(test);
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
        its bound or the test fails; where none is measured, the test asserts bits, counts, messages or ranges. A\n\
        mutation is one changed expression that makes a test of the row fail; `tests/extremes/mutate.py` tries all of\n\
        them (`mutations.tsv`).\n\n\
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
        let names: Vec<String> = of_row.iter().map(|t| format!("[`{}`](../../{})", t.name, t.file)).collect();
        let of_row_too = |m: &Mutation| of_row.iter().any(|test| test.name == m.test);
        let mutations: Vec<String> = Mutation::all().filter(of_row_too).map(|m| cell(&m.told())).collect();
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
    let wrong: Vec<String> = tests().split_off(&(rows + 1)).into_values().flatten().map(|t| t.name).collect();
    assert!(wrong.is_empty(), "there are {rows} rows, none for {wrong:?}");
}

#[test]
fn every_row_has_a_mutation_of_what_stands_in_the_sources() {
    let bare = |text: &str| text.replace(|c: char| c.is_whitespace() || "«»".contains(c), "");
    let tests_of = tests();
    let named: Vec<&str> = tests_of.values().flatten().map(|test| test.name.as_str()).collect();
    for mutation in Mutation::all() {
        let Mutation { test, file, before, .. } = mutation;
        assert!(named.contains(&test), "mutations.tsv names {test}, which is no test of a row");
        let source = bare(&std::fs::read_to_string(workspace().join(file)).unwrap());
        let times = source.matches(&bare(before)).count();
        assert_eq!(times, 1, "`{before}` of mutations.tsv stands {times} times in {file}: follow the source");
    }
    let tried = |tests: &[Test]| tests.iter().any(|test| Mutation::all().any(|m| m.test == test.name));
    let untried: Vec<usize> =
        tests_of.iter().filter(|(_, tests)| !tried(tests)).map(|(row, _)| *row).collect();
    assert!(untried.is_empty(), "mutations.tsv has none for rows {untried:?}");
}

/// With `LIGHTHARMONY_ROWS` set the page is written anew, from what is measured there; with `UPDATE_GOLDEN` with the values
/// that it has.
#[test]
fn the_page_tells_of_the_tests_that_there_are() {
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
        assert_eq!(
            old, new,
            "run tests/extremes/page, or with UPDATE_GOLDEN=1 where nothing new is measured"
        );
    }
    assert_eq!(old.lines().count(), new.lines().count());
}

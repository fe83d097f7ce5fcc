//! Checks that comments, messages and pages are in plain English. The test fails on the words in `words.tsv`, which
//! lists a replacement for each.
//!
//! A pattern is a sequence of words and punctuation; `*` stands for any word, and `^` for the start of a doc
//! comment. `allowed.txt` lists longer phrases in which a pattern is permitted. Code between backticks or in a
//! fence is ignored.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test may stop at the first surprise")]

mod text;

use std::path::{Path, PathBuf};

use text::{Origin, Passage, Token};

const WORDS: &str = include_str!("words.tsv");
const ALLOWED: &str = include_str!("allowed.txt");

/// The folders and files that are checked.
const HELD: &[&str] = &[
    "README.md",
    "CHANGELOG.md",
    "cache",
    "docs",
    "engine",
    "extras",
    "graphs",
    "nodes",
    "render",
    "scene",
    "src",
    "tests",
    "benchmark",
    "trade",
];

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn split(phrase: &str) -> Vec<&str> {
    phrase.split(' ').collect()
}

/// The patterns and their replacements.
fn patterns() -> Vec<(Vec<&'static str>, &'static str)> {
    let row = |line: &'static str| line.split_once('\t').expect("a pattern, a tab, what to write instead");
    WORDS.lines().map(row).map(|(pattern, instead)| (split(pattern), instead)).collect()
}

/// True if the phrase begins at the token with index `at`.
fn stands(tokens: &[Token], at: usize, phrase: &[&str]) -> bool {
    let word = |token: &Token| token.0.chars().any(char::is_alphanumeric);
    tokens.len() >= at + phrase.len()
        && phrase.iter().zip(&tokens[at..]).all(|(part, token)| match *part {
            "*" => word(token),
            part => token.0 == part,
        })
}

/// The patterns found in a passage: line, words, and the replacement.
fn found(passage: &Passage) -> Vec<(usize, String, &'static str)> {
    let tokens = passage.tokens();
    let allowed: Vec<Vec<&str>> = ALLOWED.lines().map(split).collect();
    let is_allowed = |at: usize, length: usize| {
        allowed.iter().any(|phrase| {
            let first = (at + length).saturating_sub(phrase.len());
            (first..=at)
                .any(|start| start + phrase.len() >= at + length.min(2) && stands(&tokens, start, phrase))
        })
    };
    let mut found = Vec::new();
    for (pattern, instead) in patterns() {
        let start = pattern[0] == "^";
        let pattern = if start { &pattern[1..] } else { &pattern[..] };
        let last = if start { tokens.len().min(1) } else { tokens.len() };
        if start && passage.origin != Origin::Doc {
            continue;
        }
        for at in (0..last).filter(|at| stands(&tokens, *at, pattern)) {
            if !is_allowed(at, pattern.len()) {
                let words: Vec<&str> =
                    tokens[at..at + pattern.len()].iter().map(|token| token.0.as_str()).collect();
                found.push((tokens[at].1, words.join(" "), instead));
            }
        }
    }
    found.sort_by_key(|(line, ..)| *line);
    found
}

/// Adds the files that contain prose, in `path` and its subfolders, to `into`, in order of path.
fn files(path: &Path, into: &mut Vec<PathBuf>) {
    if path.is_dir() {
        let mut entries: Vec<PathBuf> =
            std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()).collect();
        entries.sort();
        entries
            .iter()
            .filter(|entry| !entry.ends_with("target") && !entry.ends_with("tests/words"))
            .for_each(|entry| files(entry, into));
    } else if path.extension().is_some_and(|end| ["rs", "ron", "md"].iter().any(|known| end == *known)) {
        into.push(path.to_owned());
    }
}

fn passages(path: &Path) -> Vec<Passage> {
    let source = std::fs::read_to_string(path).unwrap();
    match path.extension().and_then(|end| end.to_str()) {
        Some("rs") => text::of_rust(&source),
        Some("ron") => text::of_graph(&source),
        _ => text::of_page(&source),
    }
}

#[test]
fn prose_is_plain_english() {
    let mut all = Vec::new();
    let held = std::env::var("LIGHTHARMONY_WORDS").unwrap_or_else(|_| HELD.join(","));
    held.split(',').for_each(|name| files(&workspace().join(name), &mut all));
    let mut lines = Vec::new();
    for path in &all {
        let name = path.strip_prefix(workspace()).unwrap().display();
        for (line, words, instead) in passages(path).iter().flat_map(found) {
            lines.push(format!("{name}:{line}: `{words}`, instead: {instead}"));
        }
    }
    assert!(lines.is_empty(), "{} places:\n{}", lines.len(), lines.join("\n"));
}

fn words_of(passages: &[Passage]) -> Vec<String> {
    passages.iter().flat_map(found).map(|(line, words, _)| format!("{line} {words}")).collect()
}

#[test]
fn patterns_are_found_across_lines_and_only_in_prose() {
    let source = r##"
/// What its code takes, which is
/// told in a note.
///
/// ```
/// let x = "told";
/// ```
fn a() { let b = 'a'; let c = '"'; let d = "is \"anew\" {told} \
    made"; let e = r#"beside "it""#; let told = '\''; // `told` and what_is_told
}
/* there is no fault, and it is no longer one; this
   is no fault */
"##;
    assert_eq!(
        words_of(&text::of_rust(source)),
        ["2 what", "3 told", "8 anew", "9 beside", "12 is no fault"]
    );
    let graph = "// told\nnode: Kind(path: \"//told\"), // so many\n";
    assert_eq!(words_of(&text::of_graph(graph)), ["1 told", "2 so many"]);
    let page = "A [link](told.md), a `told`,\n```\ntold\n```\nthere are none; it\nis none.\n";
    assert_eq!(words_of(&text::of_page(page)), ["6 is none"]);
}

#[test]
fn every_pattern_matches_itself() {
    for (pattern, instead) in patterns() {
        let text = pattern.join(" ").replace('*', "matter");
        let line = text.strip_prefix("^ ").map_or(format!("// {text}"), |rest| format!("/// {rest}"));
        let passages = text::of_rust(&line);
        assert!(passages.iter().flat_map(found).any(|hit| hit.2 == instead), "{line}");
        let plain = text::of_page(instead);
        assert!(instead.contains(':') || plain.iter().all(|passage| found(passage).is_empty()), "{instead}");
    }
}

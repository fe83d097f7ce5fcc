//! The interface for crates with kinds of their own: every item that `docs/own-kinds.md` calls stable, with its signatures,
//! as `stable.txt` lists them. A change that such crates notice changes this list.
//!
//! Lines that vanish from the list, and new lines in a trait without `[default]`, break crates of users: they need the
//! next minor version and a line in `CHANGELOG.md`. `UPDATE_GOLDEN=1` writes the list.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

mod list;
mod source;

use std::collections::BTreeSet;
use std::path::Path;

use source::Module;

const PAGE: &str = include_str!("../../docs/own-kinds.md");

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The rows of the table of the page: the path of a module, and the names of its stable items. `*` stands for all.
fn stated() -> Vec<(String, Vec<String>)> {
    let section = PAGE.split_once("\n## The stable interface\n").expect("the section exists").1;
    let code = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    let rows = section.lines().filter(|line| line.starts_with("| `"));
    let cells = rows.map(|row| row.trim_matches('|').split_once('|').expect("a row has two cells"));
    cells.map(|(module, names)| (code(module).remove(0), code(names))).collect()
}

/// The file of a module: `lightharmony::scene::types` is in `scene/src`.
fn module(path: &str) -> Module {
    let parts: Vec<&str> = path.split("::").collect();
    let (folder, rest) = match parts.as_slice() {
        ["lightharmony"] => ("src", &[][..]),
        ["kind_tests"] => ("engine/kind-tests/src", &[][..]),
        ["lightharmony", name @ ("engine" | "nodes" | "render" | "scene"), rest @ ..] => {
            (&*format!("{name}/src").leak(), rest)
        }
        _ => panic!("the library has no module `{path}`"),
    };
    rest.iter().fold(Module::root(&workspace().join(folder)), |module, name| {
        module.child(name).unwrap_or_else(|| panic!("there is no module `{name}` of `{path}`"))
    })
}

/// The stable items: the path of each, and its description.
fn items() -> Vec<(String, Vec<String>)> {
    let mut found = Vec::new();
    for (path, names) in stated() {
        let module = module(&path);
        if names.iter().any(|name| name == "*") {
            found.push((format!("{path}::*"), list::macro_calls(&module)));
        }
        let names = if names == ["*"] { module.public() } else { names };
        for name in names {
            let (place, own) =
                module.find(&name).unwrap_or_else(|| panic!("`{path}` has no public `{name}`"));
            found.push((format!("{path}::{name}"), list::describe(&place, &own)));
        }
    }
    found
}

#[test]
fn the_stable_interface_is_the_stored_one() {
    let file = workspace().join("tests/api/stable.txt");
    let mut text = String::new();
    for (path, lines) in items() {
        text.push_str(&format!(
            "{path}\n{}",
            lines.iter().map(|line| format!("  {line}\n")).collect::<String>()
        ));
    }
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&file, &text).unwrap();
    }
    let stored = std::fs::read_to_string(&file).unwrap();
    let sides = [&stored, &text].map(|text| with_paths(text));
    let gone: Vec<_> = sides[0].difference(&sides[1]).map(|line| format!("- {line}")).collect();
    let new: Vec<_> = sides[1].difference(&sides[0]).map(|line| format!("+ {line}")).collect();
    assert!(
        stored == text,
        "the stable interface has changed (see the head of tests/api/main.rs):\n{}",
        [gone, new].concat().join("\n")
    );
}

/// The lines of a list, each after the path of its item.
fn with_paths(text: &str) -> BTreeSet<String> {
    let mut path = "";
    let mut found = BTreeSet::new();
    for line in text.lines() {
        match line.strip_prefix("  ") {
            Some(line) => _ = found.insert(format!("{path}: {line}")),
            None => path = line,
        }
    }
    found
}

/// The part of `Name(values)` in parentheses.
fn values_of(variant: &str) -> &str {
    variant.split_once('(').map_or("", |(_, values)| values)
}

/// A signature that names an item of `engine` is stable only if this item is.
#[test]
fn the_stable_interface_of_the_engine_names_only_stable_items() {
    let known: BTreeSet<String> = stated().into_iter().flat_map(|(_, names)| names).collect();
    let public = module("lightharmony::engine").public();
    let mut missing = BTreeSet::new();
    for (path, lines) in items().into_iter().filter(|(path, _)| path.starts_with("lightharmony::engine::")) {
        // A variant may have the name of a type.
        let signatures = lines.iter().map(|line| line.strip_prefix("variant ").map_or(&**line, values_of));
        for word in signatures.flat_map(|line| line.split(|c: char| !c.is_alphanumeric() && c != '_')) {
            if public.iter().any(|name| name == word) && !known.contains(word) {
                missing.insert(format!("{word} (in {path})"));
            }
        }
    }
    assert_eq!(
        missing,
        BTreeSet::new(),
        "add these to the table of docs/own-kinds.md, or remove what names them"
    );
}

/// The example crate uses nothing else.
#[test]
fn the_example_crate_uses_only_the_stable_interface() {
    let known: BTreeSet<String> = items().into_iter().map(|(path, _)| path).collect();
    let mut used = BTreeSet::new();
    for folder in ["examples/own-kinds/src", "examples/own-kinds/tests"] {
        for entry in std::fs::read_dir(workspace().join(folder)).unwrap() {
            used.extend(source::imports(&entry.unwrap().path()));
        }
    }
    used.retain(|path| path.starts_with("lightharmony::") || path.starts_with("kind_tests::"));
    // The crates themselves, and the existing kinds by their names.
    used.retain(|path| path != "lightharmony::engine" && !path.starts_with("lightharmony::nodes::kinds::"));
    assert!(used.len() > 10, "{used:?}");
    assert_eq!(used.difference(&known).collect::<Vec<_>>(), [""; 0]);
}

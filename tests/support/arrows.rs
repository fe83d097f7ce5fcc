//! Reads which files of a crate import which, for tests of its structure.
//!
//! A crate consists of *rooms*: the folders of its `src`, in a fixed order. A file may import from files of its own
//! room and of the rooms below it. Paths below `crate::`, `super::` and `self::` and below the modules that a file
//! declares are read. Comments, `$crate` in macros, `pub(in ..)` and unit tests are ignored.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The imports of each file: for `graph/check` the paths below `crate::` that it names, such as `text::diag::Code`.
pub type Imports = BTreeMap<String, BTreeSet<String>>;

/// Reads the imports of all files of a crate except `lib.rs` and `main.rs`.
pub fn imports(src: &Path) -> Imports {
    let mut found = Imports::new();
    let mut open = vec![src.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            if path.is_dir() {
                open.extend((name != "tests").then_some(path));
            } else if path.extension().is_some_and(|end| end == "rs")
                && !["lib", "main", "tests"].contains(&name.as_str())
            {
                let module =
                    path.with_extension("").strip_prefix(src).unwrap().to_string_lossy().into_owned();
                let module = module.strip_suffix("/mod").map(str::to_owned).unwrap_or(module);
                let text = std::fs::read_to_string(&path).unwrap();
                found.insert(module.clone(), paths_named(&module, &text));
            }
        }
    }
    found
}

/// The imports that lead to a room above the file's own room, or to the root of the crate, in the form `from ->
/// path`. `order` has the rooms from the lowest to the highest.
pub fn upward(imports: &Imports, order: &[&str]) -> Vec<String> {
    let height = |path: &str| {
        let room = path.split(['/', ':']).next().unwrap_or_default();
        order.iter().position(|known| *known == room).unwrap_or(order.len())
    };
    let named = imports.iter().flat_map(|(file, paths)| paths.iter().map(move |path| (file, path)));
    named
        .filter(|(file, path)| height(path) > height(file))
        .map(|(file, path)| format!("{file} -> {path}"))
        .collect()
}

/// The rooms of a crate, which are the names in its `src` except those in `others`; and the rooms in the table
/// below `heading` in `docs/architecture.md`, from the last to the first.
pub fn rooms(folder: &Path, others: &[&str], heading: &str) -> (BTreeSet<String>, Vec<String>) {
    let entries = std::fs::read_dir(folder.join("src")).unwrap();
    let names =
        entries.map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned());
    let folders = names.filter(|name| !others.contains(&name.as_str())).collect();
    let page = std::fs::read_to_string(folder.join("../docs/architecture.md")).unwrap();
    let (_, section) = page.split_once(heading).expect("a section on the crate");
    let lines =
        section.lines().skip_while(|line| !line.starts_with("| `")).take_while(|line| line.starts_with('|'));
    let mut table: Vec<String> =
        lines.map(|line| line[3..].split('`').next().unwrap_or_default().to_owned()).collect();
    table.reverse();
    (folders, table)
}

/// The groups of files that import each other in a cycle.
pub fn circles(imports: &Imports) -> Vec<Vec<String>> {
    let target = |path: &String| {
        let parts: Vec<&str> = path.split("::").collect();
        let names = (1..=parts.len()).rev().map(|length| parts[..length].join("/"));
        names.into_iter().find(|name| imports.contains_key(name))
    };
    let arrows: BTreeMap<&String, BTreeSet<String>> = imports
        .iter()
        .map(|(file, paths)| (file, paths.iter().filter_map(target).filter(|to| to != file).collect()))
        .collect();
    let reached = |from: &String| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(at) = open.pop() {
            open.extend(arrows[&at].iter().filter(|to| seen.insert((*to).clone())).cloned());
        }
        seen
    };
    let reach: BTreeMap<&String, BTreeSet<String>> =
        imports.keys().map(|file| (file, reached(file))).collect();
    let mut groups: Vec<Vec<String>> = Vec::new();
    for file in imports.keys().filter(|file| reach[file].contains(*file)) {
        let joined = groups
            .iter_mut()
            .find(|group| reach[file].contains(&group[0]) && reach[&group[0]].contains(file));
        match joined {
            Some(group) => group.push(file.clone()),
            None => groups.push(vec![file.clone()]),
        }
    }
    groups
}

/// The paths below the root of the crate that the code of a file names, in `use` items and elsewhere.
fn paths_named(module: &str, text: &str) -> BTreeSet<String> {
    let code = without_tests(text);
    let code: String =
        code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n");
    let code = without_visibility(&code);
    let mut paths = BTreeSet::new();
    for (at, word) in code.match_indices("crate::") {
        let before = code[..at].chars().next_back();
        if !before.is_some_and(|c| c == '$' || c.is_alphanumeric() || c == '_') {
            read_tree(&code[at + word.len()..], "", &mut paths);
        }
    }
    let mut parts: Vec<&str> = module.split('/').collect();
    for (at, _) in code.match_indices("super::") {
        let mut rest = &code[at..];
        // The second `super` of `super::super` belongs to the first.
        if code[..at].ends_with("super::") {
            continue;
        }
        let whole = parts.clone();
        while let Some(after) = rest.strip_prefix("super::") {
            parts.pop();
            rest = after;
        }
        read_tree(rest, &parts.join("::"), &mut paths);
        parts = whole;
    }
    let own = parts.join("::");
    for name in declared(&code).chain(["self"]) {
        let word = format!("{name}::");
        for (at, _) in code.match_indices(&word) {
            let before = code[..at].chars().next_back();
            if !before.is_some_and(|c| c.is_alphanumeric() || ['_', ':', '$'].contains(&c)) {
                let start = if name == "self" { at + word.len() } else { at };
                read_tree(&code[start..], &own, &mut paths);
            }
        }
    }
    paths
}

/// The text before the unit tests in a file. A declaration of a module in another file, `mod tests;`, ends nothing.
fn without_tests(text: &str) -> &str {
    const MARK: &str = "#[cfg(test)]\n";
    let is_module = |at: usize| {
        let line = text[at + MARK.len()..].lines().find(|line| !line.starts_with("#[")).unwrap_or_default();
        line.trim_start_matches("pub(crate) ").starts_with("mod ") && line.ends_with('{')
    };
    let end = text.match_indices(MARK).map(|(at, _)| at).find(|at| is_module(*at));
    &text[..end.unwrap_or(text.len())]
}

/// The names of the modules that a file declares, except modules within braces.
fn declared(code: &str) -> impl Iterator<Item = &str> {
    code.lines().filter(|line| !line.starts_with(' ')).filter_map(|line| {
        let (before, name) = line.strip_suffix(';')?.rsplit_once("mod ")?;
        (before.is_empty() || before.starts_with("pub")).then_some(name)
    })
}

/// Removes the paths of `pub(in ..)`, which are not imports.
fn without_visibility(code: &str) -> String {
    let mut pieces = code.split("pub(in ");
    let first = pieces.next().unwrap_or_default().to_owned();
    pieces.fold(first, |text, piece| text + piece.split_once(')').map_or(piece, |(_, rest)| rest))
}

/// Reads one tree of a `use` item, `a::{b, c::d}`, and returns the text after it.
fn read_tree<'t>(text: &'t str, above: &str, paths: &mut BTreeSet<String>) -> &'t str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start_matches([',', ' ', '\n']);
            match rest.strip_prefix('}') {
                Some(after) => return after,
                None if rest.is_empty() => return rest,
                None => {
                    let after = read_tree(rest, above, paths);
                    rest = after.trim_start_matches(|c: char| c.is_alphanumeric() || c == '_' || c == ' ');
                }
            }
        }
    }
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_' || c == '*')).unwrap_or(text.len());
    if end == 0 {
        return text.get(1..).unwrap_or_default();
    }
    let path = if above.is_empty() { text[..end].to_owned() } else { format!("{above}::{}", &text[..end]) };
    match text[end..].strip_prefix("::") {
        Some(rest) => read_tree(rest, &path, paths),
        None => {
            paths.insert(path);
            &text[end..]
        }
    }
}

/// The imports of a crate are read correctly: every form of a path, also after the declaration of tests, one import that goes up, and one circle.
#[test]
fn arrows_are_read() {
    let text = "//! crate::docs::no\nuse crate::a::{self, b::C, d::{E, F as G}};\nuse super::near;\n\
        fn f() -> crate::up::X { $crate::macros::no(); super::super::root(); }\nmod inner;\npub(crate) mod open;\n\
        use inner::{I, J};\npub(in super::super) fn g() { open::k(); a::inner::no(); self::l() }\n\
        #[cfg(test)]\n#[allow(x)]\nmod tests;\nuse crate::late::L;\n\
        #[cfg(test)]\n#[allow(x)]\nmod tests {\nuse crate::t;\n}";
    let named = paths_named("room/file", text);
    let own = ["inner::I", "inner::J", "open::k", "l"].map(|path| format!("room::file::{path}"));
    let wanted = ["a::self", "a::b::C", "a::d::E", "a::d::F", "room::near", "up::X", "root", "late::L"];
    let wanted = wanted.map(String::from).into_iter().chain(own);
    assert_eq!(named, wanted.collect());
    let file = |paths: &[&str]| paths.iter().map(|path| (*path).to_owned()).collect();
    let crate_files = Imports::from([
        ("low/a".to_owned(), file(&["low::b::X", "high::c::Y"])),
        ("low/b".to_owned(), file(&["low::a::Z"])),
        ("high/c".to_owned(), file(&["low::a::Z", "Root"])),
        ("high/d".to_owned(), file(&["low::b"])),
    ]);
    assert_eq!(upward(&crate_files, &["low", "high"]), ["high/c -> Root", "low/a -> high::c::Y"]);
    assert_eq!(circles(&crate_files), [["high/c", "low/a", "low/b"]]);
}

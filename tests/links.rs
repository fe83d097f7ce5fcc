//! Checks that links in the documentation lead to files and headings that exist, and that `docs/README.md` has a
//! link to every other page.
#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The paths of all pages, relative to the workspace.
fn pages() -> Vec<PathBuf> {
    let mut pages = vec![PathBuf::from("README.md"), PathBuf::from("CHANGELOG.md")];
    for folder in ["docs", "docs/evidence"] {
        let entries = std::fs::read_dir(workspace().join(folder)).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name());
        pages.extend(
            names
                .map(|name| Path::new(folder).join(name))
                .filter(|path| path.extension().is_some_and(|end| end == "md")),
        );
    }
    pages.sort();
    pages
}

/// The lines of a page outside fenced code.
fn prose(page: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(workspace().join(page)).unwrap();
    let mut fenced = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            lines.push(line.to_owned());
        }
    }
    lines
}

/// The anchors of the headings of a page, as GitHub makes them.
fn anchors(page: &Path) -> BTreeSet<String> {
    let heading =
        |line: &String| line.starts_with('#').then(|| line.trim_start_matches('#').trim().to_owned());
    let kept = |c: &char| c.is_alphanumeric() || " -_".contains(*c);
    let anchor =
        |heading: String| heading.to_lowercase().chars().filter(kept).collect::<String>().replace(' ', "-");
    prose(page).iter().filter_map(heading).map(anchor).collect()
}

/// The targets of the links of a page.
fn links(page: &Path) -> Vec<String> {
    let text = prose(page).join("\n");
    let target = |rest: &str| rest.split([')', ' ', '\n']).next().unwrap_or_default().to_owned();
    text.split("](").skip(1).map(target).filter(|link| !link.starts_with("http")).collect()
}

/// Returns a path without components `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(plain.pop()),
            part => plain.push(part),
        }
    }
    plain
}

#[test]
fn links_lead_to_files_and_headings() {
    let mut wrong = Vec::new();
    for page in pages() {
        for link in links(&page) {
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target =
                if file.is_empty() { page.clone() } else { plain(&page.parent().unwrap().join(file)) };
            let is_page = target.extension().is_some_and(|end| end == "md");
            let exists = workspace().join(&target).exists();
            if !exists || (is_page && !anchor.is_empty() && !anchors(&target).contains(anchor)) {
                wrong.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "links that lead nowhere:\n{}", wrong.join("\n"));
}

#[test]
fn the_index_has_every_page() {
    let index: BTreeSet<PathBuf> =
        links(Path::new("docs/README.md")).iter().map(|link| plain(&Path::new("docs").join(link))).collect();
    let pages: BTreeSet<PathBuf> = pages().into_iter().filter(|page| page.starts_with("docs")).collect();
    let missing: Vec<&PathBuf> =
        pages.iter().filter(|page| !index.contains(*page) && !page.ends_with("README.md")).collect();
    assert!(missing.is_empty(), "docs/README.md lacks {missing:?}");
}

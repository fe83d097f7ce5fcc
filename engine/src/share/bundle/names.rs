//! Checks the names of files in a bundle. They must be valid on every system and stay inside the folder of the
//! bundle.

use std::collections::BTreeSet;

use crate::value::root::BUNDLE_MARK;

/// Name of the graph file in a bundle.
pub(crate) const GRAPH: &str = "graph.ron";
/// Name of the lock file in a bundle.
pub(crate) const LOCK: &str = "graph.lock";

/// Maximum length of a name in bytes.
const LONGEST: usize = 1024;
/// Maximum length of a path component in bytes, as permitted by file systems.
const LONGEST_PART: usize = 240;
/// Names that some systems reserve for devices, in lower case.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];

/// The reason why a name is not valid in a bundle; `None` if it is valid.
pub(crate) fn wrong_name(name: &str) -> Option<&'static str> {
    if name.is_empty() || name.len() > LONGEST {
        return Some("the name is empty or longer than 1024 bytes");
    }
    // These characters have other meanings on other systems.
    if name.contains(['\\', ':', '*', '?', '"', '<', '>', '|']) || name.chars().any(char::is_control) {
        return Some("the name contains a character that some systems do not allow");
    }
    name.split('/').find_map(|part| {
        let stem = part.split('.').next().unwrap_or_default().to_lowercase();
        let numbered = stem.strip_prefix("com").or(stem.strip_prefix("lpt"));
        let device = DEVICES.contains(&stem.as_str())
            || numbered.is_some_and(|n| n.len() == 1 && n.starts_with(|c: char| c.is_ascii_digit()));
        match part {
            "" => Some("the name begins or ends with `/`, or contains `//`"),
            BUNDLE_MARK => Some("this name is reserved for marking unpacked bundles"),
            "." | ".." => Some("`.` and `..` could lead out of the folder of the bundle"),
            _ if part.len() > LONGEST_PART => Some("a part of the path is longer than 240 bytes"),
            _ if part.ends_with(['.', ' ']) => Some("a part of the path ends with a dot or a space"),
            _ if device => Some("some systems reserve this name for a device"),
            _ => None,
        }
    })
}

/// The first name that conflicts with an earlier name; `None` if there are no conflicts. Two names conflict if they
/// are equal except for case, or if one is a folder that contains the other.
pub(crate) fn clash<'n>(names: impl Iterator<Item = &'n str>) -> Option<String> {
    let (mut files, mut folders) = (BTreeSet::new(), BTreeSet::new());
    for name in names {
        let plain = name.to_lowercase();
        let parents = plain.char_indices().filter(|(_, c)| *c == '/').map(|(at, _)| plain[..at].to_owned());
        let parents: Vec<String> = parents.collect();
        if parents.iter().any(|folder| files.contains(folder)) || folders.contains(&plain) {
            return Some(name.to_owned());
        }
        folders.extend(parents);
        if !files.insert(plain) {
            return Some(name.to_owned());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_could_do_harm_are_refused() {
        for name in
            ["a", "inputs/0/garden scan.ply", "ä/ö.png", "console.txt", "com/lpt", "a.b.c", "..a", "com10"]
        {
            assert_eq!(wrong_name(name), None, "{name}");
        }
        let long = "a".repeat(241);
        for name in [
            "",
            "/",
            "/etc/passwd",
            "a/",
            "a//b",
            "..",
            "a/../b",
            "./a",
            "a/.",
            "a\\b",
            "C:a",
            "c:\\x",
            "a\0b",
            "a\nb",
            "nul",
            "a/CON.txt",
            "com1",
            ".lightharmony-bundle",
            "a/LPT9.x",
            "a.",
            "a /b",
            "x*",
            "~\u{7f}",
            &long,
        ] {
            assert!(wrong_name(name).is_some(), "{name:?}");
        }
    }

    #[test]
    fn names_that_would_be_one_file_clash() {
        let clash = |names: &[&str]| clash(names.iter().copied());
        assert_eq!(clash(&["a", "b", "c/a", "c/b"]), None);
        assert_eq!(clash(&["a", "b", "A"]).as_deref(), Some("A"));
        assert_eq!(clash(&["a", "a/b"]).as_deref(), Some("a/b"));
        assert_eq!(clash(&["x/y/z", "X/y"]).as_deref(), Some("X/y"));
        assert_eq!(clash(&["ä/b", "Ä/B"]).as_deref(), Some("Ä/B"));
    }
}

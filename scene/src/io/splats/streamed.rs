//! Streamed SOG (PlayCanvas, splat-transform `write-lod.ts`): `lod-meta.json` with a tree of regions. Each region
//! has several levels of detail; level 0 is the finest. A level of a region is a list of ranges of rows in SOG
//! files. Only one level is read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path};

use serde::Deserialize;

use crate::error::Error;
use crate::io::foreign::{json_text, portable_path, refuse_placeholder};

/// Name of the file that describes a streamed scene.
pub(super) const NAME: &str = "lod-meta.json";

/// Ranges of rows, each as (start, end), ascending and without overlap.
pub(crate) type Ranges = Vec<(usize, usize)>;

#[derive(Deserialize)]
struct Lod {
    filenames: Vec<String>,
    environment: Option<String>,
    tree: Node,
}

#[derive(Deserialize)]
struct Node {
    #[serde(default)]
    children: Vec<Node>,
    #[serde(default)]
    lods: BTreeMap<String, Span>,
}

#[derive(Deserialize)]
struct Span {
    file: usize,
    offset: u64,
    count: u64,
}

/// The files of one level, with the rows that belong to it.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct DetailLevel {
    /// Relative path of each file and its rows; `None` for all rows.
    pub files: Vec<(String, Option<Ranges>)>,
    /// Number of levels of the scene.
    pub levels: usize,
}

/// True if the bytes are the JSON of a streamed scene.
pub(super) fn is_streamed(bytes: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Peek {
        filenames: Option<serde::de::IgnoredAny>,
        tree: Option<serde::de::IgnoredAny>,
    }
    let peek: Result<Peek, _> = serde_json::from_slice(json_text(bytes));
    peek.is_ok_and(|peek| peek.filenames.is_some() && peek.tree.is_some())
}

/// Reads `lod-meta.json`. For a region without the wanted level, the nearest coarser level is used, otherwise the
/// nearest finer level.
pub(super) fn level(file: &str, bytes: &[u8], wanted: u32) -> Result<DetailLevel, Error> {
    let wrong = |what: String| Error::format(file, what);
    refuse_placeholder(file, bytes)?;
    let lod: Lod = serde_json::from_slice(json_text(bytes))
        .map_err(|e| wrong(format!("not the `{NAME}` of a streamed SOG: {e}")))?;
    let mut rows: BTreeMap<usize, Vec<(u64, u64)>> = BTreeMap::new();
    // Each region with the information whether it lies inside a region that has levels.
    let (mut levels, mut open) = (BTreeSet::new(), vec![(&lod.tree, false)]);
    while let Some((node, is_inside)) = open.pop() {
        if is_inside && !node.lods.is_empty() {
            let text =
                "a region with levels lies inside another one, so it is not known which of them to draw";
            return Err(wrong(text.to_owned()));
        }
        let is_inside = is_inside || !node.lods.is_empty();
        open.extend(node.children.iter().rev().map(|child| (child, is_inside)));
        let mut own = BTreeMap::new();
        for (name, span) in &node.lods {
            let level: u32 = name.parse().map_err(|_| wrong(format!("`{name}` is not a level number")))?;
            levels.insert(level);
            own.insert(level, span);
        }
        let coarser = own.range(wanted..).next();
        let Some((_, span)) = coarser.or_else(|| own.range(..wanted).next_back()) else { continue };
        if lod.filenames.get(span.file).is_none() {
            return Err(wrong(format!(
                "a region refers to file {}, but the number of files is {}",
                span.file,
                lod.filenames.len()
            )));
        }
        let end = span.offset.checked_add(span.count);
        let end =
            end.ok_or_else(|| wrong("a range of splats ends beyond the largest possible index".to_owned()))?;
        rows.entry(span.file).or_default().push((span.offset, end));
    }
    let finest = levels.len();
    if levels.is_empty() {
        return Err(wrong("no region of the scene has a level".to_owned()));
    }
    if levels.last().is_some_and(|coarsest| wanted > *coarsest) {
        let known: Vec<String> = levels.iter().map(u32::to_string).collect();
        return Err(wrong(format!("the scene has no level {wanted}; its levels are {}", known.join(", "))));
    }
    let mut files = Vec::new();
    for (index, spans) in rows {
        files.push((portable_path(&lod.filenames[index]), Some(joined(file, spans)?)));
    }
    files.extend(lod.environment.map(|name| (portable_path(&name), None)));
    // An untrusted scene must not refer to files elsewhere on this machine.
    for (name, _) in &files {
        if name.is_empty() || !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(wrong(format!("the scene refers to `{name}`, which is not in the same folder")));
        }
    }
    Ok(DetailLevel { files, levels: finest })
}

/// Sorts ranges and joins adjacent ranges. It is an error if ranges overlap, since regions do not share splats.
fn joined(file: &str, mut spans: Vec<(u64, u64)>) -> Result<Ranges, Error> {
    spans.sort_unstable();
    let mut all: Ranges = Vec::new();
    for (start, end) in spans.into_iter().filter(|(start, end)| start < end) {
        let beyond = |_| Error::format(file, "a range of splats ends beyond the largest possible index");
        let (start, end) = (usize::try_from(start).map_err(beyond)?, usize::try_from(end).map_err(beyond)?);
        match all.last_mut() {
            Some((_, last)) if start < *last => {
                return Err(Error::format(file, "two regions of one level share splats"));
            }
            Some((_, last)) if start == *last => *last = end,
            _ => all.push((start, end)),
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCENE: &str = r#"{"version": 1, "lodLevels": 3, "filenames": ["0_0/meta.json", "1_0/meta.json", "2_0/meta.json"],
        "tree": {"bound": {}, "children": [
            {"bound": {}, "lods": {"0": {"file": 0, "offset": 0, "count": 10}, "1": {"file": 1, "offset": 0, "count": 5}}},
            {"bound": {}, "lods": {"0": {"file": 0, "offset": 10, "count": 7}, "2": {"file": 2, "offset": 3, "count": 2}}}]}}"#;

    fn of(text: &str, wanted: u32) -> Result<Vec<(String, Option<Ranges>)>, String> {
        level("a", text.as_bytes(), wanted).map(|level| level.files).map_err(|e| e.to_string())
    }

    #[test]
    fn one_level_is_taken_of_each_place() {
        let file = |name: &str, ranges: &[(usize, usize)]| (name.to_owned(), Some(ranges.to_vec()));
        assert_eq!(of(SCENE, 0), Ok(vec![file("0_0/meta.json", &[(0, 17)])]));
        // The second place lacks level 1: its coarser one stands for it.
        assert_eq!(
            of(SCENE, 1),
            Ok(vec![file("1_0/meta.json", &[(0, 5)]), file("2_0/meta.json", &[(3, 5)])])
        );
        // The first place lacks level 2 and coarser ones.
        assert_eq!(
            of(SCENE, 2),
            Ok(vec![file("1_0/meta.json", &[(0, 5)]), file("2_0/meta.json", &[(3, 5)])])
        );
        // The finest level that exists.
        let coarse =
            SCENE.replace("\"0\":", "\"4\":").replace("\"1\":", "\"3\":").replace("\"2\":", "\"5\":");
        let finest = of(&coarse, 0).expect("is read");
        assert_eq!(finest, vec![file("0_0/meta.json", &[(10, 17)]), file("1_0/meta.json", &[(0, 5)])]);
        // Exporters on Windows write backslashes.
        let windows = SCENE.replace("0_0/meta.json", "0_0\\\\meta.json");
        assert_eq!(of(&windows, 0), Ok(vec![file("0_0/meta.json", &[(0, 17)])]));
        let sky = SCENE.replace("\"tree\"", "\"environment\": \"env\\\\meta.json\", \"tree\"");
        assert_eq!(of(&sky, 0).map(|files| files[1].clone()), Ok(("env/meta.json".to_owned(), None)));
    }

    #[test]
    fn wrong_scenes_are_errors() {
        for (from, to, says) in [
            ("\"0_0/meta.json\"", "\"../0_0/meta.json\"", "not in the same folder"),
            ("\"0_0/meta.json\"", "\"/etc/passwd\"", "not in the same folder"),
            ("\"0_0/meta.json\"", "\"..\\\\0_0\\\\meta.json\"", "not in the same folder"),
            (
                "\"file\": 0, \"offset\": 0",
                "\"file\": 9, \"offset\": 0",
                "refers to file 9, but the number of files is 3",
            ),
            ("\"offset\": 10", "\"offset\": 9", "share splats"),
            ("\"offset\": 10", "\"offset\": 18446744073709551615", "beyond the largest possible index"),
            ("\"0\":", "\"x\":", "is not a level number"),
            ("\"tree\"", "\"bush\"", "not the `lod-meta.json`"),
        ] {
            let text = SCENE.replace(from, to);
            assert_ne!(text, SCENE);
            let error = of(&text, 0).expect_err(to);
            assert!(error.contains(says), "{error}");
        }
        let empty = r#"{"filenames": ["0_0/meta.json"], "tree": {"bound": {}}}"#;
        assert!(of(empty, 0).is_err_and(|e| e.contains("no region of the scene has a level")));
        let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 3\n";
        assert!(of(pointer, 0).is_err_and(|e| e.contains("git lfs pull")));
        assert!(of(SCENE, 3).is_err_and(|e| e.contains("its levels are 0, 1, 2")));
        let nested = SCENE.replacen(
            "\"bound\": {}, ",
            "\"lods\": {\"1\": {\"file\": 1, \"offset\": 9, \"count\": 1}}, ",
            1,
        );
        assert!(of(&nested, 0).is_err_and(|e| e.contains("lies inside another one")));
        assert!(is_streamed(SCENE.as_bytes()) && !is_streamed(b"{\"means\": 1}"));
        // A tree that is too deep causes an error in the parser, not a stack overflow.
        let deep = format!("{}{}", "{\"children\":[".repeat(5000), "{}");
        assert!(level("a", format!("{{\"filenames\": [], \"tree\": {deep}").as_bytes(), 0).is_err());
    }

    /// A damaged `lod-meta.json` gives an error or ascending ranges of rows.
    #[test]
    fn damaged_descriptions_are_survived() {
        let mut seed = 1_u64;
        for _ in 0..5000 {
            let mut bytes = SCENE.as_bytes().to_vec();
            for _ in 0..3 {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let at = (seed >> 33) as usize % bytes.len();
                match seed >> 62 {
                    0 => bytes[at] ^= 1 << (seed >> 50 & 7),
                    1 => drop(bytes.splice(at..at, b"9".iter().copied())),
                    2 => drop(bytes.remove(at)),
                    _ => bytes[at] = b'0' + (seed >> 55 & 7) as u8,
                }
            }
            for (_, ranges) in level("a", &bytes, 0).map(|level| level.files).unwrap_or_default() {
                let ranges = ranges.unwrap_or_default();
                assert!(ranges.windows(2).all(|pair| pair[0].1 < pair[1].0));
            }
        }
    }
}

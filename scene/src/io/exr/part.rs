//! Selection of a part of an OpenEXR file.

use exr::meta::header::Header;

/// Name of the part that a header describes; empty if it has no name.
pub(super) fn part_name(header: &Header) -> String {
    header.own_attributes.layer_name.as_ref().map_or_else(String::new, ToString::to_string)
}

/// Content of a part, as its name states it; the first in this order is preferred.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Content {
    /// The finished picture.
    Picture,
    /// The name says nothing.
    Unknown,
    /// A part of the light or of the material, such as `albedo`.
    Pass,
    /// Vectors, distances and identifiers, which may be stored as R, G and B.
    Data,
}

/// Names that programs give to parts, as Arnold, Blender, Karma, RenderMan, V-Ray and Nuke do.
const NAMES: [(Content, &[&str]); 3] = [
    (
        Content::Picture,
        &[
            "beauty",
            "c",
            "color",
            "colour",
            "combined",
            "composite",
            "image",
            "main",
            "master",
            "rgb",
            "rgba",
        ],
    ),
    (
        Content::Pass,
        &[
            "albedo",
            "alpha",
            "ambient",
            "ao",
            "background",
            "basecolor",
            "coat",
            "diffcol",
            "diffdir",
            "diffind",
            "diffuse",
            "direct",
            "emission",
            "emit",
            "env",
            "environment",
            "gi",
            "gloss",
            "glosscol",
            "glossdir",
            "glossind",
            "glossy",
            "indirect",
            "light",
            "lighting",
            "mask",
            "matte",
            "noise",
            "occlusion",
            "reflection",
            "refraction",
            "shadow",
            "sheen",
            "specular",
            "sss",
            "subsurface",
            "transcol",
            "transdir",
            "transind",
            "transmission",
            "variance",
            "volume",
        ],
    ),
    (
        Content::Data,
        &[
            "crypto",
            "depth",
            "id",
            "ids",
            "motion",
            "motionvector",
            "motionvectors",
            "n",
            "ng",
            "normal",
            "normals",
            "ns",
            "p",
            "point",
            "points",
            "pos",
            "position",
            "positions",
            "pref",
            "pworld",
            "st",
            "tangent",
            "tangents",
            "uv",
            "uvs",
            "vector",
            "vectors",
            "velocity",
            "z",
            "zdepth",
        ],
    ),
];

/// The content of a part by the last of the words of its name. A word before it may make a picture a pass, such as
/// `diffuse_color`.
fn content(name: &str) -> Content {
    let lower = name.to_ascii_lowercase();
    if lower.contains("cryptomatte") {
        return Content::Data;
    }
    let of_word = |word: &str| {
        let word = word.trim_end_matches(|c: char| c.is_ascii_digit());
        let found = NAMES.iter().find(|(_, names)| names.contains(&word));
        found.map_or(Content::Unknown, |(content, _)| *content)
    };
    let mut words = lower.rsplit(['.', '/', ' ', '_']).map(of_word);
    match words.next() {
        Some(Content::Picture) if words.any(|word| word == Content::Pass) => Content::Pass,
        last => last.unwrap_or(Content::Unknown),
    }
}

/// The colours of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Colours {
    /// R, G and B without a layer.
    Plain,
    /// R, G and B in a layer with the name of the part, as some programs write them.
    Named,
    /// A grey channel Y without a layer, which is not the Y of a vector.
    Grey,
}

/// The colours of a part that are read if no layer is named; `None` if it has none.
fn colours(header: &Header) -> Option<Colours> {
    let has = |name: &str| header.channels.list.iter().any(|channel| channel.name.eq(name));
    let holds = |prefix: &str| {
        let all = |letters: [&str; 3]| letters.iter().all(|letter| has(&format!("{prefix}{letter}")));
        all(["R", "G", "B"]) || all(["r", "g", "b"])
    };
    if holds("") {
        Some(Colours::Plain)
    } else if has("Y") && !has("X") {
        Some(Colours::Grey)
    } else {
        holds(&format!("{}.", part_name(header))).then_some(Colours::Named)
    }
}

/// Name of the layer of the colours of a part.
fn layer_of(header: &Header) -> String {
    if colours(header) == Some(Colours::Named) { part_name(header) } else { String::new() }
}

/// The part of a file that contains a layer, and the name of the layer within the part. An empty name selects a flat
/// part: the first with R, G and B; else the first with R, G and B in a layer with the name of the part; else the
/// first with Y; else the first. Of parts that have colours, those whose names are those of a finished picture, such as
/// `beauty`, come first; parts of light or material, such as `albedo`, come late, and data, such as `N` or `depth`, last.
/// Any other name is the name of a layer in any part, the name of a part, or both, separated by a
/// dot or a slash.
pub fn choose_part<'a>(headers: &'a [Header], layer: &str) -> Option<(&'a Header, String)> {
    let flat = || headers.iter().filter(|header| !header.deep);
    let first = flat().next()?;
    if layer.is_empty() {
        let rank = |header: &Header| colours(header).map(|colours| (content(&part_name(header)), colours));
        // The first of several that are equal.
        let best = flat().filter(|header| rank(header).is_some()).min_by_key(|header| rank(header));
        return Some(best.map_or((first, String::new()), |header| (header, layer_of(header))));
    }
    let holds = |header: &&Header, name: &str| {
        let channels = header.channels.list.iter().map(|channel| channel.name.to_string());
        channels.into_iter().any(|channel| {
            channel == name || channel.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'))
        })
    };
    if let Some(header) = flat().find(|header| holds(header, layer)) {
        return Some((header, layer.to_owned()));
    }
    for header in flat() {
        let name = part_name(header);
        let Some(rest) = layer.strip_prefix(&*name).filter(|_| !name.is_empty()) else { continue };
        if let [only] = &*header.channels.list
            && rest.is_empty()
        {
            return Some((header, only.name.to_string()));
        }
        if rest.is_empty() {
            return Some((header, layer_of(header)));
        }
        if let Some(rest) = rest.strip_prefix(['.', '/'])
            && holds(&header, rest)
        {
            return Some((header, rest.to_owned()));
        }
    }
    Some((first, layer.to_owned()))
}

//! Writing the graph of all cases, with the files that it uses.

use std::path::{Path, PathBuf};

use scene::io::exr::{self, Channel, Depth};
use scene::types::Picture;

use crate::error::Error;
use crate::graph::{Composed, dim_path};
use crate::method::BUILT_IN;
use crate::set::Set;

/// Files of the graph, except the graph itself and the light of the cases.
const PARTS: [(&str, &str); 5] = [
    ("method.ron", BUILT_IN),
    ("bench-case.ron", include_str!("../../graphs/parts/bench-case.ron")),
    ("bench-light.ron", include_str!("../../graphs/parts/bench-light.ron")),
    ("bench-baselines.ron", include_str!("../../graphs/parts/bench-baselines.ron")),
    ("bench-score.ron", include_str!("../../graphs/parts/bench-score.ron")),
];

/// Writes the graph, the files that it uses, and the light of each case clipped at white. Returns the path of the
/// graph.
///
/// # Errors
/// If a light cannot be decoded or a file cannot be written.
pub fn write(made: &Composed, set: &Set, folder: &Path) -> Result<PathBuf, Error> {
    for (name, text) in PARTS {
        cache::publish_file(&folder.join(name), text.as_bytes())?;
    }
    for (_, case) in set.cases.iter().enumerate().filter(|(at, _)| made.scored.iter().any(|s| s.case == *at))
    {
        cache::publish_file(&dim_path(folder, case), &dimmed(&case.light)?)?;
    }
    let path = folder.join("bench.ron");
    cache::publish_file(&path, made.text.as_bytes())?;
    Ok(path)
}

/// The panorama in a file with each channel limited to 1, as OpenEXR.
fn dimmed(path: &Path) -> Result<Vec<u8>, Error> {
    let wrong = |why: String| Error::Picture { path: path.display().to_string(), why };
    let bytes = std::fs::read(path).map_err(|error| wrong(error.to_string()))?;
    let picture: Picture = scene::io::picture::of_bytes(&path.display().to_string(), &bytes)
        .map_err(|error| wrong(error.to_string()))?;
    let (width, height, channels) = picture.size();
    if channels < 3 {
        return Err(wrong("has no channels R, G and B".to_owned()));
    }
    let plane = |channel: usize| -> Vec<f32> {
        picture.samples().chunks_exact(channels).map(|pixel| pixel[channel].clamp(0.0, 1.0)).collect()
    };
    let planes = ["R", "G", "B"]
        .into_iter()
        .enumerate()
        .map(|(at, name)| (Channel { name: name.to_owned(), samples: plane(at) }, Depth::Float))
        .collect();
    let (bytes, _) =
        exr::write(width, height, planes, "linear", None).map_err(|error| wrong(error.to_string()))?;
    Ok(bytes)
}

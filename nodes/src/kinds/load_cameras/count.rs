//! Number of cameras of a file, counted before the node runs.

use std::io::Read;

use engine::{InputFile, NodeError, SourceRoot};
use scene::io::capture::colmap;

use super::files::{files, is_gltf, is_json};

/// Maximum number of cameras in a file.
pub const CAMERA_LIMIT: usize = 1_000_000;
/// Maximum size in bytes of a COLMAP text that is read completely to count its cameras before the run. In a larger
/// text, lines are counted.
pub const READ_WHOLE: u64 = 4 << 20;

/// Number of images of a binary COLMAP model, read from the start of its file. `None` for other files, and if the
/// number exceeds the limit on cameras.
pub fn images_of(path: &InputFile, root: &SourceRoot) -> Option<usize> {
    if is_json(path) || is_gltf(path) {
        return None;
    }
    let named = files(path, root).ok()?;
    let images = named.iter().find(|file| file.0.ends_with("images.bin"))?;
    let mut count = [0; 8];
    std::fs::File::open(root.file(images).path).ok()?.read_exact(&mut count).ok()?;
    usize::try_from(u64::from_le_bytes(count)).ok().filter(|count| (1..=CAMERA_LIMIT).contains(count))
}

/// Total size in bytes of the files that are read completely to load the cameras. Of pictures, only the head is
/// read.
pub fn read_bytes(
    path: &InputFile,
    dataparser: Option<&InputFile>,
    root: &SourceRoot,
) -> Result<u64, NodeError> {
    let named = if is_json(path) || is_gltf(path) { vec![path.clone()] } else { files(path, root)? };
    let size = |file: &InputFile| std::fs::metadata(root.file(file).path).map_or(0, |data| data.len());
    Ok(named.iter().chain(dataparser).map(size).fold(0, u64::saturating_add))
}

/// Number of images in the `images.txt` of a COLMAP model, which is read line by line. `None` for other files, if
/// the file cannot be read, and if it has no image or more images than the limit.
pub fn lines_of_images(path: &InputFile, root: &SourceRoot) -> Option<usize> {
    if is_json(path) || is_gltf(path) {
        return None;
    }
    let named = files(path, root).ok()?;
    let images = named.iter().find(|file| file.0.ends_with("images.txt"))?;
    let file = std::fs::File::open(root.file(images).path).ok()?;
    let count = colmap::count_images(&mut std::io::BufReader::new(file)).ok()?;
    (1..=CAMERA_LIMIT).contains(&count).then_some(count)
}

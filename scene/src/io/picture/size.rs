//! Sizes of pictures, from their headers.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use engine::FileHead;

use crate::io::head::Head;

/// Reads the head of a picture; `None` for files that are not pictures.
pub fn head_of(file: &FileHead<'_>) -> Option<Head> {
    file.open().and_then(|mut reader| Head::read(&mut reader))
}

/// Two sizes in bytes: the peak memory for reading a picture, including the bytes of the file, and the size of the
/// resulting floats.
pub fn floats_of(file: &FileHead<'_>) -> [u64; 2] {
    let [reading, floats] = head_of(file).map_or([0; 2], |head| head.as_floats());
    [reading.saturating_add(file.bytes), floats]
}

/// Width and height of the picture in a file when it is upright, from its header; `None` for files that are not
/// pictures.
pub fn upright_size(path: &Path) -> Option<[u64; 2]> {
    let head = Head::read(&mut BufReader::new(File::open(path).ok()?))?;
    let [width, height] = head.size;
    Some(if head.is_quarter_turned { [height, width] } else { [width, height] })
}

/// Width and height of the picture in a file as it is stored, from its header; `None` for files that are not
/// pictures.
pub fn size(path: &Path) -> Option<[u64; 2]> {
    Head::read(&mut BufReader::new(File::open(path).ok()?)).map(|head| head.size)
}

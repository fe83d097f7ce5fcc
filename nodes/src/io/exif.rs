//! EXIF metadata of PNG and JPEG.

use image::metadata::Orientation;

/// Text about the orientation that EXIF data state; `None` if it is upright or not stated.
pub(super) fn other_orientation(exif: &[u8]) -> Option<String> {
    let exif = exif.strip_prefix(b"Exif\0\0").unwrap_or(exif);
    let turned = Orientation::from_exif_chunk(exif).is_some_and(|turn| turn != Orientation::NoTransforms);
    turned.then(|| "an orientation other than upright (EXIF)".to_owned())
}

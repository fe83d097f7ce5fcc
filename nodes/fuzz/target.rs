//! The body of every fuzz target: reads a file and checks the guarantees of the reader.

pub mod file;

use engine::{Context, Scene, Up};
use scene::io::splats::{Frame, from_bytes};

/// Reads `head` followed by `data` as one file. The result must be an error, or a scene that contains only finite
/// numbers and no more splats than the file can hold. Returns true if the file was read.
pub fn read(head: &[u8], data: &[u8]) -> bool {
    let bytes = [head, data].concat();
    let cx =
        Context::detached(Scene { up: Up::MinusY, metres_per_unit: 1.0, seed: 0, exhaustive: false }, ".");
    let Ok((splats, _)) = from_bytes("fuzz", &bytes, Frame::ByFormat, &cx) else { return false };
    let numbers = [splats.means.as_flattened(), splats.scales.as_flattened(), splats.quats.as_flattened()];
    let others = [splats.sh.as_flattened(), splats.opacities.as_slice()];
    assert!(numbers.iter().chain(&others).copied().flatten().all(|v| v.is_finite()));
    assert_eq!(splats.sh.len(), splats.len() * splats.sh_len());
    // Formats without compression use at least 1.5 bits per splat. In the others a splat has at least 19 bytes, which
    // deflate and zstd compress by at most 1024 to 1.
    assert!(splats.len() <= bytes.len() * 64);
    true
}

/// Decodes a picture of any format. All samples must be finite. Returns true if it was decoded.
pub fn picture(data: &[u8]) -> bool {
    let Ok(picture) = scene::io::picture::of_bytes("fuzz", data) else { return false };
    let (width, height, channels) = picture.size();
    assert_eq!(picture.samples().len(), width * height * channels);
    assert!(picture.samples().iter().all(|v| v.is_finite()));
    true
}

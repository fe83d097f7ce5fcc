//! What bounds of light share.

/// Boxes of the receiver that are looked into to find what of it a tile sees.
pub(crate) const LOOKS: u32 = 256;

/// The greater of two radiances, for each channel.
pub(crate) fn greatest_of(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k].max(b[k]))
}

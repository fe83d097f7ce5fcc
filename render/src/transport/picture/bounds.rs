//! Items that the bounds in `crop` and `near_crop` share.

/// Maximum number of BVH nodes that are opened to find the visible part of the receiver.
pub(crate) const LOOKS: u32 = 256;

/// Maximum of two radiances, per channel.
pub(crate) fn greatest_of(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k].max(b[k]))
}

//! The samples of a picture.

/// Samples of a picture to compare: interleaved channels, row by row.
pub struct Plane {
    /// Width, in pixels.
    pub width: usize,
    /// Height, in pixels.
    pub height: usize,
    /// Number of samples per pixel.
    pub channels: usize,
    /// The samples, row by row.
    pub samples: Vec<f64>,
}

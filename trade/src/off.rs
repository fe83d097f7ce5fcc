//! The error of a picture in one region.

use std::collections::BTreeMap;

/// The error of one view of a picture in one region.
#[derive(Debug, Clone)]
pub struct Off {
    /// Name of the picture.
    pub output: String,
    /// Name of the view.
    pub view: String,
    /// `whole`, `touched`, `object` or `shadow`.
    pub region: String,
    /// The judged picture: `image`, or a baseline.
    pub judged: String,
    /// Number of pixels of the region.
    pub pixels: u64,
    /// By column of `compare`.
    pub values: BTreeMap<String, f64>,
    /// True if a missing value leaves the error unknown; false if that was reported before.
    pub counts: bool,
}

impl Off {
    /// The value of a column: of FLIP that of HDR-FLIP, where the picture is judged in linear light.
    pub fn value(&self, column: &str) -> Option<f64> {
        self.values.get(column).or_else(|| self.values.get(&format!("hdr-{column}"))).copied()
    }
}

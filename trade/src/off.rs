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
    /// Name of the judged picture: `image`, or a baseline.
    pub judged: String,
    /// Number of pixels of the region.
    pub pixels: u64,
    /// Values, by the names of the columns of `compare`.
    pub values: BTreeMap<String, f64>,
    /// True if a missing value makes the error of the whole point unknown; false if it was reported that the metric
    /// cannot be computed for this picture.
    pub counts: bool,
}

impl Off {
    /// The value of a column. For FLIP, it is the value of HDR-FLIP if the picture is judged in linear light.
    pub fn value(&self, column: &str) -> Option<f64> {
        self.values.get(column).or_else(|| self.values.get(&format!("hdr-{column}"))).copied()
    }
}

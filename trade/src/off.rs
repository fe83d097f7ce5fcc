//! [`Off`]: the error of one picture in one region.

use std::collections::BTreeMap;

/// The error of one view of a picture in one region.
#[derive(Debug, Clone)]
pub struct Off {
    /// Name of the picture; see [`Output::name`](crate::judge::Output::name).
    pub output: String,
    /// Name of the view.
    pub view: String,
    /// Name of the region: `whole`, `touched`, `object` or `shadow`.
    pub region: String,
    /// Name of the picture that is compared with the reference: `image` for the picture itself, or the name of a
    /// baseline.
    pub judged: String,
    /// Number of pixels in the region.
    pub pixels: u64,
    /// Values of the metrics, by the names of the columns of `compare`.
    pub values: BTreeMap<String, f64>,
    /// True if a missing value makes the error of the whole point unknown. False if the user was informed that the
    /// metric cannot be computed for this picture.
    pub counts: bool,
}

impl Off {
    /// The value of a column. For the FLIP column, this is the value of HDR-FLIP if the picture is scored in linear
    /// light.
    pub fn value(&self, column: &str) -> Option<f64> {
        self.values.get(column).or_else(|| self.values.get(&format!("hdr-{column}"))).copied()
    }
}

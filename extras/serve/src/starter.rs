//! [`Starter`]: the first graph of a captured place.

use serde::{Deserialize, Serialize};

/// Writes the first graph of a capture, for a page that starts without an object.
pub trait Starter: Send + Sync {
    /// The assumptions about the capture, such as the axis that points up.
    fn proposals(&self) -> Vec<Proposal>;

    /// Names of the files of objects that can be put into the place. A page chooses one of these names.
    fn objects(&self) -> Vec<String>;

    /// The text of a graph with an object at a place.
    ///
    /// # Errors
    /// A text for the user, for instance if the file of the object is damaged.
    fn graph(&self, object: &str, stand: &Stand) -> Result<String, String>;
}

/// An assumption about a capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Proposal {
    /// The property, such as `up`.
    pub what: String,
    /// Its value, and how it was found.
    pub value: String,
}

/// Where an object stands, and the camera that shows it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stand {
    /// Point that the object stands on, in world units.
    pub place: [f64; 3],
    /// Position of the camera, in world units.
    pub eye: [f64; 3],
    /// Point in the middle of its picture, in world units.
    pub target: [f64; 3],
    /// Vertical field of view in degrees.
    pub fov_y_deg: f64,
}

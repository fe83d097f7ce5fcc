//! [`Starter`]: the first graph of a captured place.

use engine::Graph;
use serde::{Deserialize, Serialize};

/// Writes the first graph of a capture, for a page that starts without an object.
pub trait Starter: Send + Sync {
    /// The properties of the capture in `now`, the graph that shows it without an object.
    fn bare(&self, now: &Graph) -> Bare;

    /// Names of the files of objects that can be put into the place. A page chooses one of these names.
    fn objects(&self) -> Vec<String>;

    /// The text of a graph with an object at a place. The axis that points up and the scale are those of `now`, the
    /// graph that shows the capture without an object.
    ///
    /// # Errors
    /// A text for the user, for instance if the file of the object is damaged.
    fn graph(&self, now: &Graph, object: &str, stand: &Stand) -> Result<String, String>;

    /// The text of a graph that shows the capture without an object, rotated so that an axis of the capture points up.
    /// `up` is the name of the axis, one of [`AXES`].
    ///
    /// # Errors
    /// A text for the user, for instance if the file of the capture cannot be read.
    fn turned(&self, now: &Graph, up: &str) -> Result<String, String>;
}

/// Names of the axes of a capture that can point up.
pub const AXES: [&str; 6] = ["+x", "-x", "+y", "-y", "+z", "-z"];

/// Properties of a capture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bare {
    /// The assumptions about the capture, such as the axis that points up.
    pub proposals: Vec<Proposal>,
    /// The axis of the capture that points up, one of [`AXES`]; `None` if none of them does.
    pub up: Option<&'static str>,
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

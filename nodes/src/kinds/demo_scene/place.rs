//! A demo place: its surfaces, its light, and where things are in it. Metres, right-handed, z up, y
//! forward, x right; the inserted object stands at (0, 0, `stand`).

use glam::DVec3;

use super::light::{Lamp, Opening, Sky};
use super::shape::Shapes;

/// Everything about a place that the rest is made from.
pub(super) struct Layout {
    pub shapes: Shapes,
    pub sky: Sky,
    pub opening: Option<Opening>,
    pub lamp: Option<Lamp>,
    /// Height of what the object stands on.
    pub stand: f64,
    /// Corners of the box that holds the place; a room is closed by it in the proxy.
    pub bounds: [DVec3; 2],
    /// Where the camera stands and looks, and its vertical field of view in degrees.
    pub eye: DVec3,
    pub target: DVec3,
    pub fov_y_deg: f64,
    /// Where the cameras of the capture stood; each looks about level, past the middle.
    pub captures: Vec<DVec3>,
    /// Radius of a dome of sky around the place, where it is open.
    pub dome: Option<f64>,
}

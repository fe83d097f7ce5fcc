//! Demo scene: its surfaces, its light, and the positions of its objects. Coordinates are metres,
//! right-handed, z up, y forward, x right. The inserted object stands at (0, 0, `stand`).

use glam::DVec3;

use super::light::{Lamp, Opening, Sky};
use super::shape::Shapes;

/// Description of a scene, from which all outputs are made.
pub(super) struct Layout {
    pub shapes: Shapes,
    pub sky: Sky,
    pub opening: Option<Opening>,
    pub lamp: Option<Lamp>,
    /// Height of the surface that the object stands on.
    pub stand: f64,
    /// Corners of the box that contains the place. The proxy of a room is closed by this box.
    pub bounds: [DVec3; 2],
    /// Position and target of the camera, and its vertical field of view in degrees.
    pub eye: DVec3,
    pub target: DVec3,
    pub fov_y_deg: f64,
    /// Positions of the cameras of the capture. Each looks roughly horizontally, past the middle of the
    /// place.
    pub captures: Vec<DVec3>,
    /// Radius of a dome of sky around the place, where it is open.
    pub dome: Option<f64>,
}

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
    /// Position of the camera.
    pub eye: DVec3,
    /// Point that the camera looks at.
    pub target: DVec3,
    /// Vertical field of view of the camera, in degrees.
    pub fov_y_deg: f64,
    /// Positions of the cameras of the capture. Each looks roughly horizontally, past the middle of the
    /// place.
    pub captures: Vec<DVec3>,
    /// Radius of the dome of sky around an open place; `None` for a room.
    pub dome: Option<f64>,
}

//! The ground along a ray, for placing objects and for looking around.

use engine::Context;
use glam::DVec3;
use render::pick::{on_mesh, on_splats};
use scene::math::equirect::axes;
use scene::types::Camera;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::live::Live;
use crate::thing::Thing;

/// A ray, and the value that it may hit.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ray {
    /// Digest of a mesh or of splats.
    digest: String,
    /// Start of the ray, in world units.
    eye: [f64; 3],
    /// Direction of the ray, of any length above 0.
    way: [f64; 3],
    /// Focal length of the view in pixels, which determines the area around the ray over which splats count.
    focal_px: f64,
}

/// The first surface along a ray: its position, its normal, and the angle between the normal and up in degrees. The
/// error is a text for the user.
pub fn ground(live: &Live, ray: &Ray) -> Result<Value, String> {
    let (eye, way) = (DVec3::from_array(ray.eye), DVec3::from_array(ray.way));
    let forward = way.try_normalize().ok_or("the ray has no direction")?;
    if !(eye.is_finite() && ray.focal_px > 0.0 && ray.focal_px < 1e7) {
        return Err("the ray is not finite".to_owned());
    }
    let scene = live.with_state(|state| state.graph.as_ref().map(|graph| graph.scene));
    let scene = scene.ok_or("the graph has mistakes")?;
    let up = axes(scene.up)[2];
    let right = forward.any_orthonormal_vector();
    let camera = Camera::centred("view", [1, 1], ray.focal_px, [right, forward.cross(right), forward], eye);
    let thing = live.thing(&ray.digest).ok_or("this value is not in the cache any more")?;
    let picked = match &*thing {
        Thing::Mesh(mesh) => on_mesh(mesh, &camera, [0.5, 0.5]),
        Thing::Splats(splats) => on_splats(splats, &camera, [0.5, 0.5], &Context::detached(scene, "")),
        _ => return Err("this value has no surface".to_owned()),
    };
    let picked = picked.map_err(|_| "there is no surface along this ray".to_owned())?;
    let steep = scene::math::num::atan2(picked.normal.cross(up).length(), picked.normal.dot(up)).to_degrees();
    Ok(
        json!({"position": picked.position.to_array(), "normal": picked.normal.to_array(), "steep_deg": steep}),
    )
}

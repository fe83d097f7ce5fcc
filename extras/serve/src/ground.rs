//! The ground along a ray, for placing objects and for looking around.

use engine::Context;
use glam::DVec3;
use render::pick::{Picked, on_mesh, on_splats};
use scene::math::equirect::axes;
use scene::math::num;
use scene::types::Camera;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::live::Live;
use crate::thing::Thing;

/// Factor of the width of the area over which the normal of splats is taken a second time.
const WIDER: f64 = 6.0;

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
    let camera =
        |focal_px| Camera::centred("view", [1, 1], focal_px, [right, forward.cross(right), forward], eye);
    let steep = |normal: DVec3| num::atan2(normal.cross(up).length(), normal.dot(up)).to_degrees();
    let thing = live.thing(&ray.digest).ok_or("this value is not in the cache any more")?;
    let picked = match &*thing {
        Thing::Mesh(mesh) => on_mesh(mesh, &camera(ray.focal_px), [0.5, 0.5]),
        Thing::Splats(splats) => {
            let at =
                |focal_px| on_splats(splats, &camera(focal_px), [0.5, 0.5], &Context::detached(scene, ""));
            // Grass and gravel are steep from pixel to pixel, and level over a larger area.
            at(ray.focal_px).map(|one| {
                let wide = at(ray.focal_px / WIDER).map_or(one.normal, |wide| wide.normal);
                let normal = if steep(wide) < steep(one.normal) { wide } else { one.normal };
                Picked { normal, ..one }
            })
        }
        _ => return Err("this value has no surface".to_owned()),
    };
    let picked = picked.map_err(|_| "there is no surface along this ray".to_owned())?;
    let steep = steep(picked.normal);
    Ok(
        json!({"position": picked.position.to_array(), "normal": picked.normal.to_array(), "steep_deg": steep}),
    )
}

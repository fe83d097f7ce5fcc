//! Objects partly embedded in a rough surface that they do not stand on, such as a picture on a captured
//! wall.

use crate::geometry::bvh::Ray;
use crate::geometry::sampling::{Points, unit};
use crate::transport::scene::objects::Objects;
use crate::transport::scene::receiver::Receiver;

/// Number of sample points on each object.
const PLACES: u32 = 256;
/// Range of hidden shares that are reported. If the share is smaller, only an edge is hidden; if it is larger, the
/// object is inside a wall.
const REPORTED: std::ops::Range<f64> = 0.05..0.95;

/// The part of an object that is embedded in the receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Embedded {
    /// Share that the receiver hides from the first camera, among the parts of the object's surface that face this
    /// camera.
    pub share: f64,
    /// Maximum depth of the object's surface inside the receiver, measured along the normals of the object, in
    /// world units.
    pub depth: f32,
}

impl Embedded {
    /// Measures how much of an object is hidden, with rays of length `near` from sample points on the object
    /// towards the first camera. Only points that face the camera are used. `None` if the hidden share is outside
    /// [`REPORTED`].
    pub(crate) fn of(objects: &Objects, index: usize, receiver: &Receiver, near: f32) -> Option<Self> {
        let triangles: Vec<u32> = objects.triangles_of(index).collect();
        let area = |triangle: &u32| {
            let [a, b, c] = objects.corners[*triangle as usize].map(|p| p.as_dvec3());
            let area = (b - a).cross(c - a).length();
            if area.is_finite() { area } else { 0.0 }
        };
        let areas: Vec<f64> = triangles.iter().map(area).collect();
        let all = areas.iter().fold(0.0, |sum, area| sum + area);
        let (mut facing, mut behind, mut depth) = (0_u32, 0_u32, 0.0_f32);
        let (mut at, mut passed) = (0, 0.0);
        for number in 0..PLACES {
            let goal = all * (f64::from(number) + 0.5) / f64::from(PLACES);
            while at + 1 < triangles.len() && passed + areas[at] < goal {
                passed += areas[at];
                at += 1;
            }
            let triangle = *triangles.get(at)?;
            let [u, v] = Points::new(0, number).bits(0).map(unit);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let [a, b, c] = objects.corners[triangle as usize];
            let place = a + (b - a) * u + (c - a) * v;
            // The origin is the first camera.
            let (way, normal) = (-place, objects.normal(triangle));
            let cosine = normal.dot(way.normalize_or_zero());
            let double_sided = objects.part(triangle).3.double_sided;
            let cosine = if double_sided { cosine.abs() } else { cosine };
            if cosine <= 0.1 {
                continue;
            }
            let to_camera = Ray { t_max: way.length(), ..Ray::new(place, way.normalize_or_zero()) };
            // Back faces inside a body do not face the camera, even if the material is two-sided.
            let apart = 1e-4 * to_camera.t_max;
            if double_sided && objects.bvh.any(to_camera, |hit| hit.triangle != triangle && hit.t > apart) {
                continue;
            }
            facing += 1;
            let ray = Ray { t_max: near.min(to_camera.t_max), ..to_camera };
            if let Some(hit) = receiver.bvh.closest(ray, |_| true) {
                behind += 1;
                depth = depth.max(hit.t * cosine);
            }
        }
        let share = f64::from(behind) / f64::from(facing.max(1));
        REPORTED.contains(&share).then_some(Self { share, depth })
    }
}

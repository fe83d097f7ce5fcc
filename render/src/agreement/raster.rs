//! Depths of a mesh in a small picture, by rasterization. Building a tree for ray casting would not pay off, since
//! each mesh is drawn in only a few pictures.

use glam::{DMat4, DVec3};
use scene::types::{Camera, Mesh};

/// Planar depth of the nearest triangle at the centre of each pixel, in world units; +inf where there is no
/// triangle. Triangles are visible from both sides. Parts nearer than `near` are cut away. `world_from_mesh` places
/// the mesh.
pub(super) fn depths(mesh: &Mesh, world_from_mesh: &DMat4, camera: &Camera, near: f64) -> Vec<f64> {
    let (width, height) = (camera.width_px as usize, camera.height_px as usize);
    let to_camera = camera.camera_from_world() * *world_from_mesh;
    let points: Vec<DVec3> =
        (0..mesh.positions.len() as u32).map(|i| to_camera.transform_point3(mesh.position(i))).collect();
    let mut picture = Picture { inverse: vec![0.0; width * height], width, height, camera };
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| points[i as usize]);
        if corners.iter().all(|p| p.z >= near) {
            picture.draw(corners);
        } else if corners.iter().any(|p| p.z >= near) {
            let (clipped, count) = cut(corners, near);
            for i in 2..count {
                picture.draw([clipped[0], clipped[i - 1], clipped[i]]);
            }
        }
    }
    picture
        .inverse
        .into_iter()
        .map(|inverse| if inverse > 0.0 { 1.0 / inverse } else { f64::INFINITY })
        .collect()
}

/// Corners of the part of a triangle beyond the near plane, and their number: 3 or 4, or 0 if there is no such
/// part.
fn cut(corners: [DVec3; 3], near: f64) -> ([DVec3; 4], usize) {
    let (mut out, mut count) = ([DVec3::ZERO; 4], 0);
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        if a.z >= near {
            out[count] = a;
            count += 1;
        }
        if (a.z >= near) != (b.z >= near) {
            let at = a + (b - a) * ((near - a.z) / (b.z - a.z));
            out[count] = DVec3::new(at.x, at.y, near);
            count += 1;
        }
    }
    (out, count)
}

struct Picture<'a> {
    /// Reciprocal of the depth of each pixel; 0 where there is no surface.
    inverse: Vec<f64>,
    width: usize,
    height: usize,
    camera: &'a Camera,
}

impl Picture<'_> {
    /// Draws a triangle that is in front of the camera. The reciprocal of the depth is linear in the picture.
    fn draw(&mut self, corners: [DVec3; 3]) {
        let camera = self.camera;
        let flat = corners.map(|p| {
            let inverse = 1.0 / p.z;
            DVec3::new(
                camera.fx * (p.x * inverse) + camera.cx,
                camera.fy * (p.y * inverse) + camera.cy,
                inverse,
            )
        });
        let low = flat[0].min(flat[1]).min(flat[2]);
        let high = flat[0].max(flat[1]).max(flat[2]);
        // The condition in brackets is also false for numbers that are not finite.
        if !(high.x >= 0.5
            && high.y >= 0.5
            && low.x <= self.width as f64 - 0.5
            && low.y <= self.height as f64 - 0.5
            && (low + high).is_finite())
        {
            return;
        }
        let first = |low: f64| (low - 0.5).ceil().max(0.0) as usize;
        let last = |high: f64, side: usize| ((high - 0.5).floor() as usize).min(side - 1);
        let (x0, y0) = (first(low.x), first(low.y));
        let (x1, y1) = (last(high.x, self.width), last(high.y, self.height));
        let [a, b, c] = flat;
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area == 0.0 || x0 > x1 || y0 > y1 {
            return;
        }
        let scale = 1.0 / area;
        for y in y0..=y1 {
            for x in x0..=x1 {
                let (px, py) = (x as f64 + 0.5, y as f64 + 0.5);
                let u = ((b.x - px) * (c.y - py) - (b.y - py) * (c.x - px)) * scale;
                let v = ((c.x - px) * (a.y - py) - (c.y - py) * (a.x - px)) * scale;
                let w = 1.0 - u - v;
                if u >= 0.0 && v >= 0.0 && w >= 0.0 {
                    let inverse = u * a.z + v * b.z + w * c.z;
                    let known = &mut self.inverse[y * self.width + x];
                    *known = known.max(inverse);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bvh::{Bvh, Ray};
    use crate::geometry::sampling::{fraction, hash};

    /// Rasterized depths of random triangles, some of which cross the near plane, equal the depths that rays find.
    /// This test fails if `known.max` is replaced with `known.min`.
    #[test]
    fn depths_are_those_of_rays() {
        let random = |i: u32, k: u32| (fraction(hash(i, k)) * 4.0 - 2.0) as f32;
        let positions: Vec<[f32; 3]> = (0..180).map(|i| [random(i, 0), random(i, 1), random(i, 2)]).collect();
        let triangles: Vec<[u32; 3]> = (0..60).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = Mesh { positions, triangles, ..Mesh::default() };
        let (right, down, forward) = (DVec3::X, DVec3::NEG_Z, DVec3::Y);
        let camera =
            Camera::centred("view", [40, 30], 25.0, [right, down, forward], DVec3::new(0.1, -0.5, 0.2));
        let own = depths(&mesh, &DMat4::IDENTITY, &camera, 1e-3);
        let eye = camera.eye();
        let corner = |i: u32| (mesh.position(i) - eye).as_vec3();
        let tree = Bvh::build(&mesh.triangles.iter().map(|t| t.map(corner)).collect::<Vec<_>>());
        let mut differ = 0;
        for (i, depth) in own.iter().enumerate() {
            let way = camera.direction((i % 40) as f64 + 0.5, (i / 40) as f64 + 0.5);
            let hit = tree.closest(Ray::new(glam::Vec3::ZERO, way.as_vec3()), |hit| f64::from(hit.t) > 2e-3);
            let wanted = hit.map_or(f64::INFINITY, |hit| f64::from(hit.t) * way.dot(forward));
            differ += usize::from(!(wanted == *depth || (wanted - depth).abs() < 1e-4 * wanted));
        }
        // Pixels whose centres lie on an edge.
        assert!(differ <= 6, "{differ} of 1200");
    }
}

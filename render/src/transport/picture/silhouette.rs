//! Region of an image in which objects may be visible.

use glam::{DMat3, DVec2, DVec3, Vec3};
use scene::types::Camera;

use crate::transport::scene::objects::Objects;

/// Distance outside a triangle at which a ray may still hit it, in pixels: a constant part, and a part per pixel of
/// focal length. Single precision moves rays and corners by a few units in the last of 24 bits.
const MARGIN: [f64; 2] = [0.01, 1e-5];

/// Set of the pixels of a camera through which a ray may hit an object. It may contain more pixels than
/// necessary.
#[derive(Debug)]
pub(crate) struct Silhouette {
    size: [usize; 2],
    margin: f64,
    /// True for each pixel in the set, row by row.
    held: Vec<bool>,
}

/// Rectangle of pixels: the range of columns and the range of rows, both ends included.
type Rectangle = [[usize; 2]; 2];

impl Silhouette {
    /// Computes the silhouette of objects for a camera at `eye`. `axes` are the directions to the right, down and
    /// forward of the camera, in world coordinates.
    pub(crate) fn of(objects: &Objects, camera: &Camera, eye: Vec3, axes: [DVec3; 3]) -> Self {
        let size = [camera.width_px, camera.height_px].map(|n| n as usize);
        let Camera { fx, fy, cx, cy, .. } = *camera;
        let margin = MARGIN[0] + MARGIN[1] * fx.abs().max(fy.abs());
        let mut all = Self { size, margin, held: vec![false; size[0] * size[1]] };
        let to_camera = DMat3::from_cols(axes[0], axes[1], axes[2]).inverse();
        // The image of a box is not convex if the lens has distortion.
        if !to_camera.is_finite() || !camera.lens.is_pinhole() {
            all.held.fill(true);
            return all;
        }
        let (focal, middle) = (DVec2::new(fx, fy), DVec2::new(cx, cy));
        objects.bvh.visit(|corners| {
            let mut places = [DVec3::ZERO; 8];
            let places = &mut places[..corners.len()];
            for (place, corner) in places.iter_mut().zip(corners) {
                *place = to_camera * (corner.as_dvec3() - eye.as_dvec3());
            }
            let farthest = places.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
            let nearest = places.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
            if farthest <= 0.0 {
                return false;
            }
            if nearest <= 1e-9 * farthest {
                // The box may extend behind the camera, so everything on its side counts.
                let (low, high) = places
                    .iter()
                    .map(|p| p.truncate())
                    .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
                let low = DVec2::select(low.cmpge(DVec2::ZERO), low / farthest, DVec2::NEG_INFINITY);
                let high = DVec2::select(high.cmple(DVec2::ZERO), high / farthest, DVec2::INFINITY);
                return all.look(&[low, high].map(|p| p * focal + middle), corners.len() == 8);
            }
            let mut shown = [DVec2::ZERO; 8];
            let shown = &mut shown[..corners.len()];
            for (to, place) in shown.iter_mut().zip(places.iter()) {
                *to = place.truncate() / place.z * focal + middle;
            }
            all.look(shown, corners.len() == 8)
        });
        all
    }

    /// True if a pixel may show an object.
    pub(crate) fn holds(&self, (x, y): (u32, u32)) -> bool {
        self.held[y as usize * self.size[0] + x as usize]
    }

    /// Adds the pixels of a triangle or a box, given by its corners in the image. A box larger than a pixel is not
    /// added; instead, the function returns true if the children of the box must be examined.
    fn look(&mut self, corners: &[DVec2], is_box: bool) -> bool {
        let Some(pixels) = self.around(corners) else { return false };
        if self.is_known(pixels) {
            return false;
        }
        let [[left, right], [top, bottom]] = pixels;
        if is_box && (left, top) != (right, bottom) {
            return true;
        }
        for y in top..=bottom {
            let reached = match corners {
                [a, b, c] if top < bottom => self.across([*a, *b, *c], y),
                _ => Some([left, right]),
            };
            if let Some([left, right]) = reached {
                self.held[y * self.size[0]..][left..=right].fill(true);
            }
        }
        false
    }

    /// Smallest rectangle of pixels that contains all of the points and the margin around them. `None` if the
    /// rectangle is outside the image.
    fn around(&self, points: &[DVec2]) -> Option<Rectangle> {
        let start = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let (low, high) = points.iter().fold(start, |(low, high), p| (low.min(*p), high.max(*p)));
        let range = |axis: usize| {
            let [from, to] = [low[axis] - self.margin, high[axis] + self.margin].map(f64::floor);
            let last = self.size[axis] as f64 - 1.0;
            // NaN may be anywhere.
            (!(from > last || to < 0.0)).then_some([from.max(0.0) as usize, to.min(last) as usize])
        };
        Some([range(0)?, range(1)?])
    }

    fn is_known(&self, [[left, right], [top, bottom]]: Rectangle) -> bool {
        (top..=bottom).all(|y| self.held[y * self.size[0]..][left..=right].iter().all(|held| *held))
    }

    /// Range of columns in which a triangle overlaps the given row of pixels.
    fn across(&self, corners: [DVec2; 3], row: usize) -> Option<[usize; 2]> {
        let [top, bottom] = [row as f64 - self.margin, row as f64 + 1.0 + self.margin];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            if (top..=bottom).contains(&a.y) {
                (low, high) = (low.min(a.x), high.max(a.x));
            }
            for y in [top, bottom] {
                if (a.y < y) != (b.y < y) {
                    let x = a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y));
                    (low, high) = (low.min(x), high.max(x));
                }
            }
        }
        let last = self.size[0] as f64 - 1.0;
        let [from, to] = [low - self.margin, high + self.margin].map(f64::floor);
        (from <= last && to >= 0.0).then_some([from.max(0.0) as usize, to.min(last) as usize])
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DQuat};

    use super::super::camera_rays::CameraRays;
    use super::*;
    use crate::geometry::sampling::{Points, stream};
    use crate::transport::scene::supports::Ground;
    use scene::types::{Material, Object, Placed, Primitive};

    /// Random triangles in a cube around the origin. `large` of them are about as large as the cube.
    fn triangles(large: u32) -> Objects {
        let corner = |i: u32, k: u32| {
            let points = Points::new(stream(3, i, large), k);
            let ([x, y], [z, _]) = (points.pair(0), points.pair(1));
            Vec3::new(x, y, z) * 2.0 - 1.0
        };
        let mut primitive = Primitive::default();
        for i in 0..24 {
            let first = corner(i, 0);
            let size = if i < large { 1.0 } else { 0.05 };
            let corners = [1, 2, 3].map(|k| (first + corner(i, k) * size).to_array());
            primitive.positions.extend(corners);
            primitive.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        let material = Material { double_sided: true, ..Material::default() };
        let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
        let placed = Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY };
        Objects::new(None, &[Arc::new(placed)], DVec3::ZERO).expect("consistent")
    }

    /// Every pixel with a ray that hits a triangle is included. If the camera is outside the set of triangles, few
    /// other pixels are included. The cameras are outside and inside the set, and some triangles are next to or
    /// behind the camera.
    #[test]
    fn what_a_ray_meets_is_held() {
        let ground = Ground::default();
        for (large, distance) in [(0, 3.0), (4, 4.0), (4, 0.3), (24, 0.0)] {
            let objects = triangles(large);
            for turn in 0..6 {
                let turn = DQuat::from_rotation_y(f64::from(turn)) * DQuat::from_rotation_x(0.4);
                let pose = DMat4::from_quat(turn) * DMat4::from_translation(DVec3::NEG_Z * distance);
                let camera = Camera {
                    name: String::new(),
                    width_px: 40,
                    height_px: 28,
                    fx: 30.0,
                    fy: -33.0,
                    cx: 18.5,
                    cy: 15.0,
                    lens: Default::default(),
                    world_from_camera: pose.to_cols_array(),
                };
                let rays = CameraRays::new(&camera, DVec3::ZERO, 1, &ground, 1);
                let (mut held, mut met) = (0, 0);
                for pixel in (0..28).flat_map(|y| (0..40).map(move |x| (x, y))) {
                    let meets = |k| objects.bvh.closest(rays.sample(pixel, k).2, |_| true).is_some();
                    let meets = (0..64).any(meets);
                    let holds = rays.may_show(&objects, pixel);
                    assert!(holds || !meets, "{pixel:?} of {large}, {distance}");
                    (held, met) = (held + u32::from(holds), met + u32::from(meets));
                }
                assert!(met > 0);
                // Slivers are missed by the rays.
                let most = if large > 0 { met + met / 4 } else { 2 * met };
                assert!(distance < 1.0 || held <= most, "{held} for {met}");
            }
        }
    }
}

//! Sides of objects that may rest on the receiver: the foot, and flat sides of the oriented bounding box.

use glam::{DMat3, DVec3, Vec3};
use scene::types::Placed;

use super::limits::{LARGEST, SMOOTHEST, TOUCHING};
use crate::geometry::bvh::Ray;
use crate::geometry::support::{Foot, GroundPlane, corners};
use crate::transport::scene::receiver::Receiver;
use crate::transport::scene::supports::STEEPEST;

/// Number of rays along each edge of the grid that samples the receiver near a side of an object.
const GRID: u32 = 16;
/// Minimum share of the rays of the grid that must hit ground for an object to stand on it.
const STANDS: f64 = 0.25;
/// Minimum share of the rays within a flat side that must hit its support.
const AGAINST: f64 = 0.5;
/// Minimum share of the extent of the oriented bounding box that a flat side must span along both of its axes. A
/// drum that lies along a wall spans a share of 0.28.
const FLAT: f64 = 1.0 / 3.0;
/// Maximum cosine between the direction of a flat side and straight down. If the cosine is larger, the side is the
/// foot.
const LEVEL: f64 = 0.98;
/// Maximum slope of the mesh relative to a flat side that rests on it.
const SLANT: f64 = 0.1;

/// Reason why there is no receiver below an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unsupported {
    /// The object is over a hole in the mesh, or beyond its edge.
    OverNothing,
    /// The ground is above the object.
    Buried,
}

/// Side of an object that may rest on the receiver.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    /// Unit vector from the receiver to the object.
    pub(crate) out: DVec3,
    /// Unit vectors along the side, at a right angle to each other.
    pub(crate) axes: [DVec3; 2],
    /// Height of the side along `out`.
    pub(crate) height: f64,
    /// Centre of the side. Its coordinate along `out` is not used; `height` is used instead.
    middle: DVec3,
    /// Half the size of the sampled region along each axis. The region is 1.5 times as long and wide as the side.
    pub(crate) half: [f64; 2],
    /// Lower corner of the axis-aligned bounding box of the object, in world coordinates.
    pub(crate) low: DVec3,
    /// Upper corner of the axis-aligned bounding box of the object, in world coordinates.
    pub(crate) high: DVec3,
}

impl Side {
    /// Foot of an object. `None` if it has no triangles.
    pub(crate) fn foot(placed: &Placed, up: DVec3) -> Option<Self> {
        let Foot { low, high, base, middle, half } = Foot::of(placed, up)?;
        let axes = Foot::axes(up);
        let half = axes.map(|axis| half.dot(axis.abs()));
        Some(Self { out: up, axes, height: base, middle, half, low, high })
    }

    /// Flat sides of the oriented bounding box of an object, except a side that faces straight down.
    pub(crate) fn flat(placed: &Placed, up: DVec3) -> Vec<Self> {
        let points: Vec<DVec3> = corners(placed).collect();
        let linear = DMat3::from_mat4(placed.world_from_object);
        let normals = linear.inverse().transpose();
        let mut sides = Vec::new();
        for (k, axis) in DVec3::AXES.into_iter().enumerate() {
            let Some(normal) = (normals * axis).try_normalize() else { continue };
            let along = linear.col((k + 1) % 3);
            let Some(along) = along.reject_from_normalized(normal).try_normalize() else { continue };
            for out in [normal, -normal].into_iter().filter(|out| out.dot(up) <= LEVEL) {
                sides.extend(Self::along(&points, out, [along, out.cross(along)]));
            }
        }
        sides
    }

    /// Side of an object that faces in the direction opposite to `out`. `points` are the vertices of the object.
    /// `None` if the side is not flat.
    fn along(points: &[DVec3], out: DVec3, axes: [DVec3; 2]) -> Option<Self> {
        let place = |p: &DVec3| DVec3::new(p.dot(axes[0]), p.dot(axes[1]), p.dot(out));
        let around = |points: &mut dyn Iterator<Item = DVec3>| {
            points.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))
        };
        let (low, high) = around(&mut points.iter().map(place))?;
        let size = high - low;
        // A sheet is flat up to rounding.
        let slice = low.z + f64::max(0.02 * size.z, 1e-5 * size.x.max(size.y));
        let (a, b) = around(&mut points.iter().map(place).filter(|p| p.z <= slice))?;
        let span = b - a;
        if span.x.min(span.y) <= 0.0 || span.x < FLAT * size.x || span.y < FLAT * size.y {
            return None;
        }
        let middle = (a + b) * 0.5;
        let (world_low, world_high) = around(&mut points.iter().copied())?;
        Some(Self {
            out,
            axes,
            height: low.z,
            middle: axes[0] * middle.x + axes[1] * middle.y,
            half: [0.75 * span.x, 0.75 * span.y],
            low: world_low,
            high: world_high,
        })
    }

    /// Half the size of the side along each axis. [`Side::half`] is 1.5 times as large.
    pub(crate) fn own(&self) -> [f64; 2] {
        self.half.map(|half| half / 1.5)
    }

    /// Rays through the points of a grid over the sampled region, in the direction opposite to `out`. Each ray
    /// starts `largest` above the side and ends `largest` below it. Each item contains the position of the grid
    /// point along the axes, and the ray.
    pub(crate) fn grid_rays(&self, origin: DVec3, largest: f64) -> impl Iterator<Item = ([f64; 2], Ray)> {
        let Self { out, axes, height, middle, half, .. } = *self;
        (0..GRID * GRID).map(move |k| {
            let place = [k % GRID, k / GRID].map(|i| (f64::from(2 * i + 1) / f64::from(GRID)) - 1.0);
            let [x, y] = [0, 1].map(|a| place[a] * half[a]);
            let flat = middle - out * middle.dot(out) + axes[0] * x + axes[1] * y;
            let start = (flat + out * (height + largest) - origin).as_vec3();
            ([x, y], Ray { t_max: (2.0 * largest) as f32, ..Ray::new(start, -out.as_vec3()) })
        })
    }

    /// Points where the mesh is near the side and parallel to it. For each point, returns its position along the
    /// axes and its height above the side, and whether the mesh faces the object there.
    fn heights(
        &self,
        (receiver, inverted): (&Receiver, bool),
        origin: DVec3,
        largest: f64,
    ) -> Vec<([f64; 3], bool)> {
        let out: Vec3 = self.out.as_vec3();
        let height = |([x, y], ray): ([f64; 2], Ray)| {
            let hit = receiver.bvh.closest(ray, |_| true)?;
            let along = receiver.normal(hit.triangle).dot(out).abs() >= STEEPEST;
            along.then(|| ([x, y, largest - f64::from(hit.t)], hit.back == inverted))
        };
        self.grid_rays(origin, largest).filter_map(height).collect()
    }

    /// Level of the mesh at a foot. A surface above the foot that faces down is a ceiling and does not count.
    pub(crate) fn ground(
        &self,
        receiver: (&Receiver, bool),
        origin: DVec3,
        largest: f64,
    ) -> Option<GroundPlane> {
        let hits = self.heights(receiver, origin, largest).into_iter();
        let heights: Vec<_> = hits.filter(|(at, faces)| *faces || at[2] <= 0.0).map(|(at, _)| at).collect();
        let enough = heights.len() as f64 >= STANDS * f64::from(GRID * GRID);
        if enough { GroundPlane::of(&heights) } else { None }
    }

    /// Reason why there is no receiver below most of the side, at any distance. `None` if the receiver is below it.
    pub(crate) fn unsupported(
        &self,
        (receiver, inverted): (&Receiver, bool),
        origin: DVec3,
        metre: f64,
    ) -> Option<Unsupported> {
        let own = self.own();
        let (mut all, mut under, mut over) = (0, 0, 0);
        for ([x, y], ray) in self.grid_rays(origin, LARGEST * metre) {
            if x.abs() <= own[0] && y.abs() <= own[1] {
                let (down, up) = (Ray { t_max: f32::INFINITY, ..ray }, Ray::new(ray.origin, -ray.direction));
                all += 1;
                under += u32::from(receiver.bvh.any(down, |_| true));
                // From below, ground shows its back face, a ceiling its front face.
                over += u32::from(receiver.bvh.closest(up, |_| true).is_some_and(|hit| hit.back != inverted));
            }
        }
        match (2 * under < all, 2 * over > all) {
            (true, true) => Some(Unsupported::Buried),
            (true, false) => Some(Unsupported::OverNothing),
            (false, _) => None,
        }
    }

    /// Level of the mesh at a flat side that rests on it. Also returns the height by which the mesh, due to its
    /// slope, rises from the centre of the side to a corner. `None` if the side does not rest on the mesh. Objects
    /// often stand near a wall, so a gap counts as an error of the mesh only if it is within the noise of the mesh.
    /// Objects cannot be inside a wall, so a side that the mesh covers counts as resting on the mesh. `fixed` is
    /// the error of the mesh in metres, if known.
    pub(crate) fn rests(
        &self,
        receiver: (&Receiver, bool),
        origin: DVec3,
        metre: f64,
        fixed: Option<f64>,
    ) -> Option<(GroundPlane, f64)> {
        let hits = self.heights(receiver, origin, LARGEST * metre).into_iter();
        let heights: Vec<_> = hits.filter(|(_, faces)| *faces).map(|(at, _)| at).collect();
        let own = self.own();
        let within = |x: f64, y: f64| x.abs() <= own[0] && y.abs() <= own[1];
        let sent = self.grid_rays(origin, 0.0).filter(|([x, y], _)| within(*x, *y)).count();
        let found = heights.iter().filter(|[x, y, _]| within(*x, *y)).count();
        if (found as f64) < AGAINST * sent as f64 {
            return None;
        }
        let level = GroundPlane::of(&heights)?;
        let noise = 3.0 * level.roughness;
        let tilt = level.slope[0].abs() * own[0] + level.slope[1].abs() * own[1];
        let gap = fixed.map_or((noise + SMOOTHEST * metre).min(TOUCHING * metre), |metres| metres * metre);
        let deep = fixed.unwrap_or(LARGEST) * metre;
        let flat = level.roughness <= TOUCHING * metre && tilt <= noise.max(SLANT * (own[0] + own[1]));
        (flat && (-gap..=deep).contains(&level.height)).then_some((level, tilt))
    }
}

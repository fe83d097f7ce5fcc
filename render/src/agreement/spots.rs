//! Points on the surface that the splats show in the views. The depths of a mesh are compared with these points.

use glam::{DMat4, DVec3};
use scene::types::{Mesh, Splats};

use super::cloud::Placed;
use super::raster;
use super::sight::Sight;
use crate::geometry::level;
use crate::geometry::support::median;

/// Distance between mesh and splats at which the agreement at a point is 0, as a share of the distance from the eye
/// to the point, or of the median distance of all points if that is larger. It is normal that the mesh of a capture
/// differs from its splats by several hundredths of the distance.
const TOLERANCE: f64 = 0.07;
/// Maximum distance from the eye to a point, as a multiple of the lower quartile of these distances. Points that
/// are farther away are ignored, since meshes do not contain the distant background.
const BACKDROP: f64 = 10.0;
/// Distance by which the surface of splats may appear too near, in standard deviations of the splats along their
/// middle axis. The cause is that a splat close to the eye is drawn as an ellipse that is too large.
const GRAIN: f64 = 2.0;
/// Approximate number of splats that are sampled when sizes are measured or centres are taken as points.
const MEASURED: usize = 4000;
/// Minimum opacity of the splats that are sampled.
pub(super) const OPAQUE: f32 = 0.3;
/// Maximum distance between a point of the mesh and the surface of the splats for the point to count as on the
/// surface, as a share of the distance from the eye to the point, or of the median distance of all points if that
/// is larger.
const ON: f64 = 0.03;
/// Number of consecutive points of the mesh of which only the first is tested.
const CONFIRMED: usize = 8;
/// Minimum number of points for a comparison.
const LEAST: usize = 200;
/// Weight of points at edges, where the normal is not known.
const AT_EDGE: f64 = 0.3;
/// Distance from the eye to the near plane when the mesh is drawn, as a share of the median distance of the points
/// from the eye.
const NEAR: f64 = 0.005;

/// A point on the surface of the splats in a view.
pub(super) struct Spot {
    /// Position in the world.
    pub point: DVec3,
    /// Unit normal of the surface; `None` at edges.
    pub normal: Option<DVec3>,
    /// Distance from the surface at which the agreement of a mesh is 0, in world units.
    pub tolerance: f64,
    /// Weight of the point. It is smaller if many other points face in the same direction, so that large surfaces
    /// such as the ground do not dominate.
    pub weight: f64,
    /// Index of the view.
    pub sight: usize,
    /// Index of the pixel in the view.
    pub pixel: usize,
}

/// Points on the surface of the splats in all views.
pub(super) struct Spots {
    /// The points.
    pub list: Vec<Spot>,
    /// Median distance of the points from the eye, in world units.
    pub distance: f64,
    /// Median of the coordinates of the points along each axis.
    pub middle: DVec3,
    /// Median distance of the points from `middle`.
    pub radius: f64,
    /// Distance by which the surface of large splats may appear too near, in world units.
    pub grain: f64,
}

/// Index, among 13 fixed axes, of the axis with the smallest angle to a normal.
fn facing(normal: DVec3) -> usize {
    let mut best = (0, -1.0);
    let mut index = 0;
    for x in -1_i32..=1 {
        for y in -1_i32..=1 {
            for z in -1_i32..=1 {
                // Of two opposite directions, only one counts.
                if (x, y, z) > (0, 0, 0) {
                    let axis = DVec3::new(x.into(), y.into(), z.into()).normalize();
                    let cosine = axis.dot(normal).abs();
                    if cosine > best.1 {
                        best = (index, cosine);
                    }
                    index += 1;
                }
            }
        }
    }
    best.0
}

impl Spots {
    /// Collects the points of all views. Returns `None` if the views show too little surface of the splats for a
    /// comparison.
    pub fn of(splats: &Splats, sights: &[Sight]) -> Option<Self> {
        let mut list = Vec::new();
        for (index, sight) in sights.iter().enumerate() {
            for pixel in (0..sight.depth.len()).filter(|&pixel| sight.clear[pixel]) {
                let (point, normal) = (sight.point(pixel, sight.depth[pixel]), sight.normal(pixel));
                let distance = (point - sight.camera.eye()).length();
                list.push(Spot { point, normal, tolerance: distance, weight: AT_EDGE, sight: index, pixel });
            }
        }
        let mut far: Vec<f64> = list.iter().map(|spot| spot.tolerance).collect();
        far.sort_unstable_by(f64::total_cmp);
        let limit = BACKDROP * far.get(far.len() / 4)?;
        list.retain(|spot| spot.tolerance <= limit);
        if list.len() < LEAST {
            return None;
        }
        let distance = median(list.iter().map(|spot| spot.tolerance).collect())?;
        let grain = GRAIN * size(splats, sights, limit);
        for spot in &mut list {
            spot.tolerance = (TOLERANCE * spot.tolerance.max(distance)).max(grain);
        }
        balance(&mut list);
        let (middle, radius) = extent(&list)?;
        Some(Self { list, distance, middle, radius, grain })
    }

    /// Distance from the eye to the near plane when the mesh is drawn, in world units.
    pub fn near(&self) -> f64 {
        NEAR * self.distance
    }

    /// Depth of each pixel in each of the views, for a mesh that `world_from_mesh` places in the world.
    pub fn depths(&self, sights: &[Sight], mesh: &Mesh, world_from_mesh: &DMat4) -> Vec<Vec<f64>> {
        sights.iter().map(|sight| raster::depths(mesh, world_from_mesh, &sight.camera, self.near())).collect()
    }

    /// Computes how well the depths of a mesh agree with all points, and with the points at which the depth in
    /// `known` is finite. Both arguments hold the depth of each pixel for each view.
    pub fn agreement(&self, sights: &[Sight], depths: &[Vec<f64>], known: &[Vec<f64>]) -> Agreement {
        let (mut sums, mut totals) = ([0.0; 2], [0.0; 2]);
        let mut hidden = 0.0;
        for spot in &self.list {
            let sight = &sights[spot.sight];
            let (splats, mesh) = (sight.depth[spot.pixel], depths[spot.sight][spot.pixel]);
            let mut fits = 0.0;
            if mesh.is_finite() {
                let along = sight.ray(spot.pixel) * (mesh - splats);
                let off = spot.normal.map_or(0.5 * along.length(), |normal| along.dot(normal).abs());
                fits = spot.weight * kernel(off / spot.tolerance);
                if mesh < splats && off > spot.tolerance {
                    hidden += spot.weight;
                }
            }
            let kinds = if known[spot.sight][spot.pixel].is_finite() { 2 } else { 1 };
            for kind in 0..kinds {
                sums[kind] += fits;
                totals[kind] += spot.weight;
            }
        }
        let share = totals[1] / totals[0];
        Agreement {
            all: sums[0] / totals[0],
            known: if totals[1] > 0.0 { sums[1] / totals[1] } else { 0.0 },
            share,
            hidden: hidden / totals[0],
        }
    }

    /// Share of the points of a placed cloud that lies on the surface of the splats in at least one view.
    /// Points that are outside all views, or only at pixels where the splats have no surface, are ignored.
    pub fn confirmed(&self, sights: &[Sight], Placed { cloud, at }: &Placed<'_>) -> f64 {
        let (mut seen, mut confirmed) = (0.0, 0.0);
        let cameras: Vec<DMat4> = sights.iter().map(|sight| sight.camera.camera_from_world()).collect();
        for (point, _) in cloud.points.iter().step_by(CONFIRMED) {
            let point = at.point(*point);
            let mut best: Option<bool> = None;
            for (sight, camera) in sights.iter().zip(&cameras) {
                let local = camera.transform_point3(point);
                let Some(pixel) = sight.pixel(local) else { continue };
                let off = (local.z - sight.depth[pixel]).abs() * local.length() / local.z;
                let near = off <= (ON * local.length().max(self.distance)).max(self.grain);
                best = Some(best.unwrap_or(false) || near);
            }
            seen += f64::from(u8::from(best.is_some()));
            confirmed += f64::from(u8::from(best == Some(true)));
        }
        if seen > 0.0 { confirmed / seen } else { 0.0 }
    }

    /// Takes the centres of the opaque splats as points. This is done if the views show too little surface of the
    /// splats, for example because the splats are in a different unit. The points belong to no view. Returns `None`
    /// if there are no opaque splats.
    pub fn of_centres(splats: &Splats) -> Option<Self> {
        let step = (splats.len() / MEASURED).max(1);
        let mut list: Vec<Spot> = centres(splats, step)
            .map(|(point, normal)| {
                let (sight, pixel) = (usize::MAX, 0);
                Spot { point, normal, tolerance: 0.0, weight: AT_EDGE, sight, pixel }
            })
            .collect();
        let (middle, radius) = extent(&list)?;
        list.retain(|spot| (spot.point - middle).length() <= 0.5 * BACKDROP * radius);
        let (middle, radius) = extent(&list)?;
        list.iter_mut().for_each(|spot| spot.tolerance = TOLERANCE * radius);
        balance(&mut list);
        (radius > 0.0).then_some(Self { list, distance: radius, middle, radius, grain: 0.0 })
    }

    /// Lower and upper corner of a box that contains nearly all points. About one point in 200 lies beyond each
    /// side.
    pub fn extents(&self) -> [DVec3; 2] {
        let beyond = self.list.len() / 200;
        let bounds = [0, 1, 2].map(|axis| {
            let mut along: Vec<f64> = self.list.iter().map(|spot| spot.point[axis]).collect();
            along.sort_unstable_by(f64::total_cmp);
            [along[beyond], along[along.len() - 1 - beyond]]
        });
        [0, 1].map(|side| DVec3::from_array(bounds.map(|bound| bound[side])))
    }

    /// Centres and normals of up to 24,000 opaque splats within the distance of the points of
    /// [`of_centres`](Self::of_centres) from `middle`. The normal is 0 if the splat is not flat.
    pub fn centres(splats: &Splats, middle: DVec3, radius: f64) -> Vec<(DVec3, DVec3)> {
        let step = (splats.len() / (6 * MEASURED)).max(1);
        let near = |point: DVec3| (point - middle).length() <= 0.5 * BACKDROP * radius;
        let all = centres(splats, step).filter(|(point, _)| near(*point));
        all.map(|(point, normal)| (point, normal.unwrap_or(DVec3::ZERO))).collect()
    }
}

/// Centre of every `step`-th splat that is opaque, and its normal if it is flat.
fn centres(splats: &Splats, step: usize) -> impl Iterator<Item = (DVec3, Option<DVec3>)> + '_ {
    let seen = (0..splats.len()).step_by(step).filter(|&i| splats.opacities[i] >= OPAQUE);
    seen.map(|i| {
        let scale = splats.scales[i];
        let thin = (1..3).fold(0, |best, k| if scale[k] < scale[best] { k } else { best });
        let flat = 2.5 * scale[thin] < scale[(thin + 1) % 3].min(scale[(thin + 2) % 3]);
        (splats.mean(i), flat.then(|| level::rotation(splats.quats[i]).col(thin)))
    })
}

/// Agreement of the depths of a mesh with the points, 0 to 1. The agreement with a point is 1 if the depths are
/// equal, and 0 if they differ by more than the tolerance or the mesh is not visible at the point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Agreement {
    /// Weighted mean over all points.
    pub all: f64,
    /// Weighted mean over the points at which the argument `known` of [`Spots::agreement`] is finite; 0 if there
    /// are no such points.
    pub known: f64,
    /// Total weight of the points at which `known` is finite, as a share of the weight of all points.
    pub share: f64,
    /// Weighted share of all points in front of which the mesh has a surface that is farther from the point than the
    /// tolerance.
    pub hidden: f64,
}

/// Median of the coordinates of the points along each axis, and the median distance of the points from this
/// position.
fn extent(list: &[Spot]) -> Option<(DVec3, f64)> {
    let along = |axis: usize| median(list.iter().map(|spot| spot.point[axis]).collect());
    let middle = DVec3::new(along(0)?, along(1)?, along(2)?);
    Some((middle, median(list.iter().map(|spot| (spot.point - middle).length()).collect())?))
}

/// Sets the weights of the points: the more points face in about the same direction, the smaller their weights.
fn balance(list: &mut [Spot]) {
    let found = weights(list.iter().map(|spot| spot.normal));
    for (spot, weight) in list.iter_mut().zip(found) {
        if spot.normal.is_some() {
            spot.weight = weight;
        }
    }
}

/// Weight of each point with a normal: the more points face in about the same direction, the smaller it is. Points
/// without a normal have the weight [`AT_EDGE`].
pub(super) fn weights(normals: impl Iterator<Item = Option<DVec3>>) -> Vec<f64> {
    let axes: Vec<Option<usize>> = normals.map(|normal| normal.map(facing)).collect();
    let mut counts = [0.0; 13];
    axes.iter().flatten().for_each(|&axis| counts[axis] += 1.0);
    let all: f64 = counts.iter().sum();
    let weight =
        |axis: &Option<usize>| axis.map_or(AT_EDGE, |axis| (all / (13.0 * counts[axis])).sqrt().min(3.0));
    axes.iter().map(weight).collect()
}

/// Median of the standard deviations along the middle axis, over the opaque splats whose distance from the eye of
/// at least one view is less than `limit`.
fn size(splats: &Splats, sights: &[Sight], limit: f64) -> f64 {
    let step = (splats.len() / MEASURED).max(1);
    let near = |i: usize| sights.iter().any(|sight| (splats.mean(i) - sight.camera.eye()).length() < limit);
    let seen = (0..splats.len()).step_by(step).filter(|&i| splats.opacities[i] >= OPAQUE && near(i));
    let middle = |i: usize| {
        let [a, b, c] = splats.scales[i].map(f64::from);
        a.max(b).min(a.min(b).max(c))
    };
    median(seen.map(middle).collect()).unwrap_or_default()
}

/// Agreement of a point with a surface, 0 to 1. `off` is the signed distance from the surface, divided by the
/// tolerance.
pub(super) fn kernel(off: f64) -> f64 {
    let rest = (1.0 - off * off).max(0.0);
    rest * rest
}

//! Pieces of surface, from which the up direction and level surfaces are estimated.

use glam::{DMat3, DVec3};
use scene::math::num;
use scene::types::{Mesh, SplatEncoding, Splats};

/// Opacity below which splats count as fog.
const FAINT: f32 = 0.1;
/// Maximum number of patches that are examined. If there are more, every n-th patch is used.
const MOST: usize = 300_000;
/// Radius of the core of a scene, as a multiple of the median distance of the patches from its centre.
const CORE: f64 = 2.2;
/// Maximum standard deviation of a splat, as a fraction of the radius of the core. Larger splats count as if they
/// had this size.
const WIDEST: f64 = 0.02;

/// A piece of surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    /// Position of the centre, in world units.
    pub middle: DVec3,
    /// Unit normal with an arbitrary sign. `None` if the piece is not flat.
    pub normal: Option<DVec3>,
    /// Area multiplied by opacity, in square world units.
    pub weight: f64,
    /// Opacity, 0 to 1.
    pub opacity: f64,
    /// RGB as displayed, 0 to 1.
    pub rgb: [f64; 3],
}

impl Patch {
    /// Rec. 709 luma of the displayed colour.
    pub fn luma(&self) -> f64 {
        0.2126 * self.rgb[0] + 0.7152 * self.rgb[1] + 0.0722 * self.rgb[2]
    }
}

/// The patches of a scene, inside and outside its core.
#[derive(Debug)]
pub(super) struct Patches {
    /// Patches within the core.
    pub core: Vec<Patch>,
    /// Patches outside the core: sky and background.
    pub far: Vec<Patch>,
    /// Geometric median of the centres of all patches, which is the point with the smallest mean distance from
    /// them.
    pub centre: DVec3,
    /// Radius of the core, in world units.
    pub radius: f64,
}

impl Patches {
    /// The patches of a scene of splats.
    pub fn of_splats(splats: &Splats) -> Self {
        let stride = splats.len().div_ceil(MOST).max(1);
        let chosen: Vec<usize> =
            (0..splats.len()).step_by(stride).filter(|&i| splats.opacities[i] >= FAINT).collect();
        let patch = |i: usize| Patch {
            middle: splats.mean(i),
            normal: normal(splats.scales[i], splats.quats[i]),
            weight: area(splats.scales[i]),
            opacity: f64::from(splats.opacities[i]),
            rgb: displayed(splats, i),
        };
        let mut found = Self::of(chosen.iter().map(|&i| patch(i)).collect());
        // A few splats of fog would outweigh all others.
        let largest = (WIDEST * found.radius) * (WIDEST * found.radius);
        let opacity = |p: &mut Patch| p.weight = p.weight.min(largest) * p.opacity;
        found.core.iter_mut().chain(&mut found.far).for_each(opacity);
        found
    }

    /// The patches of a mesh: its triangles.
    pub fn of_mesh(mesh: &Mesh) -> Self {
        let stride = mesh.triangles.len().div_ceil(MOST).max(1);
        let patch = |of: &[u32; 3]| {
            let [a, b, c] = of.map(|v| mesh.position(v));
            let cross = (b - a).cross(c - a);
            let length = cross.length();
            let rgb = mesh
                .colours
                .get(of[0] as usize)
                .map_or([0.5; 3], |rgb| rgb.map(|v| f64::from(scene::math::color::srgb_from_linear(v))));
            Patch {
                middle: (a + b + c) / 3.0,
                normal: (length > 0.0).then(|| cross / length),
                weight: 0.5 * length,
                opacity: 1.0,
                rgb,
            }
        };
        Self::of(mesh.triangles.iter().step_by(stride).map(patch).collect())
    }

    fn of(all: Vec<Patch>) -> Self {
        let centre = middle(&all);
        let mut distances: Vec<f64> = all.iter().map(|p| (p.middle - centre).length()).collect();
        distances.sort_by(f64::total_cmp);
        let radius = CORE * distances.get(distances.len() / 2).copied().unwrap_or_default();
        let (core, far) = all.into_iter().partition(|p| (p.middle - centre).length() <= radius);
        Self { core, far, centre, radius }
    }
}

/// Geometric median of the centres of the patches, by Weiszfeld's iteration. Unlike a median of each coordinate, it
/// does not depend on the orientation of the axes.
fn middle(all: &[Patch]) -> DVec3 {
    let mean = |weight: &dyn Fn(DVec3) -> f64| {
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for patch in all {
            let w = weight(patch.middle);
            sum += patch.middle * w;
            total += w;
        }
        if total > 0.0 { sum / total } else { DVec3::ZERO }
    };
    let mut at = mean(&|_| 1.0);
    for _ in 0..25 {
        at = mean(&|p| 1.0 / (p - at).length().max(1e-12));
    }
    at
}

/// Area of the flat side of a splat, up to a constant factor.
fn area(scale: [f32; 3]) -> f64 {
    let mut scale = scale.map(f64::from);
    scale.sort_by(f64::total_cmp);
    scale[1] * scale[2]
}

/// The direction of the shortest axis. `None` if this axis is not much shorter than the others.
fn normal(scale: [f32; 3], quat: [f32; 4]) -> Option<DVec3> {
    let axis = (1..3).fold(0, |best, i| if scale[i] < scale[best] { i } else { best });
    let middle = scale[(axis + 1) % 3].min(scale[(axis + 2) % 3]);
    (scale[axis] * 2.5 < middle).then(|| rotation(quat).col(axis))
}

/// The rotation of a unit quaternion (w, x, y, z).
pub fn rotation(quat: [f32; 4]) -> DMat3 {
    let [w, x, y, z] = quat.map(f64::from);
    DMat3::from_cols(
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// The displayed colour of a splat, averaged over all directions.
fn displayed(splats: &Splats, i: usize) -> [f64; 3] {
    let rgb = splats.sh[i * splats.sh_len()]
        .map(|v| (f64::from(v) * 0.282_094_791_773_878_14 + 0.5).clamp(0.0, 1.0));
    match splats.encoding {
        SplatEncoding::Srgb => rgb,
        SplatEncoding::Linear => rgb.map(|v| num::pow(v, 1.0 / 2.2)),
    }
}

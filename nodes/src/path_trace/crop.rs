//! Where the objects do not matter: a bound of what they can change of the light of a tile of pixels.
//!
//! Objects change what comes from the directions in which they are seen: there they hide what is behind them and send
//! light of their own. All these directions lie in a [`Window`], so with `P` its projected solid angle, `T` the light
//! of the sky in it times the cosine, `L` the greatest radiance of any surface, and `Q` the projected solid angle of
//! all of the receiver that the tile's points see, their irradiance changes by no more than
//!
//! `max(T + P L, P L) + Q L`
//!
//! where the terms of surfaces seen or changed count if scattered rays meet the receiver and `Q` is not 0. With nothing
//! that shines `L` is at most the greatest radiance of the sky, since no material gives more light than it gets. Where
//! all surfaces are matte it is also at most what the greatest irradiance `E` makes of the largest albedo `a`,
//! `E / pi (a + a^2 + ..)`. That of a sky is the half of what comes from both sides of a plane and of how these differ:
//!
//! `E(n) = 1/2 (int |n.w| L + n. int w L) <= 1/2 (sqrt(int L . int (n.w)^2 L) + |int w L|)`.
//!
//! It is compared with the light that the pixels were traced to have without objects, by which the ratio is divided, so
//! that nothing of it is guessed.

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::{DMat3, DVec3, Vec3};

use super::env_resolution::smoothest;
use super::integrator::Scene;
use super::light_distribution::Cone;
use super::near_crop::{NearBounds, apart};
use super::receiver::Receiver;
use crate::bvh::Hit;

/// Boxes of the receiver that are looked into to find what of it a tile sees.
pub(super) const LOOKS: u32 = 256;

/// Where the points of a tile are, and what light they have without the objects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileBounds {
    /// Box around the points that rays start from; lower above upper where the camera sees no receiver.
    pub low: Vec3,
    /// Its upper corner.
    pub high: Vec3,
    /// Holds their normals.
    pub normals: Cone,
    /// The least of their heights along the middle of the normals.
    pub height: f32,
    /// The least that the light of a pixel is of its albedo, for each channel.
    pub least: Vec3,
}

impl Default for TileBounds {
    /// Of no points.
    fn default() -> Self {
        let normals = Cone { axis: Vec3::Z, cosine: 1.0 };
        Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, normals, height: f32::MAX, least: Vec3::MAX }
    }
}

impl TileBounds {
    /// Of the pixels of a tile: for each its sum of light and the hits of its samples.
    pub fn of<'a>(
        receiver: &Receiver,
        pixels: impl Iterator<Item = (Vec3, &'a [Option<Hit>])> + Clone,
    ) -> Self {
        let normals =
            pixels.clone().flat_map(|(_, hits)| hits.iter().flatten()).map(|hit| receiver.facing(hit));
        let mut tile = Self::default();
        let Some(first) = normals.clone().next() else { return tile };
        tile.normals = match normals.clone().all(|normal| normal == first) {
            true => Cone { axis: first, cosine: 1.0 },
            false => Cone::around(normals),
        };
        let axis = tile.normals.axis.as_dvec3();
        for (light, hits) in pixels {
            let mut albedo = Vec3::ZERO;
            for hit in hits.iter().flatten() {
                let start = receiver.start(hit);
                (tile.low, tile.high) = (tile.low.min(start), tile.high.max(start));
                tile.height = tile.height.min(start.as_dvec3().dot(axis) as f32);
                albedo += receiver.albedo_at(hit);
            }
            // What reflects nothing is not changed by anything.
            let share = Vec3::select(albedo.cmpgt(Vec3::ZERO), light / albedo, Vec3::MAX);
            tile.least = tile.least.min(share);
        }
        tile
    }

    /// Values in a store: box, normals, height, light.
    pub const VALUES: usize = 14;

    /// The values.
    pub fn values(&self) -> [f32; Self::VALUES] {
        let Self { low, high, normals, height, least } = self;
        let mut all = [normals.cosine; Self::VALUES];
        for (to, from) in all.chunks_exact_mut(3).zip([low, high, &normals.axis, least]) {
            to.copy_from_slice(&from.to_array());
        }
        all[12] = *height;
        all
    }

    /// From the values.
    pub fn from_values(all: &[f32; Self::VALUES]) -> Self {
        let [low, high, axis, least] = [0, 3, 6, 9].map(|i| Vec3::new(all[i], all[i + 1], all[i + 2]));
        Self { low, high, normals: Cone { axis, cosine: all[13] }, height: all[12], least }
    }

    /// Whether the camera sees none of the receiver.
    pub fn is_empty(&self) -> bool {
        !self.low.cmple(self.high).all()
    }

    /// With points that may lie so much farther on any side.
    fn grown(&self, by: f32) -> Self {
        Self { low: self.low - by, high: self.high + by, height: self.height - by, ..*self }
    }
}

/// A part of the sphere that holds the directions from the points of a place to a box: a cone about the way to its
/// middle, and, where the box is aside, a [`Wedge`].
struct Window {
    /// Middle of the normals.
    up: DVec3,
    /// Sine and tangent of the angle to the farthest normal.
    tilt: [f64; 2],
    /// Middle of the cone, cosine and sine of the angle to its edge; of a cone of less than a right angle.
    cone: Option<(DVec3, [f64; 2])>,
    /// Squared sine of the angle from the middle of the box to its edge, for the nearest of the points.
    ball: f64,
    wedge: Option<Wedge>,
}

/// A range of azimuths about the normal, from the horizon of any of its normals up to some elevation.
struct Wedge {
    /// Towards the middle, and aside of that.
    axes: [DVec3; 2],
    /// Tangent of half of the range of azimuths.
    side: f64,
    /// Tangent of the highest elevation.
    rise: f64,
}

impl Window {
    /// Of a box or a triangle by its corners; none where it may be all around the points.
    fn of(tile: &TileBounds, corners: &[Vec3]) -> Option<Self> {
        let up = tile.normals.axis.as_dvec3();
        let heights = corners.iter().map(|corner| corner.as_dvec3().dot(up));
        let above = heights.fold(f64::NEG_INFINITY, f64::max) - f64::from(tile.height);
        let cosine = f64::from(tile.normals.cosine);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let tilt = [sine, if cosine > 0.0 { sine / cosine } else { f64::INFINITY }];
        if above <= 0.0 && sine == 0.0 {
            let wedge = Wedge { axes: [DVec3::X, DVec3::Y], side: 0.0, rise: 0.0 };
            return Some(Self { up, tilt, cone: None, ball: 0.0, wedge: Some(wedge) });
        }
        let [low, high] = corners.iter().fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], corner| {
            [low.min(*corner), high.max(*corner)]
        });
        let cone = Cone::between([tile.low, tile.high], [low, high]);
        let cosine = f64::from(cone.cosine);
        let cone = (cosine > 0.0).then(|| (cone.axis.as_dvec3(), [cosine, (1.0 - cosine * cosine).sqrt()]));
        let wedge = Wedge::of(tile, corners, above).filter(|_| tilt[1] < 1.0);
        let (middle, radius) = ((low + high).as_dvec3() * 0.5, (high - low).as_dvec3().length() * 0.5);
        let way = middle - middle.clamp(tile.low.as_dvec3(), tile.high.as_dvec3());
        let ball = (radius * radius / way.length_squared()).min(1.0);
        let any = cone.is_some() || wedge.is_some() || ball < 1.0;
        any.then_some(Self { up, tilt, cone, ball, wedge })
    }

    /// A bound of its projected solid angle for any of the normals.
    fn projected(&self) -> f64 {
        let of_cone = self.cone.map_or(PI, |(axis, [cosine, sine])| {
            // Most where the normal is its axis; and all of it times the cosine of the least angle to a normal: that to
            // the axis, less those from there to the edge and to the farthest normal.
            let angle = axis.dot(self.up).clamp(-1.0, 1.0);
            let away = (1.0 - angle * angle).sqrt();
            let (near, off) = (angle * cosine + away * sine, away * cosine - angle * sine);
            let [tilt, tangent] = self.tilt;
            let flat = (1.0 - tilt * tilt).sqrt();
            let faces = off <= 0.0 || off * flat <= near * tilt || tangent == f64::INFINITY;
            let least = if faces { 1.0 } else { (near * flat + off * tilt).max(0.0) };
            (PI * sine * sine).min(2.0 * PI * sine * sine / (1.0 + cosine) * least)
        });
        let tilt = self.tilt[1];
        // Of any cone less than a hemisphere a surface sees the most that faces it.
        of_cone.min(PI * self.ball).min(self.wedge.as_ref().map_or(PI, |wedge| wedge.projected(tilt)))
    }

    /// A bound of the cosine to any normal for what lies within `radius` of a unit direction; 0 if none of that is in the
    /// window.
    fn cosine(&self, direction: DVec3, radius: f64) -> f64 {
        // The cosine to the cone's axis changes by no more than the way that a direction goes.
        let inside = self.cone.is_none_or(|(axis, [cosine, _])| direction.dot(axis) + radius >= cosine);
        let above = direction.dot(self.up);
        let within = inside && self.wedge.as_ref().is_none_or(|wedge| wedge.holds(direction, above, radius));
        if within { (above + self.tilt[1] + radius).clamp(0.0, 1.0) } else { 0.0 }
    }
}

impl Wedge {
    /// Of corners whose highest is so far above the points; none where they may be anywhere above the points.
    fn of(tile: &TileBounds, corners: &[Vec3], above: f64) -> Option<Self> {
        let up = tile.normals.axis.as_dvec3();
        let [low, high] = [tile.low, tile.high].map(|p| p.as_dvec3());
        let (middle, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let way = corners.iter().map(|corner| corner.as_dvec3() - middle).sum::<DVec3>();
        let x = (way - up * way.dot(up)).try_normalize()?;
        let y = up.cross(x);
        let (mut nearest, mut side) = (f64::INFINITY, 0.0_f64);
        for way in corners.iter().map(|corner| corner.as_dvec3() - middle) {
            // The points may lie nearer and farther aside than their middle.
            let ahead = way.dot(x) - half.dot(x.abs());
            let aside = way.dot(y).abs() + half.dot(y.abs());
            nearest = nearest.min(ahead);
            side = side.max(aside / ahead);
        }
        let there = nearest > 0.0 && side.is_finite();
        there.then(|| Self { axes: [x, y], side, rise: (above / nearest).max(0.0) })
    }

    /// Its width times the integral of the sine of the elevation over any normal up to so far from the middle.
    fn projected(&self, tilt: f64) -> f64 {
        let steep = self.rise * tilt;
        if steep >= 1.0 {
            return PI;
        }
        let rise = (self.rise + tilt) / (1.0 - steep);
        let square = rise * rise;
        (2.0 * self.side * square / (1.0 + square + (1.0 + square).sqrt())).min(PI)
    }

    /// Whether some of what lies within `radius` of a unit direction, which is so far above, may be in it.
    fn holds(&self, direction: DVec3, above: f64, radius: f64) -> bool {
        let [ahead, aside] = self.axes.map(|axis| axis.dot(direction));
        let level = (ahead * ahead + aside * aside).sqrt();
        ahead + radius > 0.0
            && aside.abs() <= self.side * ahead + radius * (1.0 + self.side)
            && above <= self.rise * level + radius * (1.0 + self.rise)
    }
}

/// What is left out where it is shown to change little, and what shows it.
#[derive(Debug)]
pub struct Crop {
    /// The largest change that is left out, as a share of the light.
    limit: f64,
    /// Greatest radiance of any surface.
    surfaces: [f64; 3],
    /// Whether scattered rays meet the receiver.
    lands: bool,
    objects: [Vec3; 2],
    /// Where the receiver is the light: what is told of that when it is first asked for.
    near: Option<NearCrop>,
}

/// What is known where the receiver is the light.
#[derive(Debug)]
struct NearCrop {
    eye: Vec3,
    albedo: Option<[f64; 3]>,
    /// Whether objects lie apart from all of the receiver.
    apart: bool,
    bounds: OnceLock<NearBounds>,
}

impl Crop {
    /// For a scene; `Err` tells why nothing can be shown.
    pub fn new(scene: &Scene<'_>, limit: f64) -> Result<Self, &'static str> {
        let objects = scene.objects.bvh.bounds().ok_or("there is no object")?;
        if !scene.objects.emitters.is_empty() {
            return Err("objects shine");
        }
        if let Some(eye) = scene.rules.near {
            let albedo = matte_albedo(scene).map(|albedo| albedo.max(scene.receiver.albedo()));
            let near = NearCrop {
                eye: Vec3::from_array(eye),
                albedo: albedo.map(|albedo| albedo.to_array().map(f64::from)),
                apart: apart(scene).is_some(),
                bounds: OnceLock::new(),
            };
            let (surfaces, objects) = ([0.0; 3], objects.into());
            return Ok(Self { limit, surfaces, lands: true, objects, near: Some(near) });
        }
        let (brightest, irradiance) = scene.sky.bounds();
        let lands = scene.rules.bounce_solid;
        let albedo = matte_albedo(scene).map(|of_objects| {
            let of_receiver = if lands { scene.receiver.albedo() } else { Vec3::ZERO };
            of_objects.max(of_receiver).to_array().map(f64::from)
        });
        let surfaces = std::array::from_fn(|k| {
            let matte = albedo.map_or(f64::INFINITY, |albedo| {
                let each = (0..scene.rules.max_bounces.max(1)).scan(1.0, |left, _| {
                    *left *= albedo[k];
                    Some(*left)
                });
                irradiance[k] / PI * each.sum::<f64>()
            });
            matte.min(brightest[k])
        });
        Ok(Self { limit, surfaces, lands, objects: objects.into(), near: None })
    }

    /// The largest share that the objects can change of the light of any pixel of a place whose points may be lifted so
    /// far; none if it may be above the limit.
    pub fn bound(&self, scene: &Scene<'_>, tile: &TileBounds, lifted: f32) -> Option<f64> {
        if tile.is_empty() {
            return Some(0.0);
        }
        // Light that is lost or won for an albedo of 1, from irradiance.
        let share = |changed: [f64; 3]| {
            let least = tile.least.to_array().map(f64::from);
            (0..3).filter(|&k| changed[k] > 0.0).map(|k| changed[k] / (PI * least[k])).fold(0.0, f64::max)
        };
        // Points below what lies on them, so that it stands above.
        let tile = tile.grown(lifted);
        let tile = tile.grown(scene.objects.touching.depth(tile.low, tile.high));
        let window = Window::of(&tile, &corners(self.objects))?;
        let solid = window.projected();
        if let Some(near) = &self.near {
            return self.near_bound(scene, near, &tile, (&window, solid), &share);
        }
        let sent = self.surfaces.map(|radiance| radiance * solid);
        if share(sent) > self.limit {
            return None;
        }
        let seen = if self.lands && solid > 0.0 {
            self.receiver_solid_angle(scene.receiver, &tile, &share)?
        } else {
            0.0
        };
        let taken = if solid > 0.0 { self.hidden_light(scene, &tile, &window, solid) } else { [0.0; 3] };
        let of_receiver = |k: usize| if seen > 0.0 { self.surfaces[k] } else { 0.0 };
        let bound = share(std::array::from_fn(|k| {
            (taken[k] + solid * of_receiver(k)).max(sent[k]) + seen * of_receiver(k)
        }));
        (bound <= self.limit).then_some(bound)
    }

    /// The same where the receiver is the light.
    fn near_bound(
        &self,
        scene: &Scene<'_>,
        near: &NearCrop,
        tile: &TileBounds,
        (window, solid): (&Window, f64),
        share: &impl Fn([f64; 3]) -> f64,
    ) -> Option<f64> {
        let alone = !sees(scene.receiver, tile);
        if !alone && !near.apart {
            return None;
        }
        let bounds = near.bounds.get_or_init(|| NearBounds::new(scene, near.albedo, near.eye));
        let changed = if alone { [0.0; 3] } else { bounds.change? };
        let sent = bounds.surfaces.map(|radiance| radiance * solid);
        let seen = |taken: [f64; 3]| {
            let behind = |k: usize| if alone { 0.0 } else { sent[k] };
            share(std::array::from_fn(|k| (taken[k] + behind(k)).max(sent[k]) + PI * changed[k]))
        };
        if seen([0.0; 3]) > self.limit {
            return None;
        }
        let bound = seen(if solid > 0.0 { self.hidden_light(scene, tile, window, solid) } else { [0.0; 3] });
        (bound <= self.limit).then_some(bound)
    }

    /// A bound of the projected solid angle of the receiver from the points of a place; none where it is too large for the
    /// limit or takes too long to tell.
    fn receiver_solid_angle(
        &self,
        receiver: &Receiver,
        tile: &TileBounds,
        share: &impl Fn([f64; 3]) -> f64,
    ) -> Option<f64> {
        let (mut sum, mut left, mut fails) = (0.0, LOOKS, false);
        let too_much = |solid: f64| share(self.surfaces.map(|radiance| radiance * solid)) > self.limit;
        receiver.bvh.visit(|corners| {
            let solid = Window::of(tile, corners).map_or(PI, |window| window.projected());
            // What is small is not looked into.
            if corners.len() == 8 && left > 0 && too_much(solid * 16.0) {
                left -= 1;
                return !fails;
            }
            sum += solid;
            fails |= too_much(sum);
            false
        });
        (!fails).then_some(sum)
    }

    /// Light of the sky that the objects may hide, times the cosine: that of all texels which reach into the window, or of
    /// the brightest of them all over it, whichever is less.
    fn hidden_light(&self, scene: &Scene<'_>, tile: &TileBounds, window: &Window, solid: f64) -> [f64; 3] {
        let cone = Cone::between([tile.low, tile.high], self.objects);
        let (mut sum, mut brightest) = ([0.0; 3], [0.0_f64; 3]);
        scene.sky.each_around(&cone, |direction, radius, solid_angle, radiance| {
            let cosine = window.cosine(direction, radius);
            if cosine > 0.0 {
                for k in 0..3 {
                    sum[k] += radiance[k] * solid_angle * cosine;
                    brightest[k] = brightest[k].max(radiance[k]);
                }
            }
        });
        std::array::from_fn(|k| sum[k].min(brightest[k] * solid))
    }
}

/// Whether the points of a place may see any of the receiver.
fn sees(receiver: &Receiver, tile: &TileBounds) -> bool {
    let (mut found, mut left) = (false, LOOKS);
    receiver.bvh.visit(|corners| {
        let here = !found && Window::of(tile, corners).is_none_or(|window| window.projected() > 0.0);
        let open = here && corners.len() == 8 && left > 0;
        left -= u32::from(open);
        found |= here && !open;
        open
    });
    found
}

/// The greater of two radiances, for each channel.
pub(super) fn greatest_of(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k].max(b[k]))
}

/// The corners of a box.
pub fn corners([low, high]: [Vec3; 2]) -> [Vec3; 8] {
    let corner = |i| Vec3::select(glam::BVec3::new(i & 1 == 1, i & 2 == 2, i & 4 == 4), high, low);
    [0, 1, 2, 3, 4, 5, 6, 7].map(corner)
}

/// The largest albedo of the objects, for each channel, if all of their surfaces are matte.
fn matte_albedo(scene: &Scene<'_>) -> Option<Vec3> {
    let primitives = scene.objects.placed().iter().flat_map(|placed| {
        let object = &placed.object;
        object.primitives.iter().map(move |part| (object, part, &object.materials[part.material as usize]))
    });
    primitives
        .map(|(object, part, material)| {
            let plain = smoothest(object, material).is_none()
                && material.sheen.colour.factor == [0.0; 3]
                && material.diffuse_transmission.strength.factor == 0.0;
            let [r, g, b, _] = material.base_colour;
            // Textures are at most 1, vertex colours may be more.
            plain.then(|| if part.colours.is_empty() { Vec3::new(r, g, b).min(Vec3::ONE) } else { Vec3::ONE })
        })
        .try_fold(Vec3::ZERO, |most, albedo| Some(most.max(albedo?)))
}

/// The greatest irradiance of light given by the integrals over the sphere of its radiance, of that times the direction,
/// and times the products of its components.
pub fn greatest_irradiance(power: f64, towards: DVec3, squares: DMat3) -> f64 {
    let trace = squares.x_axis.x + squares.y_axis.y + squares.z_axis.z;
    if trace <= 0.0 {
        return 0.0;
    }
    // The largest eigenvalue, at most 3.5 % too large: the sum of their 32nd powers is at most three times that of it.
    let mut powers = squares * (1.0 / trace);
    for _ in 0..5 {
        powers = powers * powers;
    }
    let mut root = powers.x_axis.x + powers.y_axis.y + powers.z_axis.z;
    for _ in 0..5 {
        root = root.sqrt();
    }
    0.5 * ((power * trace * root).sqrt() + towards.length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path_trace::texel_grid::TexelGrid;
    use crate::sampling::{Points, circle};

    fn direction([u, v]: [f32; 2]) -> Vec3 {
        let (z, (sin, cos)) = (1.0 - 2.0 * v, circle(u));
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * cos, r * sin, z)
    }

    /// A number between two.
    fn between(low: f32, high: f32, u: f32) -> f32 {
        low + (high - low) * u
    }

    fn meets([low, high]: [Vec3; 2], from: Vec3, way: Vec3) -> bool {
        let (a, b) = ((low - from) / way, (high - from) / way);
        a.min(b).max_element().max(0.0) <= a.max(b).min_element()
    }

    /// What any point and normal of a place see of a box is within the bound, which is not many times too large.
    #[test]
    fn windows_hold_what_is_seen_of_a_box() {
        const RAYS: u32 = 20_000;
        let (mut ratios, mut held) = (0.0, 0);
        for i in 0..40 {
            let points = Points::new(11, i);
            let [[a, b], [c, d], [e, f], [g, h]] = [0, 1, 2, 3].map(|k| points.pair(k));
            let axis = direction([a, b]);
            let low = Vec3::new(between(1.5, 5.0, c), between(-2.0, 2.0, d), between(-2.0, 2.0, e));
            let target =
                [low, low + Vec3::new(between(0.2, 1.0, f), between(0.2, 2.0, g), between(0.2, 2.0, h))];
            let tile = TileBounds {
                low: Vec3::splat(-0.2),
                high: Vec3::splat(0.2),
                normals: Cone { axis, cosine: if i % 2 == 0 { 1.0 } else { 0.995 } },
                height: -0.2 * (axis.x.abs() + axis.y.abs() + axis.z.abs()),
                least: Vec3::ONE,
            };
            let Some(window) = Window::of(&tile, &corners(target)) else { continue };
            held += 1;
            for number in 0..4 {
                let points = Points::new(12 + i, number);
                let [[a, b], [c, d]] = [0, 1].map(|k| points.pair(k));
                let from = Vec3::new(a, b, c) * 0.4 - 0.2;
                let tip = Vec3::new(d - 0.5, a - 0.5, b - 0.5).normalize();
                let normal = (axis + tip * (if i % 2 == 0 { 0.0 } else { 0.08 })).normalize();
                let mut seen = 0.0;
                for ray in 0..RAYS {
                    let way = direction(Points::new(13, ray).pair(0));
                    if way.dot(normal) > 0.0 && meets(target, from, way) {
                        let cosine = window.cosine(way.as_dvec3(), 1e-6);
                        assert!(cosine >= f64::from(way.dot(normal)) - 1e-6, "{cosine} {}", way.dot(normal));
                        seen += f64::from(way.dot(normal)) * 4.0 * PI / f64::from(RAYS);
                    }
                }
                assert!(seen <= window.projected() * 1.02 + 1e-3, "{i}: {seen} of {}", window.projected());
                ratios += if window.projected() > 0.0 { seen / window.projected() } else { 1.0 };
            }
        }
        assert!(held > 20 && ratios / f64::from(4 * held) > 0.2, "{held} {ratios}");
    }

    /// No surface gets more than the bound, and some gets nearly as much.
    #[test]
    fn irradiance_is_within_its_bound() {
        // Directions with light, from one to all around.
        for (lights, least) in [(1, 0.99), (2, 0.6), (7, 0.6), (4096, 0.8)] {
            let of = |i| direction(Points::new(5, i).pair(0)).as_dvec3();
            let (mut power, mut towards, mut squares) = (0.0, DVec3::ZERO, DMat3::ZERO);
            for (i, light) in (0..lights).map(|i| (i, 1.0 + f64::from(i % 5))) {
                let d = of(i);
                power += light;
                towards += d * light;
                squares += DMat3::from_cols(d * d.x, d * d.y, d * d.z) * light;
            }
            let bound = greatest_irradiance(power, towards, squares);
            let irradiance = |normal: DVec3| -> f64 {
                (0..lights).map(|i| (1.0 + f64::from(i % 5)) * of(i).dot(normal).max(0.0)).sum()
            };
            let normals = (0..500).map(|i| direction(Points::new(6, i).pair(0)).as_dvec3());
            let most = normals.chain([of(0)]).map(irradiance).fold(0.0, f64::max);
            assert!(most <= bound * (1.0 + 1e-9) && most >= least * bound, "{lights}: {most} of {bound}");
        }
        assert_eq!(greatest_irradiance(0.0, DVec3::ZERO, DMat3::ZERO), 0.0);
    }

    /// Every texel that a direction of the cone falls into is visited, once, and few others.
    #[test]
    fn texels_of_a_cone_are_all_visited() {
        for (width, height) in [(64, 32), (200, 77), (8, 3), (1, 1)] {
            let texel_grid = TexelGrid::new(width, height, engine::Up::PlusY);
            for i in 0..60 {
                let [[a, b], [c, _]] = [0, 1].map(|k| Points::new(7, i).pair(k));
                let cone = Cone { axis: direction([a, b]), cosine: between(0.4, 0.9999, c) };
                let mut visits = vec![0; width * height];
                texel_grid.each_around(&cone, |x, y| visits[y * width + x] += 1);
                assert!(visits.iter().all(|&n| n <= 1));
                for k in 0..3_000 {
                    let way = direction(Points::new(8, k).pair(0));
                    let (x, y) = texel_grid.texel(way);
                    assert!(
                        way.dot(cone.axis) < cone.cosine || visits[y * width + x] == 1,
                        "{x} {y} {cone:?}"
                    );
                }
                let share = f64::from(visits.iter().sum::<u32>()) / (width * height) as f64;
                assert!(width < 64 || share < 0.1 + 8.0 * f64::from(1.0 - cone.cosine), "{share} {cone:?}");
            }
        }
    }
}

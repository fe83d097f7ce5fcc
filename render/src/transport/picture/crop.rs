//! Cropping: an upper bound of the change that objects make to the light of a tile of pixels.
//!
//! Objects change the light from the directions in which they are visible: they block the light behind them and add
//! light. All these directions lie in a [`Window`]. Let `P` be the projected solid angle of the window, `T` the
//! cosine-weighted light of the sky in the window, `L` the maximum radiance of any surface, and `Q` the projected
//! solid angle of the receiver as seen from the tile. Then the irradiance changes by at most
//!
//! `max(T + P L, P L) + Q L`
//!
//! where the first term `P L` and the term `Q L` stand for light of the receiver. They are 0 if scattered rays do
//! not hit the receiver, or if `Q` is 0. Without emitters `L` is at most the maximum radiance of the sky, since no
//! material amplifies light. If all surfaces are matte, `L` is also at most the radiance that follows from the
//! maximum irradiance `E` and the largest albedo `a`, `E / pi (a + a^2 + ..)`
//! ([`crate::transport::sky::irradiance_bound`]).
//!
//! The bound is compared with the traced light of the pixels without objects, which is the divisor of the ratio.
//! The comparison therefore needs no estimate.
use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::Vec3;

use super::bounds::LOOKS;
use super::near_crop::{NearBounds, apart};
use super::tile_bounds::TileBounds;
use super::window::{Window, corners};
use crate::light::env_resolution::smoothest;
use crate::transport::path::integrator::Scene;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::cone::Cone;

/// Cropping rule of a scene.
#[derive(Debug)]
pub struct Crop {
    /// Maximum relative change of light at which a tile is cropped.
    limit: f64,
    /// Maximum radiance of any surface, per channel.
    surfaces: [f64; 3],
    /// True if scattered rays hit the receiver.
    lands: bool,
    objects: [Vec3; 2],
    /// Bounds under near light, computed on first use.
    near: Option<NearCrop>,
}

/// Cropping rule under near light.
#[derive(Debug)]
struct NearCrop {
    eye: Vec3,
    albedo: Option<[f64; 3]>,
    /// True if there is a gap between the receiver and every object.
    apart: bool,
    bounds: OnceLock<NearBounds>,
}

impl Crop {
    /// Computes the rule for a scene. `Err` states why there is no bound.
    pub fn new(scene: &Scene<'_>, limit: f64) -> Result<Self, &'static str> {
        let objects = scene.objects.bvh.bounds().ok_or("there are no objects")?;
        if !scene.objects.emitters.is_empty() {
            return Err("an object emits light");
        }
        if scene.receiver.is_glossy() {
            return Err("the receiver is glossy");
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

    /// Upper bound of the relative change of the light of any pixel in a tile. The points of the tile may be moved
    /// by up to `lifted`. `None` if the change may exceed the limit.
    pub fn bound(&self, scene: &Scene<'_>, tile: &TileBounds, lifted: f32) -> Option<f64> {
        if tile.is_empty() {
            return Some(0.0);
        }
        // Light lost or gained at an albedo of 1, from irradiance.
        let share = |changed: [f64; 3]| {
            let least = tile.least.to_array().map(f64::from);
            (0..3).filter(|&k| changed[k] > 0.0).map(|k| changed[k] / (PI * least[k])).fold(0.0, f64::max)
        };
        // The points are lowered below objects that lie on them.
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

    /// Same as [`bound`](Self::bound) under near light.
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

    /// Upper bound of the projected solid angle of the receiver as seen from a tile. `None` if it exceeds the
    /// limit or takes too long to find.
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
            // Small nodes are not opened.
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

    /// Upper bound of the sky irradiance that objects may block, per channel. It is the smaller of two values: the
    /// cosine-weighted sum of the light of all texels that overlap the window, and the radiance of the brightest of
    /// these texels times `solid`.
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

/// True if the receiver may be visible from at least one point of a tile.
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

/// Largest albedo of the objects per channel. `None` unless all of their surfaces are matte.
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
            // Textures are at most 1, vertex colours may exceed it.
            plain.then(|| if part.colours.is_empty() { Vec3::new(r, g, b).min(Vec3::ONE) } else { Vec3::ONE })
        })
        .try_fold(Vec3::ZERO, |most, albedo| Some(most.max(albedo?)))
}

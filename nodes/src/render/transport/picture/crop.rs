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
//! `E / pi (a + a^2 + ..)` ([`crate::render::transport::sky::irradiance_bound`]).
//!
//! It is compared with the light that the pixels were traced to have without objects, by which the ratio is divided, so
//! that nothing of it is guessed.
use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::Vec3;

use super::bounds::LOOKS;
use super::near_crop::{NearBounds, apart};
use super::tile_bounds::TileBounds;
use super::window::{Window, corners};
use crate::light::env_resolution::smoothest;
use crate::render::transport::path::integrator::Scene;
use crate::render::transport::scene::receiver::Receiver;
use crate::render::transport::sky::cone::Cone;

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
        let objects = scene.objects.bvh.bounds().ok_or("there are no objects")?;
        if !scene.objects.emitters.is_empty() {
            return Err("an object emits light");
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

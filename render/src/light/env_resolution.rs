//! Number of columns that an environment needs, depending on the materials of the objects and on its lights.
//!
//! Every node that makes or reads the panorama has a cost per pixel. A texel blurs the light over its width. This
//! blur is not visible in reflections that the material blurs more, nor at the edges of shadows if the light is
//! several texels wide, since such edges are soft.

use std::f64::consts::PI;
use std::sync::Arc;

use engine::Notes;
use scene::math::color::luminance;
use scene::math::equirect::pixel_solid_angle;
use scene::math::num;
use scene::types::{Environment, Material, Object, Placed};

use crate::light::regions;

/// Required number of texels across the reflection lobe of the smoothest material. The width of the lobe is
/// measured at half of its maximum.
const ACROSS_LOBE: f64 = 4.0;
/// Required number of texels across the smallest light.
const ACROSS_LIGHT: f64 = 8.0;
/// Factor by which a texel must exceed the mean luminance to belong to a light.
const BRIGHT: f64 = 16.0;
/// Minimum fraction of the total power that a light must have to affect the result.
const SHARE: f64 = 0.05;
/// Minimum number of columns.
const LEAST: usize = 64;

/// Required resolution of an environment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EnvResolution {
    /// Number of columns: a power of two, or the largest allowed number.
    pub columns: usize,
    /// Roughness of the smoothest reflecting surface; `None` if all are matte.
    roughness: Option<f64>,
    /// Width of the smallest light in degrees; `None` if there are no lights.
    light_deg: Option<f64>,
}

impl EnvResolution {
    /// Computes the number of columns that `environment` needs to light `objects`, at most `most`. The result may
    /// exceed the number of columns that the environment has.
    pub fn of(environment: &Environment, objects: &[Arc<Placed>], most: usize) -> Self {
        let materials = objects.iter().flat_map(|placed| {
            placed.object.materials_in_use().filter_map(|material| smoothest(&placed.object, material))
        });
        let roughness = materials.reduce(f64::min);
        // In an environment with fewer columns, a light looks wider by up to half a texel.
        let texel = 2.0 * PI / environment.image.width.max(1) as f64;
        let blur = if environment.image.width < most { texel / 2.0 } else { 0.0 };
        let light = smallest_light(environment).map(|width| (width - blur).max(blur));
        // Facets of roughness r tilt by 0.64 r^2 where their density is half of the peak, reflections by twice that.
        let lobe = roughness.map(|r| 2.0 * num::atan2(0.64 * r * r, 1.0) / ACROSS_LOBE);
        let texel = [lobe, light.map(|width| width / ACROSS_LIGHT)].into_iter().flatten().fold(PI, f64::min);
        // A mirror needs all columns.
        let columns = (2.0 * PI / texel.max(1e-9)).min(most as f64) as usize;
        Self {
            columns: columns.max(LEAST).next_power_of_two().min(most.max(LEAST)),
            roughness,
            light_deg: light.map(f64::to_degrees),
        }
    }

    /// Adds a note if at most half of the columns of the environment are needed.
    pub fn report(&self, environment: &Environment, notes: &mut Notes) {
        let there = environment.image.width;
        if 2 * self.columns > there {
            return;
        }
        let text = format!(
            "the environment has {there} columns, but {} are enough, since {}",
            self.columns,
            self.why()
        );
        notes.decision(
            "finer-than-needed",
            format!(
                "{text}. With a smaller panorama (use `fit-probe`, or reduce `width_px`), the picture looks the same and is rendered faster"
            ),
        );
    }

    /// Text that states the reason for the required number of columns.
    pub fn why(&self) -> String {
        let surface = match self.roughness {
            Some(roughness) => format!("the smoothest surface of the objects has roughness {roughness:.2}"),
            None => "the objects are matte".to_owned(),
        };
        let light = match self.light_deg {
            Some(width) => format!("the smallest light is {width:.1} degrees wide"),
            None => "there is no small light".to_owned(),
        };
        format!("{surface} and {light}")
    }
}

/// The smallest roughness of the reflections of a material; `None` for a matte material.
pub(crate) fn smoothest(object: &Object, material: &Material) -> Option<f64> {
    let texture = material.metallic_roughness_texture;
    // A missing texture counts as the worst case.
    let least = |texture: usize| {
        let codes = object.textures.get(texture)?.rgba.chunks_exact(4).map(|texel| texel[1]);
        codes.min().map(|code| f64::from(code) / 255.0)
    };
    let texel = texture.map_or(1.0, |map| least(map.texture as usize).unwrap_or(0.0));
    let glossy = material.ior > 1.0 && material.specular.strength.factor > 0.0;
    let base = (glossy || material.metallic > 0.0 || material.transmission.factor > 0.0)
        .then(|| texel * f64::from(material.roughness));
    let coat = &material.clearcoat;
    let rough = if coat.roughness.texture.is_some() { 0.0 } else { f64::from(coat.roughness.factor) };
    let coat = (coat.strength.factor > 0.0).then_some(rough);
    [base, coat].into_iter().flatten().filter(|_| !material.unlit).reduce(f64::min)
}

/// The width, in radians, of a disc with the solid angle of the smallest light with at least [`SHARE`] of the
/// power; `None` if there are no lights. The solid angle of a light is taken as `(int L)^2 / int L^2`, so that an
/// aureole hardly increases the size of a sun.
fn smallest_light(environment: &Environment) -> Option<f64> {
    let image = &environment.image;
    let (width, height) = (image.width, image.height);
    let sizes: Vec<f64> = (0..height).map(|y| pixel_solid_angle(width, height, y)).collect();
    let size = |at: usize| sizes[at / width];
    let value = |at: usize| {
        let value = f64::from(luminance(image.rgb(at % width, at / width)));
        if value.is_finite() { value.max(0.0) } else { 0.0 }
    };
    let whole = (0..width * height).map(|at| value(at) * size(at)).sum::<f64>();
    let mask: Vec<bool> = (0..width * height).map(|at| value(at) * 4.0 * PI > BRIGHT * whole).collect();
    let lights = regions::label(&mask, width);
    let mut sums = vec![[0.0; 2]; lights.count];
    for (at, light) in lights.of.iter().enumerate().filter_map(|(at, light)| Some((at, (*light)? as usize))) {
        sums[light][0] += value(at) * size(at);
        sums[light][1] += value(at) * value(at) * size(at);
    }
    let counts = sums.into_iter().filter(|[power, _]| *power >= SHARE * whole);
    // Divided twice, since the square of a bright light may overflow.
    counts.map(|[power, squares]| 2.0 * (power / squares * power / PI).sqrt()).reduce(f64::min)
}

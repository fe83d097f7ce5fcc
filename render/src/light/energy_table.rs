//! Energy tables: the light of a panorama after each step that resamples it, in total and for each of its lights.

use std::f64::consts::{PI, TAU};

use engine::{Context, NodeError, Up};
use glam::DVec3;
use scene::math::equirect::{axes, direction, pixel_solid_angle};
use scene::math::num;
use scene::types::{Cell, Table};

use super::{measure, regions};
use crate::light::energy::Energy;

/// Maximum number of lights that are listed. The lights with the most power are listed first.
const LISTED: usize = 32;
/// A pixel with a luminance above this fraction of white belongs to a light.
const BRIGHT: f64 = 0.95;

/// A bright region of the panorama. Light within the first of the two angles from its centre is attributed to it
/// fully. From there to the second angle, the weight decreases, since resampling spreads light.
struct Light {
    centre: DVec3,
    angles: [f64; 2],
}

/// Energy of a panorama after each recorded step, in total and for each light.
pub struct EnergyTable {
    up: Up,
    lights: Vec<Light>,
    /// The recorded steps. For each: its name, the total energy, and, for each light, the irradiance on a plane
    /// that faces the light, from the directions attributed to that light.
    steps: Vec<(&'static str, Energy, Vec<f64>)>,
}

/// The direction of the centre of pixel `at`, and the solid angle of this pixel.
fn pixel(up: Up, width: usize, height: usize, at: usize) -> (DVec3, f64) {
    let (u, v) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
    let toward = direction(up, u / width as f64, v / height as f64);
    (toward, pixel_solid_angle(width, height, at / width))
}

fn find(up: Up, width: usize, luminance: &[f64], margin: f64) -> Vec<Light> {
    let height = luminance.len() / width.max(1);
    let mask: Vec<bool> = luminance.iter().map(|l| *l > BRIGHT).collect();
    let labels = regions::label(&mask, width);
    let members = || labels.of.iter().enumerate().filter_map(|(at, region)| Some((at, (*region)? as usize)));
    let mut found = vec![(0.0_f64, DVec3::ZERO, 0.0_f64); labels.count];
    for (at, region) in members() {
        let (toward, size) = pixel(up, width, height, at);
        found[region].0 += size * luminance[at];
        found[region].1 += toward * (size * luminance[at]);
    }
    for (_, centre, _) in &mut found {
        *centre = centre.try_normalize().unwrap_or(axes(up)[2]);
    }
    for (at, region) in members() {
        let (_, centre, radius) = &mut found[region];
        let cosine = pixel(up, width, height, at).0.dot(*centre).clamp(-1.0, 1.0);
        *radius = radius.max(num::f64::acos(cosine));
    }
    // Equal lights stay in the order of their first pixels.
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.truncate(LISTED);
    let own = PI / height as f64;
    let light = |(_, centre, radius): (f64, DVec3, f64)| Light {
        centre,
        angles: [radius + own, radius + own + margin],
    };
    found.into_iter().map(light).collect()
}

impl EnergyTable {
    /// Creates a table for the lights of a panorama, which are the regions with a luminance above 0.95. `luminance`
    /// holds the luminance of each pixel, row by row. Light around a region is attributed to it with a weight that
    /// falls to 0 over the angle `margin` (radians, above 0).
    pub fn new(up: Up, width: usize, luminance: &[f64], margin: f64) -> Self {
        Self { up, lights: find(up, width, luminance, margin), steps: Vec::new() }
    }

    /// Records a step whose result consists of `count` tiles. `tile(i)` returns the direction, solid angle and
    /// luminance of each pixel of tile `i`.
    pub fn record<I: Iterator<Item = (DVec3, f64, f64)>>(
        &mut self,
        step: &'static str,
        count: usize,
        cx: &Context,
        tile: impl Fn(usize) -> I + Send + Sync,
    ) -> Result<(), NodeError> {
        let above = axes(self.up)[2];
        // Angles are limited to the opposite point, beyond which cosines would rise again.
        let cosines = |angles: [f64; 2]| angles.map(|angle| num::f64::cos(angle.min(PI)));
        let cones: Vec<(DVec3, [f64; 2])> =
            self.lights.iter().map(|light| (light.centre, cosines(light.angles))).collect();
        let tiles = cx.for_each_tile(count, |i| {
            let (mut whole, mut facing) = (Energy::default(), vec![0.0; cones.len()]);
            for (toward, size, luminance) in tile(i).filter(|(_, _, luminance)| *luminance > 0.0) {
                whole.power += luminance * size;
                whole.ground += luminance * size * toward.dot(above).max(0.0);
                whole.peak = whole.peak.max(luminance);
                for (sum, (centre, [inner, outer])) in facing.iter_mut().zip(&cones) {
                    let cosine = toward.dot(*centre);
                    if cosine > *outer {
                        let part = ((cosine - outer) / (inner - outer)).min(1.0);
                        *sum += luminance * size * part * cosine.max(0.0);
                    }
                }
            }
            (whole, facing)
        })?;
        let (mut whole, mut facing) = (Energy::default(), vec![0.0; cones.len()]);
        for (part, of_lights) in tiles {
            whole.power += part.power;
            whole.ground += part.ground;
            whole.peak = whole.peak.max(part.peak);
            facing.iter_mut().zip(of_lights).for_each(|(sum, v)| *sum += v);
        }
        self.steps.push((step, whole, facing));
        Ok(())
    }

    /// Records a step whose result is a panorama. `luminance` holds the luminance of each pixel, row by row.
    pub fn record_panorama(
        &mut self,
        step: &'static str,
        width: usize,
        luminance: &[f64],
        cx: &Context,
    ) -> Result<(), NodeError> {
        let height = luminance.len() / width.max(1);
        let [right, forward, above] = axes(self.up);
        let turn = |x: usize| num::sin_cos(TAU * ((x as f64 + 0.5) / width as f64 - 0.5));
        let columns: Vec<DVec3> =
            (0..width).map(turn).map(|(sine, cosine)| right * sine + forward * cosine).collect();
        self.record(step, height, cx, |y| {
            let (sine, cosine) = num::sin_cos(PI * (y as f64 + 0.5) / height as f64);
            let size = pixel_solid_angle(width, height, y);
            let row = columns.iter().zip(&luminance[y * width..]);
            row.map(move |(column, luminance)| (*column * sine + above * cosine, size, *luminance))
        })
    }

    /// Returns two tables. The first lists the positions of the lights. The second lists, for each step, the total
    /// energy and the energy of each light after the step.
    pub fn tables(&self) -> [Table; 2] {
        let place = |light: &Light| {
            let (azimuth, elevation) = measure::angles_deg(self.up, light.centre);
            [azimuth, elevation, light.angles[0].to_degrees()].map(Cell::Number).to_vec()
        };
        let row = |name: String, values: Vec<f64>| -> Vec<Cell> {
            std::iter::once(Cell::Text(name)).chain(values.into_iter().map(Cell::Number)).collect()
        };
        let whole = |name: &str, of: fn(&Energy) -> f64| {
            row(name.to_owned(), self.steps.iter().map(|(_, energy, _)| of(energy)).collect())
        };
        let mut rows = vec![
            whole("power over the whole sphere (sr)", |energy| energy.power),
            whole("irradiance on a plane that faces up", |energy| energy.ground),
            whole("peak luminance", |energy| energy.peak),
        ];
        rows.extend((0..self.lights.len()).map(|i| {
            let values = self.steps.iter().map(|(.., facing)| facing[i]).collect();
            row(format!("irradiance from light {} on a plane that faces it", i + 1), values)
        }));
        let names = std::iter::once("quantity").chain(self.steps.iter().map(|(name, ..)| *name));
        let places = ["azimuth (deg, clockwise from forward)", "elevation (deg)", "angular radius (deg)"];
        [
            Table::new("lights", places, self.lights.iter().map(place).collect()),
            Table::new("steps", names, rows),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    // If the whole sphere is one light, the irradiance of any plane is pi times its luminance. This test fails
    // without `min(PI)`.
    #[test]
    fn a_light_may_be_all_there_is() {
        let white = vec![2.0; 64 * 32];
        let mut table = EnergyTable::new(Up::PlusY, 64, &white, 0.05);
        table.record_panorama("white", 64, &white, &context()).expect("enters");
        let [_, steps] = table.tables();
        let Cell::Number(facing) = steps.rows[3][1] else { panic!("a number") };
        assert!((facing / TAU - 1.0).abs() < 0.02, "{facing}");
    }

    // The irradiance of one bright pixel of 8 by 8 degrees, and that of the whole, do not depend on the resolution.
    // This test fails if the cone has no margin, if `size` is left out, or if directions are off by half a pixel.
    #[test]
    fn a_light_has_the_same_irradiance_on_a_finer_panorama() {
        for up in [Up::PlusZ, Up::PlusY, Up::MinusY] {
            let picture = |scale: usize| -> Vec<f64> {
                let width = 45 * scale;
                let lit = |at: usize| (at % width / scale, at / width / scale) == (30, 7);
                (0..width * 22 * scale).map(|at| if lit(at) { 40.0 } else { 0.01 }).collect()
            };
            let mut table = EnergyTable::new(up, 45, &picture(1), 0.05);
            table.record_panorama("coarse", 45, &picture(1), &context()).expect("enters");
            table.record_panorama("fine", 270, &picture(6), &context()).expect("enters");
            let [lights, steps] = table.tables();
            assert_eq!(lights.rows.len(), 1);
            let wanted = pixel(up, 45, 22, 7 * 45 + 30);
            let Cell::Number(azimuth) = lights.rows[0][0] else { panic!("a number") };
            assert!((azimuth - (360.0 * (30.5 / 45.0 - 0.5))).abs() < 0.01, "{azimuth}");
            for row in &steps.rows {
                let (Cell::Number(coarse), Cell::Number(fine)) = (&row[1], &row[2]) else {
                    panic!("numbers")
                };
                assert!((coarse / fine - 1.0).abs() < 0.01, "{row:?}");
            }
            let Cell::Number(facing) = steps.rows[3][1] else { panic!("a number") };
            assert!((facing / (40.0 * wanted.1) - 1.0).abs() < 0.02, "{facing}");
        }
    }
}

//! Emitters of an environment: its regions that are at least as bright as white.

use glam::DVec3;
use scene::math::color::luminance;
use scene::math::equirect::{direction, pixel_solid_angle};
use scene::types::Environment;

use super::regions;

/// Minimum luminance of texels that count as clipped in the panorama.
pub const WHITE: f32 = 0.95;
/// Gap between two regions that count as one emitter, in degrees. The panes of a window are one emitter.
pub const GAP_DEG: f64 = 3.0;
/// Maximum number of columns of the grid on which regions are joined.
const COLUMNS: usize = 512;

/// Connected bright region of an environment.
#[derive(Debug, Clone)]
pub struct Emitter {
    /// Texels at least as bright as white, in ascending order.
    pub texels: Vec<usize>,
    /// Unit direction of the centroid of the light.
    pub direction: DVec3,
    /// Solid angle of the texels, in steradians.
    pub solid_angle: f64,
    /// Integral of linear radiance over solid angle: the irradiance on surfaces that face all of the emitter.
    pub flux: [f64; 3],
}

/// Emitters of an environment.
pub struct Emitters {
    /// The emitters, in descending order of luminance of their flux.
    pub list: Vec<Emitter>,
    /// Integral of linear radiance over the whole sphere.
    pub total: [f64; 3],
    /// Emitter of each cell of the joining grid, including the margin by which regions were grown.
    cells: Vec<Option<u32>>,
    /// Columns and rows of this grid.
    size: [usize; 2],
}

/// Direction and solid angle of a texel.
pub fn texel(env: &Environment, at: usize) -> (DVec3, f64) {
    let (width, height) = (env.image.width, env.image.height);
    let [u, v] = [(at % width) as f64 + 0.5, (at / width) as f64 + 0.5];
    let towards = direction(env.up, u / width as f64, v / height as f64);
    (towards, pixel_solid_angle(width, height, at / width))
}

/// Linear radiance of a texel.
pub fn radiance(env: &Environment, at: usize) -> [f64; 3] {
    let samples = &env.image.samples[3 * at..3 * at + 3];
    [0, 1, 2].map(|channel| f64::from(samples[channel]))
}

/// Index of the cell of a grid of the given size that contains a texel.
fn cell(env: &Environment, at: usize, [columns, rows]: [usize; 2]) -> usize {
    let (width, height) = (env.image.width, env.image.height);
    at / width * rows / height * columns + at % width * columns / width
}

/// Integral of linear radiance over the whole sphere.
pub fn total(env: &Environment) -> [f64; 3] {
    let mut total = [0.0; 3];
    for at in 0..env.image.width * env.image.height {
        let (_, solid_angle) = texel(env, at);
        total.iter_mut().zip(radiance(env, at)).for_each(|(sum, value)| *sum += value * solid_angle);
    }
    total
}

/// Finds the emitters of an environment.
pub fn find(env: &Environment) -> Emitters {
    let (width, height) = (env.image.width, env.image.height);
    let size = [width.min(COLUMNS), height.min(COLUMNS / 2)];
    let mut mask = vec![false; size[0] * size[1]];
    let bright: Vec<usize> = (0..width * height)
        .filter(|&at| luminance([0, 1, 2].map(|c| env.image.samples[3 * at + c])) >= WHITE)
        .collect();
    bright.iter().for_each(|&at| mask[cell(env, at, size)] = true);
    let steps = (0.5 * GAP_DEG * size[0] as f64 / 360.0).round() as usize;
    let labels = regions::label(&regions::grow(&mask, size[0], steps), size[0]);
    let mut list: Vec<(u32, Emitter)> = (0..labels.count as u32)
        .map(|label| {
            let emitter =
                Emitter { texels: Vec::new(), direction: DVec3::ZERO, solid_angle: 0.0, flux: [0.0; 3] };
            (label, emitter)
        })
        .collect();
    for at in bright {
        let Some(label) = labels.of[cell(env, at, size)] else { continue };
        let emitter = &mut list[label as usize].1;
        let ((towards, solid_angle), rgb) = (texel(env, at), radiance(env, at));
        emitter.texels.push(at);
        emitter.solid_angle += solid_angle;
        emitter.direction += towards * (solid_angle * super::measure::luminance(rgb));
        emitter.flux.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += value * solid_angle);
    }
    list.sort_by(|(_, a), (_, b)| {
        super::measure::luminance(b.flux).total_cmp(&super::measure::luminance(a.flux))
    });
    let mut rank = vec![0; list.len()];
    list.iter().enumerate().for_each(|(index, (label, _))| rank[*label as usize] = index as u32);
    let emitters = list.into_iter().map(|(_, emitter)| {
        let direction = emitter.direction.try_normalize().unwrap_or(texel(env, emitter.texels[0]).0);
        Emitter { direction, ..emitter }
    });
    Emitters {
        list: emitters.collect(),
        total: total(env),
        cells: labels.of.iter().map(|label| label.map(|label| rank[label as usize])).collect(),
        size,
    }
}

impl Emitters {
    /// Index of the emitter that a direction belongs to, including a margin of half of [`GAP_DEG`].
    pub fn at(&self, up: engine::Up, direction: DVec3) -> Option<usize> {
        let (u, v) = scene::math::equirect::uv(up, direction);
        let index = |t: f64, n: usize| ((t * n as f64) as usize).min(n - 1);
        let at = index(v, self.size[1]) * self.size[0] + index(u, self.size[0]);
        self.cells[at].map(|emitter| emitter as usize)
    }

    /// Fluxes of another environment within the emitters of this one, margins included, in the same order.
    pub fn fluxes(&self, of: &Environment) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 3]; self.list.len()];
        for at in 0..of.image.width * of.image.height {
            let (towards, solid_angle) = texel(of, at);
            let Some(emitter) = self.at(of.up, towards) else { continue };
            let sum = &mut sums[emitter];
            sum.iter_mut().zip(radiance(of, at)).for_each(|(sum, value)| *sum += value * solid_angle);
        }
        sums
    }
}

/// Angle between two linear colours as vectors of red, green and blue, in degrees. `None` if one of them is black.
pub fn colour_angle_deg(a: [f64; 3], b: [f64; 3]) -> Option<f64> {
    let (a, b) = (DVec3::from(a), DVec3::from(b));
    let (a, b) = (a.try_normalize()?, b.try_normalize()?);
    Some(scene::math::num::atan2(a.cross(b).length(), a.dot(b)).to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Up;
    use scene::types::Image;

    fn env(width: usize, light: impl Fn(DVec3) -> [f32; 3]) -> Environment {
        let mut env =
            Environment { image: Image::new(width, width / 2, 3).into(), up: Up::PlusZ, origin: None };
        for at in 0..width * width / 2 {
            let rgb = light(texel(&env, at).0);
            env.image.samples[3 * at..3 * at + 3].copy_from_slice(&rgb);
        }
        env
    }

    const LAMP: [f64; 3] = [0.0, 0.8, 0.6];

    /// A warm lamp, and a window of two panes behind the observer, across the seam of the panorama.
    fn two(d: DVec3) -> [f32; 3] {
        if d.dot(DVec3::from(LAMP)) > 0.995 {
            return [30.0, 20.0, 8.0];
        }
        let window = d.y < -0.9 && d.z.abs() < 0.2 && d.x.abs() > 0.01;
        if window { [3.0, 4.0, 6.0] } else { [0.3; 3] }
    }

    // This test fails if regions are not grown before they are labelled.
    #[test]
    fn the_panes_of_a_window_are_one_emitter() {
        for width in [256, 1024] {
            let found = find(&env(width, two));
            assert_eq!(found.list.len(), 2, "{width}");
            let lamp = found.list.iter().position(|e| e.direction.dot(DVec3::from(LAMP)) > 0.999);
            let lamp = &found.list[lamp.expect("the lamp is found")];
            assert!((lamp.solid_angle / (2.0 * std::f64::consts::PI * 0.005) - 1.0).abs() < 0.05);
            assert!((lamp.flux[0] / lamp.flux[2] - 3.75).abs() < 1e-9);
        }
    }

    // Fluxes do not depend on the resolution of the environment in which they are measured.
    #[test]
    fn the_flux_of_an_emitter_is_measured_in_another_environment() {
        let found = find(&env(512, two));
        let double = env(256, |d| two(d).map(|v| 2.0 * v));
        for (emitter, flux) in found.list.iter().zip(found.fluxes(&double)) {
            for (a, b) in emitter.flux.iter().zip(flux) {
                assert!((b / a / 2.0 - 1.0).abs() < 0.12, "{emitter:?} {flux:?}");
            }
        }
    }

    #[test]
    fn angles_of_colours_do_not_depend_on_brightness() {
        let angle = colour_angle_deg([1.0, 0.0, 0.0], [0.0, 5.0, 0.0]).expect("not black");
        assert!((angle - 90.0).abs() < 1e-9);
        assert_eq!(colour_angle_deg([1.0; 3], [0.0; 3]), None);
        assert!(colour_angle_deg([0.2; 3], [7.0; 3]).is_some_and(|angle| angle < 1e-6));
    }
}

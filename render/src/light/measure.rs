//! Measures of light, in float64: irradiance, the dominant direction, contrast.

use std::f64::consts::PI;

use glam::DVec3;
use scene::math::equirect::{direction, pixel_solid_angle};
use scene::math::num;
use scene::types::Environment;

/// A cell of an environment: a direction, its solid angle and the mean radiance in it.
#[derive(Debug, Clone, Copy)]
pub struct Cell {
    /// Unit direction of the centroid of the texels in the cell.
    pub direction: DVec3,
    /// Solid angle, in steradians.
    pub solid_angle: f64,
    /// Mean linear radiance.
    pub rgb: [f64; 3],
}

impl Cell {
    /// Luminance of the mean radiance.
    pub fn luminance(&self) -> f64 {
        luminance(self.rgb)
    }
}

/// Luminance of linear RGB in f64, with the weights of [`scene::math::color::LUMINANCE`].
pub fn luminance(rgb: [f64; 3]) -> f64 {
    0.21267 * rgb[0] + 0.71516 * rgb[1] + 0.07217 * rgb[2]
}

/// A texel of an environment, or one of the equal parts of a large texel.
struct Texel {
    direction: DVec3,
    solid_angle: f64,
    rgb: [f64; 3],
    /// Column and row. If texels are split, the parts are counted.
    place: [usize; 2],
}

/// Number of parts into which each texel is split horizontally and vertically, so that the environment has about
/// `columns` columns in total.
fn cuts(env: &Environment, columns: usize) -> [usize; 2] {
    [columns / env.image.width, columns / 2 / env.image.height].map(|parts| parts.max(1))
}

/// Calls `give` for every texel of an environment, row by row. Large texels are split, since a texel that is many
/// degrees wide cannot be treated as a point.
fn each_texel(env: &Environment, [across, down]: [usize; 2], mut give: impl FnMut(Texel)) {
    let (width, height) = (env.image.width * across, env.image.height * down);
    for y in 0..height {
        let solid_angle = pixel_solid_angle(width, height, y);
        for x in 0..width {
            let (u, v) = ((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
            let rgb = env.image.rgb(x / across, y / down).map(f64::from);
            give(Texel { direction: direction(env.up, u, v), solid_angle, rgb, place: [x, y] });
        }
    }
}

/// Averages an environment over a grid of at most `columns` x `columns / 2` cells. The power of every texel is
/// added to the cell that contains its centre, which preserves the total for any image size. Texels larger than
/// cells are split.
pub fn cells(env: &Environment, columns: usize) -> Vec<Cell> {
    let cuts = cuts(env, columns);
    let (width, height) = (env.image.width * cuts[0], env.image.height * cuts[1]);
    let (columns, rows) = (columns.min(width), (columns / 2).min(height).max(1));
    let mut sums = vec![(DVec3::ZERO, 0.0_f64, [0.0_f64; 3]); columns * rows];
    each_texel(env, cuts, |Texel { direction, solid_angle, rgb, place: [x, y] }| {
        let row = (2 * y + 1) * rows / (2 * height) * columns;
        let cell = &mut sums[row + (2 * x + 1) * columns / (2 * width)];
        cell.0 += direction * solid_angle;
        cell.1 += solid_angle;
        for (sum, value) in cell.2.iter_mut().zip(rgb) {
            *sum += solid_angle * value;
        }
    });
    let cell = |(toward, solid_angle, sum): (DVec3, f64, [f64; 3])| {
        Some(Cell { direction: toward.try_normalize()?, solid_angle, rgb: sum.map(|s| s / solid_angle) })
    };
    sums.into_iter().filter_map(cell).collect()
}

/// Irradiance on planes with the given unit normals, summed over texels.
pub fn irradiances<const N: usize>(env: &Environment, normals: [DVec3; N]) -> [[f64; 3]; N] {
    let mut sums = [[0.0; 3]; N];
    each_texel(env, cuts(env, 128), |texel| {
        for (sum, normal) in sums.iter_mut().zip(normals) {
            let weight = texel.direction.dot(normal).max(0.0) * texel.solid_angle;
            sum.iter_mut().zip(texel.rgb).for_each(|(sum, value)| *sum += weight * value);
        }
    });
    sums
}

/// Irradiance on a plane with the given unit normal.
pub fn irradiance(cells: &[Cell], normal: DVec3) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for cell in cells {
        let weight = cell.direction.dot(normal).max(0.0) * cell.solid_angle;
        for (sum, value) in sum.iter_mut().zip(cell.rgb) {
            *sum += weight * value;
        }
    }
    sum
}

/// `n` evenly distributed unit vectors: a Fibonacci spiral about z.
pub fn spiral(n: usize) -> Vec<DVec3> {
    let golden = PI * (1.0 + 5.0_f64.sqrt());
    (0..n)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / n as f64;
            let (sin, cos) = num::sin_cos(golden * (i as f64 + 0.5));
            let r = (1.0 - z * z).sqrt();
            DVec3::new(r * cos, r * sin, z)
        })
        .collect()
}

/// Cosine of 15 degrees, the angle from its centre within which light belongs to the dominant light.
pub const DOMINANT_COS: f64 = 0.965_925_826_289_068_3;

/// The direction in which the radiance, smoothed by a lobe of 10 degrees, is largest, and the ratio of this
/// radiance to the mean over the sphere. `None` if all cells are black.
pub fn brightest(coarse: &[Cell]) -> Option<(DVec3, f64)> {
    let sharpness = 1.0 / (PI / 18.0 * (PI / 18.0));
    let mut best = (0.0, None);
    for at in coarse {
        let smoothed: f64 = coarse
            .iter()
            .map(|cell| (cell, sharpness * (at.direction.dot(cell.direction) - 1.0)))
            .filter(|(_, exponent)| *exponent > -16.0)
            .map(|(cell, exponent)| num::f64::exp(exponent) * cell.solid_angle * cell.luminance())
            .sum();
        if smoothed > best.0 {
            best = (smoothed, Some(at.direction));
        }
    }
    let power: f64 = coarse.iter().map(|cell| cell.solid_angle * cell.luminance()).sum();
    // The lobe's integral over the sphere is 2 pi / sharpness.
    Some((best.1?, best.0 * 2.0 * sharpness / power))
}

/// The centroid of luminance within 15 degrees of a direction.
pub fn centroid(fine: &[Cell], around: DVec3) -> DVec3 {
    let near = fine.iter().filter(|cell| cell.direction.dot(around) > DOMINANT_COS);
    let sum =
        near.fold(DVec3::ZERO, |sum, cell| sum + cell.direction * (cell.solid_angle * cell.luminance()));
    sum.try_normalize().unwrap_or(around)
}

/// Direction of the dominant light: the [`centroid`] around the [`brightest`] direction. `None` if all cells are
/// black.
pub fn dominant(coarse: &[Cell], fine: &[Cell]) -> Option<DVec3> {
    brightest(coarse).map(|(around, _)| centroid(fine, around))
}

/// Irradiance on a plane from within 15 degrees of `light`, divided by the irradiance from all other directions;
/// `None` if the latter is 0. The plane is the ground. If `light` is less than about 6 degrees above the horizon,
/// the plane faces `light` instead.
pub fn contrast(cells: &[Cell], light: DVec3, up: DVec3) -> Option<f64> {
    let normal = if light.dot(up) > 0.1 { up } else { light };
    let (mut near, mut rest) = (0.0, 0.0);
    for cell in cells {
        let power = cell.direction.dot(normal).max(0.0) * cell.solid_angle * cell.luminance();
        if cell.direction.dot(light) > DOMINANT_COS { near += power } else { rest += power }
    }
    (rest > 0.0).then(|| near / rest)
}

/// Azimuth and elevation of a direction, in degrees. The azimuth is 0 straight ahead and increases to the right,
/// which is clockwise as seen from above.
pub fn angles_deg(up: engine::Up, direction: DVec3) -> (f64, f64) {
    let (u, v) = scene::math::equirect::uv(up, direction);
    (360.0 * (u - 0.5), 90.0 - 180.0 * v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Up;
    use scene::types::Image;

    fn env(width: usize, f: impl Fn(DVec3) -> f32) -> Environment {
        let mut image = Image::new(width, width / 2, 3);
        for y in 0..width / 2 {
            for x in 0..width {
                let d = direction(
                    Up::PlusZ,
                    (x as f64 + 0.5) / width as f64,
                    (y as f64 + 0.5) / (width / 2) as f64,
                );
                image.pixel_mut(x, y).fill(f(d));
            }
        }
        Environment { image: image.into(), up: Up::PlusZ, origin: None }
    }

    #[test]
    fn uniform_light_gives_pi_on_every_plane() {
        let cells = cells(&env(300, |_| 1.0), 128);
        for normal in spiral(40) {
            assert!((irradiance(&cells, normal)[1] - PI).abs() < 2e-3);
        }
    }

    // This test fails if `cuts` returns 1 and 1.
    #[test]
    fn texels_are_areas_however_large() {
        let mut pair = env(2, |_| 1.0);
        pair.image.samples.fill(1.0);
        for env in [env(8, |_| 1.0), env(32, |_| 1.0), pair] {
            let cells = cells(&env, 128);
            let axes = [DVec3::X, DVec3::Y, DVec3::NEG_Z];
            for (i, exact) in irradiances(&env, axes).iter().enumerate() {
                assert!((exact[0] - PI).abs() < 2e-3, "{exact:?}");
                assert!((irradiance(&cells, axes[i])[0] - PI).abs() < 2e-3);
            }
            assert!(brightest(&cells).is_some_and(|(_, over)| over < 1.02), "nothing stands out");
        }
    }

    #[test]
    fn power_does_not_depend_on_the_cells() {
        let env = env(300, |d| (5.0 * d.x as f32).max(0.0) + 0.1);
        let power = |n| cells(&env, n).iter().map(|c| c.solid_angle * c.luminance()).sum::<f64>();
        assert!((power(128) - power(300)).abs() < 1e-9 * power(300));
    }

    #[test]
    fn a_small_bright_light_is_dominant() {
        let light = DVec3::new(0.3, -0.5, 0.6).normalize();
        let env = env(256, |d| if d.dot(light) > 0.999 { 500.0 } else { 0.2 });
        let (fine, coarse) = (cells(&env, 256), cells(&env, 128));
        let found = dominant(&coarse, &fine).expect("there is light");
        assert!(found.dot(light) > 0.9995, "{found}");
        assert!(contrast(&fine, light, DVec3::Z).is_some_and(|contrast| contrast > 1.0));
        let (azimuth, elevation) = angles_deg(Up::PlusZ, light);
        assert!((azimuth - 149.04).abs() < 0.01 && (elevation - 45.82).abs() < 0.01, "{azimuth} {elevation}");
    }
}

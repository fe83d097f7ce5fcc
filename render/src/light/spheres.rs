//! Comparison of two lights by renders of a matte, a glossy and a mirror sphere.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::math::num;

use super::measure::{Cell, irradiance};

/// Diameter of a sphere in pixels.
const SIZE: usize = 32;
/// Material of a sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sphere {
    /// White and matte.
    Diffuse,
    /// Glossy, with a normalised Phong lobe: the cosine of the angle to the mirror direction, to the power of 24.
    Glossy,
    /// A mirror, which shows the cell of light nearest to the mirror direction.
    Mirror,
}

/// Difference between the render of a sphere in the compared light and its render in the reference light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphereError {
    /// Root-mean-square difference over pixels and channels, divided by the root-mean-square value of the
    /// reference.
    pub relative: f64,
    /// Same as `relative`, after scaling the compared sphere by the factor that minimises the difference.
    pub scaled: f64,
    /// Mean angle between the colours of both spheres, taken as RGB vectors, in degrees.
    pub angle_deg: f64,
}

/// Renders a sphere in the compared light `found` and in the reference light `truth`, and compares both renders.
/// The camera is orthographic and looks along `forward`. `None` if the render in the reference is black.
pub fn sphere_error(
    sphere: Sphere,
    found: &[Cell],
    truth: &[Cell],
    [right, forward, up]: [DVec3; 3],
    cx: &Context,
) -> Result<Option<SphereError>, NodeError> {
    let rows = cx.for_each_tile(SIZE, |row| {
        let at = |i: usize| 2.0 * (i as f64 + 0.5) / SIZE as f64 - 1.0;
        let mut pixels = Vec::with_capacity(SIZE);
        for column in 0..SIZE {
            let (x, y) = (at(column), -at(row));
            let rest = 1.0 - x * x - y * y;
            if rest > 0.0 {
                let normal = right * x + up * y - forward * rest.sqrt();
                pixels.push((shade(sphere, found, normal, forward), shade(sphere, truth, normal, forward)));
            }
        }
        pixels
    })?;
    let (mut ff, mut ft, mut tt, mut error, mut angles, mut coloured) = (0.0, 0.0, 0.0, 0.0, 0.0, 0_u32);
    for (f, t) in rows.iter().flatten() {
        let (f, t) = (DVec3::from(*f), DVec3::from(*t));
        (ff, ft, tt) = (ff + f.dot(f), ft + f.dot(t), tt + t.dot(t));
        error += (f - t).length_squared();
        if f.length_squared() > 0.0 && t.length_squared() > 0.0 {
            angles += num::atan2(f.cross(t).length(), f.dot(t)).to_degrees();
            coloured += 1;
        }
    }
    if tt <= 0.0 {
        return Ok(None);
    }
    // The least-squares factor. The error is summed again, so that equal spheres differ by exactly 0.
    let best = if ff > 0.0 { ft / ff } else { 0.0 };
    let rest = |(f, t): &([f64; 3], [f64; 3])| (DVec3::from(*f) * best - DVec3::from(*t)).length_squared();
    let scaled: f64 = rows.iter().flatten().map(rest).sum();
    Ok(Some(SphereError {
        relative: (error / tt).sqrt(),
        scaled: (scaled / tt).sqrt(),
        angle_deg: angles / f64::from(coloured.max(1)),
    }))
}

/// Radiance that is seen along `forward` at the point of a sphere with this normal.
fn shade(sphere: Sphere, cells: &[Cell], normal: DVec3, forward: DVec3) -> [f64; 3] {
    if sphere == Sphere::Diffuse {
        return irradiance(cells, normal).map(|e| e / std::f64::consts::PI);
    }
    let mirror = forward - normal * (2.0 * forward.dot(normal));
    if sphere == Sphere::Mirror {
        let nearer = |best: (f64, [f64; 3]), cell: &Cell| {
            let cos = cell.direction.dot(mirror);
            if cos > best.0 { (cos, cell.rgb) } else { best }
        };
        return cells.iter().fold((f64::NEG_INFINITY, [0.0; 3]), nearer).1;
    }
    let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
    for cell in cells {
        let cos = cell.direction.dot(mirror).max(0.0);
        let eighth = cos * cos * cos * cos * (cos * cos * cos * cos);
        let weight = eighth * eighth * eighth * cell.solid_angle;
        sum += DVec3::from(cell.rgb) * weight;
        weights += weight;
    }
    if weights > 0.0 { (sum / weights).into() } else { [0.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::measure::cells;
    use engine::Up;
    use scene::math::equirect::axes;
    use scene::types::{Environment, Image};

    fn light(top: [f32; 3], bottom: [f32; 3]) -> Vec<Cell> {
        let mut image = Image::new(128, 64, 3);
        for y in 0..64 {
            (0..128).for_each(|x| image.pixel_mut(x, y).copy_from_slice(if y < 32 { &top } else { &bottom }));
        }
        cells(&Environment { image: image.into(), up: Up::PlusZ, origin: None }, 128)
    }

    fn error(sphere: Sphere, found: &[Cell], truth: &[Cell]) -> SphereError {
        let error = sphere_error(sphere, found, truth, axes(Up::PlusZ), &testing::context());
        error.expect("runs").expect("the truth is not black")
    }

    #[test]
    fn a_sphere_in_constant_light_is_that_light() {
        let cells = light([0.25, 0.5, 1.0], [0.25, 0.5, 1.0]);
        for sphere in [Sphere::Diffuse, Sphere::Glossy, Sphere::Mirror] {
            let seen = shade(sphere, &cells, DVec3::new(0.6, -0.8, 0.0), DVec3::Y);
            assert!(seen.iter().zip([0.25, 0.5, 1.0]).all(|(a, b)| (a - b).abs() < 2e-3 * b), "{seen:?}");
        }
    }

    #[test]
    fn exposure_is_no_scaled_error_and_colour_is_an_angle() {
        let truth = light([1.0; 3], [0.1; 3]);
        let twice: Vec<Cell> = light([2.0; 3], [0.2; 3]);
        for sphere in [Sphere::Diffuse, Sphere::Glossy, Sphere::Mirror] {
            let e = error(sphere, &twice, &truth);
            assert!((e.relative - 1.0).abs() < 1e-9 && e.scaled < 1e-6 && e.angle_deg < 1e-5, "{e:?}");
            assert_eq!(error(sphere, &truth, &truth).relative, 0.0);
        }
        let red = light([1.0, 0.0, 0.0], [0.1, 0.0, 0.0]);
        // (1, 0, 0) against (1, 1, 1): the angle whose cosine is 1 / sqrt 3.
        assert!((error(Sphere::Diffuse, &red, &truth).angle_deg - 54.7356).abs() < 1e-3);
        let upside_down = light([0.1; 3], [1.0; 3]);
        let [matte, mirror] =
            [Sphere::Diffuse, Sphere::Mirror].map(|s| error(s, &upside_down, &truth).scaled);
        assert!(mirror > matte && matte > 0.3, "a mirror shows more: {mirror} {matte}");
    }
}

//! Virtual lights in groups of eight, for vector registers.

use std::f32::consts::TAU;

use fearless_simd::{f32x8, prelude::*};
use glam::Vec3;

/// Number of lights per group.
pub(super) const LANES: usize = 8;

/// A virtual light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LightPoint {
    /// Position on the receiver, or unit direction to the sky.
    pub(super) at: Vec3,
    /// Unit normal of the receiver on the side of the point of capture; `None` for the sky.
    pub(super) normal: Option<Vec3>,
    pub(super) radiance: Vec3,
    /// Area on the receiver, or solid angle of the sky.
    pub(super) size: f32,
}

/// Eight virtual lights, one per lane. Empty lanes have no light.
#[derive(Debug, Clone, Copy)]
pub(super) struct WideLights {
    at: [[f32; LANES]; 3],
    /// Normals; 0 for the sky.
    normal: [[f32; LANES]; 3],
    radiance: [[f32; LANES]; 3],
    size: [f32; LANES],
    /// 1 for the sky, 0 for the receiver.
    sky: [f32; LANES],
}

impl WideLights {
    /// Creates a group of at most eight lights.
    pub(super) fn new(lights: &[LightPoint]) -> Self {
        let none = [[0.0; LANES]; 3];
        let (size, sky) = ([0.0; LANES], [1.0; LANES]);
        let mut all = Self { at: none, normal: none, radiance: none, size, sky };
        for (lane, light) in lights.iter().enumerate() {
            let normal = light.normal.unwrap_or_default();
            for k in 0..3 {
                all.at[k][lane] = light.at[k];
                all.normal[k][lane] = normal[k];
                all.radiance[k][lane] = light.radiance[k];
            }
            all.size[lane] = light.size;
            all.sky[lane] = f32::from(u8::from(light.normal.is_none()));
        }
        all
    }

    /// Irradiance that each light contributes at `place` to a surface with the unit normal `normal`, per channel.
    #[inline(always)]
    pub(super) fn irradiance<S: Simd>(&self, simd: S, place: Vec3, normal: Vec3) -> [[f32; LANES]; 3] {
        let load = |values: &[f32; LANES]| f32x8::from_slice(simd, values);
        let zero = f32x8::splat(simd, 0.0);
        let at = [load(&self.at[0]), load(&self.at[1]), load(&self.at[2])];
        let [x, y, z] = [at[0] - place.x, at[1] - place.y, at[2] - place.z];
        let distance = (x * x + y * y + z * z).sqrt();
        let [x, y, z] = [x / distance, y / distance, z / distance];
        let (own_x, own_y, own_z) = (load(&self.normal[0]), load(&self.normal[1]), load(&self.normal[2]));
        let size = load(&self.size);
        // At close range the piece fills at most half of all directions.
        let solid = size * -(own_x * x + own_y * y + own_z * z) / (distance * distance);
        let solid = solid.simd_lt(f32x8::splat(simd, TAU)).select(solid, f32x8::splat(simd, TAU));
        let sky = load(&self.sky).simd_gt(zero);
        let [x, y, z] = [sky.select(at[0], x), sky.select(at[1], y), sky.select(at[2], z)];
        let solid = sky.select(size, solid);
        let solid = solid.simd_gt(zero).select(solid, zero);
        let cosine = x * normal.x + y * normal.y + z * normal.z;
        let cosine = cosine.simd_gt(zero).select(cosine, zero);
        let light = |k: usize| load(&self.radiance[k]) * solid * cosine;
        let (red, green, blue) = (light(0), light(1), light(2));
        let most = f32x8::splat(simd, f32::MAX);
        let finite = red.simd_le(most) & green.simd_le(most) & blue.simd_le(most);
        let mut out = [[0.0; LANES]; 3];
        finite.select(red, zero).store_slice(&mut out[0]);
        finite.select(green, zero).store_slice(&mut out[1]);
        finite.select(blue, zero).store_slice(&mut out[2]);
        out
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;
    use crate::geometry::sampling::Points;
    use testing::direction;

    /// Irradiance that one light contributes, without vectors.
    fn alone(light: &LightPoint, place: Vec3, normal: Vec3) -> Vec3 {
        let (direction, solid_angle) = match light.normal {
            None => (light.at, light.size),
            Some(own) => {
                let to = light.at - place;
                let distance = to.length();
                let direction = to / distance;
                (direction, (light.size * -own.dot(direction) / (distance * distance)).min(TAU))
            }
        };
        let irradiance = light.radiance * solid_angle.max(0.0) * normal.dot(direction).max(0.0);
        if irradiance.is_finite() { irradiance } else { Vec3::ZERO }
    }

    /// A group gives the same bits as each light alone, at every SIMD level: for lights of the receiver and of the
    /// sky, at the place itself, close to it, and with radiance that overflows. This test fails if `solid` is
    /// limited to `TAU` for the sky too.
    #[test]
    fn a_group_gives_the_bits_of_each_light() {
        let place = Vec3::new(0.3, -0.2, 1.1);
        for group in 0..200 {
            let lights: Vec<LightPoint> = (0..5 + group % 4)
                .map(|i| {
                    let points = Points::new(group, i);
                    let [[a, b], [c, d]] = [points.pair(2), points.pair(3)];
                    let own = direction(points.pair(0));
                    let far = [0.0, 1e-20, 0.01, 3.0][(4.0 * a) as usize % 4];
                    let bright = if b < 0.1 { f32::MAX } else { 1.0 + b };
                    let (at, normal) = match c < 0.3 {
                        true => (own, None),
                        false => (place + direction(points.pair(1)) * far, Some(own)),
                    };
                    let radiance = Vec3::new(bright, 0.5, d);
                    LightPoint { at, normal, radiance, size: if d < 0.2 { 9.0 } else { d } }
                })
                .collect();
            let normal = direction(Points::new(group, 99).pair(0));
            let wide = WideLights::new(&lights);
            for level in testing::levels() {
                let found = dispatch!(level, simd => wide.irradiance(simd, place, normal));
                for lane in 0..LANES {
                    let expected = lights.get(lane).map_or(Vec3::ZERO, |light| alone(light, place, normal));
                    let found = [0, 1, 2].map(|k| found[k][lane]);
                    assert_eq!(found, expected.to_array(), "{level:?} {group} {lane}");
                }
            }
        }
    }
}

//! Windows: parts of the sphere that contain all directions from the points of a tile to a box, and bounds of
//! the light from them.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::tile_bounds::TileBounds;
use crate::transport::sky::cone::Cone;

/// Part of the sphere that contains all directions from the points of a tile to a box. It is a cone around the
/// direction to the centre of the box. If, seen along the axis of the normals of the tile, the box lies entirely to
/// one side of the tile, the window is the intersection of this cone and a [`Wedge`].
pub(crate) struct Window {
    /// Axis of the cone that contains the normals of the tile.
    up: DVec3,
    /// Sine and tangent of the angle between `up` and the farthest normal.
    tilt: [f64; 2],
    /// Axis of the cone, and cosine and sine of its angle. `None` if the angle is a right angle or more.
    cone: Option<(DVec3, [f64; 2])>,
    /// Squared sine of the angular radius of the box, as seen from the nearest point of the tile.
    ball: f64,
    wedge: Option<Wedge>,
}

/// Directions within a range of azimuths around the axis of normals, from the horizon up to a maximum elevation.
struct Wedge {
    /// Axes towards the centre of the wedge and perpendicular to it.
    axes: [DVec3; 2],
    /// Tangent of half the range of azimuths.
    side: f64,
    /// Tangent of the maximum elevation.
    rise: f64,
}

impl Window {
    /// Window of a box or a triangle, given by its corners. `None` if the box or triangle may surround the points.
    pub(crate) fn of(tile: &TileBounds, corners: &[Vec3]) -> Option<Self> {
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

    /// Upper bound of the projected solid angle of the window, for a surface with any normal of the tile.
    pub(crate) fn projected(&self) -> f64 {
        let of_cone = self.cone.map_or(PI, |(axis, [cosine, sine])| {
            // Largest if the normal is its axis; and at most the solid angle times the cosine of the smallest angle
            // to a normal: the angle to the axis, less those to the boundary and to the farthest normal.
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
        // For any cone less than a hemisphere the projected solid angle is largest if the surface faces it.
        of_cone.min(PI * self.ball).min(self.wedge.as_ref().map_or(PI, |wedge| wedge.projected(tilt)))
    }

    /// Upper bound of the cosine between any of the normals and any direction within `radius` of the unit vector
    /// `direction`. 0 if all of these directions are outside the window.
    pub(crate) fn cosine(&self, direction: DVec3, radius: f64) -> f64 {
        // The cosine with the cone's axis changes by at most the distance that a direction moves.
        let inside = self.cone.is_none_or(|(axis, [cosine, _])| direction.dot(axis) + radius >= cosine);
        let above = direction.dot(self.up);
        let within = inside && self.wedge.as_ref().is_none_or(|wedge| wedge.holds(direction, above, radius));
        if within { (above + self.tilt[1] + radius).clamp(0.0, 1.0) } else { 0.0 }
    }
}

impl Wedge {
    /// Wedge that contains the directions to some corners. The highest corner is `above` higher than the points.
    /// `None` if the corners may be in any direction above the points.
    fn of(tile: &TileBounds, corners: &[Vec3], above: f64) -> Option<Self> {
        let up = tile.normals.axis.as_dvec3();
        let [low, high] = [tile.low, tile.high].map(|p| p.as_dvec3());
        let (middle, half) = ((low + high) * 0.5, (high - low) * 0.5);
        let way = corners.iter().map(|corner| corner.as_dvec3() - middle).sum::<DVec3>();
        let x = (way - up * way.dot(up)).try_normalize()?;
        let y = up.cross(x);
        let (mut nearest, mut side) = (f64::INFINITY, 0.0_f64);
        for way in corners.iter().map(|corner| corner.as_dvec3() - middle) {
            // The points may be nearer and farther to the side than their centre.
            let ahead = way.dot(x) - half.dot(x.abs());
            let aside = way.dot(y).abs() + half.dot(y.abs());
            nearest = nearest.min(ahead);
            side = side.max(aside / ahead);
        }
        let there = nearest > 0.0 && side.is_finite();
        there.then(|| Self { axes: [x, y], side, rise: (above / nearest).max(0.0) })
    }

    /// Upper bound of the projected solid angle for normals whose angle to the axis has a tangent of at most
    /// `tilt`: the width of the wedge times the integral of the sine of the elevation.
    fn projected(&self, tilt: f64) -> f64 {
        let steep = self.rise * tilt;
        if steep >= 1.0 {
            return PI;
        }
        let rise = (self.rise + tilt) / (1.0 - steep);
        let square = rise * rise;
        (2.0 * self.side * square / (1.0 + square + (1.0 + square).sqrt())).min(PI)
    }

    /// True if the wedge may contain a direction within `radius` of a unit direction whose sine of elevation
    /// is `above`.
    fn holds(&self, direction: DVec3, above: f64, radius: f64) -> bool {
        let [ahead, aside] = self.axes.map(|axis| axis.dot(direction));
        let level = (ahead * ahead + aside * aside).sqrt();
        ahead + radius > 0.0
            && aside.abs() <= self.side * ahead + radius * (1.0 + self.side)
            && above <= self.rise * level + radius * (1.0 + self.rise)
    }
}

/// The corners of a box.
pub fn corners([low, high]: [Vec3; 2]) -> [Vec3; 8] {
    let corner = |i| Vec3::select(glam::BVec3::new(i & 1 == 1, i & 2 == 2, i & 4 == 4), high, low);
    [0, 1, 2, 3, 4, 5, 6, 7].map(corner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::Points;
    use testing::direction;

    /// Interpolates between two numbers.
    fn between(low: f32, high: f32, u: f32) -> f32 {
        low + (high - low) * u
    }

    fn meets([low, high]: [Vec3; 2], from: Vec3, way: Vec3) -> bool {
        let (a, b) = ((low - from) / way, (high - from) / way);
        a.min(b).max_element().max(0.0) <= a.max(b).min_element()
    }

    /// The projected solid angle of a box, as seen from any point of the tile with any normal, is within the bound,
    /// and the bound is not many times too large.
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
}

//! Objects at rest on uneven ground: on a mound, in a hollow, over a kerb.

use glam::{DQuat, DVec2, DVec3, Vec3};

use crate::geometry::bvh::{Bvh, Ray};
use crate::geometry::support::GroundPlane;

/// Number of columns and of rows of the grid on which an object and the ground are sampled.
const GRID: usize = 24;
/// Number of standard deviations of noise by which the ground is lowered in the search for contacts. At about one
/// position in 160, the noise is larger than this.
const DEVIATIONS: f64 = 2.5;
/// Number of successive rotations that bring an object to rest on its contacts. Each rotation is much smaller than
/// the previous one.
const TURNS: u32 = 4;
/// Maximum number of times that one of the three contacts of the plane is replaced with a higher contact.
const EXCHANGES: u32 = 1000;

/// A mesh below an object. Its coordinates are in world units, relative to a point at the foot of the object.
#[derive(Debug)]
pub struct Relief<'a> {
    /// Bounding volume hierarchy of the triangles of the mesh. Coordinates are along the axes of the world.
    pub bvh: &'a Bvh,
    /// The corners of the triangles of `bvh`.
    pub corners: &'a [[Vec3; 3]],
    /// Unit vectors in world space: the two horizontal axes and the up direction.
    pub axes: [DVec3; 3],
    /// Maximum height above or below the origin at which ground is found, in world units.
    pub reach: f64,
    /// The plane fitted to the ground.
    pub plane: GroundPlane,
}

/// Motion that brings an object to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// Rotation about the origin of [`Relief`], applied before the translation.
    pub turn: DQuat,
    /// Translation upwards, in world units.
    pub lift: f64,
}

impl Relief<'_> {
    /// Returns the height of the ground at a position. If there are several surfaces at this position, it is the
    /// height of the one nearest to the plane.
    fn height(&self, x: f64, y: f64) -> Option<f64> {
        let [across, along, up] = self.axes;
        let start = across * x + along * y + up * self.reach;
        let ray = Ray { t_max: (2.0 * self.reach) as f32, ..Ray::new(start.as_vec3(), -up.as_vec3()) };
        let expected = self.plane.at(x, y);
        let mut best = None::<f64>;
        self.bvh.any(ray, |hit| {
            let [a, b, c] = self.corners[hit.triangle as usize].map(|p| p.as_dvec3());
            let height = self.reach - f64::from(hit.t);
            // Of two heights that are equally near, the lower one is taken, so that the order of hits does not
            // matter.
            let nearer = |best: f64| {
                let [own, other] = [height, best].map(|height| (height - expected).abs());
                own < other || (own == other && height < best)
            };
            if (b - a).cross(c - a).dot(up) > 0.0 && best.is_none_or(nearer) {
                best = Some(height);
            }
            false
        });
        best
    }

    /// Measures the ground in a rectangle around the middle of the foot; `half` is half the length of its sides.
    /// First result: the 98th percentile of the deviation of the ground from the plane, minus the noise of the
    /// mesh. Second: the standard deviation of this noise.
    pub fn departure(&self, half: [f64; 2]) -> (f64, f64) {
        let place = |i: usize| (2 * i + 1) as f64 / GRID as f64 - 1.0;
        let row = |j: usize| {
            let at = move |i: usize| (place(i) * half[0], place(j) * half[1]);
            (0..GRID).map(at).map(move |(x, y)| Some([x, y, self.height(x, y)?]))
        };
        let rows: Vec<Vec<Option<[f64; 3]>>> = (0..GRID).map(|j| row(j).collect()).collect();
        // The third difference of four columns nearly removes smooth shapes. Its variance is 20 times that of the
        // noise.
        let third = |four: &[Option<[f64; 3]>]| match four {
            [Some(a), Some(b), Some(c), Some(d)] => Some((a[2] - 3.0 * b[2] + 3.0 * c[2] - d[2]).abs()),
            _ => None,
        };
        let mut thirds: Vec<f64> = rows.iter().flat_map(|row| row.windows(4)).filter_map(third).collect();
        thirds.sort_by(f64::total_cmp);
        let noise = thirds.get(thirds.len() / 2).map_or(0.0, |middle| 1.4826 * middle / 20.0_f64.sqrt());
        let over = |p: [f64; 3]| p[2] - self.plane.at(p[0], p[1]);
        let mut off: Vec<f64> = rows.into_iter().flatten().flatten().map(|p| over(p).abs()).collect();
        off.sort_by(f64::total_cmp);
        let most = off.get(off.len() * 49 / 50).copied().unwrap_or_default();
        ((most - DEVIATIONS * noise).max(0.0), noise)
    }

    /// Positions where the object and the ground may touch, each with the translation upwards at which they touch.
    /// These are the lowest corner of the object in each cell of a grid, and its underside at the centre of each
    /// cell.
    fn contacts(&self, object: &[[DVec3; 3]], noise: f64) -> Vec<[f64; 3]> {
        let [across, along, up] = self.axes;
        let local = |p: DVec3| DVec3::new(p.dot(across), p.dot(along), p.dot(up));
        let points = || object.iter().flatten().map(move |&p| local(p));
        let low = points().fold(DVec3::INFINITY, DVec3::min);
        let size = points().fold(DVec3::NEG_INFINITY, DVec3::max) - low;
        let mut lowest: Vec<Option<DVec3>> = vec![None; GRID * GRID];
        for p in points() {
            let cell = |a: usize| ((p - low)[a] / size[a].max(f64::MIN_POSITIVE) * GRID as f64) as usize;
            let cell = &mut lowest[cell(1).min(GRID - 1) * GRID + cell(0).min(GRID - 1)];
            if cell.is_none_or(|known| p.z < known.z) {
                *cell = Some(p);
            }
        }
        let corners: Vec<[Vec3; 3]> = object.iter().map(|t| t.map(|p| local(p).as_vec3())).collect();
        let bvh = Bvh::build(&corners);
        let underside = |k: usize| {
            let place = |i: usize, a: usize| low[a] + size[a] * ((2 * i + 1) as f64 / (2 * GRID) as f64);
            let start = DVec3::new(place(k % GRID, 0), place(k / GRID, 1), low.z - size.max_element());
            let hit = bvh.closest(Ray::new(start.as_vec3(), Vec3::Z), |_| true)?;
            Some(start + DVec3::Z * f64::from(hit.t))
        };
        let touch = |p: DVec3| Some([p.x, p.y, self.height(p.x, p.y)? - DEVIATIONS * noise - p.z]);
        lowest.into_iter().flatten().chain((0..GRID * GRID).filter_map(underside)).filter_map(touch).collect()
    }

    /// Finds the resting pose of an object, given by its triangles. The object is translated vertically until it
    /// touches the ground. If `turned`, it is first rotated until it lies on three contacts around its middle. The
    /// result is the lowest pose in which the object does not penetrate the ground. `None` if there is no ground
    /// below the object.
    pub fn rest(&self, object: &[[DVec3; 3]], noise: f64, turned: bool) -> Option<Rest> {
        let mut turn = DQuat::IDENTITY;
        let mut object = object.to_vec();
        let [across, along, up] = self.axes;
        for _ in 0..if turned { TURNS } else { 0 } {
            let middle = centroid(&object);
            let contacts = self.contacts(&object, noise);
            let middle = DVec2::new(middle.dot(across), middle.dot(along));
            // If the plane is too steep, the middle of the object is not supported.
            let plane = lowest_plane(&contacts, middle).filter(|[_, x, y]| x * x + y * y <= 1.0);
            let Some([_, x, y]) = plane else { break };
            let normal = (up - across * x - along * y).normalize();
            let step = DQuat::from_rotation_arc(up, normal);
            object.iter_mut().flatten().for_each(|p| *p = step * *p);
            turn = step * turn;
        }
        let lift = self.contacts(&object, noise).into_iter().map(|contact| contact[2]).reduce(f64::max)?;
        Some(Rest { turn, lift })
    }
}

/// Centroid of the surface of the triangles, weighted by area.
fn centroid(triangles: &[[DVec3; 3]]) -> DVec3 {
    let (sum, area) = triangles.iter().fold((DVec3::ZERO, 0.0), |(sum, area), &[a, b, c]| {
        let own = (b - a).cross(c - a).length();
        (sum + (a + b + c) * (own / 3.0), area + own)
    });
    if area > 0.0 { sum / area } else { triangles.first().map_or(DVec3::ZERO, |t| t[0]) }
}

/// Finds the plane that is lowest at a position, among all planes above which there is no contact. This plane rests
/// on three contacts around the position. Returns its height at (0, 0) and its slopes along both axes. `None` if
/// there are no such contacts.
fn lowest_plane(contacts: &[[f64; 3]], at: DVec2) -> Option<[f64; 3]> {
    let span = contacts.iter().flatten().fold(at.length(), |most, v| most.max(v.abs()));
    // Starting points that are far away and far below. Contacts replace them.
    let far = |x: f64, y: f64| [at.x + 1e3 * span * x, at.y + 1e3 * span * y, -1e6 * span];
    let mut held = [far(0.0, 1.0), far(-0.866, -0.5), far(0.866, -0.5)];
    for _ in 0..EXCHANGES {
        let plane = through(&held)?;
        let over = |p: &[f64; 3]| p[2] - plane[0] - plane[1] * p[0] - plane[2] * p[1];
        let most = contacts.iter().max_by(|a, b| over(a).total_cmp(&over(b)))?;
        if over(most) <= 1e-9 * span {
            return held.iter().all(|p| p[2] > -1e5 * span).then_some(plane);
        }
        let exchanged = |k: usize| {
            let mut next = held;
            next[k] = *most;
            next
        };
        held = (0..3).map(exchanged).find(|next| encloses(next, at))?;
    }
    None
}

fn through(&[a, b, c]: &[[f64; 3]; 3]) -> Option<[f64; 3]> {
    let [a, b, c] = [a, b, c].map(DVec3::from_array);
    let normal = (b - a).cross(c - a);
    let rise = normal.truncate() / -normal.z;
    let plane = [a.z - rise.dot(a.truncate()), rise.x, rise.y];
    plane.iter().all(|v| v.is_finite()).then_some(plane)
}

/// True if a position lies in a triangle. Both are seen from above, so heights are ignored.
fn encloses(triangle: &[[f64; 3]; 3], at: DVec2) -> bool {
    let [a, b, c] = triangle.map(|p| DVec2::new(p[0], p[1]) - at);
    let sides = [a.perp_dot(b), b.perp_dot(c), c.perp_dot(a)];
    let area: f64 = sides.iter().sum();
    area != 0.0 && sides.iter().all(|side| side / area >= -1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_plane_rests_on_three_contacts() {
        // A table with four legs, one of them on a stone. It stands on this leg and two others.
        let legs = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.1], [-1.0, 1.0, 0.0]];
        let plane = lowest_plane(&legs, DVec2::new(-0.1, -0.2)).expect("a rest");
        let over = |p: &[f64; 3]| plane[0] + plane[1] * p[0] + plane[2] * p[1] - p[2];
        assert!(legs.iter().all(|leg| over(leg) > -1e-9), "{plane:?}");
        assert_eq!(legs.iter().filter(|leg| over(leg).abs() < 1e-9).count(), 3, "{plane:?}");
        // The plane of a slope is the slope itself, wherever the middle of the object is.
        let slope: Vec<_> = (0..100)
            .map(|i| [f64::from(i % 10) - 4.5, f64::from(i / 10) - 4.5])
            .map(|[x, y]| [x, y, 0.3 + 0.1 * x - 0.2 * y])
            .collect();
        let plane = lowest_plane(&slope, DVec2::new(1.0, 0.3)).expect("a rest");
        for (found, expected) in plane.into_iter().zip([0.3, 0.1, -0.2]) {
            assert!((found - expected).abs() < 1e-9, "{plane:?}");
        }
        // An object whose middle is outside all contacts is not supported.
        assert_eq!(lowest_plane(&slope, DVec2::new(9.0, 0.0)), None);
        assert_eq!(lowest_plane(&[], DVec2::ZERO), None);
    }
}

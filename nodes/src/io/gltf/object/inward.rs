//! Detection of shapes whose faces look inwards, which exporters and mirrored copies produce. If their material is
//! single-sided, they are black from outside; programs that draw both sides show them correctly.

use engine::{Context, NodeError, Notes};
use glam::DVec3;

use crate::types::{Material, Primitive};

/// A part counts as closed if the length of the sum of its area vectors is less than this fraction of its area.
const CLOSED: f64 = 1e-3;
/// An open part is reported only if the length of the sum of its area vectors is less than this fraction of its
/// area.
const OPEN: f64 = 0.5;
/// A part looks inwards if the mean cosine between its face normals and the directions from its middle, weighted by
/// area and distance, is below this. If a shape is turned inside out, the mean is -1 for a sphere, -0.8 for a cube
/// and -0.5 for a long box.
const INWARD: f64 = -0.3;
/// Maximum number of parts that are tested for enclosing another part as a cavity. The largest parts are tested.
const HOLDERS: usize = 64;

/// A connected part of an object.
#[derive(Debug, Clone, Copy)]
struct Part {
    area: f64,
    middle: DVec3,
    /// Sum of the area vectors of the triangles.
    vector: DVec3,
    /// Sum over triangles of area times the signed distance of the triangle's plane from the middle of the part,
    /// positive if the triangle faces away from the middle.
    height: f64,
    /// Sum over triangles of area times distance from the middle of the part.
    distance: f64,
    low: DVec3,
    high: DVec3,
    single_sided: bool,
}

impl Part {
    const EMPTY: Self = Self {
        area: 0.0,
        middle: DVec3::ZERO,
        vector: DVec3::ZERO,
        height: 0.0,
        distance: 0.0,
        low: DVec3::INFINITY,
        high: DVec3::NEG_INFINITY,
        single_sided: true,
    };

    fn score(&self) -> f64 {
        if self.distance > 0.0 { self.height / self.distance } else { 0.0 }
    }

    fn balance(&self) -> f64 {
        self.vector.length() / self.area.max(f64::MIN_POSITIVE)
    }

    fn holds(&self, other: &Self) -> bool {
        self.low.cmplt(other.low).all() && self.high.cmpgt(other.high).all()
    }

    fn size(&self) -> f64 {
        (self.high - self.low).max(DVec3::ZERO).element_product()
    }
}

/// Returns the root of a vertex in the union-find forest, and shortens the paths on the way.
fn root(parents: &mut [u32], mut at: u32) -> u32 {
    while parents[at as usize] != at {
        let above = parents[parents[at as usize] as usize];
        parents[at as usize] = above;
        at = above;
    }
    at
}

/// Index of the part to which each vertex belongs. Vertices of one triangle belong to the same part, and so do
/// vertices at one position.
fn parts_of(primitives: &[Primitive], starts: &[usize], cx: &Context) -> Result<Vec<u32>, NodeError> {
    let total = primitives.iter().map(|p| p.positions.len()).sum::<usize>();
    // Positive and negative zero are one place.
    let key = |p: &[f32; 3]| p.map(|v| (v + 0.0).to_bits());
    let mut places: Vec<([u32; 3], u32)> = Vec::with_capacity(total);
    for (primitive, start) in primitives.iter().zip(starts) {
        let own = primitive.positions.iter().enumerate();
        places.extend(own.map(|(at, position)| (key(position), (start + at) as u32)));
    }
    cx.check()?;
    places.sort_unstable();
    let mut parents: Vec<u32> = (0..total as u32).collect();
    for pair in places.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        let (a, b) = (root(&mut parents, pair[0].1), root(&mut parents, pair[1].1));
        parents[a.max(b) as usize] = a.min(b);
    }
    drop(places);
    cx.check()?;
    for (primitive, start) in primitives.iter().zip(starts) {
        for triangle in &primitive.triangles {
            for vertex in &triangle[1..] {
                let a = root(&mut parents, triangle[0] + *start as u32);
                let b = root(&mut parents, vertex + *start as u32);
                parents[a.max(b) as usize] = a.min(b);
            }
        }
    }
    Ok((0..total as u32).map(|at| root(&mut parents, at)).collect())
}

/// Reverses the faces of closed, single-sided parts that look inwards, unless the part is a cavity of another part.
/// Reports open parts that look inwards.
pub(super) fn turn(
    primitives: &mut [Primitive],
    materials: &[Material],
    cx: &Context,
    notes: &mut Notes,
) -> Result<(), NodeError> {
    let mut starts = Vec::with_capacity(primitives.len());
    let mut total = 0;
    for primitive in primitives.iter() {
        starts.push(total);
        total += primitive.positions.len();
    }
    let roots = parts_of(primitives, &starts, cx)?;
    // Consecutive numbers of parts.
    let mut number = vec![u32::MAX; total];
    let mut count = 0;
    for &root in &roots {
        if number[root as usize] == u32::MAX {
            number[root as usize] = count;
            count += 1;
        }
    }
    let of =
        |start: usize, triangle: &[u32; 3]| number[roots[start + triangle[0] as usize] as usize] as usize;
    let corners =
        |p: &Primitive, t: &[u32; 3]| t.map(|v| DVec3::from(p.positions[v as usize].map(f64::from)));
    let face = |[a, b, c]: [DVec3; 3]| ((b - a).cross(c - a) * 0.5, (a + b + c) / 3.0);
    let mut parts = vec![Part::EMPTY; count as usize];
    for (primitive, &start) in primitives.iter().zip(&starts) {
        let two_sided = materials.get(primitive.material as usize).is_some_and(|m| m.double_sided);
        for triangle in &primitive.triangles {
            let at = corners(primitive, triangle);
            let (vector, centre) = face(at);
            let part = &mut parts[of(start, triangle)];
            part.area += vector.length();
            part.middle += centre * vector.length();
            part.vector += vector;
            part.low = at.iter().fold(part.low, |low, p| low.min(*p));
            part.high = at.iter().fold(part.high, |high, p| high.max(*p));
            part.single_sided &= !two_sided;
        }
    }
    parts.iter_mut().for_each(|part| part.middle /= part.area.max(f64::MIN_POSITIVE));
    for (primitive, &start) in primitives.iter().zip(&starts) {
        for triangle in &primitive.triangles {
            let (vector, centre) = face(corners(primitive, triangle));
            let part = &mut parts[of(start, triangle)];
            part.height += vector.dot(centre - part.middle);
            part.distance += vector.length() * (centre - part.middle).length();
        }
    }
    let mut holders: Vec<&Part> = parts.iter().filter(|part| part.score() > 0.0).collect();
    holders.sort_by(|a, b| b.size().total_cmp(&a.size()));
    holders.truncate(HOLDERS);
    let inward = |part: &Part| {
        part.single_sided && part.score() < INWARD && !holders.iter().any(|holder| holder.holds(part))
    };
    let turned: Vec<bool> = parts.iter().map(|part| inward(part) && part.balance() < CLOSED).collect();
    let open = parts.iter().filter(|part| inward(part) && (CLOSED..OPEN).contains(&part.balance())).count();
    let closed = turned.iter().filter(|turned| **turned).count();
    if open > 0 {
        let text = format!(
            "faces of open parts look inwards (parts: {open}): they are black from outside, since their material is \
             single-sided; reverse them in the program that made them, or make the material double-sided"
        );
        notes.warning("faces-inwards", text);
    }
    if closed == 0 {
        return Ok(());
    }
    let text = format!("faces of closed parts looked inwards and were turned outwards (parts: {closed})");
    notes.decision("faces-turned", text);
    for (primitive, &start) in primitives.iter_mut().zip(&starts) {
        let mut facing = vec![0.0_f64; primitive.positions.len()];
        for at in 0..primitive.triangles.len() {
            let triangle = primitive.triangles[at];
            if !turned[of(start, &triangle)] {
                continue;
            }
            primitive.triangles[at] = [triangle[0], triangle[2], triangle[1]];
            let (vector, _) = face(corners(primitive, &primitive.triangles[at]));
            for vertex in triangle.map(|v| v as usize) {
                let normal =
                    primitive.normals.get(vertex).map_or(DVec3::ZERO, |n| DVec3::from(n.map(f64::from)));
                facing[vertex] += vector.dot(normal);
            }
        }
        // Normals that agreed with the faces are turned with them; others looked outwards already.
        for (vertex, _) in facing.iter().enumerate().filter(|(_, facing)| **facing < 0.0) {
            if let Some(normal) = primitive.normals.get_mut(vertex) {
                *normal = normal.map(|v| -v);
            }
            if let Some([.., sign]) = primitive.tangents.get_mut(vertex) {
                *sign = -*sign;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;

    /// A box with separate vertices for each face, as exporters write it. Only the first `faces` of its six faces
    /// exist; `inwards` reverses their winding, and `normals` is the sign of their normals.
    fn cube(half: f32, at: [f32; 3], inwards: bool, normals: f32, faces: usize) -> Primitive {
        let mut p = Primitive::default();
        for face in 0..faces {
            let (axis, sign) = (face / 2, if face % 2 == 0 { 1.0_f32 } else { -1.0 });
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let first = p.positions.len() as u32;
            for [a, b] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0_f32]] {
                let mut corner = [0.0; 3];
                (corner[axis], corner[u], corner[v]) = (sign * half, a * half, b * half);
                p.positions.push([0, 1, 2].map(|k| corner[k] + at[k]));
                let mut normal = [0.0; 3];
                normal[axis] = sign * normals;
                p.normals.push(normal);
                p.tangents.push([1.0, 0.0, 0.0, 1.0]);
            }
            let outwards = (sign > 0.0) != inwards;
            for t in [[0, 1, 2], [0, 2, 3]] {
                let t = if outwards { t } else { [t[0], t[2], t[1]] };
                p.triangles.push(t.map(|v| v + first));
            }
        }
        p
    }

    fn turned(mut list: Vec<Primitive>, two_sided: bool) -> (Vec<Primitive>, Vec<String>) {
        let mut notes = Notes::none();
        let material = Material { double_sided: two_sided, ..Material::default() };
        turn(&mut list, &[material], &context(), &mut notes).unwrap_or_else(|e| panic!("{e}"));
        (list, notes.iter().map(|note| note.id.clone()).collect())
    }

    /// Closed parts that look inwards are turned, and other parts are not. This test fails if `score() < INWARD` is
    /// replaced with `score() > 0.3`.
    #[test]
    fn closed_shapes_that_look_inwards_are_turned() {
        let right = cube(1.0, [3.0, 0.0, 0.0], false, 1.0, 6);
        assert_eq!(turned(vec![right.clone()], false), (vec![right.clone()], vec![]));
        for normals in [1.0, -1.0] {
            let wrong = cube(1.0, [3.0, 0.0, 0.0], true, normals, 6);
            let (list, ids) = turned(vec![wrong], false);
            assert_eq!((ids, &list[0].normals), (vec!["faces-turned".to_owned()], &right.normals));
            let area = |p: &Primitive| -> f64 {
                p.triangles
                    .iter()
                    .map(|t| {
                        let [a, b, c] = t.map(|v| DVec3::from(p.positions[v as usize].map(f64::from)));
                        a.dot(b.cross(c)) / 6.0
                    })
                    .sum()
            };
            assert!((area(&list[0]) - 8.0).abs() < 1e-9, "the volume is positive");
            let sign = if normals > 0.0 { 1.0 } else { -1.0 };
            assert!(list[0].tangents.iter().all(|t| t[3] == sign));
        }
        // Two parts, one of which is wrong; one shape in two primitives.
        let (list, ids) = turned(vec![right.clone(), cube(0.5, [-3.0, 0.0, 0.0], true, 1.0, 6)], false);
        assert_eq!((&list[0], ids.len()), (&right, 1));
        let whole = cube(1.0, [0.0; 3], true, 1.0, 6);
        let half = |range: std::ops::Range<usize>| Primitive {
            triangles: whole.triangles[range].to_vec(),
            ..whole.clone()
        };
        let (list, ids) = turned(vec![half(0..6), half(6..12)], false);
        assert_eq!(ids, ["faces-turned"]);
        assert_ne!(list[1].triangles[0], whole.triangles[6]);
    }

    #[test]
    fn cavities_open_and_two_sided_shapes_are_left() {
        let outer = cube(1.0, [0.0; 3], false, 1.0, 6);
        let cavity = cube(0.5, [0.1, 0.0, 0.0], true, -1.0, 6);
        let both = vec![outer, cavity];
        assert_eq!(turned(both.clone(), false), (both, vec![]));
        let wrong = vec![cube(1.0, [0.0; 3], true, 1.0, 6)];
        assert_eq!(turned(wrong.clone(), true), (wrong, vec![]));
        let open = vec![cube(1.0, [0.0; 3], true, 1.0, 5)];
        assert_eq!(turned(open.clone(), false), (open, vec!["faces-inwards".to_owned()]));
        let sheet = vec![cube(1.0, [0.0; 3], true, 1.0, 1)];
        assert_eq!(turned(sheet.clone(), false), (sheet, vec![]));
    }
}

use super::*;
use testing::context;

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

/// Closed parts that look inwards are turned, and other parts are not. This test fails if a positive
/// volume is doubtful, or a negative one is not.
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

/// A box without separate vertices shares those of its corners with the boxes that touch it.
fn soup(list: &[Primitive], noise: f32) -> Primitive {
    let mut p = Primitive::default();
    let mut seed = 1_u32;
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 / 16_777_216.0 - 0.5
    };
    for part in list {
        for triangle in &part.triangles {
            let first = p.positions.len() as u32;
            p.positions.extend(triangle.map(|v| part.positions[v as usize].map(|c| c + noise * next())));
            p.triangles.push([first, first + 1, first + 2]);
        }
    }
    p
}

/// Triangles whose orientation differs between two lists, by their number.
fn changed(before: &Primitive, after: &Primitive) -> Vec<usize> {
    (0..before.triangles.len()).filter(|at| before.triangles[*at] != after.triangles[*at]).collect()
}

// Parts that touch at a face, an edge or a corner are decided one by one, with vertices of their own and with small
// cracks. This test fails if patches are connected over edges of four faces.
#[test]
fn parts_that_touch_are_turned_one_by_one() {
    let of = |at: [f32; 3], inwards: bool| cube(1.0, at, inwards, 1.0, 6);
    for at in [[2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [2.0, 2.0, 2.0], [1.0, 1.5, 0.0], [5.0, 0.0, 0.0]] {
        for noise in [0.0, 1e-7] {
            for (first, second) in [(false, true), (true, false), (true, true), (false, false)] {
                let before = soup(&[of([0.0; 3], first), of(at, second)], noise);
                let (list, ids) = turned(vec![before.clone()], false);
                let wanted = (0..24).filter(|face| if *face < 12 { first } else { second });
                // Faces that the other part covers cannot be seen, and may be left.
                let covered = |face: &usize| at == [2.0, 0.0, 0.0] && matches!(face, 0 | 1 | 14 | 15);
                let wanted: Vec<usize> = wanted.filter(|face| !covered(face)).collect();
                let found: Vec<usize> =
                    changed(&before, &list[0]).into_iter().filter(|face| !covered(face)).collect();
                assert_eq!(found, wanted, "{at:?} {noise}");
                assert_eq!(ids.len(), usize::from(first || second), "{at:?} {noise} {ids:?}");
            }
        }
    }
}

// Cracks too wide to be welded, single faces that are reversed, and faces that exist twice.
#[test]
fn damaged_shapes_are_turned() {
    let wrong = cube(1.0, [0.0; 3], true, 1.0, 6);
    let cracked = soup(std::slice::from_ref(&wrong), 1e-4);
    let (list, ids) = turned(vec![cracked.clone()], false);
    assert_eq!((changed(&cracked, &list[0]).len(), ids), (12, vec!["faces-turned".to_owned()]));
    let mut one = cube(1.0, [0.0; 3], false, 1.0, 6);
    one.triangles[3].swap(1, 2);
    let (list, _) = turned(vec![one.clone()], false);
    assert_eq!(changed(&one, &list[0]), [3]);
    let mut twice = wrong.clone();
    twice.triangles.extend([wrong.triangles[0], wrong.triangles[1]]);
    let (list, _) = turned(vec![twice.clone()], false);
    assert_eq!(changed(&twice, &list[0]).len(), 14);
    // Both sides are there already.
    let mut both = wrong.clone();
    both.triangles.extend(wrong.triangles.iter().map(|t| [t[0], t[2], t[1]]));
    assert_eq!(turned(vec![both.clone()], false), (vec![both], vec![]));
}

// A bowl of one sheet whose faces look into it has no inside, so it is reported.
#[test]
fn sheets_that_are_bent_are_reported() {
    for (inwards, ids) in [(true, vec!["faces-inwards".to_owned()]), (false, vec![])] {
        let tray = vec![cube(1.0, [0.0; 3], inwards, 1.0, 5)];
        assert_eq!(turned(tray.clone(), false), (tray, ids));
    }
}

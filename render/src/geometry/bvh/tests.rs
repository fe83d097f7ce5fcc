//! Tests that compare hits with a reference, including hits at edges and extreme values.

use super::build::{Fold, Opens, balanced};
use super::*;
use crate::geometry::sampling::{mix, unit};
use testing::row;

struct Random(u32);
impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(1);
        unit(mix(self.0))
    }
    fn point(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next()) * 2.0 - Vec3::ONE
    }
}

/// Reference: the nearest hit in f64, found by testing every triangle.
fn brute(corners: &[[Vec3; 3]], ray: Ray) -> Option<(f64, usize)> {
    let mut best: Option<(f64, usize)> = None;
    for (i, t) in corners.iter().enumerate() {
        let [a, b, c] = t.map(|p| p.as_dvec3());
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let (ab, ac) = (b - a, c - a);
        let p = d.cross(ac);
        let det = ab.dot(p);
        if det == 0.0 {
            continue;
        }
        let s = o - a;
        let (u, q) = (s.dot(p) / det, s.cross(ab));
        let (v, t) = (d.dot(q) / det, ac.dot(q) / det);
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && best.is_none_or(|b| t < b.0) {
            best = Some((t, i));
        }
    }
    best
}

/// Number of triangles that a ray crosses away from their edges, computed in f64.
fn crossed(corners: &[[Vec3; 3]], ray: Ray) -> u32 {
    let inside = |t: &&[Vec3; 3]| {
        let [a, b, c] = t.map(|p| p.as_dvec3() - ray.origin.as_dvec3());
        let d = ray.direction.as_dvec3();
        let sides = [b.cross(c).dot(d), c.cross(a).dot(d), a.cross(b).dot(d)];
        let sum: f64 = sides.iter().sum();
        sum != 0.0 && sides.iter().all(|s| s / sum > 1e-3) && a.cross(b).dot(c) / sum > 0.0
    };
    corners.iter().filter(inside).count() as u32
}

/// Every set of vector instructions gives the same bits with the same number of steps. This test fails if the box
/// test or the triangle test uses `mul_add` with AVX2 only.
#[test]
fn every_set_of_instructions_finds_the_same() {
    let corners = soup(3_000, 0.2, 5);
    let bvhs: Vec<Bvh> =
        testing::levels().into_iter().map(|level| Bvh { level, ..Bvh::build(&corners) }).collect();
    let mut random = Random(23);
    let mut hits = 0;
    for _ in 0..3_000 {
        let ray = Ray::new(random.point() * 1.5, random.point());
        let found = bvhs[0].closest(ray, |_| true);
        let beyond = bvhs[0].any(ray, |hit| hit.t > 0.5);
        hits += u32::from(found.is_some());
        for bvh in &bvhs[1..] {
            assert_eq!(bvh.closest(ray, |_| true), found, "{:?}", bvh.level);
            assert_eq!(bvh.any(ray, |hit| hit.t > 0.5), beyond, "{:?}", bvh.level);
        }
    }
    assert!(hits > 1_000, "{hits}");
}

fn soup(n: usize, size: f32, seed: u32) -> Vec<[Vec3; 3]> {
    let mut random = Random(seed);
    (0..n)
        .map(|_| {
            let p = random.point();
            [p, p + random.point() * size, p + random.point() * size]
        })
        .collect()
}

/// A ray that starts and runs in a plane with box faces and triangles hits every triangle that it crosses away from
/// the edges of this triangle. For such rays the box test could compute 0 times infinity. This test fails if
/// `1e30_f32.copysign(d)` is replaced with `0.0` in `Bvh::enter`.
#[test]
fn rays_in_the_planes_of_boxes_find_what_stands_across() {
    // Unit squares perpendicular to each axis on a lattice, so that all boxes share their planes.
    let mut corners = Vec::new();
    for i in 0..6 * 6 * 6_u32 {
        let at = Vec3::new((i % 6) as f32, (i / 6 % 6) as f32, (i / 36) as f32);
        let [u, v] = [[Vec3::Y, Vec3::Z], [Vec3::Z, Vec3::X], [Vec3::X, Vec3::Y]][(i % 3) as usize];
        corners.extend([[at, at + u, at + u + v], [at, at + u + v, at + v]]);
    }
    let bvh = Bvh::build(&corners);
    let mut random = Random(17);
    let mut lattice = |steps: f32| (random.next() * steps).floor() * (6.0 / steps);
    let mut unequal = 0;
    for i in 0..20_000 {
        let origin = Vec3::new(lattice(12.0), lattice(12.0), lattice(12.0));
        let way = Vec3::new(lattice(3.0), lattice(3.0), lattice(3.0)) - Vec3::splat(2.0);
        if way == Vec3::ZERO {
            continue;
        }
        // Zeros of either sign.
        let way = if i % 2 == 0 { way } else { way * Vec3::new(1.0, -1.0, 1.0) };
        let ray = Ray::new(origin, way);
        let mut met = 0;
        bvh.any(ray, |hit| {
            let inside = [hit.b1, hit.b2, 1.0 - hit.b1 - hit.b2].iter().all(|w| *w > 1e-3);
            met += u32::from(inside);
            false
        });
        unequal += u32::from(met != crossed(&corners, ray));
    }
    row(
        44,
        "rays of 20,000 in planes of boxes that do not cross what brute force crosses",
        f64::from(unequal),
        0.0,
    );
}

/// Rays find the same hits as brute force, including rays along the axes with components 0 and -0.
#[test]
fn rays_find_what_brute_force_finds() {
    for (n, size) in [(1, 1.0), (2, 1.0), (5, 0.7), (500, 0.15)] {
        let corners = soup(n, size, n as u32);
        let bvh = Bvh::build(&corners);
        let mut random = Random(99);
        let mut unequal = 0;
        for i in 0..250_000 {
            let mut direction = random.point();
            match i % 8 {
                0 => direction = Vec3::new(0.0, -0.0, direction.z),
                1 => direction = Vec3::new(direction.x, -0.0, 0.0),
                2 => direction.y = 0.0,
                _ => {}
            }
            let ray = Ray::new(random.point() * 1.5, direction);
            let found = bvh.closest(ray, |_| true);
            assert_eq!(found.is_some(), bvh.any(ray, |_| true));
            match (found, brute(&corners, ray)) {
                (Some(hit), Some((t, id))) if hit.triangle as usize == id => {
                    assert!((f64::from(hit.t) - t).abs() < 1e-3 * t.max(1e-2), "{hit:?} {t}");
                }
                (None, None) => {}
                // A ray within rounding of an edge may hit either side.
                _ => unequal += 1,
            }
        }
        row(44, "rays of 250,000 that go another way at an edge", f64::from(unequal), 100.0);
    }
}

/// A closed, subdivided sphere.
fn sphere(rings: usize) -> Vec<[Vec3; 3]> {
    let point = |i: usize, j: usize| {
        let theta = std::f64::consts::PI * i as f64 / rings as f64;
        let phi = std::f64::consts::PI * (j % (2 * rings)) as f64 / rings as f64;
        let ((st, ct), (sp, cp)) = (scene::math::num::sin_cos(theta), scene::math::num::sin_cos(phi));
        let st = if i == 0 || i == rings { 0.0 } else { st };
        Vec3::new((st * cp) as f32, (st * sp) as f32, ct as f32)
    };
    let mut out = Vec::new();
    for i in 0..rings {
        for j in 0..2 * rings {
            let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
            out.push([a, b, c]);
            out.push([a, c, d]);
        }
    }
    out
}

// Rays from the inside through every edge and corner of a closed mesh, where leaks would be.
#[test]
fn closed_meshes_do_not_leak() {
    let corners = sphere(24);
    let bvh = Bvh::build(&corners);
    assert_eq!(bvh.degenerate, 96, "the poles of this sphere");
    let mut random = Random(5);
    for &[a, b, c] in &corners {
        for _ in 0..40 {
            let origin = random.point() * 0.3;
            let s = random.next();
            for target in [a, a + (b - a) * s, b + (c - b) * s, c + (a - c) * s, (a + b) * 0.5] {
                let direction = target - origin;
                assert!(bvh.any(Ray::new(origin, direction), |_| true), "leak at {target}");
                assert!(bvh.any(Ray::new(origin, direction.normalize()), |_| true), "leak at {target}");
            }
        }
    }
}

#[test]
fn broken_triangles_are_left_out_and_counted() {
    let good = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let line = [Vec3::ZERO, Vec3::X, Vec3::X * 2.0];
    let corners = [[Vec3::NAN, Vec3::X, Vec3::Y], line, good, good, [Vec3::ONE; 3]];
    let bvh = Bvh::build(&corners);
    assert_eq!((bvh.broken, bvh.degenerate), (1, 2));
    // A triangle whose area underflows in single precision has an area.
    let tiny = Bvh::build(&[[Vec3::ZERO, Vec3::X * 1e-12, Vec3::Y * 1e-12]]);
    assert_eq!(tiny.degenerate, 0);
    let hit = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z), |_| true).expect("hit");
    assert_eq!((hit.triangle, hit.back), (2, false), "the smaller of two equal ones");
    let behind = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, -1.0), Vec3::Z), |h| h.triangle != 2);
    assert_eq!(behind.map(|h| (h.triangle, h.back)), Some((3, true)));
}

/// Trees stay shallow for any input: no triangle, a single triangle, half a million triangles with the same
/// centroid, and a sequence of triangles each half as large as the previous one, whose best tree may be too deep
/// for the stack.
#[test]
fn identical_triangles_stay_shallow() {
    let one = Bvh::build(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]);
    assert!(one.closest(Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z), |_| true).is_some());
    assert!(!Bvh::build(&[]).any(Ray::new(Vec3::ZERO, Vec3::X), |_| true));
    let corners = vec![[Vec3::ZERO, Vec3::X, Vec3::Y]; 3_000];
    let bvh = Bvh::build(&corners);
    let hit = bvh.closest(Ray::new(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z), |_| true).expect("hit");
    assert_eq!(hit.triangle, 0);
    let mut order: Vec<u32> = (0..5_000).collect();
    let boxes = vec![(Vec3::ZERO, Vec3::ONE); 5_000];
    let mut tree = Vec::new();
    balanced(&boxes, &mut order, 0, &mut tree);
    assert!(tree.len() < 5_000);
    // As many triangles as in a large mesh, all at one position, of equal or different sizes: the traversal does
    // not overflow its stack, and building is not quadratic.
    for grows in [0.0, 1e-6] {
        let n = 1 << 19;
        let around = |k: u32| [Vec3::X, Vec3::Y, -Vec3::X - Vec3::Y].map(|p| p * (1.0 + grows * k as f32));
        let crowd = Bvh::build(&(0..n).map(around).collect::<Vec<_>>());
        let ray = Ray::new(Vec3::new(0.01, 0.02, 1.0), Vec3::NEG_Z);
        assert_eq!(crowd.closest(ray, |_| true).map(|hit| hit.triangle), Some(0));
        let mut met = 0;
        crowd.any(ray, |_| {
            met += 1;
            false
        });
        assert_eq!(met, n);
    }
    let halved = |k: u32| {
        let side = f32::from_bits((127 + 40 - k) << 23);
        [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| (Vec3::ONE + axis) * side)
    };
    // Four of each, as many as a leaf holds.
    let nested = Bvh::build(&(0..360).map(|k| halved(k / 4)).collect::<Vec<_>>());
    let mut met = 0;
    nested.any(Ray::new(Vec3::ZERO, Vec3::ONE), |_| {
        met += 1;
        false
    });
    assert_eq!(met, 360);
    assert_eq!(nested.closest(Ray::new(Vec3::ZERO, Vec3::ONE), |_| true).map(|hit| hit.triangle), Some(356));
}

// The folded tree gives the same hits as a differently shaped one: results do not depend on the tree.
#[test]
fn hits_do_not_depend_on_the_tree() {
    let corners = soup(3_000, 0.2, 3);
    let quality = Bvh::build(&corners);
    let kept: Vec<u32> = (0..3_000).collect();
    let boxes: Vec<_> = corners.iter().map(|[a, b, c]| (a.min(*b).min(*c), a.max(*b).max(*c))).collect();
    let mut order = kept.clone();
    let mut tree = Vec::new();
    balanced(&boxes, &mut order, 0, &mut tree);
    let mut fold = Fold { corners: &corners, kept: &kept, boxes: &boxes, out: Bvh::default() };
    fold.fold(&tree, &order, Opens::Fullest);
    let mut random = Random(4);
    for _ in 0..20_000 {
        let ray = Ray::new(random.point(), random.point());
        assert_eq!(quality.closest(ray, |_| true), fold.out.closest(ray, |_| true));
    }
}

/// A large tree, which consists of pieces, gives the same hits as a tree in one piece, with hardly more steps. The
/// tree does not depend on the number of threads.
#[test]
fn a_tree_of_pieces_gives_the_same_hits() {
    // Triangles of mixed sizes; some are broken and some are equal.
    let mut random = Random(31);
    let mut corners = soup(240_000, 0.01, 17);
    for (index, triangle) in corners.iter_mut().enumerate() {
        match index % 1000 {
            0 => *triangle = triangle.map(|p| p * 3.0),
            1 => triangle[0].x = f32::NAN,
            2..5 => *triangle = [Vec3::X, Vec3::Y, Vec3::Z],
            _ => {}
        }
    }
    let alone = Bvh::build(&corners);
    let shared = Bvh::build_in(&corners, &testing::context()).expect("nothing stops it");
    let bytes = |bvh: &Bvh| {
        let mut hash = blake3::Hasher::new();
        for node in &bvh.nodes {
            let bounds = node.bounds.iter().flatten().flatten().map(|v| v.to_bits());
            bounds.chain(node.children).for_each(|word| _ = hash.update(&word.to_le_bytes()));
        }
        for packet in &bvh.packets {
            let corners = packet.corners.iter().flatten().flat_map(|v| v.to_array()).map(f32::to_bits);
            corners.chain(packet.ids).for_each(|word| _ = hash.update(&word.to_le_bytes()));
        }
        hash.finalize()
    };
    assert_eq!(bytes(&alone), bytes(&shared));
    assert_eq!((alone.broken, alone.degenerate), (240, 0));
    let kept: Vec<u32> = (0..corners.len() as u32).filter(|i| i % 1000 != 1).collect();
    let boxes: Vec<_> = kept
        .iter()
        .map(|&i| corners[i as usize])
        .map(|[a, b, c]| (a.min(b).min(c), a.max(b).max(c)))
        .collect();
    let whole = Fold { corners: &corners, kept: &kept, boxes: &boxes, out: Bvh::default() };
    let whole = whole.built(STACK, true);
    let rays: Vec<Ray> = (0..20_000).map(|_| Ray::new(random.point(), random.point())).collect();
    let hits = |bvh: &Bvh| rays.iter().map(|ray| bvh.closest(*ray, |_| true)).collect::<Vec<_>>();
    let ((some, steps), (same, most)) = (Steps::of(|| hits(&alone)), Steps::of(|| hits(&whole)));
    assert_eq!(some, same);
    assert!(some.iter().flatten().count() > 5_000);
    // Measured: 1.21 and 1.05 million nodes, 1.10 and 2.96 million packets.
    let all = |steps: &Steps| steps.nodes + steps.packets;
    assert!(all(&steps) * 20 <= all(&most) * 21, "{steps:?} {most:?}");
}

/// A cancelled run ends the build.
#[test]
fn a_build_can_be_cancelled() {
    let cx = testing::context();
    cx.stop();
    assert!(Bvh::build_in(&soup(210_000, 0.01, 3), &cx).is_err_and(|error| error.is_cancelled()));
}

// A ray that misses the box around all triangles takes no step; counting changes no hit and ends as requested.
#[test]
fn steps_are_counted_where_asked() {
    let one = Bvh::build(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]);
    let ray = |x: f32| Ray::new(Vec3::new(x, 0.2, 1.0), Vec3::NEG_Z);
    let steps = |x: f32| Steps::of(|| one.any(ray(x), |_| true));
    assert_eq!(steps(0.2), (true, Steps { nodes: 1, packets: 1 }));
    assert_eq!(steps(2.0), (false, Steps::default()));
    let bvh = Bvh::build(&soup(2_000, 0.2, 3));
    let mut random = Random(6);
    let rays: Vec<Ray> = (0..500).map(|_| Ray::new(random.point(), random.point())).collect();
    let hits = || rays.iter().map(|ray| bvh.closest(*ray, |_| true)).collect::<Vec<_>>();
    let (counted, steps) = Steps::of(hits);
    assert_eq!(counted, hits());
    let ((_, inner), outer) = Steps::of(|| Steps::of(hits));
    assert_eq!((inner, outer), (steps, Steps::default()), "walks count once");
    assert!(steps.nodes > 500 && steps.packets > 250, "{steps:?}");
}

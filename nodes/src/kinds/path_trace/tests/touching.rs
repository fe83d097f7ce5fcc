//! Tests of objects that coincide with the receiver: coverage, shadow and transmission are the same as a
//! millimetre above it.

use scene::types::{AlphaMode, ColourMap, DiffuseTransmission, Map};

use super::hanging::rough_wall;
use super::materials::clear;
use super::*;

/// Tolerances for the four values that [`looks`] returns: coverage, light, ratio under the object, and ratio over
/// the whole picture.
const TOLERANCES: [f64; 4] = [0.003, 0.02, 0.03, 0.006];
const LEAST: [f64; 4] = [0.1, 0.1, 0.5, 0.5];

/// Renders an object. Returns its coverage, its light, the mean ratio S under it, and the mean ratio S over the
/// whole picture.
fn looks(
    receiver: &Mesh,
    sheet: &Mesh,
    material: &Material,
    at: DVec3,
    rig: &Arc<Rig>,
    near: bool,
) -> [f64; 4] {
    let mut env = sunny();
    let mut params = PathTrace { crop: 0.001, ..params(64, Surroundings::OPEN) };
    if near {
        env.origin = Some(DVec3::new(0.3, -0.4, 1.7));
        params.surroundings = Surroundings::Projected;
    }
    let (out, _) = render(&params, receiver, &[placed(sheet, material.clone(), at)], rig, &env);
    let [r0, r1, object] = [&out.without, &out.with, &out.object].map(|images| samples(images));
    let mut sums = [0.0; 5];
    for ((a, b), o) in r0.chunks(3).zip(r1.chunks(3)).zip(object.chunks(4)) {
        let ratio = f64::from(luminance([b[0], b[1], b[2]]) / luminance([a[0], a[1], a[2]]));
        let alpha = f64::from(o[3]);
        sums[0] += alpha;
        sums[1] += f64::from(o[0] + o[1] + o[2]);
        // Weighted by coverage, since otherwise a hardly covered pixel would count as much as a covered one.
        sums[2] += alpha * ratio;
        sums[3] += ratio;
        sums[4] += alpha;
    }
    let pixels = (r0.len() / 3) as f64;
    [sums[0] / pixels, sums[1] / pixels, sums[2] / f64::max(sums[4], 1e-6), sums[3] / pixels]
}

fn sheets() -> Vec<(&'static str, Material)> {
    let paper = DiffuseTransmission { strength: Map::of(0.6), colour: ColourMap::of(0.9) };
    let glow = Material { emissive: [3.0, 2.0, 1.0], ..matte(0.4) };
    let lace =
        |alpha: f32, alpha_mode| Material { base_colour: [0.6, 0.5, 0.4, alpha], alpha_mode, ..matte(0.5) };
    vec![
        ("opaque", matte(0.5)),
        ("one side", Material { double_sided: false, ..matte(0.5) }),
        ("blend", lace(0.5, AlphaMode::Blend)),
        ("mask", lace(0.7, AlphaMode::Mask(0.5))),
        ("cut away", lace(0.3, AlphaMode::Mask(0.5))),
        ("paper", Material { diffuse_transmission: paper, ..matte(0.7) }),
        ("wall of glass", clear(0.8, None, 1.5)),
        ("lamp", glow),
    ]
}

/// A sheet looks the same exactly on a surface, above or below it by a rounding error, and a millimetre above it.
/// Tested on a floor, under distant and under near light, and on a table that is smaller than the sheet. In an
/// earlier version, an opaque sheet exactly on the floor covered 71 % of its pixels and cast no shadow.
#[test]
fn what_lies_on_the_receiver_looks_as_a_millimetre_over_it() {
    let camera = rig(DVec3::new(1.5, -1.5, 1.2), DVec3::ZERO, 24, 2.5);
    let sheet = plane(0.4);
    let floor = plane(3.0);
    let table = merge(
        box_mesh([-0.25, -0.25, -0.7], [0.25, 0.25, 0.0], false),
        Mesh {
            positions: plane(3.0).positions.iter().map(|&[x, y, _]| [x, y, -0.7]).collect(),
            ..plane(3.0)
        },
    );
    for (name, material) in sheets() {
        for (place, receiver, near) in
            [("floor", &floor, false), ("floor, near light", &floor, true), ("table", &table, false)]
        {
            let at = |z: f64| looks(receiver, &sheet, &material, DVec3::Z * z, &camera, near);
            let over = at(1e-3);
            for z in [0.0, -1e-7, 1e-7] {
                let found = at(z);
                for (k, what) in ["cover", "light", "ratio under it", "ratio"].into_iter().enumerate() {
                    // The ground directly under a lamp has too little light for this number of samples.
                    if name == "lamp" && k > 1 {
                        continue;
                    }
                    // Near light under a sheet needs more samples too: the image as a whole is compared, which
                    // shows the ground where the sheet does not cover it.
                    if near && k == 2 {
                        continue;
                    }
                    let tolerance = TOLERANCES[k] * f64::max(over[k], LEAST[k]);
                    assert!(
                        (found[k] - over[k]).abs() <= tolerance,
                        "{name} on the {place} at {z}: {what} {} for {}",
                        found[k],
                        over[k]
                    );
                }
            }
            assert_eq!(over[0] > 0.01, name != "cut away", "{name}: it is seen");
        }
    }
}

/// A sheet on a wall looks the same exactly on the wall and a millimetre in front of it.
#[test]
fn what_hangs_on_a_wall_looks_as_a_millimetre_before_it() {
    let turned =
        |mesh: Mesh| Mesh { positions: mesh.positions.iter().map(|&[x, y, z]| [x, z, -y]).collect(), ..mesh };
    let (wall, sheet) = (turned(plane(3.0)), turned(plane(0.4)));
    let facing = Mesh { triangles: wall.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..wall };
    let camera = rig(DVec3::new(0.8, -2.0, 0.5), DVec3::ZERO, 24, 2.5);
    for (name, material) in
        sheets().into_iter().filter(|(name, _)| *name != "one side" && *name != "cut away")
    {
        let at = |y: f64| looks(&facing, &sheet, &material, DVec3::Y * y, &camera, false);
        let (over, on) = (at(-1e-3), at(0.0));
        for k in 0..if name == "lamp" { 2 } else { 4 } {
            let tolerance = TOLERANCES[k] * f64::max(over[k], LEAST[k]);
            assert!((on[k] - over[k]).abs() <= tolerance, "{name}: {on:?} for {over:?}");
        }
    }
}

/// A label on a box and a card on a card: an object exactly on another object is in front of it, as if it were a
/// millimetre above it. In an earlier version, the visible object changed from pixel to pixel.
#[test]
fn what_lies_on_an_object_looks_as_a_hair_over_it() {
    let camera = rig(DVec3::new(1.2, -1.3, 1.5), DVec3::new(0.0, 0.0, 0.3), 24, 2.5);
    let block = placed(&box_mesh([-0.4, -0.4, 0.0], [0.4, 0.4, 0.3], false), matte(0.1), DVec3::ZERO);
    let label = |z: f64, colour: [f32; 3]| {
        let [r, g, b] = colour;
        placed(&plane(0.3), Material { base_colour: [r, g, b, 1.0], ..matte(0.5) }, DVec3::Z * z)
    };
    let seen = |objects: &[Arc<Placed>]| -> [f64; 3] {
        let (out, _) = render(&params(16, Surroundings::OPEN), &plane(3.0), objects, &camera, &sunny());
        [0, 1, 2].map(|k| samples(&out.object).chunks(4).map(|p| f64::from(p[k])).sum())
    };
    let green = [0.05, 0.9, 0.05];
    let over = seen(&[block.clone(), label(0.301, green)]);
    for z in [0.3, 0.3 - 3e-8, 0.3 + 3e-8] {
        for objects in [[block.clone(), label(z, green)], [label(z, green), block.clone()]] {
            let found = seen(&objects);
            for k in 0..3 {
                assert!((found[k] / over[k] - 1.0).abs() < 0.02, "{z}: {found:?} for {over:?}");
            }
        }
    }
    // Of two flat objects, the later one lies on the earlier one.
    let red = [0.9, 0.05, 0.05];
    let pair = |z: f64| seen(&[block.clone(), label(0.3, red), label(z, green)]);
    let (over, found) = (pair(0.301), pair(0.3));
    assert!((found[1] / over[1] - 1.0).abs() < 0.02, "{found:?} for {over:?}");
}

/// Objects exactly on the floor look as they do a millimetre above it, even if other objects are much higher.
/// Tested with a rug under another object, and with tiles edge to edge whose winding points down. In an earlier
/// version, the foot of the object moved the rug into the floor, and each tile was moved by its neighbour, so that
/// the rug and three quarters of the tiles were invisible.
#[test]
fn a_rug_under_a_table_stays_on_the_floor() {
    let camera = rig(DVec3::new(1.2, -1.2, 0.9), DVec3::ZERO, 24, 1.4);
    let table = placed(&box_mesh([-0.1, -0.1, 0.0], [0.1, 0.1, 0.2], false), matte(0.1), DVec3::ZERO);
    let high = placed(&plane(0.2), matte(0.1), DVec3::Z * 10.0);
    let red = Material { base_colour: [0.9, 0.05, 0.05, 1.0], ..matte(0.5) };
    let down = |size: f32| {
        let up = plane(size);
        Mesh { triangles: up.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), ..up }
    };
    let seen = |objects: &[Arc<Placed>]| -> f64 {
        let (out, _) = render(&params(16, Surroundings::OPEN), &plane(3.0), objects, &camera, &sunny());
        samples(&out.object).chunks(4).map(|p| f64::from(p[0])).sum()
    };
    let rug = |z: f64| seen(&[placed(&plane(0.35), red.clone(), DVec3::Z * z), table.clone(), high.clone()]);
    let tiles = |z: f64| {
        let tile = |i: i32| placed(&down(0.1), red.clone(), DVec3::new(0.2 * f64::from(i) - 0.5, 0.0, z));
        seen(&(0..6).map(tile).chain([high.clone()]).collect::<Vec<_>>())
    };
    let cards = |z: f64| {
        let of = |size, colour: f32| {
            placed(&down(size), Material { base_colour: [colour, 0.1, 0.1, 1.0], ..matte(0.5) }, DVec3::Z * z)
        };
        seen(&[of(0.35, 0.1), of(0.3, 0.9)])
    };
    let over = {
        let of = |size, colour: f32, z| {
            placed(&down(size), Material { base_colour: [colour, 0.1, 0.1, 1.0], ..matte(0.5) }, DVec3::Z * z)
        };
        seen(&[of(0.35, 0.1, 0.001), of(0.3, 0.9, 0.002)])
    };
    for (name, found, wanted) in
        [("rug", rug(0.0), rug(0.001)), ("tiles", tiles(0.0), tiles(0.001)), ("cards", cards(0.0), over)]
    {
        assert!((found / wanted - 1.0).abs() < 0.02, "{name}: {found} for {wanted}");
    }
}

/// A framed picture is embedded in a wall with 3 mm of noise. A note states how far it must be moved so that all of
/// it is visible. Nothing is reported after such a move, on a smooth wall, or on rough ground. This test fails if
/// `REPORTED` starts at 0.7.
#[test]
fn a_picture_in_a_rough_wall_is_reported() {
    let camera = rig(DVec3::new(0.3, -3.0, 0.2), DVec3::ZERO, 16, 1.5);
    let picture = |y: f64| {
        let card = Mesh {
            positions: vec![[-0.6, 0.0, -0.4], [0.6, 0.0, -0.4], [0.6, 0.0, 0.4], [-0.6, 0.0, 0.4]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        [placed(&card, matte(0.5), DVec3::Y * y)]
    };
    let reported = |noise: f32, y: f64| {
        let (out, notes) =
            render(&params(4, Surroundings::OPEN), &rough_wall(noise), &picture(y), &camera, &white());
        let note = notes.iter().find(|note| note.id == "in-a-surface").map(|note| note.text.clone());
        (note, samples(&out.object).chunks(4).map(|pixel| pixel[3]).sum::<f32>())
    };
    let (note, cover) = reported(0.005, 0.0);
    let note = note.expect("a note");
    assert!(note.starts_with("object 0 is partly embedded in the receiver mesh, which hides "), "{note}");
    let farther = note.split("; ").nth(1).and_then(|text| text.split(' ').nth(5)).expect("a length");
    let farther: f64 = farther.parse().expect("a number");
    let (none, whole) = reported(0.005, -farther * 1e-3);
    assert!(none.is_none() && cover < 0.8 * whole && (3.0..7.0).contains(&farther), "{note} {cover} {whole}");
    assert_eq!(reported(0.0, 0.0).0, None);
}

/// An object that stands exactly on a floor is not reported as embedded in a surface, whatever `contact_metres` is:
/// the inner side of its two-sided bottom does not count as hidden. An object above the floor is reported as
/// `off-the-ground`, and an object that reaches below it as `in-the-ground`. This test fails if `measure` measures
/// nothing when `fixed` is set, or if `double_sided &&` is replaced by `false &&` in `embedded.rs`.
#[test]
fn what_stands_on_a_floor_lies_in_no_surface() {
    let material = Material { double_sided: true, ..matte(0.5) };
    let cube = |z: f64| {
        [placed(&box_mesh([-0.3, -0.3, 0.0], [0.3, 0.3, 0.5], false), material.clone(), DVec3::Z * z)]
    };
    let camera = rig(DVec3::new(2.0, -3.0, 2.0), DVec3::ZERO, 16, 1.5);
    for contact_metres in [None, Some(0.0), Some(0.02)] {
        let params = PathTrace { contact_metres, ..params(4, Surroundings::OPEN) };
        let reported = |z: f64| render(&params, &plane(3.0), &cube(z), &camera, &white()).1;
        assert!(reported(0.0).iter().all(|note| note.id != "in-a-surface"), "{contact_metres:?}");
        for (z, id) in [(0.2, "off-the-ground"), (-0.2, "in-the-ground")] {
            assert!(reported(z).iter().any(|note| note.id == id), "{contact_metres:?} {z}");
        }
    }
}

/// A plate that extends over its coaster keeps its shadow on rough ground, since the coaster and not the plate
/// rests on the ground. This test fails if `on_others` returns only false.
#[test]
fn a_plate_on_a_coaster_keeps_its_shadow() {
    let ground = |noise: f32| {
        let side = 81_u32;
        let mut mesh = Mesh::default();
        for i in 0..side * side {
            let [x, y] = [i % side, i / side].map(|k| k as f32 / 20.0 - 2.0);
            mesh.positions.push([
                x,
                y,
                noise * (2.0 * render::geometry::sampling::unit(render::geometry::sampling::mix(i)) - 1.0),
            ]);
        }
        for i in (0..side * (side - 1)).filter(|i| i % side + 1 < side) {
            mesh.triangles.extend([[i, i + 1, i + side + 1], [i, i + side + 1, i + side]]);
        }
        mesh
    };
    let slab = |half: f32, low: f32, high: f32| {
        placed(&box_mesh([-half, -half, low], [half, half, high], false), matte(0.5), DVec3::ZERO)
    };
    let objects = [slab(0.125, 0.0, 0.04), slab(0.35, 0.04, 0.07)];
    let camera = rig(DVec3::new(0.6, -1.6, 0.25), DVec3::new(0.0, -0.3, 0.0), 32, 3.0);
    let shadow = |noise: f32| {
        let how = PathTrace { contact_metres: None, ..params(16, Surroundings::OPEN) };
        let (out, _) = render(&how, &ground(noise), &objects, &camera, &white());
        let pixels = samples(&out.without).chunks(3).zip(samples(&out.with).chunks(3));
        let seen = pixels.zip(samples(&out.object).chunks(4)).filter(|(_, object)| object[3] == 0.0);
        seen.map(|((without, with), _)| 1.0 - with[0] / without[0].max(1e-6)).sum::<f32>()
    };
    let (smooth, rough) = (shadow(0.0), shadow(0.004));
    assert!((rough / smooth - 1.0).abs() < 0.2, "{rough} for {smooth}");
}

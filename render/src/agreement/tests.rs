//! Tests with a synthetic place: a floor, three walls and two boxes.

mod cubes;
mod eyes;
mod wrong_splats;

use engine::Up;
use glam::{DMat3, DVec3};

use super::{CapturedPlace, Comparison, Finding, Likely, compare};
use scene::math::equirect::axes;
use scene::types::frame::Similarity;
use scene::types::{Camera, Mesh, SplatEncoding, Splats};
use testing::context;

/// A rectangle: a corner, and the vectors along the two sides that meet there.
type Face = [DVec3; 3];

/// Index of the back wall in [`faces`].
const BACK: usize = 1;

fn faces() -> Vec<Face> {
    let at = DVec3::new;
    let mut faces = vec![
        [at(-3.0, -3.0, 0.0), at(6.0, 0.0, 0.0), at(0.0, 5.0, 0.0)],
        [at(-3.0, 2.0, 0.0), at(6.0, 0.0, 0.0), at(0.0, 0.0, 2.5)],
        [at(-3.0, -3.0, 0.0), at(0.0, 5.0, 0.0), at(0.0, 0.0, 2.0)],
        [at(3.0, -3.0, 0.0), at(0.0, 5.0, 0.0), at(0.0, 0.0, 1.0)],
    ];
    for (low, size) in [(at(-2.0, 0.7, 0.0), at(1.0, 0.6, 0.8)), (at(1.2, -0.4, 0.0), at(0.7, 0.7, 1.3))] {
        let [x, y, z] = [DVec3::X * size.x, DVec3::Y * size.y, DVec3::Z * size.z];
        faces.extend([[low, x, z], [low + y, x, z], [low, y, z], [low + x, y, z], [low + z, x, y]]);
    }
    faces
}

/// Flat splats on all faces, 6 cm apart from each other.
fn splats() -> Splats {
    splats_on(&faces(), 0.06, 0.035, 0.0)
}

/// Flat splats with the given distance from each other and the given standard deviation. Their centres are at least
/// `inset` away from the edges of the faces, or in the middle.
fn splats_on(faces: &[Face], apart: f64, deviation: f32, inset: f64) -> Splats {
    let mut splats = Splats::empty();
    for &[corner, a, b] in faces {
        let (long, wide) = (a.length(), b.length());
        let normal = a.cross(b).normalize();
        // A rotation by 180 degrees about the bisector of z and the normal maps z to the normal.
        let half = (normal + DVec3::Z).normalize();
        let (columns, rows) = ((long / apart).ceil(), (wide / apart).ceil());
        for i in 0..(columns * rows) as usize {
            let (u, v) = ((i % columns as usize) as f64 + 0.5, (i / columns as usize) as f64 + 0.5);
            let within = |share: f64, length: f64| {
                let edge = (inset / length).min(0.5);
                share.clamp(edge, 1.0 - edge)
            };
            let point = corner + a * within(u / columns, long) + b * within(v / rows, wide);
            splats.means.push(point.as_vec3().to_array());
            splats.quats.push([0.0, half.x as f32, half.y as f32, half.z as f32]);
            splats.scales.push([deviation, deviation, 0.003]);
            splats.opacities.push(0.95);
            splats.sh.push([0.5; 3]);
        }
    }
    splats.encoding = SplatEncoding::Srgb;
    splats
}

/// Triangles of the faces, except the face `without`.
fn mesh(without: Option<usize>) -> Mesh {
    let mut mesh = Mesh::default();
    for (_, [corner, a, b]) in faces().into_iter().enumerate().filter(|(i, _)| Some(*i) != without) {
        add(&mut mesh, corner, a, b);
    }
    mesh
}

fn add(mesh: &mut Mesh, corner: DVec3, a: DVec3, b: DVec3) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend([corner, corner + a, corner + a + b, corner + b].map(|p| p.as_vec3().to_array()));
    mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
}

fn placed(mesh: &Mesh, by: &Similarity) -> Mesh {
    let at = |i: usize| by.point(mesh.position(i as u32)).as_vec3().to_array();
    Mesh { positions: (0..mesh.positions.len()).map(at).collect(), ..mesh.clone() }
}

fn camera(eye: DVec3, target: DVec3) -> Camera {
    let z = (target - eye).normalize();
    let x = z.cross(DVec3::Z).normalize();
    Camera::centred("view", [200, 150], 180.0, [x, z.cross(x), z], eye)
}

fn compared(splats: &Splats, mesh: &Mesh, camera: Camera) -> Comparison {
    let place = CapturedPlace {
        splats,
        mesh,
        cameras: &[camera],
        around: &[DVec3::new(0.0, 0.0, 0.5)],
        axes: axes(Up::PlusZ),
        metre: 1.0,
    };
    compare(&place, &context()).expect("runs").expect("surfaces")
}

fn good_camera() -> Camera {
    camera(DVec3::new(0.6, -2.8, 1.5), DVec3::new(0.0, 0.3, 0.6))
}

fn found(mesh: &Mesh) -> Comparison {
    compared(&splats(), mesh, good_camera())
}

/// A mesh that agrees with the splats raises no warning, even if it is only a part of the place or off by a few
/// centimetres. This test fails if `PART_DISAGREES` is 2.
#[test]
fn what_agrees_raises_no_alarm() {
    let whole = found(&mesh(None));
    assert_eq!(whole.findings(), [], "{whole:?}");
    assert!(whole.agreement > 0.9, "{whole:?}");
    // A mesh of the floor near the object only is a usual receiver.
    for side in [2.0, 0.5] {
        let mut floor = Mesh::default();
        add(&mut floor, DVec3::new(-0.5, -0.5, 0.0) * side, DVec3::X * side, DVec3::Y * side);
        let part = found(&floor);
        assert_eq!(part.findings(), [], "{side}: {part:?}");
    }
    // A few centimetres off, as proxies are.
    let low = Similarity { offset: DVec3::new(0.02, 0.0, -0.06), ..Similarity::IDENTITY };
    assert_eq!(found(&placed(&mesh(None), &low)).findings(), []);
}

/// Transforms the mesh by `fault`. Checks that a difference of frames is reported, with a transform that undoes the
/// fault.
fn undone(fault: Similarity) {
    let result = found(&placed(&mesh(None), &fault));
    assert_eq!(result.findings(), [Finding::Elsewhere], "{fault:?}: {result:?}");
    let best = result.best.unwrap_or_else(|| panic!("{fault:?}: {result:?}"));
    let rest = best.by.after(&fault);
    let middle = DVec3::new(0.0, 0.3, 0.5);
    assert!(
        (rest.scale - 1.0).abs() < 0.04 && (rest.point(middle) - middle).length() < 0.12,
        "{fault:?}: {best:?}"
    );
    assert_eq!(best.likely, Likely::Mesh, "{fault:?}");
}

/// A wrong scale of the mesh is detected and measured. This test fails if `FACTORS` is 1.
#[test]
fn factors_are_found() {
    for scale in [0.01, 0.37, 2.0, 100.0] {
        undone(Similarity { scale, ..Similarity::IDENTITY });
    }
}

#[test]
fn quarter_turns_are_found() {
    let [x, y, z] = [
        DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        DMat3::from_cols(DVec3::NEG_Z, DVec3::Y, DVec3::X),
        DMat3::from_cols(DVec3::Y, DVec3::NEG_X, DVec3::Z),
    ];
    for rotation in [x, x * x, x * x * x, y, z * z] {
        undone(Similarity { rotation, ..Similarity::IDENTITY });
    }
}

#[test]
fn shifts_of_half_a_metre_are_found() {
    for axis in [DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z] {
        undone(Similarity { offset: axis * 0.5, ..Similarity::IDENTITY });
    }
}

/// Faces of the place that the trials of other tools use: a floor, and a thin post between camera and object.
fn floor_and_post() -> Vec<Face> {
    let at = DVec3::new;
    let mut faces = vec![[at(-2.0, -2.0, 0.0), at(4.0, 0.0, 0.0), at(0.0, 4.0, 0.0)]];
    let (low, [x, y, z]) = (at(-0.1, -1.1, 0.0), [DVec3::X * 0.2, DVec3::Y * 0.15, DVec3::Z * 1.2]);
    faces.extend([[low, x, z], [low + y, x, z], [low, y, z], [low + x, y, z], [low + z, x, y]]);
    faces
}

/// A place whose splats are so large that their depths are inaccurate near the object.
fn coarse() -> (Splats, Mesh) {
    let mut mesh = Mesh::default();
    floor_and_post().into_iter().for_each(|[corner, a, b]| add(&mut mesh, corner, a, b));
    (splats_on(&floor_and_post(), 0.08, 0.094, 0.12), mesh)
}

fn coarse_camera() -> Camera {
    camera(DVec3::new(0.6, -3.2, 1.6), DVec3::new(0.0, 0.0, 0.45))
}

/// The transform that undoes a fault is found exactly where splats are large and one plane dominates, and neither
/// debris nor missing surfaces are reported there. This test fails if `of_surfaces` returns `None`.
#[test]
fn faults_are_found_in_a_place_of_large_splats() {
    let (splats, mesh) = coarse();
    assert_eq!(compared(&splats, &mesh, coarse_camera()).findings(), []);
    let turn = |x: DVec3, y: DVec3| Similarity {
        rotation: DMat3::from_cols(x, y, x.cross(y)),
        ..Similarity::IDENTITY
    };
    let scaled = |scale: f64| Similarity { scale, ..Similarity::IDENTITY };
    let shifted = |offset: DVec3| Similarity { offset, ..Similarity::IDENTITY };
    let faults = [
        scaled(0.1),
        scaled(0.5),
        scaled(100.0),
        shifted(DVec3::X * 0.5),
        shifted(DVec3::Y * -0.5),
        turn(DVec3::Y, DVec3::NEG_X),
        turn(DVec3::NEG_X, DVec3::NEG_Y),
    ];
    for fault in faults {
        let result = compared(&splats, &placed(&mesh, &fault), coarse_camera());
        assert_eq!(result.findings(), [Finding::Elsewhere], "{fault:?}: {result:?}");
        let best = result.best.unwrap_or_else(|| panic!("{fault:?}: {result:?}"));
        let rest = best.by.after(&fault);
        let post = DVec3::new(0.0, -1.0, 0.6);
        assert!(
            (rest.scale - 1.0).abs() < 0.01 && (rest.point(post) - post).length() < 0.03,
            "{fault:?}: {best:?}"
        );
        assert!(best.agreement > 0.9 && best.agreement > best.before + 0.12, "{fault:?}: {best:?}");
    }
}

/// Splats of another scale are blamed if the cameras show that the mesh is in place.
#[test]
fn the_cameras_show_which_input_is_elsewhere() {
    let (mut splats, mesh) = coarse();
    splats.means.iter_mut().flatten().for_each(|v| *v *= 0.25);
    splats.scales.iter_mut().flatten().for_each(|v| *v *= 0.25);
    let result = compared(&splats, &mesh, coarse_camera());
    let best = result.best.unwrap_or_else(|| panic!("{result:?}"));
    assert!((best.by.scale - 0.25).abs() < 1e-3 && best.turn_deg < 1.0, "{best:?}");
    assert!(best.likely == Likely::Splats && best.is_decided, "{best:?}");
}

/// A mesh whose axes were swapped or negated is recognized as a reflection. This test fails without the reflections
/// in `all_turns`.
#[test]
fn reflections_are_found() {
    let swap = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::Y);
    let negate = DMat3::from_cols(DVec3::NEG_X, DVec3::Y, DVec3::Z);
    for rotation in [swap, negate] {
        let result = found(&placed(&mesh(None), &Similarity { rotation, ..Similarity::IDENTITY }));
        let best = result.best.unwrap_or_else(|| panic!("{rotation}: {result:?}"));
        assert!(best.is_mirrored(), "{rotation}: {best:?}");
        // Each of the two is its own inverse.
        assert_eq!((best.by.rotation, best.by.scale), (rotation, 1.0), "{best:?}");
    }
}

/// A mesh of another place gets no transform, and neither debris nor missing surfaces are reported.
#[test]
fn a_mesh_of_another_place_gets_no_transform() {
    let (_, other) = coarse();
    let fault = Similarity { offset: DVec3::new(0.3, 0.4, 0.9), ..Similarity::IDENTITY };
    let result = found(&placed(&other, &fault));
    assert_eq!(result.best, None, "{result:?}");
    assert_eq!(result.findings(), [Finding::Elsewhere], "{result:?}");
}

/// If only `up` is wrong, splats and mesh still agree, although the object stands at a wrong place. This test fails
/// without the second comparison in `compare`.
#[test]
fn a_wrong_up_is_not_reported_as_a_wrong_mesh() {
    let (splats, mesh) = coarse();
    for up in [Up::PlusY, Up::MinusY] {
        let place = CapturedPlace {
            splats: &splats,
            mesh: &mesh,
            cameras: &[coarse_camera()],
            around: &[axes(up)[2] * 0.5],
            axes: axes(up),
            metre: 1.0,
        };
        let result = compare(&place, &context()).expect("runs").expect("surfaces");
        assert_eq!(result.findings(), [], "{up:?}: {result:?}");
    }
}

/// Floating debris of the mesh and a missing wall are reported. This test fails if `FLOATS` is 1.1.
#[test]
fn debris_and_missing_walls_are_found() {
    let mut debris = mesh(None);
    for i in 0..6 {
        let corner = DVec3::new(
            -1.2 + 0.4 * f64::from(i),
            -0.9 + 0.2 * f64::from(i % 3),
            0.9 + 0.1 * f64::from(i % 2),
        );
        add(&mut debris, corner, DVec3::X * 0.15, DVec3::new(0.0, 0.05, 0.15));
    }
    let result = found(&debris);
    assert_eq!(result.findings(), [Finding::Debris], "{result:?}");
    let result = found(&mesh(Some(BACK)));
    assert_eq!(result.findings(), [Finding::Missing], "{result:?}");
    assert!((result.missing.at.y - 2.0).abs() < 0.1, "{result:?}");
}

#[test]
fn cameras_and_splats_that_are_elsewhere_are_named() {
    let away = camera(DVec3::new(0.6, -28.0, 15.0), DVec3::new(0.0, -60.0, 40.0));
    let result = compared(&splats(), &mesh(None), away);
    assert_eq!(result.findings(), [Finding::Cameras], "{result:?}");
    // If the splats have another unit, the wanted view shows only the mesh.
    let mut small = splats();
    small.means.iter_mut().flatten().for_each(|v| *v *= 0.02);
    small.scales.iter_mut().flatten().for_each(|v| *v *= 0.02);
    let result = compared(&small, &mesh(None), good_camera());
    assert_eq!(result.findings(), [Finding::Elsewhere], "{result:?}");
    let best = result.best.unwrap_or_else(|| panic!("{result:?}"));
    assert!(best.likely == Likely::Splats && (best.by.scale / 0.02 - 1.0).abs() < 0.04, "{best:?}");
}

/// Points on both sides of a surface agree alike, and points beyond the tolerance do not agree. An earlier version
/// gave points behind the surface an agreement above 1.
#[test]
fn the_agreement_of_a_point_is_symmetric_and_bounded() {
    for off in [0.0, 0.3, 0.99, 1.0, 1.5, 3.0] {
        let both = [off, -off].map(super::spots::kernel);
        assert_eq!(both[0], both[1]);
        assert!(if off < 1.0 { both[0] > 0.0 && both[0] <= 1.0 } else { both[0] == 0.0 }, "{off}: {both:?}");
    }
}

/// An eye just above the ground is nearer to it than the near plane of the splats, so the mesh there is not debris. This
/// test fails if `CLIPPED` is 0.
#[test]
fn ground_before_the_near_plane_is_not_debris() {
    let (splats, mesh) = (splats(), mesh(None));
    for height in [0.01, 0.02, 0.04] {
        let place = CapturedPlace {
            splats: &splats,
            mesh: &mesh,
            cameras: &[good_camera()],
            around: &[DVec3::new(0.0, 0.0, height)],
            axes: axes(Up::PlusZ),
            metre: 1.0,
        };
        let found = compare(&place, &context()).expect("runs").expect("surfaces");
        assert_eq!(found.findings(), [], "{height}: {found:?}");
    }
}

//! Splats in the wrong frame, with a mesh and cameras that fit each other.

use glam::{DMat3, DQuat, DVec3};
use scene::types::Splats;
use scene::types::frame::Similarity;

use super::{compared, good_camera, mesh, splats};
use crate::agreement::{Finding, Likely};

fn placed(splats: &Splats, by: &Similarity) -> Splats {
    let mut placed = splats.clone();
    let turn = DQuat::from_mat3(&by.rotation);
    for (i, mean) in placed.means.iter_mut().enumerate() {
        *mean = by.point(splats.mean(i)).as_vec3().to_array();
    }
    for quat in &mut placed.quats {
        let [w, x, y, z] = quat.map(f64::from);
        let [x, y, z, w] = (turn * DQuat::from_xyzw(x, y, z, w)).to_array();
        *quat = [w, x, y, z].map(|v| v as f32);
    }
    placed.scales.iter_mut().flatten().for_each(|scale| *scale *= by.scale as f32);
    placed
}

/// The transform is found, and the splats are blamed if the views show less of them than of the mesh.
#[test]
fn splats_that_are_elsewhere_are_found() {
    let one = Similarity::IDENTITY;
    let turn = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);
    let faults = [
        (Similarity { rotation: turn, ..one }, false),
        (Similarity { rotation: turn * turn, ..one }, false),
        (Similarity { offset: DVec3::Z * 2.0, ..one }, true),
        (Similarity { scale: 100.0, ..one }, false),
    ];
    for (fault, is_decided) in faults {
        let result = compared(&placed(&splats(), &fault), &mesh(None), good_camera());
        assert_eq!(result.findings(), [Finding::Elsewhere], "{fault:?}: {result:?}");
        let best = result.best.unwrap_or_else(|| panic!("{fault:?}: {result:?}"));
        if is_decided {
            assert!(best.likely == Likely::Splats && best.is_decided, "{fault:?}: {best:?}");
        }
        let point = DVec3::new(0.5, -0.3, 0.7);
        let off = (best.by.point(point) - fault.point(point)).length();
        assert!(
            off < 0.04 * fault.scale && (best.by.scale / fault.scale - 1.0).abs() < 0.02,
            "{fault:?}: {best:?}"
        );
    }
}

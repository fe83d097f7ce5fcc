//! Checks and notes of a glossy receiver.

use engine::{NodeError, Notes};
use render::transport::scene::receiver::Receiver;
use scene::types::Mesh;

/// Rejects a glossy receiver if the pixels are splats: their ratio would hold for a single direction of view.
pub(super) fn check(mesh: &Mesh, points: bool) -> Result<(), NodeError> {
    if points && !mesh.gloss_of.is_empty() {
        let text =
            "the receiver is glossy, so a ratio at each splat would hold for one direction of view only";
        return Err(NodeError::new(text)
            .at("receiver")
            .hint("with `points`, use the mesh without `SetGloss`"));
    }
    Ok(())
}

/// Reports what a glossy receiver changes.
pub(super) fn report(receiver: &Receiver, notes: &mut Notes) {
    if receiver.is_glossy() {
        let text =
            "the receiver is glossy: the change is traced everywhere (`crop` is off), with whole paths";
        notes.decision("glossy-receiver", text);
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use scene::types::Gloss;

    use super::*;

    /// This test fails if the gloss or `points` is ignored.
    #[test]
    fn only_a_glossy_receiver_is_reported_or_refused() {
        let gloss = Gloss { roughness: 0.1, metallic: 0.0, ior: 1.5, specular: 1.0, normal: [0.0; 3] };
        let sheet = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let glossy = Mesh { glosses: vec![gloss], gloss_of: vec![1], ..sheet.clone() };
        for (mesh, expected) in [(&sheet, 0), (&glossy, 1)] {
            let mut notes = Notes::none();
            report(&Receiver::new(mesh, DVec3::ZERO), &mut notes);
            assert_eq!(notes.iter().count(), expected);
            assert_eq!([false, true].map(|points| check(mesh, points).is_err()), [false, expected == 1]);
        }
    }
}

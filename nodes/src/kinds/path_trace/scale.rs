//! Checks of sizes and views that reveal a wrong `metres_per_unit`, `scale` or axis.

use engine::Notes;
use glam::Vec3;
use render::transport::scene::aabb::Aabb;
use render::transport::scene::receiver::Receiver;

/// Ratio of object size to receiver size above which a warning is given.
const TOO_LARGE: f32 = 2.0;

/// Warns of objects larger than the receiver, by their bounding boxes.
pub(crate) fn report_size(receiver: &Receiver, boxes: &[Aabb], metres_per_unit: f64, notes: &mut Notes) {
    let Some((low, high)) = receiver.bvh.bounds() else { return };
    let place = (high - low).length();
    for (index, one) in boxes.iter().enumerate() {
        let size = one.size();
        if size > TOO_LARGE * place {
            let metres = f64::from(size) * metres_per_unit;
            let text = format!(
                "object {index} is {} units ({} m) across, but the whole receiver mesh is only {} units across",
                short(size),
                short(metres as f32),
                short(place)
            );
            let hint = "check `metres_per_unit` of the scene and `scale` of the pose";
            notes.warning("object-too-large", format!("{text}; {hint}"));
        }
    }
}

/// Likely reason why a camera sees none of the objects, derived from their bounding boxes. `backs` is true if the
/// camera looks at the backs of their faces.
pub(crate) fn why_not_seen(camera: &str, eye: Vec3, boxes: &[Aabb], backs: bool) -> String {
    if let Some(around) = boxes.iter().position(|one| one.holds(eye)) {
        return format!(
            "`{camera}` is inside the bounding box of object {around} and sees no object, since single-sided surfaces are invisible \
             from behind; check the size of the object and the position of the camera"
        );
    }
    if backs {
        return format!(
            "`{camera}` sees objects only from behind, where the faces of single-sided materials are invisible; turn the object, \
             reverse its faces in the program that made it, or make the material double-sided"
        );
    }
    let mut all: Vec<_> = boxes
        .iter()
        .enumerate()
        .filter(|(_, one)| !one.is_empty())
        .map(|(i, one)| (one.distance(eye), i))
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let near = all.first().map_or(String::new(), |&(distance, index)| {
        format!(
            "; object {index} ({} units across) is {} units away",
            short(boxes[index].size()),
            short(distance)
        )
    });
    format!("`{camera}` sees no object{near}; check that pose, rig and mesh share axes and scale")
}

/// Formats a length with two decimals, or in scientific notation if it is very small or very large.
pub(crate) fn short(length: f32) -> String {
    if (0.01..100_000.0).contains(&length) { format!("{length:.2}") } else { format!("{length:.1e}") }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use scene::types::Mesh;

    fn cube(at: f32, half: f32) -> Aabb {
        Aabb { low: Vec3::splat(at - half), high: Vec3::splat(at + half) }
    }

    /// Objects larger than the place are reported. This test fails if `TOO_LARGE` is 0, or if `Aabb::size` does not
    /// test `is_empty`.
    #[test]
    fn what_is_larger_than_the_place_is_reported() {
        let floor = Mesh {
            positions: vec![[0.0; 3], [6.0, 0.0, 0.0], [0.0, 6.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let receiver = Receiver::new(&floor, DVec3::ZERO);
        let reported = |receiver: &Receiver, half| {
            let mut notes = Notes::none();
            report_size(receiver, &[cube(0.0, 1.0), Aabb::EMPTY, cube(0.0, half)], 0.01, &mut notes);
            notes.iter().map(|note| note.text.clone()).collect::<Vec<_>>()
        };
        assert_eq!(reported(&receiver, 4.0), [""; 0]);
        let text = &reported(&receiver, 50.0)[0];
        assert!(
            text.starts_with(
                "object 2 is 173.21 units (1.73 m) across, but the whole receiver mesh is only 8.49 units across;"
            ),
            "{text}"
        );
        assert_eq!(reported(&Receiver::default(), 50.0), [""; 0]);
    }

    #[test]
    fn a_camera_that_sees_nothing_is_reported_where_the_objects_are() {
        let boxes = [cube(9.0, 1.0), Aabb::EMPTY, cube(5.0, 1.0)];
        let text = why_not_seen("a", Vec3::new(5.0, 5.0, 2.0), &boxes, false);
        assert!(
            text.starts_with("`a` sees no object; object 2 (3.46 units across) is 2.00 units away;"),
            "{text}"
        );
        let text = why_not_seen("a", Vec3::splat(8.5), &boxes, true);
        assert!(text.starts_with("`a` is inside the bounding box of object 0"), "{text}");
        let text = why_not_seen("a", Vec3::ZERO, &boxes, true);
        assert!(text.starts_with("`a` sees objects only from behind"), "{text}");
        let text = why_not_seen("a", Vec3::ZERO, &[Aabb::EMPTY], false);
        assert!(text.starts_with("`a` sees no object; check"), "{text}");
    }
}

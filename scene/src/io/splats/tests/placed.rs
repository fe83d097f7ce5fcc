//! Tests of splats in glTF, and of the frames of formats that define one.

use engine::Scene;

use super::*;

fn at(up: Up, metres_per_unit: f64) -> Context {
    Context::detached(Scene { up, metres_per_unit, seed: 0, exhaustive: false }, ".")
}

#[test]
fn glb_is_turned_and_scaled_as_objects_are() {
    let bytes = build::glb("", "srgb_rec709_display");
    let (stored, notes) = from_bytes("a", &bytes, Frame::AsStored, &at(Up::PlusZ, 2.0)).unwrap();
    near(&stored.means[0], &[1.0, 2.0, 3.0], 0.0);
    near(&stored.scales[1], &[0.4, 0.5, 0.0], 0.0);
    near(&stored.opacities, &[1.0, 0.2], 1e-7);
    near(&stored.quats[0], &[1.0, 0.0, 0.0, 0.0], 0.0);
    near(&stored.quats[1], &[0.8165, 0.5774, 0.0, 0.0], 1e-3);
    assert_eq!((stored.sh_degree, stored.encoding), (1, SplatEncoding::Srgb));
    near(&stored.sh[3], &[2.0, 0.0, 1.0], 0.0);
    let ids: Vec<&str> = notes.iter().map(|note| note.id.as_str()).collect();
    assert_eq!(ids, ["frame", "sorting-method"]);
    let (turned, _) = from_bytes("a", &bytes, Frame::ByFormat, &at(Up::PlusZ, 2.0)).unwrap();
    near(&turned.means[0], &[0.5, -1.5, 1.0], 0.0);
    near(&turned.scales[1], &[0.2, 0.25, 0.0], 1e-8);
    // A feature along +y moves to +z: -y is the first function of degree 1, z the second. +z moved to -y.
    let before = stored.sh[1..4].to_vec();
    near(&turned.sh[1], &before[1], 1e-7);
    near(&turned.sh[2], &before[0].map(|v| -v), 1e-7);
    near(&turned.sh[3], &before[2], 1e-7);
}

#[test]
fn nodes_of_glb_move_their_splats() {
    let node =
        r#","translation":[10,0,0],"rotation":[0,0,0.7071067811865476,0.7071067811865476],"scale":[2,2,2]"#;
    let bytes = build::glb(node, "lin_rec709_display");
    let (splats, _) = from_bytes("a", &bytes, Frame::ByFormat, &at(Up::PlusY, 1.0)).unwrap();
    assert_eq!(splats.encoding, SplatEncoding::Linear);
    // Rotated by 90 degrees about z, twice as large, 10 to the right.
    near(&splats.means[0], &[10.0 - 4.0, 2.0, 6.0], 1e-6);
    near(&splats.scales[0], &[0.2, 0.4, 0.6], 1e-7);
    let matrix = r#","matrix":[0,2,0,0,-2,0,0,0,0,0,2,0,10,0,0,1]"#;
    let (same, _) =
        from_bytes("a", &build::glb(matrix, "lin_rec709_display"), Frame::ByFormat, &at(Up::PlusY, 1.0))
            .unwrap();
    near(same.means.as_flattened(), splats.means.as_flattened(), 1e-6);
    near(same.quats.as_flattened(), splats.quats.as_flattened(), 1e-6);
    for bad in [r#","scale":[1,2,1]"#, r#","scale":[0,0,0]"#, r#","children":[0]"#] {
        assert!(read(&build::glb(bad, "srgb_rec709_display")).is_err(), "{bad}");
    }
    assert!(read(&build::glb("", "scene_linear_p3")).is_err());
}

#[test]
fn spz_is_turned_by_its_format() {
    let bytes = build::spz(3, 1);
    let load = |frame, up| from_bytes("a", &bytes, frame, &at(up, 3.0)).unwrap();
    let (stored, _) = load(Frame::AsStored, Up::MinusY);
    let (turned, notes) = load(Frame::ByFormat, Up::MinusY);
    assert!(
        notes.iter().any(|note| note.id == "frame" && note.text.contains("+y up, according to its format"))
    );
    for (a, b) in stored.means.iter().zip(&turned.means) {
        near(&[a[0], -a[1], -a[2]], b, 0.0);
    }
    for (a, b) in stored.quats.iter().zip(&turned.quats) {
        // A rotation by 180 degrees about x: (0, 1, 0, 0) times q.
        near(&[-a[1], a[0], -a[3], a[2]], b, 1e-7);
    }
    // y and z change sign, x does not.
    near(&turned.sh[1], &stored.sh[1].map(|v| -v), 0.0);
    near(&turned.sh[2], &stored.sh[2].map(|v| -v), 0.0);
    near(&turned.sh[3], &stored.sh[3], 0.0);
    assert_eq!(load(Frame::ByFormat, Up::PlusY).0, stored);
    assert_eq!(load(Frame::YDown, Up::MinusY).0, stored);
    assert_eq!(load(Frame::YDown, Up::PlusY).0, turned);
}

/// A comment of a PLY file about its up axis does not move the splats, but is compared with the world. This test fails
/// if the comment is not read, or if `frame` does not silence the warning.
#[test]
fn a_comment_about_the_up_axis_is_compared_with_the_world() {
    let bytes = build::ply(&[PlyRow::default()], 0);
    let at_element = bytes.windows(14).position(|window| window == b"element vertex").unwrap();
    let of = |comment: &str, frame: Frame, up: Up| {
        let line = format!("comment {comment}\n");
        let file = [&bytes[..at_element], line.as_bytes(), &bytes[at_element..]].concat();
        let (splats, notes) = from_bytes("a", &file, frame, &at(up, 1.0)).unwrap();
        (splats, notes.iter().any(|note| note.id == "up-differs"))
    };
    let (wanted, _) = of("none", Frame::ByFormat, Up::PlusZ);
    for (comment, up, warned) in [
        ("Vertical Axis: z", Up::PlusZ, false),
        ("Vertical Axis: z", Up::MinusY, true),
        ("vertical axis: y", Up::PlusZ, true),
        ("Vertical Axis: -y", Up::MinusY, false),
        ("axis: z", Up::MinusY, false),
    ] {
        assert!(of(comment, Frame::ByFormat, up) == (wanted.clone(), warned), "{comment} {up:?}");
        assert!(!of(comment, Frame::AsStored, up).1, "{comment} {up:?}");
    }
}

// Extension SPZ_ADOBE_coordinate_system: 6 is RDF, 12 is RFU (right, forward, up).
#[test]
fn spz_names_its_axes() {
    let of_axes = |notes: &Notes| notes.iter().any(|note| note.id == "spz-axes");
    let (plain, notes) = from_bytes("a", &build::spz(4, 1), Frame::ByFormat, &at(Up::PlusY, 1.0)).unwrap();
    let text = &notes.iter().find(|note| note.id == "spz-axes").unwrap().text;
    assert!(text.contains("splat-transform 3") && text.contains("`frame: AsStored`"), "{text}");
    for (code, expected) in [(4_u32, [0, 1, 2]), (6, [0, 11, 12]), (12, [0, 2, 11])] {
        let bytes = build::spz(4, 1);
        let mut extended = bytes[..32].to_vec();
        extended[14] |= 2;
        extended[16] = 32 + 12 + 12;
        for word in [0x1234_0001_u32, 4, 99, 0xadbe_0003, 4, code] {
            extended.extend_from_slice(&word.to_le_bytes());
        }
        extended.extend_from_slice(&bytes[32..]);
        let (splats, notes) = from_bytes("a", &extended, Frame::ByFormat, &at(Up::PlusY, 1.0)).unwrap();
        assert!(!of_axes(&notes), "an extension names the axes");
        for (a, b) in plain.means.iter().zip(&splats.means) {
            // 10 and more means the negative of the axis.
            let moved = expected.map(|i: usize| if i >= 10 { -a[i - 10] } else { a[i] });
            near(b, &moved, 0.0);
        }
    }
}

/// Drafts of `KHR_gaussian_splatting` stored scales as logarithms; a negative scale indicates such a file.
#[test]
fn scales_below_0_of_a_glb_are_logarithms() {
    let lengths = [0.1_f32, 0.2, 0.3, 0.4, 0.5, 1e-9];
    let bytes = |values: [f32; 6]| values.map(f32::to_le_bytes).as_flattened().to_vec();
    let mut draft = build::glb("", "srgb_rec709_display");
    let stored = bytes([0.1, 0.2, 0.3, 0.4, 0.5, 0.0]);
    let at = draft.windows(stored.len()).position(|window| window == stored).unwrap();
    let logarithms = lengths.map(|v| crate::math::num::f64::ln(v.into()) as f32);
    draft[at..at + stored.len()].copy_from_slice(&bytes(logarithms));
    let (splats, notes) = read(&draft).unwrap();
    near(splats.scales.as_flattened(), &lengths, 1e-6);
    assert!(notes.iter().any(|note| note.id == "logarithmic-scales" && note.text.starts_with("2 of 2 ")));
    let (_, notes) = read(&build::glb("", "srgb_rec709_display")).unwrap();
    assert!(notes.iter().all(|note| note.id != "logarithmic-scales"));
}

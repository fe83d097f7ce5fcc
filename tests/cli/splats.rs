//! Tests of `inspect` and `convert`: their output and their errors.

use std::fmt::Write as _;

use crate::Place;

/// An INRIA PLY file with a floor of flat splats, and with round splats above the floor. +z is up, and the floor is
/// 10 times `scale` wide. `log` must be the natural logarithm of `scale`.
fn room(scale: f32, log: f32) -> Vec<u8> {
    let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    let mut text = "ply\nformat binary_little_endian 1.0\nelement vertex 900\n".to_owned();
    fields.split(' ').for_each(|name| writeln!(text, "property float {name}").unwrap());
    text.push_str("end_header\n");
    let mut bytes = text.into_bytes();
    for i in 0..900_usize {
        let unit = |k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 1008.0 - 0.5;
        let floor = i % 3 > 0;
        let z = if floor { -2.5 } else { 2.5 * unit(3) };
        let mean = [unit(1) * 10.0, unit(2) * 10.0, z].map(|v| v * scale);
        // Logarithms of 0.02 and, across the floor, of 0.0002.
        let sizes = [-3.9, -3.9, if floor { -8.5 } else { -3.9 }].map(|size| size + log);
        let row = mean.into_iter().chain([0.5, 0.5, 0.5, 2.0]).chain(sizes).chain([1.0, 0.0, 0.0, 0.0]);
        row.for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    }
    bytes
}

fn printed(output: &std::process::Output) -> (Option<i32>, String) {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    (output.status.code(), String::from_utf8(text).unwrap())
}

#[test]
fn scenes_are_reported_with_the_digits_they_need() {
    let place = Place::new("");
    std::fs::write(place.path("large.ply"), room(1.0, 0.0)).unwrap();
    std::fs::write(place.path("small.ply"), room(0.001, -6.908)).unwrap();
    let (code, text) = printed(&place.call(&["inspect", "large.ply"]));
    assert_eq!(code, Some(0), "{text}");
    assert!(text.contains("900") && text.contains("+z, sure") && text.contains("z = -2.500"), "{text}");
    let (_, text) = printed(&place.call(&["inspect", "small.ply"]));
    assert!(text.contains("-0.00250"), "{text}");
}

#[test]
fn converting_says_what_it_took_for_granted() {
    let place = Place::new("");
    std::fs::write(place.path("room.ply"), room(1.0, 0.0)).unwrap();
    // The floor indicates +z, and no option contradicts it.
    let (code, text) = printed(&place.call(&["convert", "room.ply", "room.spz"]));
    assert!(code == Some(0) && text.contains("[up-unlikely]") && text.contains("`--up`"), "{text}");
    let (code, text) = printed(&place.call(&["convert", "room.ply", "room.spz", "--up", "+z"]));
    assert!(code == Some(0) && !text.contains("up-unlikely") && text.contains("splats: 900"), "{text}");
    let (code, text) = printed(&place.call(&["convert", "room.spz", "four.spz", "--spz4"]));
    assert!(
        code == Some(0) && std::fs::read(place.path("four.spz")).unwrap().starts_with(b"NGSP\x04"),
        "{text}"
    );
    let (_, text) = printed(&place.call(&["inspect", "four.spz"]));
    assert!(text.contains("+y, defined by the file format") && text.contains("+y, sure"), "{text}");
    for wrong in [
        &["convert", "room.ply", "a.spz", "--up", "+z", "--as-stored"][..],
        &["convert", "room.ply", "a.ply", "--spz4"],
        &["convert", "room.ply", "a.obj"],
    ] {
        assert_eq!(place.call(wrong).status.code(), Some(2), "{wrong:?}");
    }
    assert!(!place.path("a.spz").exists());
}

/// The up axis that a comment of a PLY file states is used and reported, and that of a USD stage is reported. This test
/// fails if `convert` takes -y for such a file, or `inspect` prints only axes of formats.
#[test]
fn axes_that_a_file_states_are_used() {
    let place = Place::new("");
    let plain = room(1.0, 0.0);
    let at = plain.windows(14).position(|window| window == b"element vertex").unwrap();
    let file = [&plain[..at], b"comment Vertical Axis: z\n", &plain[at..]].concat();
    std::fs::write(place.path("room.ply"), file).unwrap();
    std::fs::write(place.path("plain.ply"), plain).unwrap();
    let (code, text) = printed(&place.call(&["convert", "room.ply", "room.spz"]));
    assert!(code == Some(0) && text.contains("from +z up") && !text.contains("up-unlikely"), "{text}");
    let (code, _) = printed(&place.call(&["convert", "plain.ply", "plain.spz", "--up", "+z"]));
    assert_eq!(code, Some(0));
    assert!(
        std::fs::read(place.path("room.spz")).unwrap() == std::fs::read(place.path("plain.spz")).unwrap()
    );
    let (code, text) = printed(&place.call(&["convert", "room.ply", "room.spz", "--up=-y"]));
    assert!(code == Some(0) && text.contains("a comment of `room.ply` says that +z is up"), "{text}");
    let (_, text) = printed(&place.call(&["inspect", "room.ply", "--json"]));
    assert!(text.contains("\"declared_up\":\"+z\""), "{text}");
    let (_, text) = printed(&place.call(&["inspect", "room.ply"]));
    assert!(text.contains("+z, stated by a comment of the file"), "{text}");
    let (_, text) = printed(&place.call(&["inspect", "room.spz"]));
    assert!(text.contains("[spz-axes]"), "{text}");
    let stage = "#usda 1.0\n(\n upAxis = \"Z\"\n metersPerUnit = 1\n)\ndef ParticleField3DGaussianSplat \"S\"\n{\n \
                 point3f[] positions = [(1, 2, 3), (0, 0, 1)]\n}\n";
    std::fs::write(place.path("a.usda"), stage).unwrap();
    let (_, text) = printed(&place.call(&["inspect", "a.usda", "--json"]));
    assert!(text.contains("\"declared_up\":\"+z\""), "{text}");
}

/// A picture that cannot be read is reported as `LoadImage` reports it. This test fails if `inspect` drops the error of
/// the reader.
#[test]
fn pictures_that_cannot_be_read_are_named_with_the_reason() {
    let place = Place::new("");
    // One directory with the tag of the compression: LZMA.
    let tags = [
        b"II*\0\x08\0\0\0\x04\0".to_vec(),
        tag(256, 2),
        tag(257, 2),
        tag(259, 34_925),
        tag(262, 2),
        vec![0; 4],
    ];
    std::fs::write(place.path("a.tif"), tags.concat()).unwrap();
    let (code, text) = printed(&place.call(&["inspect", "a.tif"]));
    assert!(code == Some(1) && text.contains("LZMA compression; save it with deflate"), "{text}");
    std::fs::write(place.path("a.exr"), b"\x76\x2f\x31\x01\x02\0\0\0").unwrap();
    let (code, text) = printed(&place.call(&["inspect", "a.exr"]));
    assert!(code == Some(1) && text.contains("`a.exr`: not a complete EXR"), "{text}");
}

/// An entry of a TIFF directory with one number of 16 bits.
fn tag(number: u16, value: u16) -> Vec<u8> {
    [number, 3, 1, 0, value, 0].map(u16::to_le_bytes).as_flattened().to_vec()
}

#[test]
#[cfg(unix)]
fn what_is_no_file_is_refused_at_once() {
    let place = Place::new("");
    let (code, text) = printed(&place.call(&["inspect", "/dev/zero"]));
    assert!(code == Some(1) && text.contains("neither a regular file nor a folder"), "{text}");
    let (code, text) = printed(&place.call(&["convert", "/dev/zero", "a.ply"]));
    assert!(code == Some(1) && text.contains("neither a regular file nor a folder"), "{text}");
}

#[test]
fn converting_makes_no_folder_and_no_empty_scene() {
    let place = Place::new("");
    let whole = room(1.0, 0.0);
    std::fs::write(place.path("room.ply"), &whole).unwrap();
    let (code, text) = printed(&place.call(&["convert", "room.ply", "new/room.spz"]));
    assert!(code == Some(1) && text.contains("the folder `new` does not exist"), "{text}");
    assert!(!place.path("new").exists());
    // Every number is NaN.
    let head = whole.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let broken: Vec<u8> = whole[..head].iter().copied().chain(vec![0xff; whole.len() - head]).collect();
    std::fs::write(place.path("broken.ply"), broken).unwrap();
    let (code, text) = printed(&place.call(&["convert", "broken.ply", "a.spz"]));
    assert!(code == Some(1) && text.contains("no splat that can be drawn"), "{text}");
    assert!(
        text.contains("900 of the splats of `broken.ply` had to be dropped because of a field that is NaN"),
        "{text}"
    );
    assert!(!place.path("a.spz").exists());
    // Splats of 1000 units are shortened to 379, which is reported as a warning.
    std::fs::write(place.path("large.ply"), room(1.0, 10.8)).unwrap();
    let (code, text) = printed(&place.call(&["convert", "large.ply", "large.spz", "--up", "+z"]));
    assert!(
        code == Some(0) && text.contains("warning splat axes longer than") && text.contains("(2100 of 2700)"),
        "{text}"
    );
}

/// A picture of a few bytes that claims 400 million pixels is refused from its header. This test fails if
/// `check_memory` counts only the length of the file.
#[test]
fn a_picture_that_claims_more_than_the_memory_is_refused() {
    let place = Place::new("Graph(version: 1, nodes: ())");
    let header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 20000 +X 20000\n";
    std::fs::write(place.path("large.hdr"), header).unwrap();
    let (code, text) = printed(&place.call(&["inspect", "large.hdr", "--memory", "50M"]));
    assert!(code == Some(1) && text.contains("of memory, but the budget is"), "{text}");
}

//! Types of files that contain neither splats nor a mesh, and the kinds of nodes that read these files.

use std::path::Path;

/// First bytes of picture files.
const PICTURES: [&[u8]; 10] = [
    b"#?",
    b"\x76\x2f\x31\x01",
    b"\x89PNG",
    b"\xff\xd8\xff",
    b"RIFF",
    b"\x00\x00\x00\x0cjP",
    b"II*\0",
    b"MM\0*",
    b"II+\0",
    b"MM\0+",
];
/// JSON keys that identify the camera files of splat trainers, nerfstudio and Instant-NGP, which `load-cameras`
/// reads.
const CAMERAS: [&str; 5] = ["\"fx\"", "\"rotation\"", "\"camera_angle_x\"", "\"frames\"", "\"fl_x\""];

/// True if a file that begins with `bytes` is a picture.
pub(super) fn is_picture(bytes: &[u8]) -> bool {
    PICTURES.iter().any(|begin| bytes.starts_with(begin))
}

/// Describes a file that is not a scene, and names the kind or subcommand that reads it. `None` for unknown files.
pub(super) fn other(path: &Path, bytes: &[u8]) -> Option<String> {
    let ends_with = |end: &str| path.extension().is_some_and(|own| own.eq_ignore_ascii_case(end));
    if ends_with("ron") {
        return Some("a graph, which `lightharmony check` and `lightharmony plan` read".into());
    }
    if ends_with("lhb") {
        return Some("a bundle, which `lightharmony verify` and `lightharmony unpack` read".into());
    }
    let text = std::str::from_utf8(bytes).ok()?;
    let opens = text.trim_start().starts_with(['{', '[']);
    if opens && !text.contains("\"asset\"") && CAMERAS.iter().filter(|key| text.contains(**key)).count() >= 2
    {
        return Some("a camera file, which `load-cameras` reads".into());
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_by_what_they_hold() {
        let found = |name: &str, bytes: &[u8]| other(Path::new(name), bytes).unwrap_or_default();
        assert!(is_picture(b"#?RADIANCE\n") && is_picture(b"MM\0*\0\0") && !is_picture(b"ply\n"));
        assert!(found("a.RON", b"Graph(").starts_with("a graph"));
        assert!(found("a.json", br#" [{"id": 0, "rotation": [], "fx": 1.0}]"#).starts_with("a camera file"));
        assert!(found("transforms.json", br#"{"fl_x": 1, "frames": []}"#).starts_with("a camera file"));
        assert_eq!(found("a.gltf", br#"{"asset": {}, "frames": 1, "rotation": 2}"#), "");
        assert_eq!(found("a.ply", b"ply\n"), "");
    }
}

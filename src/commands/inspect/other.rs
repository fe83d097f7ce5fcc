//! Files that are neither splats nor a mesh: their type, and the kinds of nodes that read them.

use std::path::Path;

/// First bytes of picture files, one entry per format.
const PICTURES: [&[u8]; 6] =
    [b"#?", b"\x76\x2f\x31\x01", b"\x89PNG", b"\xff\xd8\xff", b"RIFF", b"\x00\x00\x00\x0cjP"];
/// Keys that identify the camera files that `load-cameras` reads: of trainers, of nerfstudio and of Instant-NGP.
const CAMERAS: [&str; 5] = ["\"fx\"", "\"rotation\"", "\"camera_angle_x\"", "\"frames\"", "\"fl_x\""];

/// True if a file is a picture, by its first bytes.
pub(super) fn is_picture(bytes: &[u8]) -> bool {
    PICTURES.iter().any(|begin| bytes.starts_with(begin))
}

/// Describes a file that is not a scene, and names the kind that reads it; `None` for unknown files.
pub(super) fn other(path: &Path, bytes: &[u8]) -> Option<String> {
    let ends_with = |end: &str| path.extension().is_some_and(|own| own.eq_ignore_ascii_case(end));
    if is_picture(bytes) {
        return Some(
            "a picture, which `load-image` reads; `load-environment` and `load-panorama` read panoramas"
                .into(),
        );
    }
    if ends_with("ron") {
        return Some("a graph, for `lightharmony check` and `lightharmony plan`".into());
    }
    if ends_with("lhb") {
        return Some("a bundle, for `lightharmony verify` and `lightharmony unpack`".into());
    }
    let text = std::str::from_utf8(bytes).ok()?;
    let opens = text.trim_start().starts_with(['{', '[']);
    if opens && !text.contains("\"asset\"") && CAMERAS.iter().filter(|key| text.contains(**key)).count() >= 2
    {
        return Some("a file of cameras, which `load-cameras` reads".into());
    }
    None
}

/// True if a file, by its header, contains a mesh and no splats.
pub(super) fn is_mesh(bytes: &[u8]) -> bool {
    let holds = |what: &[u8]| bytes.windows(what.len()).any(|at| at == what);
    if bytes.starts_with(b"ply") {
        let end = bytes.windows(10).position(|at| at == b"end_header").unwrap_or(bytes.len());
        let head = String::from_utf8_lossy(&bytes[..end]);
        return head.contains("element face") && !head.contains("scale_0");
    }
    // The metadata in a `.sog` has an asset as well.
    let is_text = bytes.trim_ascii_start().starts_with(b"{");
    (bytes.starts_with(b"glTF") || (is_text && holds(b"\"asset\""))) && !holds(b"KHR_gaussian_splatting")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_by_what_they_hold() {
        let found = |name: &str, bytes: &[u8]| other(Path::new(name), bytes).unwrap_or_default();
        assert!(found("a.hdr", b"#?RADIANCE\n").starts_with("a picture"));
        assert!(found("a.RON", b"Graph(").starts_with("a graph"));
        assert!(
            found("a.json", br#" [{"id": 0, "rotation": [], "fx": 1.0}]"#).starts_with("a file of cameras")
        );
        assert!(found("transforms.json", br#"{"fl_x": 1, "frames": []}"#).starts_with("a file of cameras"));
        assert_eq!(found("a.gltf", br#"{"asset": {}, "frames": 1, "rotation": 2}"#), "");
        assert_eq!(found("a.ply", b"ply\n"), "");
    }

    #[test]
    fn headers_distinguish_meshes_from_splats() {
        assert!(is_mesh(b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 0\nend_header\n"));
        assert!(!is_mesh(b"ply\nelement vertex 3\nproperty float scale_0\nelement face 0\nend_header\n"));
        assert!(!is_mesh(b"ply\nelement vertex 3\nend_header\nelement face"));
        assert!(!is_mesh(b"\0\0{\"asset\": {}}"), "a damaged archive");
        assert!(is_mesh(br#"{"asset": {}}"#) && !is_mesh(br#"{"asset": {}, "x": "KHR_gaussian_splatting"}"#));
    }
}

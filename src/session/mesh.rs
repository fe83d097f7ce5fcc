//! Reads a mesh from a file without a graph, for `convert` and `inspect`.

use std::io::Read;
use std::path::Path;
use std::sync::Arc;

use engine::{Context, FileHead, InputFile, Kind, NodeError, Notes};
use nodes::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
use scene::types::Mesh;

/// Maximum length of the header of a PLY file, in bytes.
const PLY_HEADER: u64 = 1 << 16;

/// Reads a mesh of any format that `load-mesh` reads.
pub fn load(path: &Path, frame: MeshFrame, cx: &Context) -> Result<(Mesh, Notes), NodeError> {
    let params = params(InputFile(path.display().to_string()), frame);
    let (out, notes) = LoadMesh::run(&params, load_mesh::In {}, cx)?;
    Ok((Arc::unwrap_or_clone(out.mesh), notes))
}

/// Estimated memory in bytes for reading a mesh.
pub fn estimate(path: InputFile, heads: &[FileHead<'_>]) -> u64 {
    LoadMesh::estimate_files(&params(path, MeshFrame::World), heads).bytes
}

fn params(path: InputFile, frame: MeshFrame) -> LoadMesh {
    LoadMesh { path, colours: ColourEncoding::Auto, frame, matrix: None }
}

/// Name of the format of a mesh, for reports: by the extension for formats without a distinctive start, else by the
/// first bytes.
pub fn format(path: &Path, bytes: &[u8]) -> &'static str {
    match named(path) {
        Some(format) => format,
        None if bytes.starts_with(b"ply") || bytes.starts_with(b"\xef\xbb\xbfply") => "ply",
        None => "gltf",
    }
}

/// Name of the format that the extension of a file states, for formats without a distinctive start.
pub fn named(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_string_lossy().to_ascii_lowercase().as_str() {
        "obj" => Some("obj"),
        "stl" => Some("stl"),
        _ => None,
    }
}

/// True if a file contains a mesh and no splats, judging by its name and header. Returns false if the file cannot
/// be read.
pub fn is_mesh(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let ply = || -> std::io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        engine::open_regular(path)?.take(PLY_HEADER).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    match ending.as_deref() {
        // Neither has a header that identifies it.
        Some("obj" | "stl") => path.is_file(),
        Some("ply") => ply().is_ok_and(|bytes| is_mesh_header(&bytes)),
        // The JSON may name the extensions at any position. The data after it are not read.
        Some("glb" | "gltf") => match scene::io::gltf::json_of(path) {
            Ok(Some((json, true))) => is_mesh_header(&[b"glTF", json.as_slice()].concat()),
            Ok(Some((json, false))) => is_mesh_header(&json),
            _ => false,
        },
        _ => false,
    }
}

/// True if a PLY or glTF file contains a mesh and no splats, judging by its header.
pub fn is_mesh_header(bytes: &[u8]) -> bool {
    let holds = |what: &[u8]| bytes.windows(what.len()).any(|at| at == what);
    if bytes.starts_with(b"ply") {
        let end = bytes.windows(10).position(|at| at == b"end_header").unwrap_or(bytes.len());
        let head = String::from_utf8_lossy(&bytes[..end]);
        return head.contains("element face") && !head.contains("scale_0");
    }
    // The metadata in a `.sog` archive contains the key `asset` as well.
    let is_text = bytes.trim_ascii_start().starts_with(b"{");
    (bytes.starts_with(b"glTF") || (is_text && holds(b"\"asset\""))) && !holds(b"KHR_gaussian_splatting")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{format, is_mesh_header as is_mesh};

    #[test]
    fn formats_of_meshes_are_named() {
        for (name, bytes, wanted) in [
            ("a.STL", &[0; 64][..], "stl"),
            ("a.obj", &b"v 0 0 0\n"[..], "obj"),
            ("a.ply", b"ply\n", "ply"),
            ("a.glb", b"glTF", "gltf"),
            ("a.gltf", b"{}", "gltf"),
        ] {
            assert_eq!(format(Path::new(name), bytes), wanted, "{name}");
        }
    }

    #[test]
    fn meshes_are_distinguished_from_splats() {
        assert!(is_mesh(b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 0\nend_header\n"));
        assert!(!is_mesh(b"ply\nelement vertex 3\nproperty float scale_0\nelement face 0\nend_header\n"));
        assert!(!is_mesh(b"ply\nelement vertex 3\nend_header\nelement face"));
        assert!(!is_mesh(b"\0\0{\"asset\": {}}"), "a damaged archive");
        assert!(is_mesh(br#"{"asset": {}}"#) && !is_mesh(br#"{"asset": {}, "x": "KHR_gaussian_splatting"}"#));
    }
}

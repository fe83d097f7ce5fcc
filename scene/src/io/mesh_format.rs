//! Formats of meshes that the readers of meshes and objects name but do not read.

use crate::error::Error;

use super::foreign::BYTE_ORDER_MARK;

/// The format of a file by its first bytes; `None` if they are not known.
pub(crate) fn by_content(bytes: &[u8]) -> Option<&'static str> {
    let starts: [(&[u8], &str); 10] = [
        (b"Kaydara FBX", "FBX"),
        (b"; FBX", "FBX"),
        (b"BLENDER", "a Blender file"),
        // Blender compresses its files.
        (b"\x28\xb5\x2f\xfd", "a file compressed with Zstandard, such as a Blender file"),
        (b"PXR-USDC", "binary USD"),
        (b"#usda", "USD"),
        (b"Ogawa", "Alembic"),
        (b"DRACO", "Draco"),
        (b"OFF", "OFF"),
        (b"#VRML", "VRML"),
    ];
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes).trim_ascii_start();
    let head = &text[..text.len().min(1024)];
    let mentions = |what: &[u8]| head.windows(what.len()).any(|at| at == what);
    let found = starts.iter().find(|(start, _)| text.starts_with(start)).map(|(_, format)| *format);
    if found.is_some() {
        return found;
    }
    if ["ply\n", "ply\r", "ply "].iter().any(|start| text.starts_with(start.as_bytes())) {
        return Some("PLY");
    }
    if let Some(version) = text.strip_prefix(b"glTF") {
        return Some(if version.starts_with(&[1, 0, 0, 0]) { "glTF 1" } else { "glTF" });
    }
    if text.starts_with(b"{") && mentions(b"\"asset\"") {
        return Some(if mentions(b"\"1.0\"") { "glTF 1" } else { "glTF" });
    }
    if text.starts_with(b"<") && mentions(b"<COLLADA") {
        return Some("COLLADA");
    }
    if text.starts_with(b"<") && (mentions(b"<X3D") || mentions(b"<!DOCTYPE X3D")) {
        return Some("X3D");
    }
    if text.starts_with(b"PK\x03\x04") {
        return Some("a ZIP archive, such as USDZ or 3MF");
    }
    let solid = text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    if solid && (mentions(b"facet") || mentions(b"FACET")) {
        return Some("STL");
    }
    // The chunk of an entire 3DS file, with its length.
    let length = bytes.get(2..6).map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize);
    (bytes.starts_with(b"MM") && length == Some(bytes.len())).then_some("3DS")
}

/// The format of a file by its first bytes or, if these are not known, by its name.
pub fn of(name: &str, bytes: &[u8]) -> Option<&'static str> {
    let endings = [
        (".obj", "Wavefront OBJ"),
        (".fbx", "FBX"),
        (".stl", "STL"),
        (".dae", "COLLADA"),
        (".3ds", "3DS"),
        (".3mf", "3MF"),
        (".usd", "USD"),
        (".usda", "USD"),
        (".usdc", "USD"),
        (".usdz", "USD"),
        (".abc", "Alembic"),
        (".blend", "a Blender file"),
        (".drc", "Draco"),
        (".off", "OFF"),
        (".wrl", "VRML"),
        (".x3d", "X3D"),
        (".dxf", "DXF"),
        (".step", "STEP"),
        (".stp", "STEP"),
        (".max", "3ds Max"),
        (".ma", "Maya"),
        (".mb", "Maya"),
        (".c4d", "Cinema 4D"),
        (".skp", "SketchUp"),
        (".las", "LAS, a point cloud"),
        (".laz", "LAZ, a point cloud"),
        (".e57", "E57, a point cloud"),
        (".pcd", "PCD, a point cloud"),
        (".xyz", "XYZ, a point cloud"),
    ];
    let name = name.to_ascii_lowercase();
    let by_name = || endings.iter().find(|(end, _)| name.ends_with(end)).map(|(_, format)| *format);
    by_content(bytes).or_else(by_name)
}

/// The error about a file in `format` where a reader expects `expected`, with what to do.
pub fn refused(name: &str, format: &str, expected: &str) -> Error {
    let ending = match format {
        "glTF" => Some(".glb` or `.gltf"),
        "STL" => Some(".stl"),
        "Wavefront OBJ" => Some(".obj"),
        _ => None,
    };
    let todo = match ending {
        _ if format == "PLY" => {
            "`LoadMesh` reads a PLY file if its name ends with `.ply`; for an object, export glTF 2.0"
                .to_owned()
        }
        Some(ending) => format!("give the file a name that ends with `{ending}`"),
        None if format.contains("point cloud") => {
            "a point cloud has no faces; make a mesh from the points in a program such as MeshLab, or use `ExtractMesh`"
                .to_owned()
        }
        None => "open the file in a program that reads it, such as Blender, and export glTF 2.0".to_owned(),
    };
    Error::unsupported(name, format!("{format}, where {expected} is expected; {todo}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_known_by_bytes_or_names() {
        for (name, bytes, format) in [
            ("chair.bin", &b"Kaydara FBX Binary  "[..], "FBX"),
            ("chair.bin", b"; FBX 7.3.0 project file", "FBX"),
            ("chair.fbx", b"\0\0", "FBX"),
            ("a.ply", b"BLENDER-v279", "a Blender file"),
            ("a.ply", b"<?xml version=\"1.0\"?>\n<COLLADA xmlns=", "COLLADA"),
            ("a.ply", b"MM\x08\0\0\0ab", "3DS"),
            ("a.ply", b"Ogawa\xff", "Alembic"),
            ("a.ply", b"#usda 1.0", "USD"),
            ("a.ply", b"PXR-USDC\0", "binary USD"),
            ("a.bin", b"glTF\x01\0\0\0", "glTF 1"),
            ("a.bin", b"glTF\x02\0\0\0", "glTF"),
            ("a.bin", b"{\"asset\": {\"version\": \"1.0\"}}", "glTF 1"),
            ("a.bin", b"\xef\xbb\xbf {\"asset\": {}}", "glTF"),
            ("a.bin", b"ply\nformat ascii 1.0", "PLY"),
            ("a.ply", b"SOLID x\nFACET NORMAL 0 0 1", "STL"),
            ("a.E57", b"ASTM-E57", "E57, a point cloud"),
        ] {
            assert_eq!(of(name, bytes), Some(format), "{name}");
        }
        assert_eq!(of("a.ply", b"format ascii 1.0"), None);
        let text = refused("a.fbx", "FBX", "PLY").to_string();
        assert!(text.contains("FBX, where PLY is expected") && text.contains("export glTF 2.0"), "{text}");
        let text = refused("a.bin", "PLY", "glTF").to_string();
        assert!(text.contains("`.ply`"), "{text}");
    }
}

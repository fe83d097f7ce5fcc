//! `load-mesh`: the receiver, a proxy mesh of the captured scene.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
    Up,
};
use glam::DVec3;
use scene::io::foreign::refuse_foreign;
use scene::io::gltf::{self, object};
use scene::io::head;
use scene::io::import::Foreign;
use scene::io::mesh_format;
use scene::io::surface::{RawMesh, clean, from_ply};
use scene::types::frame::{Similarity, world_from_gltf};
use scene::types::{Mesh, Primitive};

engine::choices! {
    /// Encoding of vertex colours.
    pub enum ColourEncoding {
        /// The usual encoding of the format: sRGB in PLY, in OBJ and in all files written by trimesh; linear in
        /// other glTF files.
        Auto,
        /// Display-encoded with the sRGB curve.
        Srgb,
        /// Linear light.
        Linear,
    }
}
engine::choices! {
    /// Frame of reference of a mesh file.
    pub enum MeshFrame {
        /// The frame of the captured scene, in world units. Programs that extract a mesh from a capture use this
        /// frame.
        World,
        /// The frame of glTF, y up and in metres. Coordinates are converted to the world with `up` and
        /// `metres_per_unit` of the scene.
        Gltf,
    }
}
engine::params! {
    /// Loads a triangle mesh: PLY (ASCII or binary), glTF or GLB, Wavefront OBJ, or STL.
    ///
    /// The mesh represents the captured scene: it receives shadows and reflects light. Faces of more than three
    /// corners are split into fans of triangles. Vertex colours become linear albedo. Vertex colours of glTF are
    /// multiplied by `baseColorFactor`, and a PLY file without vertex colours gets the colours of its faces.
    /// Unusable parts (vertices that are not finite, faces without area) are dropped and counted.
    pub struct LoadMesh {
        /// The file: `.ply`, `.glb`, `.gltf`, `.obj` or `.stl`.
        path: InputFile, other("\"b.ply\"");
        /// Encoding of vertex colours.
        colours: ColourEncoding = ColourEncoding::Auto, other("Linear");
        /// Frame of reference of the coordinates.
        frame: MeshFrame = MeshFrame::World, other("Gltf");
        /// Rotation, uniform scale and translation of the mesh, applied after `frame`: a 4x4 matrix in row-major
        /// order, as in `load-splats`.
        matrix: Option<[f64; 16]> = None, other("Some((0.0, -1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))");
    }
}
engine::inputs! {
    /// No inputs.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadMesh`].
    pub struct Out {
        /// The mesh in world units.
        mesh: Arc<Mesh>,
    }
}

impl Kind for LoadMesh {
    const NAME: &'static str = "load-mesh";
    const VERSION: u32 = 9;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        Similarity::of_parameter(p.matrix.as_ref()).map(|_| ())
    }

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        if is_gltf(&p.path) { object::sources(&p.path, root) } else { Ok(vec![root.file(&p.path)]) }
    }

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        let all = files.iter().fold(0, |sum: u64, file| sum.saturating_add(file.bytes));
        let elements =
            files.first().and_then(FileHead::open).map(|mut reader| head::ply_elements(&mut reader));
        let of = |wanted: &str| {
            let found = elements.iter().flatten().find(|(name, ..)| name == wanted);
            found.map_or((0, 0), |(_, count, fields)| (*count, *fields))
        };
        let ((vertices, fields), (faces, face_fields)) = (of("vertex"), of("face"));
        // In f64 when read, then in f32, and a new index per vertex.
        let vertex = if fields > 3 { 2 * 24 + 2 * 12 + 4 } else { 24 + 12 + 4 };
        // Faces with colours may have vertices of their own.
        let face = if fields == 3 && face_fields > 3 { 2 * 12 + 3 * (24 + 24 + 2 * 12 + 4) } else { 2 * 12 };
        let bytes = vertices.saturating_mul(vertex).saturating_add(faces.saturating_mul(face));
        // glTF stores floats and indices directly; it is first read to an object.
        // The text of an OBJ file is read to lists and a table of corners first.
        let foreign = files.first().is_some_and(|file| Foreign::of(file.name).is_some());
        let times = if foreign { 16 } else { 5 };
        let bytes = if vertices == 0 { all.saturating_mul(times) } else { bytes };
        Cost { bytes: all.saturating_add(bytes) }
    }

    fn run(p: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let name = &p.path.0;
        let bytes = cx.read(&p.path).map_err(|e| e.at("path"))?;
        cx.progress(0.2);
        let of_gltf = is_gltf(&p.path);
        let mut raw = if of_gltf {
            from_gltf(p, &bytes, cx, &mut notes)?
        } else {
            refuse_foreign(name, &bytes)?;
            if let Some(format) = mesh_format::of(name, &bytes).filter(|format| *format != "PLY") {
                return Err(mesh_format::refused(name, format, "PLY, glTF, OBJ or STL").into());
            }
            from_ply(name, &bytes, cx, &mut notes)?
        };
        cx.progress(0.7);
        if of_gltf && p.frame == MeshFrame::World && cx.up() != Up::PlusY {
            let text = "the coordinates of the file are used as world coordinates; `frame: Gltf` converts them from glTF, \
                        y up and in metres";
            notes.decision("mesh-frame", text);
        }
        if p.frame == MeshFrame::Gltf {
            let m = world_from_gltf(cx.up(), cx.metres_per_unit());
            for position in &mut raw.positions {
                *position = m.transform_point3(DVec3::from_array(*position)).to_array();
            }
        }
        if p.matrix.is_some() {
            let matrix = Similarity::of_parameter(p.matrix.as_ref())?;
            for position in &mut raw.positions {
                *position = matrix.point(DVec3::from_array(*position)).to_array();
            }
        }
        let srgb = match p.colours {
            ColourEncoding::Auto if !raw.colours.is_empty() => {
                let srgb = !of_gltf || raw.by_trimesh;
                let word = if srgb { "sRGB" } else { "linear" };
                notes.decision("colour-encoding", format!("vertex colours are assumed to be {word}"));
                srgb
            }
            other => other == ColourEncoding::Srgb,
        };
        let mesh = clean(name, raw, srgb, cx, &mut notes)?;
        cx.count("triangles", mesh.triangles.len() as u64);
        Ok((Out { mesh: Arc::new(mesh) }, notes))
    }
}

fn is_gltf(path: &InputFile) -> bool {
    let lower = path.0.to_lowercase();
    lower.ends_with(".glb") || lower.ends_with(".gltf") || Foreign::of(&path.0).is_some()
}

fn from_gltf(p: &LoadMesh, bytes: &[u8], cx: &Context, notes: &mut Notes) -> Result<RawMesh, NodeError> {
    let object = object::object(&p.path, bytes, gltf::Want::Geometry, (None, None), cx, notes)?;
    // Vertex colours of OBJ are display colours, as those of PLY.
    let by_trimesh = Foreign::of(&p.path.0).is_some()
        || gltf::parse(&p.path.0, bytes)?.json["asset"]["generator"].to_string().contains("trimesh");
    let mut raw = RawMesh { by_trimesh, ..RawMesh::default() };
    let coloured = object.primitives.iter().any(|part| !part.colours.is_empty());
    let tint = |part: &Primitive| {
        let factor = object.materials.get(part.material as usize).map_or([1.0; 4], |m| m.base_colour);
        [factor[0], factor[1], factor[2]].map(f64::from)
    };
    // With an ignored texture, the factor alone is not the colour.
    let plain = |part: &Primitive| {
        object.materials.get(part.material as usize).is_none_or(|m| m.base_colour_texture.is_none())
    };
    let tinted = object.primitives.iter().any(|part| tint(part) != [1.0; 3] && (coloured || plain(part)));
    for part in &object.primitives {
        let first = raw.positions.len() as u32;
        raw.positions.extend(part.positions.iter().map(|v| v.map(f64::from)));
        if coloured {
            let white = [1.0; 4];
            let colour = |i| part.colours.get(i).unwrap_or(&white);
            raw.colours.extend((0..part.positions.len()).map(|i| {
                let c = colour(i);
                [c[0], c[1], c[2]].map(f64::from)
            }));
        }
        if tinted {
            raw.tints.resize(raw.positions.len(), tint(part));
        }
        raw.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    }
    if object.materials.iter().any(|m| m.base_colour_texture.is_some()) {
        notes.warning(
            "mesh-textures-ignored",
            "a receiver takes its colours from vertices and `baseColorFactor`; its textures are ignored",
        );
    }
    Ok(raw)
}

#[cfg(test)]
mod tests;

//! `write-mesh`: a mesh as a file.

use std::sync::Arc;

use engine::{Context, ContextField, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::io::mesh::{MeshFormat, encode};
use scene::types::Mesh;

engine::params! {
    /// Writes a mesh as PLY, GLB or OBJ, depending on the extension of the path.
    ///
    /// PLY and OBJ have the coordinates of the world. GLB has the frame of glTF, y up and in metres; `LoadMesh`
    /// reads it with `frame: Gltf`. The gloss of `set-gloss` is not written.
    pub struct WriteMesh {
        /// The file: `.ply`, `.glb` or `.obj`.
        path: OutputFile, other("\"b.obj\"");
    }
}
engine::inputs! {
    /// Inputs of [`WriteMesh`].
    pub struct In {
        /// The mesh.
        mesh: Arc<Mesh>,
    }
}
engine::outputs! {
    /// The written file.
    pub struct Out {
        /// List of one file.
        files: Arc<Files>,
    }
}

impl Kind for WriteMesh {
    const NAME: &'static str = "write-mesh";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.0.contains("{view}") {
            let error = NodeError::new(
                "`{view}` is not allowed here: the mesh is written to a single file for all views",
            )
            .at("path");
            return Err(error.hint("remove `{view}` from `path`"));
        }
        let known = MeshFormat::of_path(&p.path.0).is_some();
        known.then_some(()).ok_or_else(|| {
            NodeError::new(format!("cannot write a mesh as `.{}`", p.path.extension()))
                .at("path")
                .hint("end the path in `.ply`, `.glb` or `.obj`")
        })
    }

    fn run(p: &Self, In { mesh }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(p)?;
        let format = MeshFormat::of_path(&p.path.0).unwrap_or(MeshFormat::Ply);
        let mut notes = Notes::none();
        if !mesh.gloss_of.is_empty() {
            let text = "the file holds no gloss; apply `SetGloss` to the mesh that is read from it";
            notes.warning("gloss-left-out", text);
        }
        let bytes = encode(&mesh, format, Some((cx.up(), cx.metres_per_unit())));
        let file = FileBytes { view: String::new(), bytes };
        Ok((Out { files: Arc::new(Files(vec![file])) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use engine::InputFile;

    use super::*;
    use crate::kinds::load_mesh::{self, ColourEncoding, LoadMesh, MeshFrame};
    use testing::context;

    /// Writes a mesh and reads it back.
    fn read_back(mesh: &Mesh, name: &str) -> Arc<Mesh> {
        let folder = std::env::temp_dir().join(format!("lightharmony-write-mesh-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let path = folder.join(name);
        let params = WriteMesh { path: OutputFile(name.to_owned()) };
        let (out, _) =
            WriteMesh::run(&params, In { mesh: Arc::new(mesh.clone()) }, &context()).expect("writes");
        std::fs::write(&path, &out.files.0[0].bytes).expect("is written");
        let frame = if name.ends_with("glb") { MeshFrame::Gltf } else { MeshFrame::World };
        let params = LoadMesh {
            path: InputFile(path.display().to_string()),
            colours: ColourEncoding::Auto,
            frame,
            matrix: None,
        };
        let read = LoadMesh::run(&params, load_mesh::In {}, &context()).expect("reads").0.mesh;
        std::fs::remove_file(&path).expect("is there");
        read
    }

    // This test fails if the axes of GLB are swapped, or if the colours of PLY are linear.
    #[test]
    fn what_is_written_is_read_back() {
        let plain = Mesh {
            positions: vec![[0.1, 0.2, 0.3], [1.0, 0.0, 0.5], [0.0, 2.0, 0.7], [1.0, 1.0, -1.0]],
            colours: vec![[0.1, 0.5, 0.9], [0.0, 1.0, 0.25], [0.3, 0.3, 0.3], [1.0, 0.0, 0.0]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
            ..Mesh::default()
        };
        let far = Mesh {
            positions: plain.positions.iter().map(|p| [p[0] + 1048576.0, p[1], p[2]]).collect(),
            positions_low: plain.positions.iter().map(|_| [0.001, 0.0, 0.0]).collect(),
            ..plain.clone()
        };
        let bare = Mesh { colours: Vec::new(), ..plain.clone() };
        for mesh in [&plain, &far, &bare] {
            for name in ["a.ply", "a.glb"] {
                let read = read_back(mesh, name);
                assert_eq!(
                    (read.triangles.clone(), read.colours.len()),
                    (mesh.triangles.clone(), mesh.colours.len())
                );
                for i in 0..4 {
                    // `LoadMesh` reads glTF in f32: a million metres from the origin its steps are 62 mm.
                    let most = if name == "a.glb" && !mesh.positions_low.is_empty() { 0.07 } else { 1e-6 };
                    assert!((read.position(i) - mesh.position(i)).length() < most, "{name} {i}");
                }
                for (a, b) in read.colours.iter().zip(&mesh.colours) {
                    assert!((0..3).all(|c| (a[c] - b[c]).abs() < 5e-3), "{name} {a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn obj_holds_one_line_a_vertex_and_a_triangle() {
        let mesh = Mesh {
            positions: vec![[0.1, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            colours: vec![[0.0; 3], [1.0; 3], [0.0; 3]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let text = String::from_utf8(encode(&mesh, MeshFormat::Obj, None)).expect("is text");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 4);
        assert_eq!(lines[1], "v 1 0 0 1.00000 1.00000 1.00000");
        assert_eq!(lines[3], "f 1 2 3");
    }

    #[test]
    fn other_endings_are_refused() {
        for path in ["a.stl", "a", "a_{view}.ply"] {
            assert!(WriteMesh::check(&WriteMesh { path: OutputFile(path.to_owned()) }).is_err(), "{path}");
        }
    }
}

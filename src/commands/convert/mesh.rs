//! The part of `convert` that writes meshes.

use std::io::Write;
use std::path::Path;

use engine::{NodeError, Notes, Up};
use nodes::kinds::load_mesh::MeshFrame;
use scene::io::mesh::{MeshFormat, encode};
use scene::types::Mesh;

use super::{Convert, check_output};
use crate::session::{Error, mesh, splats};
use crate::terminal;

impl Convert {
    /// Writes the mesh of the input. Returns exit code 0, 1 if a file cannot be read or written, or 2 if the
    /// arguments do not fit a mesh.
    pub(super) fn write_mesh(&self, memory: u64) -> Result<u8, Error> {
        let Some(format) = MeshFormat::of_path(&self.output.to_string_lossy()) else {
            let output = self.output.display();
            terminal::error(&format!("`{output}`: the extension for a mesh must be .ply, .glb or .obj"));
            return Ok(2);
        };
        if self.spz4 {
            terminal::error("`--spz4` requires an output file that ends in .spz");
            return Ok(2);
        }
        let (bytes, mesh, notes) = match self.encoded(format, memory) {
            Ok(encoded) => encoded,
            Err(error) => return Ok(splats::failed(&error)),
        };
        if let Err(error) = cache::publish_file(&self.output, &bytes) {
            terminal::error(&error.to_string());
            return Ok(1);
        }
        std::io::stderr().lock().write_all(splats::lines(&notes).as_bytes())?;
        let (name, count) = (self.output.display(), mesh.triangles.len());
        terminal::print(&format!("wrote {name} (triangles: {count}, bytes: {})\n", bytes.len()))?;
        Ok(0)
    }

    fn encoded(&self, format: MeshFormat, memory: u64) -> Result<(Vec<u8>, Mesh, Notes), NodeError> {
        splats::check_memory(&self.input, memory)?;
        check_output(&self.input, &self.output)?;
        // glTF has +y up. Other formats do not define an up axis, so the mesh is rotated only if `--up` was given.
        let up: Option<Up> = self.up.map(Into::into).filter(|_| !self.as_stored);
        let frame = if up.is_some() && is_gltf(&self.input) { MeshFrame::Gltf } else { MeshFrame::World };
        let cx = splats::context(up.unwrap_or(Up::PlusY));
        let (mesh, notes) = mesh::load(&self.input, frame, &cx)?;
        if mesh.triangles.is_empty() {
            let what = format!("`{}` is a mesh that has no faces", self.input.display());
            return Err(NodeError::new(format!("{what}\n{}", splats::lines(&notes).trim_end())));
        }
        Ok((encode(&mesh, format, up.map(|up| (up, 1.0))), mesh, notes))
    }
}

fn is_gltf(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    matches!(ending.as_deref(), Some("glb" | "gltf"))
}

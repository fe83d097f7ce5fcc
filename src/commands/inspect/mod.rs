//! `inspect`: prints the properties of a scene of splats, a mesh or a picture.

mod answer;
mod other;
mod person;
mod picture;

use std::path::PathBuf;

use clap::Args;
use engine::{NodeError, Notes, Up};
use nodes::kinds::load_mesh::MeshFrame;
use render::geometry::inspect::mesh;
use render::geometry::inspect::splats::inspect as splats_of;
use scene::io::splats::{Format, StatedUp};

use crate::session::Error;
use crate::session::look;
use crate::session::mesh as mesh_file;
use crate::session::splats::{self, MemoryArgs};
use crate::terminal;
use answer::Answer;

/// Prints the properties of a scene of splats, a mesh or a picture: size, up axis, floor, brightness, and probable
/// mistakes.
#[derive(Debug, Args)]
pub struct Inspect {
    /// A file or folder of splats (PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF, .usda), a mesh (PLY, glTF,
    /// OBJ, STL), or a picture or panorama (PNG, JPEG, OpenEXR, Radiance HDR)
    file: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
    /// Write a picture (PNG) with a plan of the scene, a grid, and views; the cameras of the views are printed
    #[arg(long, value_name = "PNG")]
    picture: Option<PathBuf>,
    /// The cameras of the capture, which indicate the up direction and good views
    #[arg(long, requires = "picture")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    memory: MemoryArgs,
}

impl Inspect {
    /// Prints the properties. Returns exit code 0, or 1 if the file cannot be read.
    pub fn run(self) -> Result<u8, Error> {
        let memory = self.memory.bytes()?;
        if let Err(error) = splats::check(&self.file).and_then(|()| splats::check_memory(&self.file, memory))
        {
            return Ok(splats::failed(&error));
        }
        let cx = splats::context(Up::PlusY);
        // A folder is a SOG scene, which defines no axes.
        let bytes = std::fs::read(&self.file).unwrap_or_default();
        let (format, stated) = (Format::of("", &bytes).ok(), StatedUp::of(&bytes));
        let mut answer = Answer {
            file: self.file.display().to_string(),
            holds: "splats",
            format: format.map_or(Some("sog"), |format| Some(format.name())),
            declared_up: stated.map(|up| up.axis.name()),
            is_up_comment: stated.is_some_and(|up| !up.by_format),
            scene: None,
            mesh: None,
            picture: None,
            notes: &Notes::none(),
        };
        let name = self.file.display().to_string();
        let unread = match picture::inspect(&name, &bytes) {
            Ok(found) => {
                (answer.holds, answer.format, answer.picture) = ("picture", None, Some(&found));
                self.print(&answer)?;
                return self.draw(|| look::of_panorama(&self.file, &bytes));
            }
            Err(unread) => unread,
        };
        let of_mesh = mesh_file::format(&self.file, &bytes);
        // The loaders read the file again.
        drop(bytes);
        // The bytes of an OBJ or STL file may pass for those of splats.
        let inspected = match mesh_file::named(&self.file) {
            Some(_) => Err(NodeError::new("a mesh")),
            None => splats::load_plain(&self.file, &cx)
                .and_then(|(scene, degree, notes)| Ok((splats_of(&scene, degree, &cx)?, notes))),
        };
        let failed = match inspected {
            Ok((scene, notes)) => {
                // `inspect` reads coordinates as stored, so this note about graphs does not apply.
                let notes = notes.iter().filter(|note| note.id != "frame").cloned().collect();
                (answer.scene, answer.notes) = (Some(&scene), &notes);
                self.print(&answer)?;
                return self.draw(|| look::of_splats(&self.file, self.cameras.as_deref()));
            }
            Err(failed) => failed,
        };
        // PLY, glTF and GLB hold splats or a mesh; if a file can be read as neither, the error is for the more
        // likely of the two.
        let is_mesh = mesh_file::is_mesh(&self.file);
        match mesh_file::load(&self.file, MeshFrame::World, &cx) {
            Ok((found, notes)) if !found.triangles.is_empty() => {
                let inspected = mesh::inspect(&found);
                (answer.holds, answer.mesh, answer.notes) = ("mesh", Some(&inspected), &notes);
                let declared = (of_mesh == "gltf").then_some(Up::PlusY);
                (answer.format, answer.declared_up) = (Some(of_mesh), declared.map(Up::name));
                answer.is_up_comment = false;
                self.print(&answer)?;
                return self.draw(|| look::of_mesh(&found, declared));
            }
            Err(of_mesh) if is_mesh => return Ok(splats::failed(&of_mesh)),
            _ => {}
        }
        let bytes = std::fs::read(&self.file).unwrap_or_default();
        let failed = match other::other(&self.file, &bytes) {
            _ if other::is_picture(&bytes) => unread.into(),
            Some(what) => NodeError::new(format!("`{name}` holds neither splats nor a mesh; it is {what}")),
            None if is_mesh => NodeError::new(format!("`{name}` is a mesh that has no faces")),
            None => failed,
        };
        Ok(splats::failed(&failed))
    }

    /// Writes the picture, if one is requested, and prints the lines that describe it.
    fn draw(&self, make: impl FnOnce() -> Result<(Vec<u8>, String), NodeError>) -> Result<u8, Error> {
        let Some(path) = &self.picture else { return Ok(0) };
        let (png, lines) = match make() {
            Ok(made) => made,
            Err(error) => return Ok(splats::failed(&error)),
        };
        cache::publish_file(path, &png)?;
        if !self.json {
            terminal::print(&format!("{:>14}  {}\n{lines}", "picture", path.display()))?;
        }
        Ok(0)
    }

    fn print(&self, answer: &Answer<'_>) -> Result<u8, Error> {
        let text = if self.json {
            let json = serde_json::to_string(answer).map_err(std::io::Error::from)?;
            format!("{json}\n")
        } else {
            person::person(answer)
        };
        terminal::print(&text)?;
        Ok(0)
    }
}

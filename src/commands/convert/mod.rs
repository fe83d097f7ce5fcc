//! `convert`: writes a scene of splats, or a mesh, in another format.

mod mesh;

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use engine::{Context, NodeError, Notes, ReadFiles, Up};
use scene::io::splats::Frame;
use scene::io::splats::save::{SaveFormat, encode};
use scene::types::Splats;

use crate::session::Error;
use crate::session::mesh::is_mesh;
use crate::session::splats::{self, MemoryArgs, UpArg};
use crate::terminal;

/// Writes a scene of splats, or a mesh, in another format.
#[derive(Debug, Args)]
pub struct Convert {
    /// A file or folder of splats (PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF, .usda), or a mesh (PLY,
    /// glTF, GLB, OBJ, STL)
    input: PathBuf,
    /// The file to write. Its extension selects the format: .ply (INRIA) or .spz for splats; .ply, .glb or .obj for
    /// a mesh
    output: PathBuf,
    /// The up axis of files whose format does not define one, such as PLY. SPZ and glTF have +y up, so a scene is
    /// rotated when it is converted from or to them [default: the axis that a comment of the file states, else -y,
    /// which most INRIA files have]
    #[arg(long, value_enum, allow_hyphen_values = true)]
    up: Option<UpArg>,
    /// Keep the coordinates as stored, even if the formats define different up axes
    #[arg(long, conflicts_with = "up")]
    as_stored: bool,
    /// Write SPZ version 4. The default is version 3, which all readers of SPZ support; it is version 4 if the
    /// scene has harmonics of degree 4
    #[arg(long)]
    spz4: bool,
    #[command(flatten)]
    memory: MemoryArgs,
}

impl Convert {
    /// Converts the scene. Returns exit code 0, or 1 if a file cannot be read or written.
    pub fn run(self) -> Result<u8, Error> {
        let memory = self.memory.bytes()?;
        if is_mesh(&self.input) {
            return self.write_mesh(memory);
        }
        let Some(format) = SaveFormat::of_path(&self.output.to_string_lossy()) else {
            terminal::error(&format!(
                "`{}`: the extension for splats must be .ply or .spz",
                self.output.display()
            ));
            return Ok(2);
        };
        let format = match (format, self.spz4) {
            (SaveFormat::Ply, true) => {
                terminal::error("`--spz4` requires an output file that ends in .spz");
                return Ok(2);
            }
            (_, true) => SaveFormat::Spz4,
            (format, false) => format,
        };
        let commented = splats::commented_up(&self.input);
        let up = self.up.map(Up::from).or(commented).unwrap_or(Up::MinusY);
        let cx = splats::context(up);
        let frame = if self.as_stored { Frame::AsStored } else { Frame::ByFormat };
        let convert = || {
            splats::check(&self.input)?;
            splats::check_memory(&self.input, memory)?;
            check_output(&self.input, &self.output)?;
            let (scene, notes) = splats::load(&self.input, frame, &cx)?;
            if scene.is_empty() {
                let what = format!("`{}` has no splat that can be drawn", self.input.display());
                return Err(NodeError::new(format!("{what}\n{}", splats::lines(&notes).trim_end())));
            }
            let (bytes, mut lost) = encode(&scene, format, (!self.as_stored).then_some(up), &cx)?;
            // The up axis is the default, and it changes the output.
            let ours = self.up.is_none() && !notes.iter().any(|note| note.id == "frame");
            if let Some(other) = commented.filter(|other| !self.as_stored && *other != up) {
                let (name, other, up) = (self.input.display(), other.name(), up.name());
                let text = format!("`--up` is {up}, but a comment of `{name}` says that {other} is up");
                lost.warning("up-unlikely", text);
            }
            if ours && lost.iter().any(|note| note.id == "frame") {
                warn_of_floor(&scene, up, &mut lost, &cx)?;
            }
            Ok((scene.len(), bytes, notes, lost))
        };
        let converted: Result<_, NodeError> = convert();
        let (count, bytes, notes, lost) = match converted {
            Ok(converted) => converted,
            Err(error) => return Ok(splats::failed(&error)),
        };
        if let Err(error) = cache::publish_file(&self.output, &bytes) {
            terminal::error(&error.to_string());
            return Ok(1);
        }
        let text = format!("{}{}", splats::lines(&notes), splats::lines(&lost));
        std::io::stderr().lock().write_all(text.as_bytes())?;
        terminal::print(&format!(
            "wrote {} (splats: {count}, bytes: {})\n",
            self.output.display(),
            bytes.len()
        ))?;
        Ok(0)
    }
}

/// Returns an error if the output is the input, or if its folder does not exist. As with `cp`, a typing mistake
/// must not create a folder.
fn check_output(input: &Path, output: &Path) -> Result<(), NodeError> {
    if ReadFiles::new([input.to_owned()]).has(output) {
        return Err(NodeError::new(format!(
            "the output `{}` is the same file as the input",
            output.display()
        ))
        .hint("choose another output file"));
    }
    let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty());
    let Some(folder) = folder.filter(|folder| !folder.is_dir()) else { return Ok(()) };
    let what =
        format!("cannot write `{}`: the folder `{}` does not exist", output.display(), folder.display());
    Err(NodeError::new(what).hint("create it first"))
}

/// Warns if the floor of a scene indicates an up axis that differs from the assumed up axis.
fn warn_of_floor(scene: &Splats, up: Up, notes: &mut Notes, cx: &Context) -> Result<(), NodeError> {
    cx.check()?;
    let level = render::geometry::level::of_splats(scene, None).filter(|level| level.is_sure());
    let [_, _, axis] = scene::math::equirect::axes(up);
    // 20 degrees, because a capture may be tilted a little.
    if let Some(level) = level.filter(|level| glam::DVec3::from_array(level.up).dot(axis) < 0.94) {
        let measured = level.axis().map_or_else(
            || {
                let [x, y, z] = level.up;
                format!("({x:.3}, {y:.3}, {z:.3})")
            },
            str::to_owned,
        );
        let text = format!(
            "{} was assumed to be up, but the floor of the scene indicates {measured}; set the axis with `--up`",
            up.name(),
        );
        notes.warning("up-unlikely", text);
    }
    Ok(())
}

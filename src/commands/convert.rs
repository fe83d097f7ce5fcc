//! `convert`: a scene of splats in another format.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use nodes::load_splats::Frame;
use nodes::save_splats::{SaveFormat, encode};

use super::splats::{self, UpArg};
use crate::report;
use crate::session::Error;

/// Writes a scene of splats in another format.
#[derive(Debug, Args)]
pub struct Convert {
    /// A file or folder of splats: PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF
    input: PathBuf,
    /// The file to write; its ending names the format: .ply (INRIA) or .spz (version 3)
    output: PathBuf,
    /// Up in the PLY: SPZ and glTF have +y up and are turned between it and this axis
    #[arg(long, value_enum, default_value = "-y", allow_hyphen_values = true)]
    up: UpArg,
    /// Turn nothing, whatever the formats say
    #[arg(long)]
    as_stored: bool,
}

impl Convert {
    /// Exit code 0, or 1 where the file cannot be read or written.
    pub fn run(self) -> Result<u8, Error> {
        let Some(format) = SaveFormat::of_path(&self.output.to_string_lossy()) else {
            report::error(&format!("`{}`: the ending must be .ply or .spz", self.output.display()));
            return Ok(2);
        };
        let up = self.up.into();
        let cx = splats::context(up);
        let frame = if self.as_stored { Frame::AsStored } else { Frame::ByFormat };
        let converted = splats::load(&self.input, frame, &cx).and_then(|(scene, notes)| {
            let (bytes, lost) = encode(&scene, format, (!self.as_stored).then_some(up), &cx)?;
            Ok((scene.len(), bytes, notes, lost))
        });
        let (count, bytes, notes, lost) = match converted {
            Ok(converted) => converted,
            Err(error) => return Ok(splats::failed(&error)),
        };
        if let Err(error) = cache::publish_file(&self.output, &bytes) {
            report::error(&error.to_string());
            return Ok(1);
        }
        let text = format!("{}{}", splats::lines(&notes), splats::lines(&lost));
        std::io::stderr().lock().write_all(text.as_bytes())?;
        super::print(&format!("{}: {count} splats, {} bytes\n", self.output.display(), bytes.len()))?;
        Ok(0)
    }
}

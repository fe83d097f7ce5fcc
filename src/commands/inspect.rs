//! `inspect`: what a scene of splats is like.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::Args;
use engine::{Notes, Up};
use nodes::inspect_splats::{Extent, Inspection, inspect};
use nodes::load_splats::{Format, Frame};
use serde::Serialize;

use super::splats;
use crate::session::Error;

/// Tells what a scene of splats is like.
#[derive(Debug, Args)]
pub struct Inspect {
    /// A file or folder of splats: PLY, compressed PLY, SOG, SPZ, .splat, .ksplat, glTF
    file: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// The answer, as JSON has it.
#[derive(Serialize)]
struct Answer<'a> {
    file: String,
    format: Option<&'static str>,
    /// Up by the format, where it says so; coordinates below are as stored all the same.
    declared_up: Option<&'static str>,
    #[serde(flatten)]
    scene: &'a Inspection,
    notes: &'a Notes,
}

impl Inspect {
    /// Exit code 0, or 1 where the file cannot be read.
    pub fn run(self) -> Result<u8, Error> {
        let cx = splats::context(Up::PlusY);
        // A folder is a SOG scene, which says nothing about axes.
        let format = std::fs::read(&self.file).ok().and_then(|bytes| Format::of("", &bytes).ok());
        let inspected = splats::load(&self.file, Frame::AsStored, &cx)
            .and_then(|(scene, notes)| Ok((inspect(&scene, &cx)?, notes)));
        let (scene, notes) = match inspected {
            Ok(inspected) => inspected,
            Err(error) => return Ok(splats::failed(&error)),
        };
        let answer = Answer {
            file: self.file.display().to_string(),
            format: format.map_or(Some("sog"), |format| Some(format.name())),
            declared_up: format.and_then(Format::declared_up).map(Up::name),
            scene: &scene,
            notes: &notes,
        };
        let text = if self.json {
            let json = serde_json::to_string(&answer).map_err(std::io::Error::from)?;
            format!("{json}\n")
        } else {
            person(&answer)
        };
        super::print(&text)?;
        Ok(0)
    }
}

fn vector(v: [f64; 3]) -> String {
    format!("({:.3}, {:.3}, {:.3})", v[0], v[1], v[2])
}

fn extent(extent: &Extent) -> String {
    format!("{} to {}, {:.3} across", vector(extent.min), vector(extent.max), extent.diagonal())
}

fn person(answer: &Answer<'_>) -> String {
    let scene = answer.scene;
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{name:>14}  {value}");
    };
    line("file", format!("{} ({})", answer.file, answer.format.unwrap_or("unknown")));
    line("splats", scene.splats.to_string());
    let trained = if scene.antialiased { ", trained antialiased" } else { "" };
    line(
        "colours",
        format!("spherical harmonics of degree {}, {}{trained}", scene.sh_degree, scene.encoding),
    );
    if let (Some(bounds), Some(core), Some(centre)) = (&scene.bounds, &scene.core, scene.centre) {
        line("bounds", extent(bounds));
        line("core (96 %)", extent(core));
        line("median", vector(centre));
    }
    if let Some(up) = answer.declared_up {
        line("up", format!("{up} by its format"));
    }
    match &scene.floor {
        Some(floor) => {
            let (axis, sign) = (&floor.up[1..], if floor.up.starts_with('-') { -1.0 } else { 1.0 });
            line(
                "up, guessed",
                format!(
                    "{} with confidence {:.2} (next: {}); floor at {axis} = {:.3}, {:.0} % of the surface lies flat in it",
                    floor.up,
                    floor.confidence,
                    floor.second,
                    floor.height * sign,
                    floor.share * 100.0
                ),
            );
        }
        None => line("up, guessed", "no floor found".to_owned()),
    }
    if let Some(sizes) = &scene.sizes {
        line(
            "sizes",
            format!(
                "median {:.2e}, 99 % below {:.2e}, largest {:.2e}; {:.0} % flat, {:.1} % needles",
                sizes.median_longest,
                sizes.p99_longest,
                sizes.longest,
                sizes.flat * 100.0,
                sizes.needles * 100.0
            ),
        );
    }
    if let Some(opacities) = &scene.opacities {
        line(
            "opacities",
            format!(
                "median {:.3}, {:.0} % above 0.95, {:.0} % never drawn",
                opacities.median,
                opacities.opaque * 100.0,
                opacities.unseen * 100.0
            ),
        );
    }
    if let Some(overdraw) = &scene.overdraw {
        line(
            "overdraw",
            format!(
                "about {:.0} splats a pixel from inside, {:.0} from outside, were none hidden",
                overdraw.from_inside, overdraw.from_outside
            ),
        );
    }
    for finding in &scene.findings {
        line("look at this", format!("{} [{}]", finding.text, finding.id));
    }
    text.push_str(&splats::lines(answer.notes));
    text
}

//! What `inspect` found, for a person to read.

use std::fmt::Write as _;

use nodes::inspect::{Extent, Finding, FloorGuess, mesh, splats::Inspection};

use super::Answer;
use crate::commands::splats;

fn vector(v: [f64; 3]) -> String {
    format!("({:.3}, {:.3}, {:.3})", v[0], v[1], v[2])
}

fn extent(extent: &Extent) -> String {
    format!("{} to {}, {:.3} across", vector(extent.min), vector(extent.max), extent.diagonal())
}

/// Lines of a name and a value.
struct Lines(String);

impl Lines {
    fn line(&mut self, name: &str, value: String) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{name:>14}  {value}");
    }

    fn floor(&mut self, floor: Option<&FloorGuess>) {
        let Some(floor) = floor else { return self.line("up, guessed", "no floor found".to_owned()) };
        let (axis, sign) = (&floor.up[1..], if floor.up.starts_with('-') { -1.0 } else { 1.0 });
        self.line(
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

    fn findings(&mut self, findings: &[Finding]) {
        for finding in findings {
            self.line("look at this", format!("{} [{}]", finding.text, finding.id));
        }
    }
}

/// All of it.
pub fn person(answer: &Answer<'_>) -> String {
    let mut text = Lines(String::new());
    text.line("file", format!("{} ({})", answer.file, answer.format.unwrap_or("unknown")));
    match (answer.scene, answer.mesh) {
        (Some(scene), _) => of_splats(&mut text, scene, answer.declared_up),
        (None, Some(mesh)) => of_mesh(&mut text, mesh, answer.declared_up),
        (None, None) => {}
    }
    text.0 + &splats::lines(answer.notes)
}

fn of_mesh(text: &mut Lines, mesh: &mesh::Inspection, declared_up: Option<&str>) {
    text.line("mesh", format!("{} triangles, {} vertices", mesh.triangles, mesh.vertices));
    text.line("colours", if mesh.coloured { "of the vertices" } else { "none" }.to_owned());
    if let Some(bounds) = &mesh.bounds {
        text.line("bounds", extent(bounds));
    }
    text.line("area", format!("{:.3} square units", mesh.area));
    text.line(
        "closed",
        if mesh.is_closed() {
            "yes: every edge has two triangles that agree".to_owned()
        } else {
            format!("no: {} open edges, {} odd ones", mesh.open_edges, mesh.odd_edges)
        },
    );
    if let Some(up) = declared_up {
        text.line("up", format!("{up} by its format"));
    }
    text.floor(mesh.floor.as_ref());
    text.findings(&mesh.findings);
}

fn of_splats(text: &mut Lines, scene: &Inspection, declared_up: Option<&str>) {
    text.line("splats", scene.splats.to_string());
    let trained = if scene.antialiased { ", trained antialiased" } else { "" };
    text.line(
        "colours",
        format!("spherical harmonics of degree {}, {}{trained}", scene.sh_degree, scene.encoding),
    );
    if let (Some(bounds), Some(core), Some(centre)) = (&scene.bounds, &scene.core, scene.centre) {
        text.line("bounds", extent(bounds));
        text.line("core (96 %)", extent(core));
        text.line("median", vector(centre));
    }
    if let Some(up) = declared_up {
        text.line("up", format!("{up} by its format"));
    }
    text.floor(scene.floor.as_ref());
    if let Some(sizes) = &scene.sizes {
        text.line(
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
        text.line(
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
        text.line(
            "overdraw",
            format!(
                "about {:.0} splats a pixel from inside, {:.0} from outside, were none hidden",
                overdraw.from_inside, overdraw.from_outside
            ),
        );
    }
    text.findings(&scene.findings);
}

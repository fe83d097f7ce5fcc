//! The output of `inspect` as text.

use std::fmt::Write as _;

use render::geometry::inspect::{Extent, Finding, FloorGuess, mesh, splats::Inspection};
use render::geometry::level::LevelEstimate;

use super::answer::Answer;
use super::picture;
use crate::session::splats;

/// Formats lengths with the number of digits that the size of the scene needs.
#[derive(Clone, Copy)]
struct Ruler {
    /// Digits after the decimal point; `None` for scientific notation.
    digits: Option<usize>,
}

impl Ruler {
    /// Chooses the number of digits for lengths in a scene of this size: at least three after the decimal point,
    /// and enough to show four significant digits of `size`.
    fn of(size: f64) -> Self {
        let (mut digits, mut scaled) = (0, size);
        while (0.0..1000.0).contains(&scaled) && digits < 10 {
            (digits, scaled) = (digits + 1, scaled * 10.0);
        }
        // For larger or smaller sizes zeros would hide the number.
        let plain = size == 0.0 || (digits < 10 && size < 1e9);
        Self { digits: plain.then_some(if size == 0.0 { 3 } else { digits.max(3) }) }
    }

    fn length(self, v: f64) -> String {
        match self.digits {
            Some(digits) => format!("{v:.digits$}"),
            None => format!("{v:.3e}"),
        }
    }

    fn vector(self, v: [f64; 3]) -> String {
        format!("({})", v.map(|c| self.length(c)).join(", "))
    }

    fn extent(self, extent: &Extent) -> String {
        let (min, max) = (self.vector(extent.min), self.vector(extent.max));
        format!("{min} to {max}, diagonal {}", self.length(extent.diagonal()))
    }
}

/// Lines of text, each with a name and a value.
struct Lines(String);

impl Lines {
    fn line(&mut self, name: &str, value: String) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{name:>14}  {value}");
    }

    fn floor(&mut self, floor: Option<&FloorGuess>, ruler: Ruler) {
        let Some(floor) = floor else {
            return self.line(
                "up, guessed",
                "not found: no plane contains more of the surface area than expected by chance".to_owned(),
            );
        };
        let (axis, sign) = (&floor.up[1..], if floor.up.starts_with('-') { -1.0 } else { 1.0 });
        self.line(
            "up, guessed",
            format!(
                "{}{} with confidence {:.2} (second best: {}); floor at {axis} = {}, which contains {:.0} % of the surface area",
                if floor.is_clear() { "" } else { "not clear: " },
                floor.up,
                floor.confidence,
                floor.second,
                ruler.length(floor.height * sign),
                floor.share * 100.0
            ),
        );
    }

    fn level(&mut self, level: Option<&LevelEstimate>, ruler: Ruler) {
        let Some(level) = level else { return self.line("up, measured", "not found".to_owned()) };
        let [x, y, z] = level.up;
        let up = level.axis().map_or_else(|| format!("({x:.4}, {y:.4}, {z:.4})"), str::to_owned);
        let sure = if level.is_sure() { "sure" } else { "not sure" };
        self.line("up, measured", format!("{up}, {sure} (confidence {:.2})", level.confidence));
        let ceiling = level.ceiling.map_or_else(String::new, |c| {
            format!(", ceiling {} above the floor", ruler.length(c - level.floor))
        });
        let sure = if level.is_floor_sure() { "sure" } else { "not sure" };
        // Below the middle of the scene, since the measured direction may differ a little from the axis that it names.
        let floor = match level.axis().and_then(|axis| axis.chars().nth(1)) {
            Some(axis) => {
                let coordinate = level.floor_point()["xyz".find(axis).unwrap_or_default()];
                format!("{axis} = {}", ruler.length(coordinate))
            }
            None => format!("{} along the up axis", ruler.length(level.floor)),
        };
        let confidence = level.floor_confidence;
        self.line("floor", format!("{floor}{ceiling}, {sure} (confidence {confidence:.2})"));
        let scale = &level.scale;
        let metres = scale.metres_per_unit.map_or_else(
            || format!("not known: {}", scale.reason),
            |m| format!("{m:.3} m per unit (confidence {:.2}): {}", scale.confidence, scale.reason),
        );
        self.line("scale", metres);
    }

    fn findings(&mut self, findings: &[Finding]) {
        for finding in findings {
            self.line("check", format!("{} [{}]", finding.text, finding.id));
        }
    }
}

/// Formats the answer as text.
pub fn person(answer: &Answer<'_>) -> String {
    let mut text = Lines(String::new());
    let format = answer.format.map(|format| format!(" ({format})")).unwrap_or_default();
    text.line("file", format!("{}{format}", answer.file));
    if let Some(picture) = answer.picture {
        of_picture(&mut text, picture);
    }
    match (answer.scene, answer.mesh) {
        (Some(scene), _) => of_splats(&mut text, scene, answer),
        (None, Some(mesh)) => of_mesh(&mut text, mesh, answer.declared_up),
        (None, None) => {}
    }
    text.0 + &splats::lines(answer.notes)
}

fn of_picture(text: &mut Lines, picture: &picture::Inspection) {
    let picture::Inspection { width, height, channels, encoding, peak, mean } = picture;
    text.line("picture", format!("{width}x{height} pixels, channels: {channels}, {encoding}"));
    if let Some(peak) = peak {
        let place = format!("at pixel ({}, {})", peak.x, peak.y);
        text.line("brightest", format!("{}, {place}", picture::brightness(peak.luminance)));
    }
    if let Some(mean) = mean {
        text.line("mean", picture::brightness(*mean));
    }
    let kinds = if *width == 2 * height { "`load-environment`, `load-panorama`" } else { "`load-image`" };
    text.line("read by", kinds.to_owned());
}

/// Size in metres from which an object may be in centimetres.
const LARGE: f64 = 20.0;

fn of_mesh(text: &mut Lines, mesh: &mesh::Inspection, declared_up: Option<&str>) {
    text.line("mesh", format!("triangles: {}, vertices: {}", mesh.triangles, mesh.vertices));
    text.line("colours", if mesh.coloured { "per vertex" } else { "none" }.to_owned());
    let ruler = Ruler::of(mesh.bounds.map_or(0.0, |bounds| bounds.diagonal()));
    if let Some(bounds) = &mesh.bounds {
        text.line("bounds", ruler.extent(bounds));
        if declared_up.is_some() {
            let [x, y, z] = [0, 1, 2].map(|k| bounds.max[k] - bounds.min[k]);
            let cm = if x.max(y).max(z) < LARGE {
                ""
            } else {
                "; if it is in centimetres, pose it with `scale: 0.01`"
            };
            text.line(
                "size",
                format!("{x:.3} x {y:.3} x {z:.3} m as an object, since glTF is in metres{cm}"),
            );
        }
    }
    text.line("area", format!("{} square units", Ruler::of(mesh.area).length(mesh.area)));
    text.line(
        "closed",
        if mesh.is_closed() {
            "yes (every edge is shared by two consistently oriented triangles)".to_owned()
        } else {
            format!(
                "no (open edges: {}, edges with more than two triangles or with inconsistent orientation: {})",
                mesh.open_edges, mesh.odd_edges
            )
        },
    );
    if let Some(up) = declared_up {
        text.line(
            "up",
            format!(
                "{up}, defined by the file format; `LoadMesh` rotates the mesh to the up axis of the graph if `frame: Gltf` is set"
            ),
        );
    }
    text.floor(mesh.floor.as_ref(), ruler);
    text.findings(&mesh.findings);
}

fn of_splats(text: &mut Lines, scene: &Inspection, answer: &Answer<'_>) {
    text.line("splats", scene.splats.to_string());
    let trained = if scene.antialiased { ", trained with antialiasing" } else { "" };
    text.line(
        "colours",
        format!("spherical harmonics of degree {}, {}{trained}", scene.sh_degree, scene.encoding),
    );
    let ruler = Ruler::of(scene.core.map_or(0.0, |core| core.diagonal()));
    if let (Some(bounds), Some(core), Some(centre)) = (&scene.bounds, &scene.core, scene.centre) {
        text.line("bounds", ruler.extent(bounds));
        text.line("central 96 %", ruler.extent(core));
        text.line("median", ruler.vector(centre));
    }
    match answer.declared_up {
        Some(up) if answer.is_up_comment => {
            let used = "`LoadSplats` uses the coordinates as stored, so set `up` of the graph's scene to it";
            text.line("up", format!("{up}, stated by a comment of the file; {used}"));
        }
        Some(up) => {
            let turned =
                "`LoadSplats` rotates the splats to the up axis of the graph unless `frame: AsStored` is set";
            text.line("up", format!("{up}, defined by the file format; {turned}"));
        }
        None => {}
    }
    text.level(scene.level.as_ref(), ruler);
    if let Some(sizes) = &scene.sizes {
        text.line(
            "sizes",
            format!(
                "longest axis (standard deviation): median {:.2e}, 99 % below {:.2e}, maximum {:.2e}; flat splats: {:.0} %, needles: {:.1} %",
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
                "median {:.3}; above 0.95: {:.0} % of the splats; too low to be drawn: {:.0} %",
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
                "about {:.0} splats per pixel seen from inside, {:.0} from outside, including hidden splats",
                overdraw.from_inside, overdraw.from_outside
            ),
        );
    }
    text.findings(&scene.findings);
}

#[cfg(test)]
mod tests {
    use super::Ruler;

    #[test]
    fn lengths_have_the_digits_their_scene_needs() {
        for (size, value, text) in [
            (0.0, 0.0, "0.000"),
            (20.0, 1.234_567, "1.235"),
            (5e8, 1.5, "1.500"),
            (0.02, 0.001_234_567, "0.00123"),
            (2e-6, 1.234_567e-6, "0.000001235"),
            (1e-9, 1.25e-10, "1.250e-10"),
            (1e12, 2.5e11, "2.500e11"),
        ] {
            assert_eq!(Ruler::of(size).length(value), text, "{size}");
        }
    }
}

//! The list of the assumptions of a graph that `init` writes.

use std::fmt::Write as _;
use std::path::Path;

use engine::Up;

use super::graph::{ALBEDO, has_colours, length, number, percent, vector};
use super::sky::Sky;
use super::survey::{Survey, decimals, is_known};
use crate::session::standing::{Standing, UpBy};

/// Describes a confidence in words.
fn sure(confidence: f64) -> String {
    let word = if confidence >= render::geometry::level::SURE {
        "sure"
    } else if confidence >= 0.6 {
        "likely"
    } else {
        "not sure"
    };
    format!("{word} ({confidence:.2})")
}

/// A measured or assumed property of a capture.
pub struct Assumption {
    /// The property: `up`, `floor` or `scale`.
    pub what: &'static str,
    /// Its value, and how it was found.
    pub value: String,
    /// Probability that it is correct; `None` if it is not known.
    pub confidence: Option<f64>,
}

#[cfg(feature = "serve")]
impl Assumption {
    /// The value, followed by the confidence in words.
    pub fn text(&self) -> String {
        let sure = self.confidence.map(|confidence| format!(", {}", sure(confidence)));
        format!("{}{}", self.value, sure.unwrap_or_default())
    }
}

/// The up axis, the floor and the scale of a capture.
pub fn of_capture(standing: &Standing, metres_per_unit: f64) -> [Assumption; 3] {
    let (stand, digits) = (&standing.stand, decimals(&standing.stand).min(3));
    let by = match standing.by {
        UpBy::Measured if stand.by_cameras => "measured from the cameras",
        UpBy::Measured => "measured from the ground and the objects on it",
        UpBy::Format => "stated by the file, but not confirmed by the splats",
        UpBy::Guessed => "guessed",
        #[cfg(feature = "serve")]
        UpBy::Chosen => "set by hand",
    };
    #[cfg(feature = "serve")]
    let is_measured = standing.by != UpBy::Chosen;
    #[cfg(not(feature = "serve"))]
    let is_measured = true;
    let turned = if standing.matrix.is_some() { " after the rotation by `matrix`" } else { "" };
    let up = Assumption {
        what: "up",
        value: format!("{}{turned}, {by}", standing.up.name()),
        // A value that the user has set is not in question.
        confidence: is_measured.then_some(standing.confidence),
    };
    let axis = match standing.up {
        Up::PlusZ => ("z", 1.0),
        Up::PlusY => ("y", 1.0),
        Up::MinusY => ("y", -1.0),
    };
    let ceiling = stand.ceiling.map(|c| format!(", ceiling at {}", length(c * axis.1, digits)));
    let floor = Assumption {
        what: "floor",
        value: format!(
            "{} = {}{}",
            axis.0,
            length(stand.floor * axis.1, digits),
            ceiling.unwrap_or_default()
        ),
        confidence: Some(stand.floor_confidence.min(standing.confidence)),
    };
    let (value, confidence) = match stand.scale.metres_per_unit {
        _ if standing.chosen_scale.is_some() => {
            (format!("{} m per unit, set by hand", number(metres_per_unit)), None)
        }
        Some(_) if is_known(stand) => (
            format!("{} m per unit: {}", number(metres_per_unit), stand.scale.reason),
            Some(stand.scale.confidence),
        ),
        _ => (format!("NOT KNOWN; the graph assumes {} m per unit", number(metres_per_unit)), None),
    };
    [up, floor, Assumption { what: "scale", value, confidence }]
}

/// Lists the assumptions, one per line, each with its confidence and the line of the graph to edit.
pub fn list(survey: &Survey, graph: &str, path: &Path) -> String {
    let s = survey;
    let at = |begin: &str| {
        let number = graph.lines().position(|line| line.trim_start().starts_with(begin)).map_or(0, |n| n + 1);
        format!("{}:{number}", path.display())
    };
    let digits = s.decimals().min(3);
    let mut out = String::from("assumed:\n");
    let mut line = |what: &str, value: String, confidence: Option<f64>, begin: &str| {
        let confidence = confidence.map(|c| format!(", {}", sure(c))).unwrap_or_default();
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{what:>9}  {value}{confidence}   [{}]", at(begin));
    };
    for Assumption { what, value, confidence } in of_capture(&s.standing, s.metres_per_unit) {
        line(what, value, confidence, if what == "floor" { "pose:" } else { "scene: (" });
    }
    match s.arranged.surface {
        Some(surface) => line(
            "place",
            format!(
                "{} on a level surface, {} above the floor, with {} of free space around the object",
                vector(s.translation),
                length(surface.height.max(0.0), digits),
                length(surface.radius, digits)
            ),
            None,
            "pose:",
        ),
        None => {
            line("place", format!("{}; NO LEVEL SURFACE was found", vector(s.translation)), None, "pose:");
        }
    }
    let size = s.extents.size().max_element();
    let units = length(size / s.metres_per_unit * s.arranged.scale, digits);
    if s.arranged.fitted && is_known(&s.standing.stand) {
        let text = format!("scaled by {} to {units} units, so that it fits", number(s.arranged.scale));
        line("size", text, None, "pose:");
    } else if s.file_scale == 1.0 {
        line("size", format!("unchanged from its file: {size:.2} m, which is {units} units"), None, "pose:");
    } else {
        let own = size / s.file_scale;
        let text =
            format!("{own:.0} m in its file, TAKEN AS CENTIMETRES: {size:.2} m, which is {units} units");
        line("size", text, None, "pose:");
    }
    match (&s.photo, s.arranged.view) {
        (Some(photo), _) => {
            line("camera", format!("the camera of the photograph, `{}`", photo.camera), None, "camera:");
        }
        (None, Some(view)) => {
            let shows =
                if view.score >= 0.6 { "sees the object well" } else { "does NOT see the object well" };
            line("camera", format!("at {}, {shows}", vector(view.eye)), None, "camera:");
        }
        (None, None) => {
            line("camera", "NO FREE PLACE with a view of the object was found".to_owned(), None, "camera:");
        }
    }
    match s.sky {
        Sky::Seen => {}
        Sky::Missing(share) => {
            let (share, albedo) = (percent(share), number(ALBEDO));
            let text = format!(
                "{share} of the upper half of the panorama shows nothing; a white sky was assumed there, which gives the ground an albedo of {albedo}"
            );
            line("light", text, None, if has_colours(s) { "fused:" } else { "env:" });
        }
        Sky::Unknown(share) => {
            let text = format!(
                "NOT KNOWN, because {} of the upper half of the panorama shows nothing",
                percent(share)
            );
            line("light", text, None, "env:");
        }
    }
    if s.mesh.is_none() {
        let made = if s.arranged.surface.is_some() { "extracted from the splats" } else { "a plane" };
        line("mesh", made.to_owned(), None, "proxy:");
    }
    out
}

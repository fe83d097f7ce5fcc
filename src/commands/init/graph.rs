//! The graph that `init` writes, and the list of its assumptions.

use std::fmt::Write as _;
use std::path::Path;

use engine::Up;
use glam::DVec3;

use super::survey::{SIZE, Survey, is_known};
use crate::session::standing::UpBy;

/// Writes a text as a string of a graph file, in quotes.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            c if c.is_control() => {
                // Writing to a string cannot fail.
                let _ = write!(out, "\\u{{{:x}}}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out + "\""
}

/// Writes a number as in a graph file, with a decimal point and without digits that come only from rounding errors.
fn number(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
    if text == "-0.0" { "0.0".to_owned() } else { text }
}

fn vector(v: DVec3) -> String {
    let [x, y, z] = v.to_array().map(number);
    format!("({x}, {y}, {z})")
}

/// Writes a length with few digits, for messages.
fn length(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    // Not -0.
    if text.trim_start_matches('-').bytes().all(|b| matches!(b, b'0' | b'.')) {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

fn matrix(rows: Option<&[f64; 16]>) -> String {
    let Some(rows) = rows else { return String::new() };
    let rows: Vec<String> = rows
        .chunks(4)
        .map(|row| row.iter().map(|v| number((v * 1e9).round() / 1e9 + 0.0)).collect::<Vec<_>>().join(", "))
        .collect();
    format!(",\n            matrix: (\n                {},\n            )", rows.join(",\n                "))
}

/// Writes the graph.
pub fn text(survey: &Survey) -> String {
    let s = survey;
    let arranged = &s.arranged;
    let turned = matrix(s.standing.matrix.as_ref());
    let size = s.extents.size();
    let height = size.y / s.metres_per_unit * arranged.scale;
    let extent = size.length() / s.metres_per_unit * arranged.scale;
    // The near plane, in metres. Objects smaller than 2 m need a nearer one than the default.
    let digits = |v: f64| {
        let mut unit = 1e-9;
        while unit * 10.0 <= v {
            unit *= 10.0;
        }
        (v / unit).floor() * unit
    };
    let near = digits((0.1 * size.length() * arranged.scale).min(0.2));
    let near = if near < 0.2 { format!(", near: {}", number(near)) } else { String::new() };
    let mut o = String::new();
    let mut line = |text: &str| {
        o.push_str(text);
        o.push('\n');
    };
    line(
        "// An object in a captured place, written by `lightharmony init`. It runs as it is; after an edit, run it again:",
    );
    line("// only what the edit affects is computed.");
    line("//");
    line("//   lightharmony run graph.ron            # writes out/picture.png");
    line("//   lightharmony nodes path-trace         # every parameter of a kind");
    line("Graph(");
    line("    version: 1,");
    line("");
    let by = match s.standing.by {
        UpBy::Measured if s.standing.matrix.is_some() => {
            "The capture is tilted: `matrix` below rotates it so that this axis points up."
        }
        UpBy::Measured => "The up axis was measured.",
        UpBy::Format => "The up axis is that of the file format.",
        UpBy::Guessed => {
            "The up axis is a GUESS: if the picture is tilted or upside down, write \"+z\", \"+y\" or \"-y\" here."
        }
    };
    line(&format!("    // {by}"));
    let scale = if is_known(&s.standing.stand) {
        format!("`metres_per_unit` was measured: {}.", s.standing.stand.scale.reason)
    } else {
        let fitted = if arranged.fitted { " With this value the object fits." } else { "" };
        format!(
            "`metres_per_unit` is NOT KNOWN: measure something of known length, and write its length in metres divided by its length in units.{fitted}"
        )
    };
    line(&format!("    // {scale}"));
    line(&format!(
        "    scene: (up: \"{}\", metres_per_unit: {}, seed: 7),",
        s.standing.up.name(),
        number(s.metres_per_unit)
    ));
    line("");
    line("    nodes: (");
    line("        // Your files; paths are relative to this file.");
    line(&format!("        scene:  LoadSplats(path: {}{turned}),", quoted(&s.splats)));
    line(&format!("        object: LoadObject(path: {}),", quoted(&s.object)));
    line("");
    let on = match arranged.surface {
        Some(surface) => format!(
            "on a level surface, {} above the floor, with {} of free space around it",
            length(surface.height.max(0.0), 2),
            length(surface.radius, 2)
        ),
        None => {
            "at the height of the lowest point of the capture, because no level surface was found".to_owned()
        }
    };
    line(&format!("        // Where the object stands: {on}."));
    line(
        "        // You will edit this line most often. `yaw_deg` turns the object, counter-clockwise seen from above.",
    );
    let fitted = if arranged.fitted && is_known(&s.standing.stand) {
        format!(" Its own size is {:.2} m; `scale` fits it to the space.", size.max_element())
    } else {
        String::new()
    };
    line(&format!("        // Scale 1 is the object's own size.{fitted}"));
    line(&format!(
        "        pose:   Pose(translation: {}, yaw_deg: {}, scale: {}),",
        vector(s.translation),
        number(s.yaw_deg),
        number(arranged.scale)
    ));
    line("");
    match &s.mesh {
        Some(mesh) => {
            line("        // The mesh of the place receives shadows and reflects light.");
            line(&format!("        proxy:  LoadMesh(path: {}{turned}),", quoted(mesh)));
        }
        None if arranged.surface.is_none() => {
            line("        // No level surface was found, so a plane receives the shadows.");
            line("        proxy:  Plane(at: \"pose\", splats: \"scene\"),");
        }
        None => {
            line(
                "        // The mesh of the place, made from the splats, receives shadows and reflects light.",
            );
            line("        proxy:  ExtractMesh(splats: \"scene\", around: \"pose\", cameras: \"camera\"),");
        }
    }
    line(
        "        // Moves the object down or up onto the mesh; for an object that hangs, wire `pose` to `placed` instead.",
    );
    let reach = digits((0.6 * height * s.metres_per_unit).max(0.02));
    line(&format!(
        "        stands: Snap(object: \"object\", pose: \"pose\", mesh: \"proxy\", reach_metres: {}),",
        number(reach)
    ));
    line("        placed: Place(object: \"object\", pose: \"stands\"),");
    line("");
    match (&s.photo, &s.cameras, arranged.view) {
        (Some(photo), Some(cameras), _) => {
            line("        // The camera of the photograph.");
            line(&format!(
                "        camera: LoadCameras(path: {}, pick: [{}]{}),",
                quoted(cameras),
                quoted(&photo.camera),
                matrix(s.standing.camera_matrix.as_ref())
            ));
        }
        (_, _, view) => {
            let (eye, target, fov) = view.map_or_else(
                || {
                    let [right, forward, up] = nodes::math::equirect::axes(s.standing.up);
                    let away = (right * 0.5 - forward + up * 0.4) * (4.0 * extent);
                    (arranged.place + away, arranged.place, 45.0)
                },
                |view| (view.eye, view.target, view.fov_y_deg),
            );
            line("        // The camera, in free space with a clear view of the object.");
            line(&format!(
                "        camera: Camera(eye: {}, target: {}, width_px: {}, height_px: {}, fov_y_deg: {}),",
                vector(eye),
                vector(target),
                SIZE[0],
                SIZE[1],
                number(fov)
            ));
        }
    }
    line("");
    line(
        "        // The light at the object: six views become a panorama, and the light lost to clipping is predicted.",
    );
    line(&format!(
        "        probe:  CubeRig(at: \"stands\", height_metres: {}, size_px: 256),",
        number(digits((0.6 * height * s.metres_per_unit).max(1e-3)))
    ));
    line(&format!("        faces:  SplatRender(splats: \"scene\", rig: \"probe\"{near}),"));
    line("        pano:   Stitch(views: \"faces\", width_px: 512),");
    line("        dark:   PredictExposure(pano: \"pano\", evs: [-6.0, -3.0], method: Learned),");
    line("        env:    FuseHdr(base: \"pano\", brackets: \"dark\"),");
    line("");
    match &s.photo {
        Some(photo) => line(&format!("        view:   LoadImage(path: {}),", quoted(&photo.path))),
        None => line(&format!("        view:   SplatRender(splats: \"scene\", rig: \"camera\"{near}),")),
    }
    line("        // More `samples` give less noise; samples already traced are reused.");
    line("        trace:  PathTrace(");
    line(
        "            receiver: \"proxy\", objects: [\"placed\"], rig: \"camera\", env: \"env\", samples: 8, clamp_indirect: 4.0,",
    );
    line("        ),");
    line("        clean:  Denoise(");
    line("            without: \"trace.without\", with: \"trace.with\", object: \"trace.object\",");
    line("            depth: \"trace.depth\", normal: \"trace.normal\", variance: \"trace.variance\",");
    line("        ),");
    line(
        "        shadow: ShadowRatio(without: \"clean.without\", with: \"clean.with\", gamma: 0.8, s_min: 0.05, lambda: 1.0),",
    );
    line(
        "        // Splats in front of the object, where the mesh has no surface, are drawn over the object.",
    );
    line(&format!(
        "        front:  SplatRender(splats: \"scene\", rig: \"camera\", limit: \"trace.nearest\"{near}),"
    ));
    line(
        "        final:  Composite(background: \"view\", object: \"clean.object\", shadow: \"shadow\", front: \"front\"),",
    );
    line("        save:   WriteImage(image: \"final\", path: \"picture.png\"),");
    line("    ),");
    line(")");
    o
}

/// Describes a confidence in words.
fn sure(confidence: f64) -> String {
    let word = if confidence >= nodes::geometry::level::SURE {
        "sure"
    } else if confidence >= 0.6 {
        "likely"
    } else {
        "not sure"
    };
    format!("{word} ({confidence:.2})")
}

/// Lists the assumptions, one per line, each with its confidence and the line of the graph to edit.
pub fn assumptions(survey: &Survey, graph: &str, path: &Path) -> String {
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
    let by = match s.standing.by {
        UpBy::Measured if s.standing.stand.by_cameras => "measured from the cameras",
        UpBy::Measured => "measured from the ground and the objects on it",
        UpBy::Format => "defined by the file format, but not confirmed by the splats",
        UpBy::Guessed => "guessed",
    };
    let turned = if s.standing.matrix.is_some() { " after the rotation by `matrix`" } else { "" };
    line("up", format!("{}{turned}, {by}", s.standing.up.name()), Some(s.standing.confidence), "scene: (");
    let axis = match s.standing.up {
        Up::PlusZ => ("z", 1.0),
        Up::PlusY => ("y", 1.0),
        Up::MinusY => ("y", -1.0),
    };
    let floor = length(s.standing.stand.floor * axis.1, digits);
    let ceiling = s
        .standing
        .stand
        .ceiling
        .map(|c| format!(", ceiling at {}", length(c * axis.1, digits)))
        .unwrap_or_default();
    line(
        "floor",
        format!("{} = {floor}{ceiling}", axis.0),
        Some(s.standing.stand.floor_confidence.min(s.standing.confidence)),
        "pose:",
    );
    match s.standing.stand.scale.metres_per_unit {
        Some(_) if is_known(&s.standing.stand) => line(
            "scale",
            format!("{} m per unit: {}", number(s.metres_per_unit), s.standing.stand.scale.reason),
            Some(s.standing.stand.scale.confidence),
            "scene: (",
        ),
        _ => line(
            "scale",
            format!("NOT KNOWN; the graph assumes {} m per unit", number(s.metres_per_unit)),
            None,
            "scene: (",
        ),
    }
    match s.arranged.surface {
        Some(surface) => line(
            "place",
            format!(
                "{} on a level surface, {} above the floor, with {} of free space around it",
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
        let text = format!("scaled by {} to {units} units, to fit", number(s.arranged.scale));
        line("size", text, None, "pose:");
    } else {
        line("size", format!("unchanged from its file: {size:.2} m, which is {units} units"), None, "pose:");
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
    if s.mesh.is_none() {
        let made = if s.arranged.surface.is_some() { "extracted from the splats" } else { "a plane" };
        line("mesh", made.to_owned(), None, "proxy:");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_numbers_are_what_the_graph_reads() {
        assert_eq!(quoted("a b\\\"c\"\n\u{7}"), r#""a b\\\"c\"\n\u{7}""#);
        assert_eq!([1.0, -0.5, 1e-7].map(number), ["1.0", "-0.5", "0.0000001"]);
        assert_eq!(vector(DVec3::new(1.0, 2.5, -3.0)), "(1.0, 2.5, -3.0)");
    }
}

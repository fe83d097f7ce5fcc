//! The graph that `init` writes.

use std::fmt::Write as _;

use glam::DVec3;
#[cfg(feature = "serve")]
use render::layout::Viewpoint;

use super::sky::Sky;
use super::survey::{NEAR, SIZE, Survey, is_known, one_digit};
use crate::session::standing::{Standing, UpBy};

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
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0');
    let text = if text.ends_with('.') { format!("{text}0") } else { text.to_owned() };
    if text == "-0.0" { "0.0".to_owned() } else { text }
}

pub(super) fn vector(v: DVec3) -> String {
    let [x, y, z] = v.to_array().map(number);
    format!("({x}, {y}, {z})")
}

/// Writes a length with few digits, for messages.
pub(super) fn length(value: f64, decimals: usize) -> String {
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

/// The lines of a graph.
#[derive(Default)]
struct Lines(String);

impl Lines {
    fn line(&mut self, text: &str) {
        self.0.push_str(text);
        self.0.push('\n');
    }
}

/// Writes the graph of a capture without an object: a view of the place.
#[cfg(feature = "serve")]
pub fn of_capture(splats: &str, standing: &Standing, metres_per_unit: f64, view: &Viewpoint) -> String {
    let mut o = Lines::default();
    o.line("// A captured place, written by `lightharmony watch`. On the live page, an object can be put into it.");
    o.line("Graph(");
    o.line("    version: 1,");
    o.line("");
    scene(&mut o, standing, metres_per_unit, false);
    o.line("");
    o.line("    nodes: (");
    o.line(&format!(
        "        scene:  LoadSplats(path: {}{}),",
        quoted(splats),
        matrix(standing.matrix.as_ref())
    ));
    o.line(&camera_line(view.eye, view.target, view.fov_y_deg));
    o.line("        view:   SplatRender(splats: \"scene\", rig: \"camera\"),");
    o.line("        save:   WriteImage(image: \"view.colour\", path: \"picture.png\"),");
    o.line("    ),");
    o.line(")");
    o.0
}

fn camera_line(eye: DVec3, target: DVec3, fov_y_deg: f64) -> String {
    let [width, height] = SIZE;
    let (eye, target, fov) = (vector(eye), vector(target), number(fov_y_deg));
    format!(
        "        camera: Camera(eye: {eye}, target: {target}, width_px: {width}, height_px: {height}, fov_y_deg: {fov}),"
    )
}

/// Writes the graph.
pub fn text(survey: &Survey) -> String {
    let mut o = Lines::default();
    head(&mut o);
    scene(&mut o, &survey.standing, survey.metres_per_unit, survey.arranged.fitted);
    o.line("");
    o.line("    nodes: (");
    object(&mut o, survey);
    o.line("");
    mesh(&mut o, survey);
    o.line("");
    camera(&mut o, survey);
    o.line("");
    light(&mut o, survey);
    o.line("");
    picture(&mut o, survey);
    o.line("    ),");
    o.line(")");
    o.0
}

/// Height of the object as it is placed, in world units.
fn height(s: &Survey) -> f64 {
    s.extents.size().y / s.metres_per_unit * s.arranged.scale
}

/// The near plane of renders, in metres. Objects smaller than 2 m need a nearer one than the default.
fn near(s: &Survey) -> String {
    let near = one_digit((0.1 * s.extents.size().length() * s.arranged.scale).min(NEAR));
    if near < NEAR { format!(", near: {}", number(near)) } else { String::new() }
}

/// Writes how to use the graph, and its first lines.
fn head(o: &mut Lines) {
    o.line(
        "// An object in a captured place, written by `lightharmony init`. Run this graph, edit it, and run it again:",
    );
    o.line("// only what the edit affects is computed.");
    o.line("//");
    o.line("//   lightharmony run graph.ron            # writes out/picture.png");
    o.line("//   lightharmony nodes path-trace         # every parameter of a kind");
    o.line("Graph(");
    o.line("    version: 1,");
    o.line("");
}

/// Writes the up axis and the scale. `is_fitted` is true if the scale of the place follows from the object.
fn scene(o: &mut Lines, standing: &Standing, metres_per_unit: f64, is_fitted: bool) {
    let by = match standing.by {
        UpBy::Measured if standing.matrix.is_some() => {
            "The capture is tilted: `matrix` below rotates it so that this axis points up."
        }
        UpBy::Measured => "The up axis was measured.",
        #[cfg(feature = "serve")]
        UpBy::Chosen if standing.matrix.is_some() => {
            "The up axis was set by hand: `matrix` below rotates the capture so that this axis points up."
        }
        #[cfg(feature = "serve")]
        UpBy::Chosen => "The up axis was set by hand.",
        UpBy::Format => "The up axis is stated by the file.",
        UpBy::Guessed => {
            "The up axis is a GUESS: if the picture is tilted or upside down, write \"+z\", \"+y\" or \"-y\" here."
        }
    };
    o.line(&format!("    // {by}"));
    let scale = if standing.chosen_scale.is_some() {
        "`metres_per_unit` was set by hand.".to_owned()
    } else if is_known(&standing.stand) {
        format!("`metres_per_unit` was measured: {}.", standing.stand.scale.reason)
    } else {
        let fitted = if is_fitted { " With this value the object fits." } else { "" };
        format!(
            "`metres_per_unit` is NOT KNOWN: choose an object whose length you know, and write its length in metres divided by its length in units.{fitted}"
        )
    };
    o.line(&format!("    // {scale}"));
    o.line(&format!(
        "    scene: (up: \"{}\", metres_per_unit: {}, seed: 7),",
        standing.up.name(),
        number(metres_per_unit)
    ));
}

/// Writes the files of the scene and of the object, and the pose.
fn object(o: &mut Lines, s: &Survey) {
    let arranged = &s.arranged;
    let (turned, size) = (matrix(s.standing.matrix.as_ref()), s.extents.size());
    o.line("        // Your files; paths are relative to this file.");
    o.line(&format!("        scene:  LoadSplats(path: {}{turned}),", quoted(&s.splats)));
    o.line(&format!("        object: LoadObject(path: {}),", quoted(&s.object)));
    o.line("");
    let on = match arranged.surface {
        Some(surface) if s.is_chosen => {
            format!("where you put it, {} above the floor", length(surface.height.max(0.0), 2))
        }
        Some(surface) => format!(
            "on a level surface, {} above the floor, with {} of free space around the object",
            length(surface.height.max(0.0), 2),
            length(surface.radius, 2)
        ),
        None => {
            "at the height of the lowest point of the capture, because no level surface was found".to_owned()
        }
    };
    o.line(&format!("        // Where the object stands: {on}."));
    o.line(
        "        // You will edit this line most often. `yaw_deg` turns the object, counter-clockwise seen from above.",
    );
    let fitted = if arranged.fitted && is_known(&s.standing.stand) {
        format!(" Its own size is {:.2} m; `scale` fits it to the space.", size.max_element())
    } else {
        String::new()
    };
    let own = if s.file_scale == 1.0 {
        "Scale 1 is the object's own size.".to_owned()
    } else {
        let metres = size.max_element() / s.file_scale;
        format!(
            "The object's file says {metres:.0} m, which was TAKEN AS CENTIMETRES: scale 0.01 is its own size."
        )
    };
    o.line(&format!("        // {own}{fitted}"));
    o.line(&format!(
        "        pose:   Pose(translation: {}, yaw_deg: {}, scale: {}),",
        vector(s.translation),
        number(s.yaw_deg),
        number(arranged.scale * s.file_scale)
    ));
}

/// Writes the mesh of the place, and the object on it.
fn mesh(o: &mut Lines, s: &Survey) {
    let turned = matrix(s.standing.matrix.as_ref());
    match &s.mesh {
        Some(mesh) => {
            o.line("        // The mesh of the place receives shadows and reflects light.");
            o.line(&format!("        proxy:  LoadMesh(path: {}{turned}),", quoted(mesh)));
        }
        None if s.arranged.surface.is_none() => {
            o.line("        // No level surface was found, so a plane receives the shadows.");
            o.line("        proxy:  Plane(at: \"pose\", splats: \"scene\"),");
        }
        None => {
            o.line(
                "        // The mesh of the place, made from the splats, receives shadows and reflects light.",
            );
            o.line("        proxy:  ExtractMesh(splats: \"scene\", around: \"pose.position\", cameras: \"camera\"),");
        }
    }
    o.line(
        "        // Moves the object down or up onto the mesh. If the object hangs, write `pose: \"pose\"` in `placed` instead.",
    );
    let reach = one_digit((height(s) * s.metres_per_unit).max(0.05));
    o.line(&format!(
        "        stands: Snap(object: \"object\", pose: \"pose\", mesh: \"proxy\", reach_metres: {}),",
        number(reach)
    ));
    o.line("        placed: Place(object: \"object\", pose: \"stands\"),");
}

/// Writes the camera.
fn camera(o: &mut Lines, s: &Survey) {
    let arranged = &s.arranged;
    match (&s.photo, &s.cameras, arranged.view) {
        (Some(photo), Some(cameras), _) => {
            o.line("        // The camera of the photograph.");
            o.line(&format!(
                "        camera: LoadCameras(path: {}, pick: [{}]{}),",
                quoted(cameras),
                quoted(&photo.camera),
                matrix(s.standing.camera_matrix.as_ref())
            ));
        }
        (_, _, view) => {
            let (eye, target, fov) = view.map_or_else(
                || {
                    let [right, forward, up] = scene::math::equirect::axes(s.standing.up);
                    let extent = s.extents.size().length() / s.metres_per_unit * arranged.scale;
                    let away = (right * 0.5 - forward + up * 0.4) * (4.0 * extent);
                    (arranged.place + away, arranged.place, 45.0)
                },
                |view| (view.eye, view.target, view.fov_y_deg),
            );
            o.line(match s.is_chosen {
                true => "        // The camera, as you looked at the place.",
                false => "        // The camera, in free space with a clear view of the object.",
            });
            o.line(&camera_line(eye, target, fov));
        }
    }
}

/// Writes the recovery of the light at the object.
fn light(o: &mut Lines, s: &Survey) {
    let near = near(s);
    o.line(
        "        // The light at the object: six views become a panorama, and the light lost to clipping is predicted.",
    );
    o.line(&format!(
        "        probe:  CubeRig(at: \"pose.position\", height_metres: {}, size_px: 256),",
        number(s.probe_metres)
    ));
    o.line(&format!("        faces:  SplatRender(splats: \"scene\", rig: \"probe\"{near}),"));
    o.line("        pano:   Stitch(views: \"faces\", width_px: 512),");
    o.line("        dark:   PredictExposure(pano: \"pano\", evs: [-6.0, -3.0], method: Learned),");
    // A plane has no colours to compare, and an unknown light is not worth correcting.
    let is_fitted = has_colours(s) && !matches!(s.sky, Sky::Unknown(_));
    let fused = if is_fitted { "fused: " } else { "env:   " };
    match s.sky {
        Sky::Seen => o.line(&format!("        {fused} FuseHdr(base: \"pano\", brackets: \"dark\"),")),
        Sky::Missing(share) => {
            o.line(&format!(
                "        // {} of the upper half of `pano` shows nothing, and the rest is too dark for the bright ground. `ground_albedo`",
                percent(share)
            ));
            o.line(
                "        // makes the unseen part a white sky that gives the ground this albedo: grass 0.2, stone or sand 0.3, concrete 0.4.",
            );
            o.line(&format!(
                "        {fused} FuseHdr(base: \"pano\", brackets: \"dark\", ground_albedo: {}),",
                number(ALBEDO)
            ));
        }
        Sky::Unknown(share) => {
            o.line(&format!(
                "        // {} of the upper half of `pano` shows nothing, so the light is UNKNOWN and the object may be dark. To light it, write",
                percent(share)
            ));
            o.line("        // env: LoadEnvironment(path: \"sky.hdr\"), in place of the line below.");
            o.line("        env:    FuseHdr(base: \"pano\", brackets: \"dark\"),");
        }
    }
    if is_fitted {
        o.line("        // The shading and the shadows of the place correct the direction, strength and colour of its lights.");
        o.line("        env:    FitLights(env: \"fused\", receiver: \"proxy\", splats: \"scene\"),");
    }
}

/// True if the receiver has the colours of the place.
pub(super) fn has_colours(s: &Survey) -> bool {
    s.mesh.is_some() || s.arranged.surface.is_some()
}

/// Writes the trace and the finished picture.
fn picture(o: &mut Lines, s: &Survey) {
    let near = near(s);
    match &s.photo {
        Some(photo) => o.line(&format!("        view:   LoadImage(path: {}),", quoted(&photo.path))),
        None => o.line(&format!("        view:   SplatRender(splats: \"scene\", rig: \"camera\"{near}),")),
    }
    o.line("        // 8 samples are a first picture. More give less noise, and samples already traced are reused: `--preset preview`");
    o.line("        // traces 16, `--preset final` 64.");
    o.line("        trace:  PathTrace(");
    o.line(
        "            receiver: \"proxy\", objects: [\"placed\"], rig: \"camera\", env: \"env\", samples: 8, clamp_indirect: 4.0,",
    );
    o.line("        ),");
    o.line("        clean:  Denoise(");
    o.line("            without: \"trace.without\", with: \"trace.with\", object: \"trace.object\",");
    o.line("            depth: \"trace.depth\", normal: \"trace.normal\", variance: \"trace.variance\",");
    o.line("        ),");
    o.line(
        "        shadow: ShadowRatio(without: \"clean.without\", with: \"clean.with\", gamma: 0.8, s_min: 0.05, lambda: 1.0),",
    );
    o.line(
        "        // Splats in front of the object, where the mesh has no surface, are drawn over the object.",
    );
    o.line(&format!(
        "        front:  SplatRender(splats: \"scene\", rig: \"camera\", limit: \"trace.nearest\"{near}),"
    ));
    o.line("        // The object becomes as sharp as the picture of the place around it.");
    o.line("        final:  Composite(");
    o.line(
        "            background: \"view\", object: \"clean.object\", shadow: \"shadow\", front: \"front\", sharpness: Match,",
    );
    o.line("        ),");
    o.line("        save:   WriteImage(image: \"final\", path: \"picture.png\"),");
}

/// Albedo of the ground where it is not known: that of stone or sand.
pub(super) const ALBEDO: f64 = 0.3;

/// Writes a share in percent, for comments and messages.
pub(super) fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
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

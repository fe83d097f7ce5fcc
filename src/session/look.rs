//! Pictures of scenes: a plan from above and some views, with lines that describe them.

use std::fmt::Write as _;
use std::path::Path;

use engine::{Context, NodeError, Up};
use glam::DVec3;
use render::geometry::level::{self, LevelEstimate};
use render::layout::Viewpoint;
use render::look::{Canvas, Plan, of_mesh as splats_of_mesh, views};
use render::splat::{Settings, render};
use scene::io::picture::of_bytes;
use scene::math::color::{linear_from_srgb, luminance, srgb_from_linear};
use scene::math::equirect::axes;
use scene::types::{Mesh, Picture, Rig, Splats};

use crate::session::splats;
use crate::session::standing::{Standing, UpBy};

/// A picture as PNG, and the lines to print.
pub type Drawn = (Vec<u8>, String);

/// Side length of the plan, in pixels.
const SIDE: usize = 1000;
/// Width and height of a view, in pixels.
const VIEW: [usize; 2] = [664, 498];
/// Number of views.
const VIEWS: usize = 4;
/// Width and height in pixels of the cameras that are printed.
const PRINTED: [u32; 2] = [1280, 720];
/// Height above the floor of the cameras that show the views, in metres: the eye level of a person.
const EYES: f64 = 1.55;
/// Width of the picture that is drawn for a panorama, in pixels.
const PANORAMA: usize = 1600;

/// The contents of the plan and the views.
struct Shown<'a> {
    splats: &'a Splats,
    stand: &'a LevelEstimate,
    cameras: Option<&'a Rig>,
    up: Up,
}

impl Shown<'_> {
    fn draw(&self, lines: &mut String, cx: &Context) -> Result<Vec<u8>, NodeError> {
        let stand = self.stand;
        let world = axes(self.up);
        let metre =
            1.0 / stand.scale.metres_per_unit.filter(|_| stand.scale.confidence >= 0.5).unwrap_or(1.0);
        let room = stand.ceiling.map(|ceiling| ceiling - stand.floor);
        let eye = room.map_or((EYES * metre).min(0.6 * stand.radius), |room| 0.58 * room);
        let found = views(self.splats, stand, eye, self.cameras, VIEWS, cx)?;
        let cut = room.map_or(1.4 * eye, |room| 0.85 * room);
        let mut plan = Plan::new(self.splats, stand, world, cut, SIDE, cx)?;
        for (number, view) in (1..).zip(&found) {
            plan.mark(view.eye, view.target, number);
        }
        let gap = 4;
        let mut sheet = Canvas::new(SIDE + 2 * (VIEW[0] + gap), SIDE, [0.06; 3]);
        sheet.put(&plan.canvas, [0, 0]);
        let decimals = if stand.radius < 2.0 { 4 } else { 2 };
        let _ = writeln!(
            lines,
            "{:>14}  grid lines are {} units apart; the up axis is {}",
            "plan",
            plan.step,
            self.up.name()
        );
        for (n, view) in found.iter().enumerate() {
            let canvas = self.view(view, world[2], n + 1, cx)?;
            sheet.put(&canvas, [SIDE + gap + (n % 2) * (VIEW[0] + gap), (n / 2) * (VIEW[1] + gap)]);
            let vector = |v: DVec3| {
                let [x, y, z] = v.to_array().map(|c| format!("{:.decimals$}", c + 0.0));
                format!("({x}, {y}, {z})")
            };
            let _ = writeln!(
                lines,
                "{:>14}  Camera(eye: {}, target: {}, width_px: {}, height_px: {}, fov_y_deg: {:.1})",
                format!("view {}", n + 1),
                vector(view.eye),
                vector(view.target),
                PRINTED[0],
                PRINTED[1],
                view.fov_y_deg,
            );
        }
        Ok(sheet.png()?)
    }

    fn view(&self, view: &Viewpoint, up: DVec3, number: usize, cx: &Context) -> Result<Canvas, NodeError> {
        let camera = view.camera("view", VIEW.map(|v| v as u32), up);
        let settings = Settings { near: 1e-3 * self.stand.radius, ..Settings::default() };
        let seen = render(self.splats, &camera, None, &settings, cx)?;
        let mut canvas = Canvas::of(&seen, VIEW[0], VIEW[1]);
        canvas.text([8, 8], &number.to_string(), 4, [1.0; 3]);
        Ok(canvas)
    }
}

/// Writes a matrix as in a graph file, row by row in one line.
fn row_major(rows: &[f64; 16]) -> String {
    let numbers: Vec<String> = rows.iter().map(|v| format!("{:?}", (v * 1e9).round() / 1e9 + 0.0)).collect();
    format!("({})", numbers.join(", "))
}

/// Draws a capture, which is rotated upright first.
pub fn of_splats(file: &Path, cameras: Option<&Path>) -> Result<Drawn, NodeError> {
    let standing = Standing::of(file, cameras)?;
    let mut lines = String::new();
    if standing.by != UpBy::Measured {
        let word = if standing.by == UpBy::Format { "stated by the file" } else { "a GUESS" };
        let _ = writeln!(
            lines,
            "{:>14}  up is {word}; the views below apply to `scene: (up: \"{}\")`",
            "note",
            standing.up.name()
        );
    }
    if let Some(matrix) = &standing.matrix {
        let text = "the capture is tilted; the plan and the views below are valid if the nodes that load the capture set:";
        let _ = writeln!(lines, "{:>14}  {text}\n{:>14}  matrix: {}", "note", "", row_major(matrix));
    }
    let shown = Shown {
        splats: &standing.splats,
        stand: &standing.stand,
        cameras: standing.cameras.as_deref(),
        up: standing.up,
    };
    let png = shown.draw(&mut lines, &splats::context(standing.up))?;
    Ok((png, lines))
}

/// Draws a mesh, or an object with its base colours. The up direction is the axis that the format defines or, if it
/// defines none, the normal of the estimated floor.
pub fn of_mesh(mesh: &Mesh, declared: Option<Up>) -> Result<Drawn, NodeError> {
    let measured = level::of_mesh(mesh, None).filter(LevelEstimate::is_sure);
    let axis = measured.as_ref().and_then(LevelEstimate::axis);
    let named = [Up::PlusZ, Up::PlusY, Up::MinusY].into_iter().find(|up| Some(up.name()) == axis);
    let up = declared.or(named).unwrap_or(Up::PlusZ);
    let splats = splats_of_mesh(mesh);
    let mut lines = String::new();
    if declared.is_some() {
        let points = || (0..mesh.positions.len() as u32).map(|v| mesh.position(v));
        let low = points().fold(DVec3::INFINITY, DVec3::min);
        let [x, y, z] = (points().fold(DVec3::NEG_INFINITY, DVec3::max) - low).to_array();
        let text = "width, height and depth, in metres (defined by glTF)";
        let _ = writeln!(lines, "{:>14}  {x:.3} x {y:.3} x {z:.3}, {text}", "size");
    }
    let (png, more) = of_scene(&splats, up)?;
    Ok((png, lines + &more))
}

/// Draws splats in a world with this up axis.
pub fn of_scene(scene: &Splats, up: Up) -> Result<Drawn, NodeError> {
    let stand = level::upright(scene, axes(up)[2], None)
        .ok_or_else(|| NodeError::new("there is no visible surface"))?;
    let (mut lines, cx) = (String::new(), splats::context(up));
    let png = Shown { splats: scene, stand: &stand, cameras: None, up }.draw(&mut lines, &cx)?;
    Ok((png, lines))
}

/// Draws a panorama, tone-mapped, with its horizon and the direction of its centre column.
pub fn of_panorama(file: &Path, bytes: &[u8]) -> Result<Drawn, NodeError> {
    let picture = of_bytes(&file.display().to_string(), bytes)?;
    let (width, height, channels) = picture.size();
    if width != 2 * height {
        let what = format!(
            "a picture of {width} by {height} pixels is not a panorama; a panorama is twice as wide as high"
        );
        return Err(NodeError::new(what).hint("open it in an image viewer"));
    }
    let decode = |v: f32| if matches!(picture, Picture::Srgb(_)) { linear_from_srgb(v) } else { v };
    let pixel = |x: usize, y: usize| {
        let at = &picture.samples()[(y * width + x) * channels..][..channels];
        [0, 1, 2].map(|k| decode(at[if channels < 3 { 0 } else { k }]))
    };
    let lumas: Vec<f32> = (0..width * height).map(|i| luminance(pixel(i % width, i / width))).collect();
    let peak =
        lumas.iter().enumerate().fold((0, 0.0), |best, (i, &v)| if v > best.1 { (i, v) } else { best });
    let mut sorted = lumas;
    sorted.sort_by(f32::total_cmp);
    let white = sorted.get(sorted.len() * 19 / 20).copied().unwrap_or(1.0).max(1e-6);
    let out = [PANORAMA.min(width), PANORAMA.min(width) / 2];
    let mut canvas = Canvas::new(out[0], out[1], [0.0; 3]);
    for y in 0..out[1] {
        for x in 0..out[0] {
            let rgb = pixel(x * width / out[0], y * height / out[1]);
            canvas.rgb[y * out[0] + x] = rgb.map(|v| srgb_from_linear((0.8 * v / white).clamp(0.0, 1.0)));
        }
    }
    let (w, h) = (out[0] as f64, out[1] as f64);
    canvas.line([0.0, 0.5 * h], [w - 1.0, 0.5 * h], [1.0; 3], 0.35);
    canvas.line([0.5 * w, 0.0], [0.5 * w, h - 1.0], [1.0; 3], 0.35);
    let (x, y) = (peak.0 % width, peak.0 / width);
    let azimuth = (x as f64 + 0.5) / width as f64 * 360.0 - 180.0;
    let rise = 90.0 - (y as f64 + 0.5) / height as f64 * 180.0;
    let mut lines = String::new();
    let _ = writeln!(
        lines,
        "{:>14}  {width} by {height} pixels; the lines mark the horizon and the centre column (forward)",
        "panorama"
    );
    let _ = writeln!(
        lines,
        "{:>14}  luminance {:.3}, {azimuth:.1} degrees right of forward, {rise:.1} degrees above the horizon; 95 % of the pixels have a luminance below {white:.3}",
        "brightest", peak.1
    );
    Ok((canvas.png()?, lines))
}

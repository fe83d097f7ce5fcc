//! `demo-scene`: a synthetic capture, an object to insert and the true light, made from a seed.

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Sizes, Up};
use glam::DVec3;
use scene::math::equirect;
use scene::math::num;
use scene::types::{Camera, Environment, Image, Linear, Mesh, Object, Rig, Splats};

mod capture;
mod cast;
mod courtyard;
mod light;
mod object;
mod paint;
mod place;
mod proxy;
mod random;
mod room;
mod shape;

use light::{Effort, Lit};
use place::Layout;
use view::{DemoCamera, WorldFrame};

engine::choices! {
    /// Setting of the demo scene.
    pub enum Setting {
        /// A furnished living room with a window and a floor lamp; the object is placed on the table.
        Room,
        /// A courtyard in the sun; the object is placed on the paving.
        Courtyard,
    }
}

engine::params! {
    /// Makes a synthetic scene for trying the whole pipeline: a captured place, an object to insert, and the
    /// true light.
    ///
    /// The light of the place is computed by light transport. The place is then captured as splats with the defects
    /// of a real capture: light clipped to white, view-dependent colours, blur, floaters, and holes where no camera
    /// looked. The object is meant to be placed at (0, 0, 0.44) in the room and at (0, 0, 0) in the courtyard:
    /// metres to the right, forward and up. These are x, y and z if `up` of the scene is "+z"; otherwise the axes
    /// are rotated accordingly. `truth_env` is the unclipped light that arrives `probe_height` above that point, as
    /// a reference for recovered light.
    pub struct DemoScene {
        /// Setting of the scene.
        place: Setting = Setting::Room, other("Courtyard");
        /// Approximate number of splats; they are smaller where the camera of `rig` looks closely.
        splats: u32 = 260000, range(2000, 4000000), other("5000");
        /// Image width of the camera in `rig`.
        width_px: u32 = 960, range(16, 8192), unit("px"), other("320");
        /// Image height of the camera in `rig`.
        height_px: u32 = 540, range(16, 8192), unit("px"), other("200");
        /// Width of the true environment; its height is half of it.
        truth_width_px: u32 = 512, range(16, 4096), unit("px"), other("64");
        /// Height of the point where `truth_env` is computed, above the surface that the object stands on.
        probe_height: f64 = 0.3, range(0.01, 1.5), unit("m"), other("0.6");
        /// Number of cameras in `capture`.
        capture: u32 = 100, range(2, 10000), other("5");
        /// Image width of the cameras in `capture`; the height is two thirds of it.
        capture_width_px: u32 = 480, range(16, 8192), unit("px"), other("60");
    }
}

engine::inputs! {
    /// No inputs.
    pub struct In {}
}

engine::outputs! {
    /// Outputs of `demo-scene`.
    pub struct Out {
        /// The place as splats.
        splats: Arc<Splats>,
        /// A closed mesh of the place, accurate to about 5 mm, with the captured colours at its vertices.
        proxy: Arc<Mesh>,
        /// A vase, a brass ball and a clay ball on a wooden plinth, about half a metre tall.
        object: Arc<Object>,
        /// One camera, `view`.
        rig: Arc<Rig>,
        /// The true light at the object, unclipped.
        truth_env: Arc<Environment>,
        /// Cameras on the way along which the place was captured, from `capture000`. Renders of `splats` by these
        /// cameras are photographs for `train-splats`.
        capture: Arc<Rig>,
    }
}

impl DemoCamera {
    fn new(layout: &Layout, params: &DemoScene) -> Self {
        let forward = (layout.target - layout.eye).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let (width, height) = (f64::from(params.width_px), f64::from(params.height_px));
        let (sin, cos) = num::sin_cos(layout.fov_y_deg * PI / 360.0);
        let focal = 0.5 * height * cos / sin;
        Self { eye: layout.eye, right, down: forward.cross(right), forward, focal, width, height }
    }

    /// Distance from the camera to a point. `None` unless the point lies in or near the frame of the picture.
    fn distance(&self, p: DVec3) -> Option<f64> {
        let way = p - self.eye;
        let depth = way.dot(self.forward);
        let (x, y) = (way.dot(self.right) * self.focal, way.dot(self.down) * self.focal);
        let inside =
            depth > 0.05 && x.abs() < 0.53 * self.width * depth && y.abs() < 0.54 * self.height * depth;
        inside.then(|| way.length())
    }

    /// Maximum size of a surface patch, in metres, for it to be no more than `pixels` pixels wide in the picture.
    /// Patches on back faces and outside the frame may be larger.
    fn patch_size(&self, p: DVec3, n: DVec3, size: f64, pixels: f64) -> f64 {
        let way = self.eye - p;
        let close = pixels / self.focal;
        // A large patch may reach into the frame though its middle lies outside.
        match self.distance(p) {
            Some(distance) => {
                let slant = n.dot(way / distance);
                let hidden = if slant < -0.05 { 3.0 } else { 1.0 };
                (close * distance * hidden).clamp(0.002, 0.25)
            }
            None if size > 0.3 => 0.3,
            None => (close * 9.0).clamp(0.02, 0.3),
        }
    }

    fn camera(&self, params: &DemoScene, world: &WorldFrame) -> Camera {
        let axes = [self.right, self.down, self.forward].map(|axis| world.turn(axis));
        let size = [params.width_px, params.height_px];
        Camera::centred("view", size, self.focal, axes, world.point(self.eye))
    }
}

impl Kind for DemoScene {
    const NAME: &'static str = "demo-scene";
    const VERSION: u32 = 4;
    const READS: &'static [ContextField] =
        &[ContextField::Seed, ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, _: &In) -> Cost {
        let splats = f64::from(params.splats);
        Cost { bytes: (splats * 600.0) as u64 + (64 << 20) }
    }

    fn work(params: &Self, _: &Sizes) -> f64 {
        f64::from(params.splats) + 50_000.0
    }

    fn run(params: &Self, _: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let seed = cx.seed();
        let world = WorldFrame { axes: equirect::axes(cx.up()), per_metre: 1.0 / cx.metres_per_unit() };
        let layout = match params.place {
            Setting::Room => room::layout(seed),
            Setting::Courtyard => courtyard::layout(seed),
        };
        let view = DemoCamera::new(&layout, params);
        let quads = &layout.shapes.quads;
        let lit = Lit::new(quads, layout.sky, layout.opening, layout.lamp, seed, cx)?;
        cx.progress(0.3);
        let (splats, defects) = capture::splats(&lit, &layout, &view, &world, params.splats as usize, cx)?;
        let proxy = proxy::mesh(&lit, &layout, &world, cx)?;
        cx.progress(0.95);
        let truth_env = truth(&lit, &layout, params, &world, cx)?;
        cx.count("splats", splats.len() as u64);
        cx.count("triangles", proxy.triangles.len() as u64);
        let mut notes = Notes::none();
        notes.count(
            "unseen-patches",
            defects.unseen,
            "of the patches had to be left out, because no camera of the capture saw them",
        );
        notes.count(
            "floaters",
            defects.floaters,
            "of the splats received a position in mid-air, like the floaters of a real capture",
        );
        let out = Out {
            splats: Arc::new(splats),
            proxy: Arc::new(proxy),
            object: Arc::new(object::still_life(seed)),
            rig: Arc::new(Rig { cameras: vec![view.camera(params, &world)] }),
            truth_env: Arc::new(truth_env),
            capture: Arc::new(view::capture(
                &layout.captures,
                (params.capture as usize, params.capture_width_px),
                &world,
            )),
        };
        Ok((out, notes))
    }
}

/// Unclipped light that arrives at the position of the object.
fn truth(
    lit: &Lit<'_>,
    layout: &Layout,
    params: &DemoScene,
    world: &WorldFrame,
    cx: &Context,
) -> Result<Environment, NodeError> {
    let width = params.truth_width_px as usize & !1;
    let height = width / 2;
    let from = DVec3::new(0.0, 0.0, layout.stand + params.probe_height);
    let effort = Effort { sky: 9, sun: 2, lamp: 3 };
    let rows = cx.for_each_tile(height, |y| {
        let mut row = Vec::with_capacity(width * 3);
        for x in 0..width {
            // Four rays per pixel: a lamp or a sun covers only a few pixels.
            let mut sum = [0.0; 3];
            for k in 0..4_u32 {
                let (a, b) = (0.25 + 0.5 * f64::from(k % 2), 0.25 + 0.5 * f64::from(k / 2));
                let (u, v) = ((x as f64 + a) / width as f64, (y as f64 + b) / height as f64);
                let toward = equirect::direction(Up::PlusZ, u, v);
                let key = 0x3000_0000 + ((y * width + x) as u64) * 4 + u64::from(k);
                sum = light::add(sum, lit.radiance(from, toward, key, effort), 0.25);
            }
            row.extend(sum.map(|v| v as f32));
        }
        row
    })?;
    let mut image = Image::from_samples(width, height, 3, rows.into_iter().flatten().collect());
    add_sun(lit, from, &mut image);
    Ok(Environment { image: image.into(), up: cx.up(), origin: Some(world.point(from)) })
}

/// Number of steps in radius, and also in angle, of the grid of points on the disc of the sun.
const SUN_POINTS: usize = 64;

/// Adds the sun, whose disc may be smaller than a pixel. The irradiance of the sun is divided equally among points
/// of the disc, and each visible point adds its share to the pixel that contains it.
fn add_sun(lit: &Lit<'_>, from: DVec3, image: &mut Image<Linear>) {
    let (width, height) = (image.width, image.height);
    let (a, b) = light::frame(lit.sky.sun);
    for i in 0..SUN_POINTS * SUN_POINTS {
        let (s, t) = ((i % SUN_POINTS) as f64 + 0.5, (i / SUN_POINTS) as f64 + 0.5);
        let (sin, cos) = num::sin_cos(2.0 * PI * t / SUN_POINTS as f64);
        let r = (s / SUN_POINTS as f64).sqrt() * lit.sky.sun_sine;
        let toward = (lit.sky.sun + a * (r * cos) + b * (r * sin)).normalize();
        if lit.hidden(from, toward) {
            continue;
        }
        let (u, v) = equirect::uv(Up::PlusZ, toward);
        let (x, y) = ((u * width as f64) as usize, (v * height as f64) as usize);
        let (x, y) = (x.min(width - 1), y.min(height - 1));
        let share = 1.0 / ((SUN_POINTS * SUN_POINTS) as f64 * equirect::pixel_solid_angle(width, height, y));
        for (to, sun) in image.pixel_mut(x, y).iter_mut().zip(lit.sky.sun_irradiance) {
            *to += (sun * share) as f32;
        }
    }
}

#[cfg(test)]
mod tests;
mod view;

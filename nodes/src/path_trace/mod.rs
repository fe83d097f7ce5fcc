//! `path-trace`: the receiver with and without the objects, and the objects, by path tracing.

mod aim;
pub mod bsdf;
pub mod contact;
pub mod emitters;
pub mod film;
pub mod light;
pub mod lookup;
pub mod objects;
pub mod rules;
pub mod scene;
mod shot;
pub mod walk;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, ParamType, Part, Sizes, ViewCount};
use glam::{DVec3, Vec3};
use serde::Serialize;

use crate::bvh::{Hit, Ray};
use crate::color::luminance;
use crate::error::Error;
use crate::sampling::{Points, hash, stream};
use crate::support::Level;
use crate::types::{Camera, Cell, Environment, Images, Mesh, NamedImage, Placed, Report, Rig, Table};
use contact::Ground;
use film::{Sums, TileSums, chunks};
use light::Sky;
use objects::Objects;
use rules::{Block, Bounce, EnvBlock, Probe, Rules, SpecularSees};
use scene::Receiver;
use shot::{Running, Shot, finish};
use walk::{Vertex, Walk, World};

engine::params! {
    /// Renders the receiver without and with the objects, and the objects themselves.
    ///
    /// `without` and `with` share every random number, so their ratio is exactly 1 where the objects change
    /// nothing. `with` hides the objects from the camera but from no other ray. `object` is premultiplied, with
    /// the share of the pixel that it covers in alpha, less where the receiver stands in front. In a closed
    /// room the receiver would keep out the light that the panorama already shows; `env_block`, `bounce` and
    /// `object_specular_sees` say how it treats each sort of ray, and by default that is found out.
    pub struct PathTrace {
        /// Paths a pixel.
        samples: u32 = 256, range(1, 1_048_576), other("3");
        /// How often light may be scattered after the first time.
        max_bounces: u32 = 8, range(0, 64), other("0");
        /// How the receiver blocks light of the environment.
        env_block: EnvBlock = EnvBlock::Auto, range(0, 1e9), other("Pass");
        /// What scattered rays find where they meet the receiver.
        bounce: Bounce = Bounce::Auto, other("Env");
        /// What reflections in objects show where they meet the receiver.
        object_specular_sees: SpecularSees = SpecularSees::Auto, other("Env");
        /// Largest radiance that one path may bring after its first vertex, 0 for no limit. Removes the bright
        /// dots of light that a glossy object throws, and some of that light with them.
        clamp_indirect: f64 = 0.0, range(0.0, 1e9), other("0.01");
        /// How far the receiver's height may be wrong where an object stands: what the camera sees of it within
        /// that of the object's base is taken to be level with the base. A mesh that lies too low would show a
        /// black gap under the object, one too high would hide its foot. `None` measures the mesh's roughness
        /// under each object and takes a smooth one as it is; 0 takes any as it is.
        contact_metres: Option<f64> = None, range(0.0, 10.0), unit("m"), other("0.5");
    }
}

engine::inputs! {
    /// Inputs of [`PathTrace`].
    pub struct In {
        /// The mesh that stands for the place; matte, of its vertex colours.
        receiver: Arc<Mesh>,
        /// The objects.
        objects: Vec<Arc<Placed>>,
        /// The cameras.
        rig: Arc<Rig>,
        /// The light.
        env: Arc<Environment>,
    }
}

engine::outputs! {
    /// Outputs of [`PathTrace`].
    pub struct Out {
        /// The receiver without the objects (R0); where the camera sees none, the environment.
        without: Arc<Images>,
        /// The receiver in the presence of the objects, which the camera does not see (R1).
        with: Arc<Images>,
        /// The objects: linear, premultiplied, alpha.
        object: Arc<Images>,
        /// Planar depth of what is in front, object or receiver, at the centre of each pixel; +inf for none.
        depth: Arc<Images>,
        /// Unit normal of the same point in world axes, towards the camera; 0 for none.
        normal: Arc<Images>,
        /// Variance of the mean over samples: of the luminance of `without`, `with` and `object` as if samples
        /// were independent (stratified points do better, so these are upper estimates), and of the ratio of
        /// luminance `with / without`, from the spread between chunks of samples.
        variance: Arc<Images>,
        /// Decisions, means, standard errors, rays.
        report: Arc<Report>,
    }
}

/// Sums a pixel of the part `r0`: RGB, squared luminance.
const R0: usize = 4;
/// Sums a pixel of the part `pair`: RGB and squared luminance of R1; RGB, alpha, squared luminance of O.
const PAIR: usize = 9;
/// Values a pixel of the part `front`: depth, normal.
const FRONT: usize = 4;
/// Sums a pixel over chunks, for the variance of the ratio.
const CROSS: usize = 3;

/// What the parts depend on beside their inputs.
#[derive(Serialize)]
struct Extra<'a> {
    view: View<'a>,
    rules: &'a Rules,
    origin: [f64; 3],
    seed: u64,
    range: (u32, u32),
    /// Up and the mesh's error where objects stand; absent for what does not depend on it.
    contact: Option<([f64; 3], Option<f64>)>,
}

/// A camera without its name, which changes no pixel.
#[derive(Serialize)]
struct View<'a> {
    size: (u32, u32),
    intrinsics: [f64; 4],
    world_from_camera: &'a [f64; 16],
}

impl<'a> View<'a> {
    fn of(camera: &'a Camera) -> Self {
        Self {
            size: (camera.width_px, camera.height_px),
            intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
            world_from_camera: &camera.world_from_camera,
        }
    }
}

/// The inputs in the form that rays want. Trees are built when a part first needs them.
struct Stage<'a> {
    inputs: &'a In,
    origin: DVec3,
    receiver: OnceLock<Receiver>,
    sky: OnceLock<Sky>,
}

impl Stage<'_> {
    fn receiver(&self) -> &Receiver {
        self.receiver.get_or_init(|| Receiver::new(&self.inputs.receiver, self.origin))
    }
    fn sky(&self) -> &Sky {
        self.sky.get_or_init(|| Sky::new(&self.inputs.env))
    }
}

/// The camera's rays.
struct Lens<'a> {
    camera: &'a Camera,
    eye: Vec3,
    /// Right, down and forward of the camera in the world.
    axes: [DVec3; 3],
    seed: u64,
    ground: &'a Ground,
}

impl<'a> Lens<'a> {
    fn new(camera: &'a Camera, origin: DVec3, seed: u64, ground: &'a Ground) -> Self {
        let pose = camera.world_from_camera();
        let axes = [pose.x_axis, pose.y_axis, pose.z_axis].map(|axis| axis.truncate());
        Self { camera, eye: rules::framed(camera.eye(), origin), axes, seed, ground }
    }

    fn through(&self, x: f64, y: f64) -> Ray {
        let Camera { fx, fy, cx, cy, .. } = *self.camera;
        let [right, down, forward] = self.axes;
        let direction = right * ((x - cx) / fx) + down * ((y - cy) / fy) + forward;
        Ray::new(self.eye, direction.normalize().as_vec3())
    }

    /// The points, hash key and camera ray of a sample: uniform over the pixel, a box filter.
    fn sample(&self, (x, y): (u32, u32), sample: u32) -> (Points, u32, Ray) {
        let stream = stream(self.seed, x, y);
        let points = Points::new(stream, sample);
        let [dx, dy] = points.pair(0);
        let ray = self.through(f64::from(x) + f64::from(dx), f64::from(y) + f64::from(dy));
        (points, hash(stream, sample), ray)
    }
}

impl PathTrace {
    /// Decides what was left to `Auto`, and tells.
    fn decide(
        &self,
        stage: &Stage<'_>,
        centre: DVec3,
        metres_per_unit: f64,
        notes: &mut Notes,
    ) -> (Rules, Option<Probe>) {
        let from = rules::framed(centre, stage.origin);
        let needs_probe = matches!(self.env_block, EnvBlock::Auto | EnvBlock::FrontFace { .. });
        let probe = needs_probe.then(|| Probe::send(stage.receiver(), from));
        let seen = |p: &Probe| {
            format!(
                "{:.1} % of {} probe rays leave, {:.1} % of the others meet a front face",
                100.0 * p.escaped_share(),
                p.rays,
                100.0 * p.front_share()
            )
        };
        let block = match (self.env_block, probe) {
            (EnvBlock::Solid, _) => Block::Solid,
            (EnvBlock::Pass, _) => Block::Pass,
            (EnvBlock::Paper, _) => Block::Solid,
            (EnvBlock::PassBeyond { metres }, _) => {
                Block::PassBeyond { centre: from.to_array(), radius: rules::units(metres, metres_per_unit) }
            }
            (EnvBlock::FrontFace { max_layers }, probe) => {
                if let Some(p) = probe.filter(|p| p.escaped < p.rays && p.front_share() <= 0.1) {
                    let text = format!("the normals seem to point out of the room: {}", seen(&p));
                    notes.warning("normals-outward", text);
                }
                Block::FrontFace { max_layers, flip: false }
            }
            (EnvBlock::Auto, probe) => {
                let probe = probe.unwrap_or_default();
                let block = probe.decide();
                let name = match block {
                    Block::Solid => "Solid",
                    Block::FrontFace { flip: true, .. } => "FrontFace with normals turned round",
                    Block::FrontFace { .. } => "FrontFace",
                    _ => "Pass",
                };
                notes.decision("env-block", format!("{name}: {}", seen(&probe)));
                block
            }
        };
        let solid = block == Block::Solid;
        let printed = self.env_block == EnvBlock::Paper;
        let rules = Rules {
            block,
            bounce_solid: match self.bounce {
                _ if printed => true,
                Bounce::Auto => solid,
                Bounce::Env => false,
                Bounce::Solid => true,
            },
            specular_env: match self.object_specular_sees {
                _ if printed => true,
                SpecularSees::Auto => !solid || stage.inputs.env.origin.is_some(),
                SpecularSees::Env => true,
                SpecularSees::Receiver => false,
            },
            printed,
            max_bounces: self.max_bounces,
            // The key takes no infinity.
            clamp: if self.clamp_indirect > 0.0 { self.clamp_indirect as f32 } else { f32::MAX },
        };
        if rules.bounce_solid && block != Block::Solid {
            // Each bounce returns the albedo's share of what falls on a wall: in a closed room all of them
            // together a / (1 - a), at most.
            let albedo = stage.receiver().mean_albedo();
            let most = 100.0 * albedo / (1.0 - albedo).max(1e-3);
            let text = format!(
                "light of the room counts twice, in the environment and off its walls: up to {most:.0} % too much"
            );
            notes.warning("double-count", text);
        }
        (rules, probe)
    }
}

/// Adds a sample, unless it is not finite.
fn add(sums: &mut [f64], light: Vec3, broken: &mut u64) -> bool {
    if !light.is_finite() {
        *broken += 1;
        return false;
    }
    let rgb = light.to_array();
    for (sum, v) in sums.iter_mut().zip(rgb) {
        *sum += f64::from(v);
    }
    true
}

fn squared_luminance(light: Vec3) -> f64 {
    let y = f64::from(luminance(light.to_array()));
    y * y
}

/// What a ray of the camera meets of the receiver.
fn receiver_hit(world: &World<'_>, ray: Ray) -> Option<Hit> {
    if world.rules.printed { None } else { world.receiver.bvh.closest(ray, |_| true) }
}

/// The receiver without the objects over some pixels.
fn trace_r0(world: World<'_>, lens: &Lens<'_>, pixels: &[(u32, u32)], range: (u32, u32)) -> TileSums {
    let mut tile = TileSums::default();
    for &pixel in pixels {
        let mut sums = [0.0; R0];
        for sample in range.0..range.1 {
            let (points, key, ray) = lens.sample(pixel, sample);
            let mut walk = Walk::new(world, points, key, false);
            let light = match receiver_hit(&world, ray) {
                Some(hit) => walk.radiance::<false>(Vertex::Receiver(hit), ray.direction),
                None => world.sky.seen(ray.direction),
            };
            tile.rays += walk.rays + 1;
            if add(&mut sums, light, &mut tile.broken) {
                sums[3] += squared_luminance(light);
            }
        }
        tile.push(&sums);
    }
    tile
}

/// The receiver with the objects, and the objects, over some pixels. `r0` are the sums of the same samples
/// without objects: a sample none of whose rays meets an object is in them already, bit for bit, so only
/// the others are traced, with and without the objects, for what these change.
fn trace_pair(
    world: World<'_>,
    lens: &Lens<'_>,
    pixels: &[(u32, u32)],
    range: (u32, u32),
    r0: &Sums,
) -> TileSums {
    let mut tile = TileSums::default();
    let objects = world.objects;
    for &pixel in pixels {
        let mut sums = [0.0; PAIR];
        let at = (pixel.1 as usize * lens.camera.width_px as usize + pixel.0 as usize) * R0;
        let known: [f64; R0] = std::array::from_fn(|k| f64::from(r0.sums[at + k]));
        let (mut with, mut without) = ([0.0; R0], [0.0; R0]);
        let mut touched = 0;
        let samples = if objects.is_empty() { range.0..range.0 } else { range.0..range.1 };
        for sample in samples {
            let (points, key, ray) = lens.sample(pixel, sample);
            tile.rays += 2;
            let front = objects.bvh.closest(ray, |hit| objects.accepts(hit, key, true));
            let landed = receiver_hit(&world, ray).map(|hit| (hit, shift(&world, lens, &hit, ray)));
            if let Some(front) = front
                && landed.is_none_or(|(hit, shift)| front.t <= hit.t + shift)
            {
                let mut walk = Walk::new(world, points, key, true);
                let light = walk.radiance::<false>(Vertex::Object(front), ray.direction);
                tile.rays += walk.rays;
                if add(&mut sums[4..], light, &mut tile.broken) {
                    sums[7] += 1.0;
                    sums[8] += squared_luminance(light);
                }
            }
            let Some((hit, shift)) = landed else { continue };
            let lift = ray.direction * shift;
            let mut probe = Walk::new(world, points, key, true);
            probe.lift = lift;
            probe.radiance::<true>(Vertex::Receiver(hit), ray.direction);
            tile.rays += probe.rays;
            if !probe.touched {
                continue;
            }
            touched += 1;
            for (there, sums) in [(true, &mut with), (false, &mut without)] {
                let mut walk = Walk::new(world, points, key, there);
                walk.lift = lift;
                let light = walk.radiance::<false>(Vertex::Receiver(hit), ray.direction);
                tile.rays += walk.rays;
                let mut counted = 0;
                if add(sums, light, &mut counted) {
                    sums[3] += squared_luminance(light);
                }
                // Without the objects it was counted before.
                tile.broken += if there { counted } else { 0 };
            }
        }
        // Where every sample is touched nothing of the sums without objects is left, nor of their rounding.
        let all = touched == range.1 - range.0;
        for k in 0..R0 {
            sums[k] = if all { with[k] } else { (known[k] + (with[k] - without[k])).max(0.0) };
        }
        tile.untouched += u64::from(touched == 0);
        tile.push(&sums);
    }
    tile
}

/// How far the camera's hit of the receiver moves along its ray to lie where objects stand.
fn shift(world: &World<'_>, lens: &Lens<'_>, hit: &Hit, ray: Ray) -> f32 {
    let position = ray.origin + ray.direction * hit.t;
    lens.ground.shift(position, world.receiver.normal(hit.triangle), ray.direction)
}

/// Depth and normal of what is in front at the centres of some pixels.
fn trace_front(world: World<'_>, lens: &Lens<'_>, pixels: &[(u32, u32)]) -> TileSums {
    let mut tile = TileSums::default();
    for &(x, y) in pixels {
        let ray = lens.through(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let key = hash(stream(lens.seed, x, y), 0);
        tile.rays += 2;
        let object = world.objects.bvh.closest(ray, |hit| world.objects.accepts(hit, key, true));
        let landed = receiver_hit(&world, ray);
        let out = -ray.direction;
        let (t, normal) = match (object, landed) {
            (Some(hit), landed) if landed.is_none_or(|l| hit.t <= l.t + shift(&world, lens, &l, ray)) => {
                (hit.t, world.objects.surface(&hit, out, false).normal)
            }
            (_, Some(hit)) => (hit.t, world.receiver.surface(&hit).normal),
            _ => (f32::INFINITY, Vec3::ZERO),
        };
        let depth = if t.is_finite() {
            f64::from(t) * ray.direction.as_dvec3().dot(lens.axes[2])
        } else {
            f64::INFINITY
        };
        let [a, b, c] = normal.to_array().map(f64::from);
        tile.push(&[depth, a, b, c]);
    }
    tile
}

fn columns(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

impl Kind for PathTrace {
    const NAME: &'static str = "path-trace";
    const VERSION: u32 = 4;
    const READS: &'static [ContextField] =
        &[ContextField::MetresPerUnit, ContextField::Seed, ContextField::Up];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_params: &Self, inputs: &In) -> Cost {
        let pixels: u64 =
            inputs.rig.cameras.iter().map(|c| u64::from(c.width_px) * u64::from(c.height_px)).sum();
        let triangles: usize =
            inputs.objects.iter().flat_map(|o| &o.object.primitives).map(|p| p.triangles.len()).sum();
        // Running sums in f64, one chunk and its tiles in f32, and the finished pictures.
        let pixel_bytes = ((R0 + PAIR + CROSS) * 8 + (R0 + PAIR + FRONT) * 4 * 2 + 18 * 4) as u64;
        let scene = (inputs.receiver.triangles.len() * 300 + triangles * 300) as u64;
        let sky = inputs.env.image.samples.len() as u64 * 12;
        Cost { bytes: pixels * pixel_bytes + scene + sky }
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        sizes.of("rig") * f64::from(params.samples)
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        if params.env_block.within(0.0, 0.0) {
            return Ok(());
        }
        let hint = "max_layers lies between 1 and 16; metres is at least 0";
        Err(NodeError::new("env_block is out of range").at("env_block").hint(hint))
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["rig"])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        if inputs.rig.cameras.is_empty() {
            return Err(NodeError::from(Error::Mismatch("the rig has no camera".to_owned())).at("rig"));
        }
        // Coordinates are taken relative to the middle of the receiver, so that a scene far from the
        // origin of its world keeps its precision.
        let origin = middle(&inputs.receiver).unwrap_or_else(|| inputs.rig.cameras[0].eye());
        let stage = Stage { inputs: &inputs, origin, receiver: OnceLock::new(), sky: OnceLock::new() };
        let centre = match inputs.env.origin {
            Some(origin) => origin,
            None => {
                if matches!(params.env_block, EnvBlock::Auto | EnvBlock::PassBeyond { .. }) {
                    let text = "the environment has no point of capture; the first camera stands for it";
                    notes.decision("probe-origin", text);
                }
                inputs.rig.cameras[0].eye()
            }
        };
        let (rules, probe) = params.decide(&stage, centre, cx.metres_per_unit(), &mut notes);
        let objects = Objects::new(&inputs.objects, origin)?;
        remark(&stage, &objects, &mut notes);

        let seed = cx.seed();
        let [_, _, up] = crate::equirect::axes(cx.up());
        let metre = 1.0 / cx.metres_per_unit();
        let (ground, felt) =
            Ground::feel(stage.receiver(), &inputs.objects, origin, up, metre, params.contact_metres);
        tell(&felt, cx.metres_per_unit(), &mut notes);
        let contact = (up.to_array(), params.contact_metres);
        let chunks = chunks(params.samples);
        let total = inputs.rig.cameras.iter().map(|c| tiles(c) * (2 * chunks.len() + 1)).sum::<usize>();
        let done = AtomicUsize::new(0);
        let step = || {
            let now = done.fetch_add(1, Ordering::Relaxed) + 1;
            cx.progress(now as f32 / total.max(1) as f32);
        };
        let world =
            || World { receiver: stage.receiver(), objects: &objects, sky: stage.sky(), rules: &rules };
        let mut shots = Vec::with_capacity(inputs.rig.cameras.len());
        for camera in &inputs.rig.cameras {
            let lens = Lens::new(camera, origin, seed, &ground);
            let extra = |range, contact| Extra {
                view: View::of(camera),
                rules: &rules,
                origin: origin.to_array(),
                seed,
                range,
                contact,
            };
            let mut running = Running::new(camera);
            for &range in &chunks {
                let part = Part { name: "r0", version: 2, inputs: &["receiver", "env"] };
                let r0 = cx.part(part, &extra(range, None), || {
                    let world = world();
                    let sums = Sums::trace(cx, camera, R0, step, |tile| trace_r0(world, &lens, tile, range))?;
                    cx.count("rays", sums.rays);
                    Ok(sums)
                })?;
                expect_size(&r0, camera, R0)?;
                let part = Part { name: "pair", version: 4, inputs: &["receiver", "objects", "env"] };
                let pair = cx.part(part, &extra(range, Some(contact)), || {
                    let world = world();
                    let trace = |tile: &[(u32, u32)]| trace_pair(world, &lens, tile, range, &r0);
                    let sums = Sums::trace(cx, camera, PAIR, step, trace)?;
                    cx.count("rays", sums.rays);
                    Ok(sums)
                })?;
                expect_size(&pair, camera, PAIR)?;
                running.add(&r0, &pair, range);
            }
            let part = Part { name: "front", version: 2, inputs: &["receiver", "objects"] };
            let front = cx.part(part, &extra((0, 0), Some(contact)), || {
                let world = world();
                Sums::trace(cx, camera, FRONT, step, |tile| trace_front(world, &lens, tile))
            })?;
            expect_size(&front, camera, FRONT)?;
            shots.push(finish(camera, params.samples, &running, &front));
        }
        let broken: u64 = shots.iter().map(|shot| shot.broken).sum();
        if broken > 0 {
            notes.warning("not-finite", format!("{broken} samples were not finite and count as black"));
        }
        for (camera, shot) in inputs.rig.cameras.iter().zip(&shots) {
            let object = &shot.images[2];
            let seen = object.samples.chunks_exact(object.channels).any(|pixel| pixel[3] > 0.0);
            if !inputs.objects.is_empty() && !seen {
                let text = format!(
                    "`{}` sees no object; do pose, rig and mesh share a frame and a scale?",
                    camera.name
                );
                notes.warning("objects-not-seen", text);
            }
        }
        Ok((assemble(&inputs.rig, shots, &rules, probe, centre), notes))
    }
}

fn tiles(camera: &Camera) -> usize {
    (camera.width_px as usize).div_ceil(film::TILE) * (camera.height_px as usize).div_ceil(film::TILE)
}

fn expect_size(sums: &Sums, camera: &Camera, channels: usize) -> Result<(), NodeError> {
    let expected = camera.width_px as usize * camera.height_px as usize * channels;
    if sums.sums.len() == expected { Ok(()) } else { Err(NodeError::new("a stored part has another size")) }
}

/// The middle of the box around a mesh.
fn middle(mesh: &Mesh) -> Option<DVec3> {
    let finite = mesh.positions.iter().map(|p| DVec3::from_array(p.map(f64::from))).filter(|p| p.is_finite());
    let (low, high) = finite.map(|p| (p, p)).reduce(|(low, high), (p, _)| (low.min(p), high.max(p)))?;
    Some((low + high) * 0.5)
}

/// Tells what the inputs made the node leave out or assume.
fn remark(stage: &Stage<'_>, objects: &Objects, notes: &mut Notes) {
    let mesh = &stage.inputs.receiver;
    if mesh.colours.is_empty() && !mesh.triangles.is_empty() {
        notes.decision("grey-receiver", "the receiver has no vertex colours and is grey, albedo 0.5");
    }
    let receiver = stage.receiver();
    let counts = [
        ("clamped-albedo", receiver.clamped, "vertex colours outside of 0 to 1 were clamped"),
        ("receiver-not-finite", receiver.bvh.broken, "triangles of the receiver are not finite"),
        ("receiver-degenerate", receiver.bvh.degenerate, "triangles of the receiver have no area"),
        ("object-not-finite", objects.bvh.broken, "triangles of the objects are not finite"),
        ("object-degenerate", objects.bvh.degenerate, "triangles of the objects have no area"),
        ("dark-texels", stage.sky().broken, "samples of the environment were negative or not finite"),
    ];
    for (id, n, text) in counts {
        if n > 0 {
            notes.count(id, n, text);
        }
    }
}

/// Tells how far the mesh misses the bases of objects that stand on it.
fn tell(felt: &[Option<Level>], metres_per_unit: f64, notes: &mut Notes) {
    let millimetres = |v: f64| v * metres_per_unit * 1e3;
    let each = felt.iter().enumerate().filter_map(|(index, felt)| {
        let level = (*felt)?;
        let (offset, roughness) = (millimetres(level.height), millimetres(level.roughness));
        Some(format!("{roughness:.1} mm rough and {offset:+.1} mm over the base of object {index}"))
    });
    let each: Vec<String> = each.collect();
    if !each.is_empty() {
        notes.decision("contact", format!("the receiver is {}", each.join("; ")));
    }
}

fn assemble(rig: &Rig, shots: Vec<Shot>, rules: &Rules, probe: Option<Probe>, centre: DVec3) -> Out {
    let mut sets: [Vec<NamedImage>; 6] = Default::default();
    let mut rows = Vec::with_capacity(shots.len());
    let mut rays = 0;
    for (camera, shot) in rig.cameras.iter().zip(shots) {
        let [without, with, object] = shot.images;
        let pictures = [
            without.into(),
            with.into(),
            object.into(),
            shot.depth.into(),
            shot.normal.into(),
            shot.variance.into(),
        ];
        for (set, picture) in sets.iter_mut().zip(pictures) {
            set.push(NamedImage { name: camera.name.clone(), picture });
        }
        rows.push(shot.row);
        rays += shot.rays;
    }
    let text = |value: String| Cell::Text(value);
    let mut decisions = vec![
        vec![text("env_block".to_owned()), text(format!("{:?}", rules.block))],
        vec![text("bounce".to_owned()), text(if rules.bounce_solid { "Solid" } else { "Env" }.to_owned())],
        vec![
            text("object_specular_sees".to_owned()),
            text(if rules.specular_env { "Env" } else { "Receiver" }.to_owned()),
        ],
        vec![text("point of capture".to_owned()), text(format!("{:?}", centre.to_array()))],
        vec![text("rays".to_owned()), Cell::Count(rays)],
    ];
    if let Some(probe) = probe {
        decisions.push(vec![text("probe rays that leave".to_owned()), Cell::Number(probe.escaped_share())]);
        decisions
            .push(vec![text("front faces among the others".to_owned()), Cell::Number(probe.front_share())]);
    }
    let report = Report {
        title: "Path tracing".to_owned(),
        tables: vec![
            Table { name: "decisions".to_owned(), columns: columns(&["what", "value"]), rows: decisions },
            Table {
                name: "views".to_owned(),
                columns: columns(&[
                    "view",
                    "mean luminance of without",
                    "standard error of a pixel of without",
                    "mean luminance of with",
                    "standard error of a pixel of with",
                    "mean luminance of object",
                    "standard error of a pixel of object",
                    "rays",
                    "share of chunks that no object touches",
                ]),
                rows,
            },
        ],
    };
    let [without, with, object, depth, normal, variance] = sets.map(|set| Arc::new(Images(set)));
    Out { without, with, object, depth, normal, variance, report: Arc::new(report) }
}

#[cfg(test)]
mod tests;

//! `path-trace`: the receiver with and without the objects, and the objects, by path tracing.

mod accumulator;
pub mod attributes;
mod auto;
pub mod bsdf;
mod camera_rays;
mod capture_point;
mod cell_grid;
mod change;
pub mod contact;
mod crop;
mod direct_light;
mod emission;
pub mod emitters;
pub(crate) mod env_resolution;
pub mod environment;
pub mod film;
mod first_hit;
pub mod integrator;
mod irradiance_bound;
mod lamp_light;
mod light_cells;
mod light_distribution;
mod light_draws;
mod light_points;
mod lobes;
pub mod media;
pub mod mipmap;
mod near_crop;
pub mod near_field;
mod object_surface;
pub mod objects;
mod pair;
mod path;
mod prepared;
pub mod receiver;
mod reporting;
mod sample_plan;
mod shades;
mod silhouette;
mod stacked;
mod subdivide;
mod sunk;
mod texel_grid;
mod tile;
mod tile_bounds;
pub mod touching;
mod transmittance;
mod unseen;
pub mod visibility;
mod window;

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Part, Sizes, ViewCount};
use glam::Vec3;
use serde::Serialize;

use crate::error::Error;
use crate::types::{Environment, Images, Mesh, Placed, Report, Rig};
use accumulator::{Accumulator, FinishedView, finish};
use camera_rays::{CameraRays, View};
use contact::Ground;
use crop::Crop;
use env_resolution::EnvResolution;
use film::{Area, Sums, TILE, chunks};
use first_hit::{PLACES, trace_first_hit};
use integrator::Scene;
use objects::Objects;
use pair::{trace_pair, trace_r0};
use prepared::PreparedScene;
use reporting::{
    assemble, report_coarse_coordinates, report_contact, report_cropped, report_cut_paths, report_darkness,
    report_inputs, report_plan, report_unseen, report_unseen_places, report_variance, tell_first,
};
use sample_plan::ErrorGoal;
use sunk::Sunk;
use tile_bounds::TileBounds;
use touching::Touching;
use visibility::{Bounce, EnvBlock, NearField, Probe, Rules, SpecularSees};

engine::params! {
    /// Renders the receiver without and with the objects, and the objects themselves.
    ///
    /// `with` is `without` plus what the objects change of it, so their ratio is exactly 1 where they change
    /// nothing. In `with` the objects are hidden from the camera but from no other ray. `object` is premultiplied; its
    /// alpha is the share of the pixel that it covers, less where the receiver stands in front. In a closed
    /// room the receiver would keep out the light that the panorama already shows; `env_block`, `bounce` and
    /// `object_specular_sees` say how it treats each sort of ray, and by default the scene decides.
    pub struct PathTrace {
        /// Paths per pixel, or with `max_error` the most of them, which is 4 at least.
        samples: u32 = 256, range(1, 1_048_576), other("3"), knob(Samples, "4", "16", "64", "1024");
        /// Standard error to reach in every tile of 8 by 8 pixels, as root mean square over the pixels that have one: of
        /// the ratio `with / without` where it is seen (relative to it where it is surely above 1, and left out where
        /// `without` is below a thousandth of its median), and of `object` relative to its mean. 4 samples of the
        /// whole picture show which blocks of 32 by 32 pixels need more; each takes them, in chunks, until the error
        /// or `samples` is reached, which is reported. None takes `samples` everywhere.
        max_error: Option<f64> = None, range(1e-6, 1.0), other("0.5"), knob(Cutoff, "", "", "", "None");
        /// How often light may be scattered after the first time.
        max_bounces: u32 = 8, range(0, 64), other("0"), knob(Depth, "2", "4", "8", "32");
        /// How the receiver blocks light of the environment.
        env_block: EnvBlock = EnvBlock::Auto, other("Pass");
        /// What scattered rays find where they meet the receiver.
        bounce: Bounce = Bounce::Auto, other("Env");
        /// What reflections in objects show where they meet the receiver.
        object_specular_sees: SpecularSees = SpecularSees::Auto, other("Env");
        /// Whether the receiver is the light that the environment shows of it, so that a lamp on a wall lights
        /// each point from where it is.
        near_field: NearField = NearField::Auto, other("Off");
        /// Largest radiance that one path may bring after its first vertex, 0 for no limit. Removes the bright
        /// dots of light that a glossy object throws, and some of that light with them.
        clamp_indirect: f64 = 0.0, range(0.0, 1e9), other("0.01"), knob(Limit, "", "", "", "0.0");
        /// How far the receiver's height may be wrong where an object stands: where the camera sees the receiver within
        /// this distance of the height of the object's base, it is taken to be level with the base. Otherwise a mesh that
        /// lies too low would show a black gap under the object, and one too high would hide its foot. `None` measures the
        /// mesh's roughness under each object and takes a smooth one as it is; 0 takes any as it is.
        contact_metres: Option<f64> = None, range(0.0, 10.0), unit("m"), other("0.5");
        /// Whether to trace only what the objects change of the receiver: for a graph that wants only the shadow, and takes
        /// the objects from elsewhere or not at all. `object` stays empty; depth and normals are those of the receiver.
        shadow_only: bool = false, other("true");
        /// Side of the blocks of which one pixel is traced and shown for all: the preview that `watch` shows before
        /// all pixels are traced. 1 traces every pixel.
        coarse_px: u32 = 1, range(1, 64), unit("px"), other("2");
        /// Where the objects provably change no more than this share of the light of a tile of 8 by 8 pixels, `with` is
        /// `without` and no ray is traced for it. The change is bounded, not estimated, so nothing is left out in
        /// shadow, near bright things, or wherever a wall may reflect their light. 0 traces everywhere.
        crop: f64 = 0.001, range(0.0, 0.1), other("0.1"), knob(Cutoff, "0.004", "0.002", "0.001", "0.0");
        /// Whether to leave out lobes that a material does not have; evaluating them anyway gives the same bits.
        skip_lobes: bool = true, inert("what is left out has no strength: only work is saved");
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
        /// Planar depth of what is in front, object or receiver, at the centre of each pixel; +inf for none. Of
        /// what is blended, where it covers more than half.
        depth: Arc<Images>,
        /// Planar depth of the nearest of the objects that is seen anywhere in the pixel, however little it covers; where
        /// there is none, `depth`. For `splat-render(limit:)`: what lies before it is in front of the objects.
        nearest: Arc<Images>,
        /// Unit normal of the same point in world axes, towards the camera; 0 for none.
        normal: Arc<Images>,
        /// Variance of the mean over samples: of the luminance of `without`, `with` and `object`, and of the ratio
        /// of luminance `with / without`. As if samples were independent: stratified points do better, so these are
        /// upper estimates. One sample tells none: then all are 0.
        variance: Arc<Images>,
        /// Decisions, means, standard errors, rays.
        report: Arc<Report>,
    }
}

impl PathTrace {
    /// The most samples of a pixel: an error is judged by a first chunk, whatever `samples` says.
    fn most(&self) -> u32 {
        if self.max_error.is_some() { self.samples.max(film::FIRST) } else { self.samples }
    }
}

/// Sums a pixel of the part `r0`: RGB, and the root of that of squared luminance, since squares leave the range of
/// single precision where light does not.
const R0: usize = 4;
/// Sums a pixel of the part `pair`: RGB of R1 and the root of that of the squared luminance of R1 - R0; RGB, alpha and
/// the root of that of the squared luminance of O.
const PAIR: usize = 9;
/// Values a pixel of the part `front`: depth, that of the nearest object, normal.
const FIRST_HIT: usize = 5;

/// Bytes that parts store of a pixel and chunk: 53.
const _: () = assert!((R0 + PAIR) * 4 + (TileBounds::VALUES * 4).div_ceil((TILE * TILE) as usize) <= 64);

/// Sums a pixel over chunks, for how far these lie apart.
const CROSS: usize = 4;

/// What the parts depend on beside their inputs.
#[derive(Serialize)]
struct Extra<'a> {
    view: View<'a>,
    rules: &'a Rules,
    origin: [f64; 3],
    seed: u64,
    area: Area,
    coarse_px: u32,
    range: (u32, u32),
    /// Up, metres per unit and the mesh's error where objects stand; absent for what does not depend on it.
    contact: Option<([f64; 3], f64, Option<f64>)>,
    /// What may be left out; absent likewise.
    crop: Option<f64>,
    /// Leaves out what the objects show.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    shadow_only: bool,
    /// Evaluates what is 0, for those who want to see that; in the key, so that it is done.
    every_lobe: bool,
}

impl Kind for PathTrace {
    const NAME: &'static str = "path-trace";
    const VERSION: u32 = 18;
    const READS: &'static [ContextField] =
        &[ContextField::MetresPerUnit, ContextField::Seed, ContextField::Up];
    const REFINES: Option<&'static str> = Some("samples");
    const COARSE: Option<&'static str> = Some("coarse_px");
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_params: &Self, inputs: &In) -> Cost {
        let pixels: u64 =
            inputs.rig.cameras.iter().map(|c| u64::from(c.width_px) * u64::from(c.height_px)).sum();
        let triangles: usize =
            inputs.objects.iter().flat_map(|o| &o.object.primitives).map(|p| p.triangles.len()).sum();
        // Running sums in f64, one chunk and its tiles in f32, and the finished pictures.
        let pixel_bytes = ((R0 + PAIR + CROSS) * 8 + (R0 + PAIR + FIRST_HIT) * 4 * 2 + 20 * 4) as u64;
        let scene = (inputs.receiver.triangles.len() * 300 + triangles * 300) as u64;
        let sky = inputs.env.image.samples.len() as u64 * 12;
        Cost { bytes: pixels * pixel_bytes + scene + sky }
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        let samples = f64::from(params.most());
        // A guess: at the edge of a shadow one sample is off by 0.2, and such tiles are a tenth of the picture.
        let all = params.max_error.map_or(samples, |error| 4.0 + 0.1 * (0.2 / error) * (0.2 / error));
        let coarse = f64::from(params.coarse_px);
        sizes.of("rig") * all.min(samples) / (coarse * coarse)
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        if params.near_field == NearField::On && params.env_block == EnvBlock::Paper {
            let text = "the printed visibility has no near field: the camera does not see the receiver";
            return Err(NodeError::new(text)
                .at("near_field")
                .hint("leave `near_field` to `Auto`, or `env_block`"));
        }
        match params.env_block.out_of_range() {
            Some(text) => Err(NodeError::new(text).at("env_block")),
            None => Ok(()),
        }
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["rig"])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        if !crate::num::keeps_subnormals() {
            let hint = "start the program without the library that asks for it, perhaps one in LD_PRELOAD";
            let text = "this process takes the smallest numbers for 0, so that its pictures would be those of no other";
            return Err(NodeError::new(text).hint(hint));
        }
        if inputs.rig.cameras.is_empty() {
            return Err(NodeError::from(Error::Mismatch("the rig has no camera".to_owned())).at("rig"));
        }
        if params.near_field == NearField::On && inputs.env.origin.is_none() {
            let hint = "give `load-environment` its `origin`, or leave `near_field` to `Auto`";
            let text = "near_field needs an environment with a point of capture";
            return Err(NodeError::new(text).at("near_field").hint(hint));
        }
        // Coordinates start at the first camera: what single precision loses grows with the distance from it, as
        // what a pixel covers does. No stray triangle moves it, nor the pose of an object.
        let origin = inputs.rig.cameras[0].eye();
        let prepared = PreparedScene::new(&inputs, origin);
        let camera = capture_point::stand_in(prepared.receiver(), &inputs.rig.cameras, origin);
        let centre = match inputs.env.origin {
            Some(origin) => origin,
            None => {
                if matches!(params.env_block, EnvBlock::Auto | EnvBlock::PassBeyond { .. }) {
                    let text = format!(
                        "the environment has no point of capture; camera `{}` stands for it",
                        camera.name
                    );
                    notes.decision("probe-origin", text);
                }
                camera.eye()
            }
        };
        let [_, _, up] = crate::equirect::axes(cx.up());
        let decided = params.decide(&prepared, centre, (up, cx.metres_per_unit()), &mut notes);
        let rules = decided.rules;
        let mut objects = Objects::new(Some(prepared.receiver()), &inputs.objects, origin)?;
        objects.every_lobe = !params.skip_lobes;
        objects.shown = !params.shadow_only;
        report_inputs(&prepared, &objects, &mut notes);
        if !objects.is_empty() {
            let most = inputs.env.image.width;
            EnvResolution::of(&inputs.env, &inputs.objects, most).report(&inputs.env, &mut notes);
        }

        report_coarse_coordinates(&prepared, &objects, &mut notes);
        if let Some(eye) = rules.near {
            let boxes = objects.boxes();
            report_unseen_places(prepared.receiver(), Vec3::from_array(eye), &boxes, &mut notes);
        }

        let seed = cx.seed();
        let metre = 1.0 / cx.metres_per_unit();
        let view = Probe::send(prepared.receiver(), visibility::in_scene_frame(camera.eye(), origin));
        let inverted = view.escaped < view.rays && view.front_share() < 0.5;
        // What rests on another object has that for its ground.
        let on_others = objects.on_others(&inputs.objects, origin, up, metre);
        let standing: Vec<_> = inputs
            .objects
            .iter()
            .zip(&on_others)
            .filter(|(_, on)| !**on)
            .map(|(one, _)| one.clone())
            .collect();
        let ground = (prepared.receiver(), inverted);
        let (ground, of_standing) =
            Ground::measure(ground, &standing, origin, up, metre, params.contact_metres);
        let mut of_standing = of_standing.into_iter();
        let measured: Vec<_> =
            on_others.iter().map(|on| if *on { None } else { of_standing.next().flatten() }).collect();
        let carried = objects.carried(&inputs.objects, origin, up, metre);
        let tall: Vec<f64> =
            objects.boxes().into_iter().map(|(low, high)| (high - low).as_dvec3().dot(up.abs())).collect();
        if params.contact_metres.is_none() {
            report_contact(&measured, &carried, &tall, cx.metres_per_unit(), &mut notes);
        }
        let stands = |index: usize| {
            measured[index].is_some_and(|level| contact::is_near(&level, metre)) || carried[index]
        };
        Sunk::report(&objects, prepared.receiver(), stands, cx.metres_per_unit(), &mut notes);
        objects.touching = Touching::of(&objects, prepared.receiver(), &ground);
        objects.ground = ground;
        let contact = (up.to_array(), cx.metres_per_unit(), params.contact_metres);
        let limit = (params.crop > 0.0).then_some(params.crop);
        let most = params.most();
        tell_first(params.samples, most, &mut notes);
        // Without an error to reach every sample is in the plan.
        let chunks = chunks(most);
        let (first, share) =
            if params.max_error.is_some() { (&chunks[..1], 0.1) } else { (&chunks[..], 1.0) };
        let near = rules.near.filter(|_| !objects.is_empty());
        let scene = || Scene {
            receiver: prepared.receiver(),
            objects: &objects,
            sky: prepared.sky(),
            rules: &rules,
            light_points: near.map(|eye| prepared.light_points(eye)),
        };
        let crop = OnceLock::new();
        let crop = || crop.get_or_init(|| Crop::new(&scene(), limit.ok_or("as set")?));
        let cameras = &inputs.rig.cameras;
        let mut views = Vec::with_capacity(cameras.len());
        for (number, camera) in cameras.iter().enumerate() {
            let camera_rays = CameraRays::new(camera, origin, seed, &objects.ground, params.coarse_px);
            let whole = Area::whole(camera).in_blocks(params.coarse_px);
            let progress = |done: f32| cx.progress((number as f32 + done) / cameras.len() as f32);
            let (done, total) = (AtomicUsize::new(0), 2 * first.len() * whole.pieces(TILE).len());
            let step = || progress(share * (done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / total as f32);
            let extra = |area, range, objects: Option<_>| Extra {
                view: View::of(camera),
                rules: &rules,
                origin: origin.to_array(),
                seed,
                area,
                coarse_px: params.coarse_px,
                range,
                contact: objects.map(|(contact, _)| contact),
                crop: objects.and_then(|(_, crop)| crop),
                shadow_only: objects.is_some() && params.shadow_only,
                every_lobe: objects.is_some() && !params.skip_lobes,
            };
            let take = |accumulator: &mut Accumulator, area: Area, range, step: &(dyn Fn() + Send + Sync)| {
                let part = Part { name: "r0", version: 10, inputs: &["receiver", "env"] };
                let r0 = cx.part(part, &extra(area, range, None), || {
                    let scene = scene();
                    Sums::trace(cx, area, R0, step, |_, tile| trace_r0(scene, &camera_rays, tile, range))
                })?;
                expect_size(&r0, area, R0)?;
                let part = Part { name: "pair", version: 17, inputs: &["receiver", "objects", "env"] };
                let pair = cx.part(part, &extra(area, range, Some((contact, limit))), || {
                    let (scene, crop) = (scene(), crop().as_ref().ok());
                    let trace = |number: usize, tile: &[(u32, u32)]| {
                        trace_pair(scene, &camera_rays, crop, (number, tile), range, (area, &r0))
                    };
                    Sums::trace(cx, area, PAIR, step, trace)
                })?;
                expect_size(&pair, area, PAIR)?;
                accumulator.add(area, &r0, &pair, range);
                Ok::<(), NodeError>(())
            };
            let mut accumulator = Accumulator::new(whole);
            for &range in first {
                take(&mut accumulator, whole, range, &step)?;
            }
            let goal = params.max_error.map(|asked| ErrorGoal::new(asked, most, &accumulator));
            let more = |accumulator: &mut Accumulator, area, range| take(accumulator, area, range, &|| ());
            let blocks = |done: f32| progress(share + (1.0 - share) * done);
            let reached = goal.map(|goal| goal.reach(&mut accumulator, more, blocks)).transpose()?;
            let places = most.min(PLACES);
            let part = Part { name: "front", version: 9, inputs: &["receiver", "objects"] };
            let front = cx.part(part, &extra(whole, (0, places), Some((contact, None))), || {
                let scene = scene();
                Sums::trace(
                    cx,
                    whole,
                    FIRST_HIT,
                    || (),
                    |_, tile| trace_first_hit(scene, &camera_rays, tile, places),
                )
            })?;
            expect_size(&front, whole, FIRST_HIT)?;
            views.push(finish(camera, params.coarse_px, &accumulator, &front, reached));
        }
        let broken: u64 = views.iter().map(|view| view.broken).sum();
        if broken > 0 {
            notes.warning("not-finite", format!("{broken} samples were not finite and count as black"));
        }
        report_variance(most, views.iter().map(|view| view.beyond).sum(), &mut notes);
        // A coarse look may miss what is there.
        let looks = params.coarse_px == 1 && !params.shadow_only;
        for (camera, view) in inputs.rig.cameras.iter().zip(&views) {
            if let Some(reached) = &view.reached {
                report_plan(&camera.name, reached, most, &mut notes);
            }
            report_cropped(&camera.name, view.cropped, &mut notes);
            report_cut_paths(&camera.name, view.cut, params.max_bounces, &mut notes);
            report_darkness(view, &camera.name, prepared.sky().power, &rules, &mut notes);
            if !inputs.objects.is_empty() && looks && !view.shows_objects() {
                let text = format!(
                    "`{}` sees no object; do pose, rig and mesh share a frame and a scale?",
                    camera.name
                );
                notes.warning("objects-not-seen", text);
            }
        }
        if looks && inputs.objects.len() > 1 && views.iter().any(FinishedView::shows_objects) {
            let rays = |camera| CameraRays::new(camera, origin, seed, &objects.ground, 1);
            let pictures: Vec<_> = cameras.iter().map(rays).zip(&views).collect();
            let unseen = unseen::of(scene(), &pictures, most.min(PLACES), cx)?;
            report_unseen(&unseen, &mut notes);
        }
        let crop = match crop() {
            Ok(_) => format!("what changes at most {} of the light", params.crop),
            Err(why) => format!("nothing: {why}"),
        };
        Ok((assemble(&inputs, views, &decided, centre, crop), notes))
    }
}

fn expect_size(sums: &Sums, area: Area, channels: usize) -> Result<(), NodeError> {
    let expected = area.pixels() * channels;
    if sums.sums.len() == expected { Ok(()) } else { Err(NodeError::new("a stored part has another size")) }
}

#[cfg(test)]
mod tests;

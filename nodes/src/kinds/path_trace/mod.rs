//! `path-trace`: path tracing of the receiver without the objects, of the receiver with the objects, and of the
//! objects.

mod auto;
mod decided;
mod former;
mod gloss;
mod interface;
mod lobes;
mod output;
mod reporting;
mod scale;
pub mod surroundings;
mod unseen;

use engine::{Context, ContextField, Cost, Former, Kind, NodeError, Notes, Sizes, ViewCount};
use glam::{DVec3, Vec3};
use render::light::env_resolution::EnvResolution;
use render::transport::ground::capture_point::{CapturePoint, stand_in};
use render::transport::ground::light_share::share_past;
use render::transport::ground::standing::find_ground;
use render::transport::path::double_count::counted_twice;
use render::transport::path::guide;
use render::transport::picture::accumulator::{FinishedView, TargetError};
use render::transport::picture::film::{self, CROSS, FIRST_HIT, PAIR, R0};
use render::transport::picture::prepared::PreparedScene;
use render::transport::picture::splat_rays::SplatRays;
use render::transport::picture::tracing::{Settings, Tracing};
use render::transport::scene::aabb::Aabb;
use render::transport::scene::block::Block;
use render::transport::scene::frame::in_scene_frame;
use render::transport::scene::objects::Objects;
use scene::error::Error;
use scene::types::Camera;

use auto::{Decision, Facts};
use decided::Decided;
pub use interface::{In, Out, PathTrace};
use output::assemble;
use reporting::{
    report_capture, report_coarse_coordinates, report_first_samples, report_inputs, report_standing,
    report_unseen, report_unseen_places, report_views,
};
use surroundings::Surroundings;

/// Maximum distance between a splat and the receiver on which it lies, as a multiple of the size of the largest object.
const REACH: f32 = 0.1;

impl PathTrace {
    /// Target error. `None` for a coarse picture, which is a preview that must be fast.
    fn target_error(&self) -> Option<f64> {
        self.max_error.filter(|_| self.coarse_px == 1)
    }

    /// Maximum number of samples per pixel. With `max_error` it is at least the size of the first chunk, from which
    /// errors are estimated.
    fn most(&self) -> u32 {
        if self.target_error().is_some() { self.samples.max(film::FIRST) } else { self.samples }
    }

    /// Error at which a block of pixels takes no more samples.
    fn goal(&self) -> Option<TargetError> {
        let required = self.target_error().map(|error| TargetError { error, required: true });
        let threshold = self.noise_threshold.filter(|_| self.coarse_px == 1);
        required.or(threshold.map(|error| TargetError { error, required: false }))
    }

    /// Settings of the tracer.
    fn settings(&self, every_lobe: bool) -> Settings {
        Settings {
            most: self.most(),
            skip: self.skip_samples,
            goal: self.goal(),
            coarse_px: self.coarse_px,
            crop: self.crop,
            contact_metres: self.contact_metres,
            shadow_only: self.shadow_only,
            every_lobe,
        }
    }

    /// Rejects inputs that cannot be traced.
    fn check_inputs(&self, inputs: &In) -> Result<(), NodeError> {
        if !scene::math::num::keeps_subnormals() {
            let hint = "run without the library that sets this mode (check LD_PRELOAD)";
            let text = "this process flushes subnormal numbers to zero, which would change the output";
            return Err(NodeError::new(text).hint(hint));
        }
        if inputs.rig.cameras.is_empty() {
            return Err(NodeError::from(Error::Mismatch("the rig has no camera".to_owned())).at("rig"));
        }
        if inputs.points.is_some() && inputs.rig.cameras.len() != 1 {
            let text = format!(
                "with `points`, the rig must have one camera, but it has {}",
                inputs.rig.cameras.len()
            );
            return Err(NodeError::new(text).at("rig").hint("pick one with `pick-cameras`"));
        }
        gloss::check(&inputs.receiver, inputs.points.is_some())?;
        if self.surroundings == Surroundings::Projected && inputs.env.origin.is_none() {
            let hint = "set `origin` of `load-environment`, or leave `surroundings` at `Auto`";
            let text = "`Projected` needs an environment with a point of capture";
            return Err(NodeError::new(text).at("surroundings").hint(hint));
        }
        Ok(())
    }

    /// Decides how the surroundings are modelled, and reports it. `from` is the point of capture in the frame
    /// of the scene.
    fn decide(
        &self,
        inputs: &In,
        prepared: &PreparedScene<'_>,
        from: Vec3,
        (up, metres_per_unit): (DVec3, f64),
        notes: &mut Notes,
    ) -> Decided {
        let (receiver, captured) = (prepared.receiver(), inputs.env.origin.is_some());
        let mut point = self.surroundings.probes().then(|| CapturePoint::at(receiver, from));
        if captured && let Some(found) = &mut point {
            let moves = self.surroundings != Surroundings::Distant;
            let camera = stand_in(receiver, &inputs.rig.cameras, prepared.origin);
            let camera = in_scene_frame(camera.eye(), prepared.origin);
            let (checked, fault) = found.checked((receiver, camera), (up, metres_per_unit), moves);
            report_capture(fault, metres_per_unit, notes);
            *found = checked;
        }
        let (from, probe) = (point.map_or(from, |point| point.at), point.map(|point| point.probe));
        let facts = Facts { probe, from, captured, metres_per_unit };
        let solid_light = || share_past(prepared.sky(), receiver, from, &Block::Solid);
        let decision = Decision::of(self.surroundings, &facts, solid_light);
        decision.report(self.surroundings, probe.as_ref(), notes);
        let rules = decision.rules(from, self.max_bounces, self.clamp_indirect);
        let twice = (rules.block != Block::Solid)
            .then(|| counted_twice(receiver, prepared.sky(), prepared.origin, from, &rules));
        if let Some(twice) = twice.filter(|_| rules.bounce_solid && rules.near.is_none()) {
            let text =
                "light reflected by the mesh is already in the panorama and counts twice, so the receiver is";
            let hint = "set `bounces: false` in `surroundings`";
            notes.warning("double-count", format!("{text} {:.0} % too bright; {hint}", 100.0 * twice));
        }
        Decided { name: decision.name(), rules, probe, twice }
    }

    /// Point of capture of the environment. If the environment has none, returns the position of `camera`, and adds
    /// a note if the setting `surroundings` depends on the point.
    fn point_of_capture(&self, inputs: &In, camera: &Camera, notes: &mut Notes) -> DVec3 {
        if let Some(origin) = inputs.env.origin {
            return origin;
        }
        if matches!(
            self.surroundings,
            Surroundings::Auto
                | Surroundings::Distant
                | Surroundings::Projected
                | Surroundings::Within { .. }
        ) {
            let text = format!(
                "the environment has no point of capture; the position of camera `{}` is used instead",
                camera.name
            );
            notes.decision("probe-origin", text);
        }
        camera.eye()
    }
}

impl Kind for PathTrace {
    const NAME: &'static str = "path-trace";
    const VERSION: u32 = 31;
    const READS: &'static [ContextField] =
        &[ContextField::Exhaustive, ContextField::MetresPerUnit, ContextField::Seed, ContextField::Up];
    const PREVIEW: engine::Preview =
        engine::Preview { refines: Some("samples"), coarse: Some("coarse_px"), ..engine::Preview::NONE };
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_params: &Self, inputs: &In) -> Cost {
        let pixels = inputs.rig.cameras.iter().map(|c| u64::from(c.width_px) * u64::from(c.height_px));
        let triangles: usize =
            inputs.objects.iter().flat_map(|o| &o.object.primitives).map(|p| p.triangles.len()).sum();
        // Running sums in f64, one chunk and its tiles in f32, and the finished images.
        let pixel_bytes = ((R0 + PAIR + CROSS) * 8 + (R0 + PAIR + FIRST_HIT) * 4 * 2 + 20 * 4) as u64;
        let points = inputs.points.as_ref().map_or(0, |splats| splats.len() as u64);
        let pixels = pixels.fold(points, u64::saturating_add);
        let sky = inputs.env.image.samples.len() as u64;
        Cost::of([
            (pixels, pixel_bytes),
            ((inputs.receiver.triangles.len() + triangles) as u64, 300),
            // For each texel, 16 bytes of radiance and density, 4 bytes of weight in each of two tiers, and 1 byte
            // for its tier. This is less than 9 bytes per sample.
            (sky, 9),
            // The light that each place of a room sees. A triangle has two sides.
            (guide::BINS.min(2 * inputs.receiver.triangles.len() as u64), guide::BIN_BYTES),
        ])
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        let samples = f64::from(params.most());
        // A guess: at the edge of a shadow one sample has an error of 0.2, and such tiles are a tenth of the image.
        let all = params.goal().map_or(samples, |TargetError { error, .. }| {
            let ratio = 0.2 / error;
            4.0 + 0.1 * ratio * ratio
        });
        let coarse = f64::from(params.coarse_px);
        // With `points`, splats take the place of pixels.
        let pixels =
            [sizes.of("points"), sizes.of("rig")].into_iter().find(|size| *size > 0.0).unwrap_or(0.0);
        pixels * all.min(samples) / (coarse * coarse)
    }

    fn former(name: &str, fields: &[(&str, &str)]) -> Option<Former> {
        former::former(name, fields)
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        match params.surroundings.out_of_range() {
            Some(text) => Err(NodeError::new(text).at("surroundings")),
            None => Ok(()),
        }
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["rig"])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        params.check_inputs(&inputs)?;
        let mut notes = Notes::none();
        let cameras = &inputs.rig.cameras;
        // The origin is the first camera: the loss of single precision grows with the distance from it, as pixel
        // footprints do. It does not depend on stray triangles or on the poses of objects.
        let origin = cameras[0].eye();
        let prepared = PreparedScene::new(&inputs.receiver, &inputs.env, origin, cx)?;
        let camera = stand_in(prepared.receiver(), cameras, origin);
        let centre = params.point_of_capture(&inputs, camera, &mut notes);
        let [_, _, up] = scene::math::equirect::axes(cx.up());
        let space = (up, cx.metres_per_unit());
        let decided = params.decide(&inputs, &prepared, in_scene_frame(centre, origin), space, &mut notes);
        let rules = &decided.rules;
        let mut objects = Objects::new(Some(prepared.receiver()), &inputs.objects, origin)?;
        objects.every_lobe = cx.exhaustive();
        objects.shown = !params.shadow_only;
        report_inputs(&inputs.receiver, &prepared, &objects, &mut notes);
        gloss::report(prepared.receiver(), &mut notes);
        // A glossy receiver may need more columns than the objects.
        if !objects.is_empty() && !prepared.receiver().is_glossy() {
            let most = inputs.env.image.width;
            EnvResolution::of(&inputs.env, &inputs.objects, most).report(&inputs.env, &mut notes);
        }
        scale::report_size(prepared.receiver(), &objects.boxes(), cx.metres_per_unit(), &mut notes);
        report_coarse_coordinates(&prepared, &objects, &mut notes);
        if let Some(eye) = rules.near {
            let boxes = objects.boxes();
            report_unseen_places(prepared.receiver(), Vec3::from_array(eye), &boxes, &mut notes);
        }
        let eye = in_scene_frame(camera.eye(), origin);
        let receiver = prepared.receiver();
        let standing = find_ground(&mut objects, receiver, origin, eye, space, params.contact_metres);
        report_standing(&standing, (cx.metres_per_unit(), params.contact_metres), &mut notes);
        report_first_samples(params.samples, params.most(), &mut notes);

        // A splat belongs to the ground up to a tenth of the largest object above it, as in the output `nearest`.
        let reach = REACH * objects.boxes().iter().map(Aabb::size).fold(0.0, f32::max);
        let space = (origin, in_scene_frame(cameras[0].eye(), origin));
        let points = inputs.points.as_deref();
        let points = points.map(|splats| SplatRays::new(splats, receiver, space, reach, cx)).transpose()?;
        let points_camera = points.as_ref().map(|points| {
            cx.count("splats_on_receiver", points.on_receiver);
            let (width_px, height_px) = points.size;
            [Camera { name: points.name.clone(), width_px, height_px, ..cameras[0].clone() }]
        });
        let cameras = points_camera.as_ref().map_or(&cameras[..], |camera| &camera[..]);
        let settings = params.settings(cx.exhaustive());
        let tracing = Tracing::new(settings, cx, (&prepared, cameras), &objects, rules)?;
        let tracing = tracing.with_splats(points.as_ref());
        let traced = |(number, camera)| tracing.picture(number, camera);
        let views = cameras.iter().enumerate().map(traced).collect::<Result<Vec<_>, _>>()?;
        let boxes = objects.boxes();
        // A coarse preview may miss small objects.
        let looks = params.coarse_px == 1 && !params.shadow_only && points.is_none();
        let backs = |(camera, view): (_, &FinishedView)| match looks && !view.shows_objects() {
            true => unseen::shows_backs(&tracing, camera),
            false => Ok(false),
        };
        let backs = cameras.iter().zip(&views).map(backs).collect::<Result<Vec<_>, _>>()?;
        report_views(params, cameras, &prepared, rules, (&views, &boxes, &backs), &mut notes);
        if looks && inputs.objects.len() > 1 && views.iter().any(FinishedView::shows_objects) {
            report_unseen(&unseen::of(&tracing, &views)?, &mut notes);
        }
        let crop = match tracing.crop() {
            Ok(_) => format!("tiles in which objects change at most the share {} of the light", params.crop),
            Err(why) => format!("off: {why}"),
        };
        Ok((assemble(&inputs, (cameras, views), &decided, centre, crop), notes))
    }
}

#[cfg(test)]
mod tests;

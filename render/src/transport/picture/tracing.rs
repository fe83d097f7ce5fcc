//! Tracing of images in stored parts: the receiver alone, receiver and objects, and first hits.

use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use engine::{Context, NodeError, Part};
use scene::types::Camera;
use serde::Serialize;

use super::accumulator::{Accumulator, FinishedView, TargetError};
use super::camera_rays::{CameraParams, CameraRays};
use super::crop::Crop;
use super::film::FIRST_HIT;
use super::film::PAIR;
use super::film::R0;
use super::film::{Area, Sums, TILE, TileSums, chunks};
use super::first_hit::{PLACES, trace_first_hit};
use super::pair::{PairTile, trace_pair};
use super::prepared::PreparedScene;
use super::r0::trace_r0;
use super::sample_plan::ErrorGoal;
use super::splat_rays::SplatRays;
use super::tile::Tile;
use crate::transport::path::guide::{Guide, LEARNT_PATHS};
use crate::transport::path::integrator::Scene;
use crate::transport::path::light_points::LightPoints;
use crate::transport::path::visibility::Rules;
use crate::transport::scene::objects::Objects;

/// A half-open range of samples.
type Range = (u32, u32);

/// Values that the key of a part contains in addition to the inputs of the part.
#[derive(Serialize)]
struct Extra<'a> {
    view: CameraParams<'a>,
    rules: &'a Rules,
    origin: [f64; 3],
    seed: u64,
    area: Area,
    coarse_px: u32,
    range: Range,
    /// Up axis, metres per unit and the error of the mesh. `None` for parts that do not depend on them.
    contact: Option<([f64; 3], f64, Option<f64>)>,
    /// Crop limit. `None` for parts that do not depend on it.
    crop: Option<f64>,
    /// True if the light of the objects is left out.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    shadow_only: bool,
    /// True if absent lobes are evaluated. This is part of the key, so that such a run does not reuse stored parts.
    every_lobe: bool,
    /// Reach of the rays to splats, if the pixels are splats.
    #[serde(skip_serializing_if = "Option::is_none")]
    reach: Option<f32>,
}

/// Settings of tracing.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Maximum number of samples per pixel.
    pub most: u32,
    /// Number of samples that are left out before the first.
    pub skip: u32,
    /// Error at which a block of pixels takes no more samples. `None` takes all samples everywhere.
    pub goal: Option<TargetError>,
    /// Side, in pixels, of the square blocks into which the image is divided. One pixel of each block is traced.
    pub coarse_px: u32,
    /// Maximum relative change of light at which a tile is cropped. 0 crops nothing.
    pub crop: f64,
    /// Error of the receiver where objects stand, in metres, if known.
    pub contact_metres: Option<f64>,
    /// True if the light of the objects is left out.
    pub shadow_only: bool,
    /// True if absent lobes are evaluated.
    pub every_lobe: bool,
}

/// A scene to trace, and the settings for tracing it.
pub struct Tracing<'a> {
    settings: Settings,
    /// Context of the node.
    pub cx: &'a Context,
    prepared: &'a PreparedScene<'a>,
    /// The cameras.
    pub cameras: &'a [Camera],
    objects: &'a Objects,
    rules: &'a Rules,
    light_points: Option<Arc<LightPoints>>,
    crop: OnceLock<Result<Crop, &'static str>>,
    splats: Option<&'a SplatRays>,
}

impl<'a> Tracing<'a> {
    /// Prepares what all cameras share.
    ///
    /// # Errors
    /// If the run was cancelled.
    pub fn new(
        settings: Settings,
        cx: &'a Context,
        (prepared, cameras): (&'a PreparedScene<'a>, &'a [Camera]),
        objects: &'a Objects,
        rules: &'a Rules,
    ) -> Result<Self, NodeError> {
        let near = rules.near.filter(|_| !objects.is_empty());
        let light_points = near.map(|eye| prepared.light_points(eye)).transpose()?;
        let crop = OnceLock::new();
        Ok(Self { settings, cx, prepared, cameras, objects, rules, light_points, crop, splats: None })
    }

    /// Traces rays to splats in place of those of the only camera. The splats are the input `points` of the node.
    pub fn with_splats(self, splats: Option<&'a SplatRays>) -> Self {
        Self { splats, ..self }
    }

    /// The inputs of a part, which are `with_points` if the pixels are splats.
    fn inputs(
        &self,
        plain: &'static [&'static str],
        with_points: &'static [&'static str],
    ) -> &'static [&'static str] {
        if self.splats.is_some() { with_points } else { plain }
    }

    /// The scene as integrators see it.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            receiver: self.prepared.receiver(),
            objects: self.objects,
            sky: self.prepared.sky(),
            rules: self.rules,
            light_points: self.light_points.as_deref(),
        }
    }

    /// The crop limit, if not 0.
    fn limit(&self) -> Option<f64> {
        Some(self.settings.crop).filter(|limit| *limit > 0.0)
    }

    /// Cropping rule, or the reason why nothing is cropped.
    pub fn crop(&self) -> Result<&Crop, &'static str> {
        let new = || Crop::new(&self.scene(), self.limit().ok_or("`crop` is 0")?);
        self.crop.get_or_init(new).as_ref().map_err(|why| *why)
    }

    /// Rays of a camera, one for each block of `coarse_px` x `coarse_px` pixels.
    pub fn camera_rays<'s>(&'s self, camera: &'s Camera, coarse_px: u32) -> CameraRays<'s> {
        CameraRays::new(camera, self.prepared.origin, self.cx.seed(), &self.objects.ground, coarse_px)
            .with_splats(self.splats)
    }

    /// Guide of the light samples of the receiver, as a camera sees it. `None` if a guide is of no use.
    fn guide(&self, camera: &Camera) -> Result<Arc<Option<Guide>>, NodeError> {
        let inputs = self.inputs(&["receiver", "env"], &["receiver", "env", "points"]);
        let part = Part { name: "guide", version: 2, inputs };
        let reach = self.splats.map(|splats| splats.reach);
        let extra = (CameraParams::of(camera), self.rules, self.prepared.origin.to_array(), reach);
        let bytes = |guide: &Option<Guide>| guide.as_ref().map_or(0, Guide::bytes);
        self.cx.in_memory(part, &extra, bytes, || {
            let camera_rays = self.camera_rays(camera, 1);
            let scene = Scene { light_points: None, ..self.scene() };
            Guide::learn(scene, camera_rays.spread_over_image(LEARNT_PATHS), Some(self.cx))
        })
    }

    /// Values in the key of a part that contains the receiver alone.
    fn of_receiver<'s>(&'s self, camera: &'s Camera, area: Area, range: Range) -> Extra<'s> {
        Extra {
            view: CameraParams::of(camera),
            rules: self.rules,
            origin: self.prepared.origin.to_array(),
            seed: self.cx.seed(),
            area,
            coarse_px: self.settings.coarse_px,
            range,
            contact: None,
            crop: None,
            shadow_only: false,
            every_lobe: false,
            reach: self.splats.map(|splats| splats.reach),
        }
    }

    /// Values in the key of a part that contains the receiver with the objects.
    fn of_objects<'s>(
        &'s self,
        camera: &'s Camera,
        area: Area,
        range: Range,
        crop: Option<f64>,
    ) -> Extra<'s> {
        let [_, _, up] = scene::math::equirect::axes(self.cx.up());
        Extra {
            contact: Some((up.to_array(), self.cx.metres_per_unit(), self.settings.contact_metres)),
            crop,
            shadow_only: self.settings.shadow_only,
            every_lobe: self.settings.every_lobe,
            ..self.of_receiver(camera, area, range)
        }
    }

    /// Adds a range of samples of some areas to `accumulator`. The samples are traced, or read from stored parts. Areas
    /// of which nothing is stored are traced together.
    fn add(
        &self,
        camera_rays: &CameraRays<'_>,
        accumulator: &mut Accumulator,
        (areas, range): (&[Area], Range),
        step: &(dyn Fn() + Send + Sync),
    ) -> Result<(), NodeError> {
        let (cx, camera) = (self.cx, camera_rays.camera);
        let skip = self.settings.skip;
        let range = (range.0.saturating_add(skip), range.1.saturating_add(skip));
        let inputs = self.inputs(&["receiver", "env"], &["receiver", "env", "points"]);
        let part = Part { name: "r0", version: 15, inputs };
        let stored = areas.iter().map(|&area| {
            let missing = Cell::new(false);
            let found = cx.part(part, &self.of_receiver(camera, area, range), || {
                missing.set(true);
                Err::<Sums, _>(NodeError::cancelled())
            });
            if missing.get() { Ok(None) } else { found.map(Some) }
        });
        let stored = stored.collect::<Result<Vec<Option<Arc<Sums>>>, _>>()?;
        let is_missing = |(area, stored): (&Area, &Option<_>)| stored.is_none().then_some(*area);
        let mut missing: Vec<Area> = areas.iter().zip(&stored).filter_map(is_missing).collect();
        let mut ahead = VecDeque::new();
        for (&area, stored) in areas.iter().zip(stored) {
            let mut traced = None;
            let r0 = match stored {
                Some(r0) => r0,
                None => cx.part(part, &self.of_receiver(camera, area, range), || {
                    if !missing.is_empty() {
                        let traced = self.trace_both(camera_rays, (&missing, range), step)?;
                        ahead.extend(missing.drain(..).zip(traced));
                    }
                    // Another process may have stored an area in the meantime, which is skipped.
                    let own = ahead.iter().position(|(other, _)| *other == area);
                    let (_, (r0, pair)) =
                        own.and_then(|own| ahead.remove(own)).unwrap_or((area, Default::default()));
                    r0.count(cx);
                    traced = pair;
                    Ok(r0)
                })?,
            };
            expect_size(&r0, area, R0)?;
            let plain = &["receiver", "objects", "env"];
            let inputs = self.inputs(plain, &["receiver", "objects", "env", "points"]);
            let part = Part { name: "pair", version: 25, inputs };
            let pair =
                cx.part(part, &self.of_objects(camera, area, range, self.limit()), || match traced.take() {
                    Some(pair) => {
                        pair.count(cx);
                        Ok(pair)
                    }
                    None => self.trace_with(camera_rays, (area, range), &r0, step),
                })?;
            expect_size(&pair, area, PAIR)?;
            accumulator.add(area, &r0, &pair, range);
        }
        Ok(())
    }

    /// Traces the receiver alone and the receiver with the objects together, since both cast the same camera rays
    /// and, under near light, the same rays at the first vertex. The results, one per area, are not counted yet. The
    /// second is `None` if there are no objects.
    fn trace_both(
        &self,
        camera_rays: &CameraRays<'_>,
        (areas, range): (&[Area], Range),
        step: &(dyn Fn() + Send + Sync),
    ) -> Result<Vec<(Sums, Option<Sums>)>, NodeError> {
        let (cx, scene, each) = (self.cx, self.scene(), (range.1 - range.0) as usize);
        let receiver = |pixels: &[(u32, u32)], followed| {
            let mut rest = None;
            let r0 = TileSums::followed(followed, || {
                let tile = Tile::new(scene, camera_rays, pixels, range);
                let (r0, firsts) = trace_r0(scene, &tile, each);
                rest = Some((tile, firsts));
                r0
            });
            step();
            (r0, rest)
        };
        if self.objects.is_empty() {
            let alone =
                Sums::trace_each(cx, areas, [R0], |_, pixels, followed| [receiver(pixels, followed).0])?;
            return Ok(alone.into_iter().map(|[r0]| (r0, None)).collect());
        }
        let crop = self.crop().ok();
        let both = Sums::trace_each(cx, areas, [R0, PAIR], |_, pixels, followed| {
            let (r0, rest) = receiver(pixels, followed);
            let pair = TileSums::followed(followed, || {
                let tile = PairTile { pixels, range, r0: &r0.sums, bounds: r0.bounds.unwrap_or_default() };
                trace_pair(scene, camera_rays, crop, &tile, rest)
            });
            step();
            [r0, pair]
        })?;
        Ok(both.into_iter().map(|[r0, pair]| (r0, Some(pair))).collect())
    }

    /// Traces the receiver with the objects, given `r0`, the sums of the render without objects.
    fn trace_with(
        &self,
        camera_rays: &CameraRays<'_>,
        (area, range): (Area, Range),
        r0: &Sums,
        step: &(dyn Fn() + Send + Sync),
    ) -> Result<Sums, NodeError> {
        let (scene, crop) = (self.scene(), self.crop().ok());
        Sums::trace(self.cx, area, PAIR, step, |number, pixels| {
            let bounds = r0.tile_bounds.get(number).copied().unwrap_or_default();
            let tile = PairTile { pixels, range, r0: &r0.of_pixels(area, pixels), bounds };
            trace_pair(scene, camera_rays, crop, &tile, None)
        })
    }

    /// First hits of the pixels of an image.
    fn first_hits(&self, camera_rays: &CameraRays<'_>, area: Area) -> Result<Arc<Sums>, NodeError> {
        let places = self.places();
        let inputs = self.inputs(&["receiver", "objects"], &["receiver", "objects", "points"]);
        let part = Part { name: "front", version: 12, inputs };
        let extra = self.of_objects(camera_rays.camera, area, (0, places), None);
        let front = self.cx.part(part, &extra, || {
            let scene = self.scene();
            let trace = |_, tile: &[(u32, u32)]| trace_first_hit(scene, camera_rays, tile, places);
            Sums::trace(self.cx, area, FIRST_HIT, || (), trace)
        })?;
        expect_size(&front, area, FIRST_HIT)?;
        Ok(front)
    }

    /// Number of positions per pixel at which the nearest object is searched for.
    pub fn places(&self) -> u32 {
        self.settings.most.min(PLACES)
    }

    /// Traces the image of a camera, which has index `number` in the rig.
    pub fn picture(&self, number: usize, camera: &Camera) -> Result<FinishedView, NodeError> {
        let most = self.settings.most;
        let guide = self.guide(camera)?;
        let camera_rays = self.camera_rays(camera, self.settings.coarse_px).guided(guide.clone());
        let whole = Area::whole(camera).in_blocks(self.settings.coarse_px);
        // Without a target error all chunks are taken.
        let chunks = chunks(most);
        let (first, share) =
            if self.settings.goal.is_some() { (&chunks[..1], 0.1) } else { (&chunks[..], 1.0) };
        let cameras = self.cameras.len() as f32;
        let progress = |done: f32| self.cx.progress((number as f32 + done) / cameras);
        let (done, total) = (AtomicUsize::new(0), 2 * first.len() * whole.pieces(TILE).len());
        let step = || progress(share * (done.fetch_add(1, Ordering::Relaxed) + 1) as f32 / total as f32);

        let mut accumulator = Accumulator::new(whole);
        for &range in first {
            self.add(&camera_rays, &mut accumulator, (&[whole], range), &step)?;
        }
        let goal = self.settings.goal.map(|asked| ErrorGoal::new(asked, most, &accumulator));
        let more = |accumulator: &mut Accumulator, areas: &[Area], range| {
            self.add(&camera_rays, accumulator, (areas, range), &|| ())
        };
        let blocks = |done: f32| progress(share + (1.0 - share) * done);
        let reached = goal.map(|goal| goal.reach(&mut accumulator, more, blocks)).transpose()?;
        let front = self.first_hits(&camera_rays, whole)?;
        if let Some(guide) = &*guide {
            accumulator.rays += guide.rays;
        }
        accumulator.finish(camera, self.settings.coarse_px, &front, reached, self.cx)
    }
}

fn expect_size(sums: &Sums, area: Area, channels: usize) -> Result<(), NodeError> {
    let expected = area.pixels() * channels;
    if sums.sums.len() == expected {
        Ok(())
    } else {
        Err(NodeError::new("a stored part of the picture has the wrong size; clear the cache"))
    }
}

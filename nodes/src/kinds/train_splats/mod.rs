//! `train-splats`: Gaussian splats from posed photographs.

mod checkpoint;
mod interface;
mod score;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Part, Preview, Sizes};
use fearless_simd::Level;
use render::splat::Settings;
use render::train::adam::Corrections;
use render::train::init::{random_points, splats_at, thinned};
use render::train::loss::Target;
use render::train::schedule::Schedule;
use render::train::state::State;
use render::train::step::{Shot, Trainer, extent};
use scene::types::{Camera, Photo, Photos, Report, Splats};
use serde::Serialize;

use checkpoint::{Checkpoint, Stretch};
pub use interface::TrainSplats;

engine::inputs! {
    /// Inputs of [`TrainSplats`].
    pub struct In {
        /// The photographs.
        photos: Arc<Photos>,
        /// Splats before the first iteration.
        splats: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// Outputs of [`TrainSplats`].
    pub struct Out {
        /// The splats, without those that are too faint to be drawn.
        splats: Arc<Splats>,
        /// Tables `training` with the course of the training, and `held-out` with the score of each photograph that
        /// was held out.
        report: Arc<Report>,
    }
}

/// Parameters that a range of iterations depends on, and the range itself.
#[derive(Serialize)]
struct Extra {
    max_splats: u32,
    start_splats: u32,
    sh_degree: u32,
    sh_every: u32,
    decay_iterations: u32,
    grow_iterations: u32,
    exposure: bool,
    background: bool,
    antialiased: bool,
    test_every: u32,
    seed: u64,
    metres_per_unit: f64,
    end: u32,
}

/// Ends of the ranges of iterations that are stored.
const ENDS: [u32; 8] = [1000, 2000, 3000, 5000, 7000, 10_000, 15_000, 20_000];
/// Length of the ranges after the last of [`ENDS`].
const LATER: u32 = 10_000;

/// Ends of the ranges of a training with this number of iterations.
fn ends(iterations: u32) -> Vec<u32> {
    let later = (1..).map(|i| ENDS[ENDS.len() - 1] + i * LATER);
    let mut ends: Vec<u32> = ENDS.into_iter().chain(later).take_while(|end| *end < iterations).collect();
    ends.push(iterations);
    ends
}

impl Kind for TrainSplats {
    const NAME: &'static str = "train-splats";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Seed, ContextField::MetresPerUnit];
    const PREVIEW: Preview = Preview { rough: &[("iterations", "300")], ..Preview::NONE };
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let started = inputs.splats.as_ref().map_or(0, |splats| splats.len() as u64);
        let splats = u64::from(p.max_splats.max(p.start_splats)).max(started);
        let camera = |photo: &Photo| u64::from(photo.camera.width_px) * u64::from(photo.camera.height_px);
        let pixels = inputs.photos.photos.iter().map(camera).max().unwrap_or(0);
        // Arrays grow by doubling, and a state is copied once when it is stored. A picture has 40 planes of floats. A
        // splat is drawn in four tiles on average.
        let state = State::bytes_of(splats, p.sh_degree).saturating_mul(4);
        let drawn = splats.saturating_mul(400);
        Cost { bytes: state.saturating_add(drawn).saturating_add(pixels.saturating_mul(160)) }
    }

    fn work(p: &Self, _: &Sizes) -> f64 {
        f64::from(p.iterations)
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let photos = &inputs.photos.photos;
        let every = p.test_every as usize;
        let is_held = |index: usize| every > 0 && index.is_multiple_of(every);
        let indexed = || photos.iter().enumerate();
        let held: Vec<&Photo> = indexed().filter(|(i, _)| is_held(*i)).map(|(_, photo)| photo).collect();
        let kept: Vec<&Photo> = indexed().filter(|(i, _)| !is_held(*i)).map(|(_, photo)| photo).collect();
        check(&kept, held.len())?;
        let cameras: Vec<Camera> = kept.iter().map(|photo| photo.camera.clone()).collect();
        let start = p.start(&inputs, &cameras, cx, &mut notes)?;
        let trainer = p.trainer(&kept, &cameras, cx);
        let checkpoint = p.train(&trainer, &held, &start, cx)?;

        let Checkpoint { state, stretches } = &*checkpoint;
        let splats = drawn(&state.splats);
        cx.count("splats", splats.len() as u64);
        cx.count("iterations", u64::from(state.step));
        let scores = score::scores(&splats, &held, state, (&trainer.settings, p.exposure), cx)?;
        let report = score::report(stretches, &scores, state, p, &cameras);
        if splats.is_empty() {
            notes.degraded(
                "no-splats",
                "no splat is visible in any photograph; check that the cameras see the same place",
            );
        }
        Ok((Out { splats: Arc::new(splats), report: Arc::new(report) }, notes))
    }
}

/// Checks that there are enough photographs.
fn check(kept: &[&Photo], held: usize) -> Result<(), NodeError> {
    if kept.len() < 2 {
        let what = format!(
            "training needs at least 2 photographs that are not held out (photographs: {}, held out: {held})",
            kept.len() + held
        );
        return Err(NodeError::new(what)
            .at("photos")
            .hint("`test_every: 0` holds no photograph out; a place needs some 20 photographs or more"));
    }
    let eye = kept[0].camera.eye();
    if kept.iter().all(|photo| (photo.camera.eye() - eye).length() == 0.0) {
        return Err(NodeError::new("all cameras are at the same position")
            .at("photos")
            .hint("distances follow only from photographs at different positions"));
    }
    Ok(())
}

/// The splats that reach the smallest alpha that is drawn.
fn drawn(splats: &Splats) -> Splats {
    let cut = Settings::default().alpha_cut as f32;
    let kept: Vec<usize> = (0..splats.len()).filter(|i| splats.opacities[*i] >= cut).collect();
    let each = splats.sh_len();
    Splats {
        means: kept.iter().map(|i| splats.means[*i]).collect(),
        means_low: Vec::new(),
        quats: kept.iter().map(|i| splats.quats[*i]).collect(),
        scales: kept.iter().map(|i| splats.scales[*i]).collect(),
        opacities: kept.iter().map(|i| splats.opacities[*i]).collect(),
        sh: kept.iter().flat_map(|i| &splats.sh[i * each..(i + 1) * each]).copied().collect(),
        ..*splats
    }
}

impl TrainSplats {
    /// Splats before the first iteration.
    fn start(
        &self,
        inputs: &In,
        cameras: &[Camera],
        cx: &Context,
        notes: &mut Notes,
    ) -> Result<Splats, NodeError> {
        if let Some(splats) = &inputs.splats {
            if splats.is_empty() {
                return Err(NodeError::new("there are no splats to begin with").at("splats"));
            }
            let mut start = Splats::clone(splats);
            start.antialiased = self.antialiased;
            return Ok(start);
        }
        let count = self.start_splats.min(self.max_splats) as usize;
        let points = if inputs.photos.points.is_empty() {
            notes.decision(
                "random-start",
                "the photographs have no points, so training begins with splats at random positions; `points` of `load-photos` gives better results in fewer iterations",
            );
            random_points(cameras, count, cx.seed())
        } else {
            thinned(&inputs.photos.points, count)
        };
        Ok(splats_at(&points, self.antialiased))
    }

    fn trainer<'a>(&self, kept: &[&'a Photo], cameras: &[Camera], cx: &Context) -> Trainer<'a> {
        let shot = |photo: &&'a Photo| Shot {
            camera: &photo.camera,
            target: Target { width: photo.camera.width_px as usize, pixels: &photo.pixels },
        };
        Trainer {
            shots: kept.iter().map(shot).collect(),
            settings: Settings {
                near: Settings::default().near / cx.metres_per_unit(),
                compensate: self.antialiased,
                ..Settings::default()
            },
            schedule: Schedule {
                max_splats: self.max_splats as usize,
                sh_degree: self.sh_degree,
                sh_every: self.sh_every,
                decay: self.decay_iterations,
                grow_until: self.grow_iterations,
                exposure: self.exposure,
                background: self.background,
                seed: cx.seed(),
            },
            extent: extent(cameras.iter()),
            level: Level::new(),
            corrections: Corrections::default(),
        }
    }

    /// Runs all iterations, or takes ranges of them from the cache.
    fn train(
        &self,
        trainer: &Trainer<'_>,
        held: &[&Photo],
        start: &Splats,
        cx: &Context,
    ) -> Result<Arc<Checkpoint>, NodeError> {
        let state = State::new(start, self.sh_degree, trainer.shots.len());
        let mut last = Arc::new(Checkpoint { state, stretches: Vec::new() });
        for end in ends(self.iterations) {
            let part = Part { name: "iterations", version: 1, inputs: &["photos", "splats"] };
            let extra = self.extra(end, cx);
            last = cx.part(part, &extra, || {
                let Checkpoint { mut state, mut stretches } =
                    Arc::try_unwrap(last).unwrap_or_else(|shared| Checkpoint::clone(&shared));
                let first = state.step;
                let (mut loss, mut relocated) = (0.0, 0);
                while state.step < end {
                    cx.check()?;
                    let progress = trainer.step(&mut state, cx, &|| 0.0)?;
                    loss += progress.loss;
                    relocated += progress.moved.relocated;
                    cx.count("splat_blends", progress.blends);
                    cx.progress(state.step as f32 / self.iterations as f32);
                }
                let (count, splats) = (f64::from(end - first), state.splats.len() as u64);
                let scores =
                    score::scores(&state.splats, held, &state, (&trainer.settings, self.exposure), cx)?;
                let psnr = score::mean_psnr(&scores);
                stretches.push(Stretch { iterations: end, splats, loss: loss / count, relocated, psnr });
                Ok(Checkpoint { state, stretches })
            })?;
            cx.progress(end as f32 / self.iterations as f32);
        }
        Ok(last)
    }

    fn extra(&self, end: u32, cx: &Context) -> Extra {
        Extra {
            max_splats: self.max_splats,
            start_splats: self.start_splats,
            sh_degree: self.sh_degree,
            sh_every: self.sh_every,
            decay_iterations: self.decay_iterations,
            grow_iterations: self.grow_iterations,
            exposure: self.exposure,
            background: self.background,
            antialiased: self.antialiased,
            test_every: self.test_every,
            seed: cx.seed(),
            metres_per_unit: cx.metres_per_unit(),
            end,
        }
    }
}

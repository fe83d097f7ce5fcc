//! One iteration of training.

use std::sync::{Mutex, PoisonError};

use engine::{Context, NodeError};
use fearless_simd::{Level, Simd, dispatch};
use glam::{DMat3, DQuat, DVec3};
use scene::math::num;
use scene::types::Camera;

use super::adam::{Corrections, update, update_few};
use super::loss::{Shown, Target, loss};
use super::random::{Purpose, normals, permutation};
use super::relocate::{Moved, relocate};
use super::schedule::{NOISE, OPACITY_WEIGHT, Rates, SCALE_WEIGHT, Schedule};
use super::state::{SHAPE_LEN, State, sigmoid};
use crate::splat::gradient::{Backward, Chain, SH_LEN, SplatValues, backward};
use crate::splat::{CHUNK, Clock, Settings};

/// A photograph with its camera.
#[derive(Debug, Clone, Copy)]
pub struct Shot<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// The photograph. It has the size of the camera's picture.
    pub target: Target<'a>,
}

/// Everything that stays the same during a training.
pub struct Trainer<'a> {
    /// Photographs from which the splats are trained, at least one.
    pub shots: Vec<Shot<'a>>,
    /// Settings of the renderer. `sh_degree` is ignored.
    pub settings: Settings,
    /// Schedule of training.
    pub schedule: Schedule,
    /// Extent of the cameras, in world units (see [`extent`]).
    pub extent: f64,
    /// Instruction set, which never changes the result.
    pub level: Level,
    /// Corrections of bias.
    pub corrections: Corrections,
}

/// Result of one iteration, for reports and benches.
#[derive(Debug, Clone, Copy, Default)]
pub struct Progress {
    /// Loss of the view.
    pub loss: f64,
    /// Number of splats that were blended.
    pub rows: u64,
    /// Number of pairs of a tile and a splat.
    pub pairs: u64,
    /// Number of times that a splat was blended into a pixel.
    pub blends: u64,
    /// Counts of the relocation, if there was one.
    pub moved: Moved,
    /// Seconds of the stages of [`Backward::seconds`], of the update of splats, and of relocation. Used by benches.
    pub seconds: [f64; 8],
}

/// Largest distance of a camera from the mean of all cameras, multiplied by 1.1; 1 if all cameras are at one place.
pub fn extent<'a>(cameras: impl Iterator<Item = &'a Camera> + Clone) -> f64 {
    let count = cameras.clone().count().max(1) as f64;
    let mean = cameras.clone().map(Camera::eye).sum::<DVec3>() / count;
    let farthest = cameras.map(|camera| (camera.eye() - mean).length()).fold(0.0, f64::max);
    if farthest > 0.0 { 1.1 * farthest } else { 1.0 }
}

/// Opacity above which the noise of a splat is less than 1e-6 of that of a transparent one, so it gets none.
const STILL: f32 = 0.15;

/// Splats of a chunk with all their state.
struct Rows<'a> {
    /// Index of the first splat.
    first_splat: usize,
    means: &'a mut [[f32; 3]],
    quats: &'a mut [[f32; 4]],
    scales: &'a mut [[f32; 3]],
    opacities: &'a mut [f32],
    sh: &'a mut [[f32; 3]],
    log_scales: &'a mut [[f32; 3]],
    logits: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    updates: &'a mut [u32],
}

/// Divides a state into chunks.
fn chunks(state: &mut State) -> Vec<Mutex<Rows<'_>>> {
    let (stride, each) = (state.stride(), state.splats.sh_len());
    let splats = &mut state.splats;
    let mut quats = splats.quats.chunks_mut(CHUNK);
    let mut scales = splats.scales.chunks_mut(CHUNK);
    let mut opacities = splats.opacities.chunks_mut(CHUNK);
    let mut sh = splats.sh.chunks_mut(CHUNK * each);
    let mut log_scales = state.log_scales.chunks_mut(CHUNK);
    let mut logits = state.logits.chunks_mut(CHUNK);
    let mut first = state.first.chunks_mut(CHUNK * stride);
    let mut second = state.second.chunks_mut(CHUNK * stride);
    let mut updates = state.updates.chunks_mut(CHUNK);
    let rows = splats.means.chunks_mut(CHUNK).enumerate().map(|(chunk, means)| {
        Mutex::new(Rows {
            first_splat: chunk * CHUNK,
            means,
            quats: quats.next().unwrap_or_default(),
            scales: scales.next().unwrap_or_default(),
            opacities: opacities.next().unwrap_or_default(),
            sh: sh.next().unwrap_or_default(),
            log_scales: log_scales.next().unwrap_or_default(),
            logits: logits.next().unwrap_or_default(),
            first: first.next().unwrap_or_default(),
            second: second.next().unwrap_or_default(),
            updates: updates.next().unwrap_or_default(),
        })
    });
    rows.collect()
}

impl Trainer<'_> {
    /// Runs the next iteration.
    pub fn step(&self, state: &mut State, cx: &Context, clock: Clock<'_>) -> Result<Progress, NodeError> {
        let step = state.step;
        let count = self.shots.len() as u32;
        let order = permutation(self.schedule.seed, u64::from(step / count), self.shots.len());
        let shot = order[(step % count) as usize] as usize;
        let Shot { camera, target } = &self.shots[shot];
        let settings = Settings { sh_degree: self.schedule.degree(step), ..self.settings };
        let shown = Shown {
            gain: state.exposures[shot].log_gain.map(num::f32::exp),
            background: state.background.log_gain,
        };
        let mut found = None;
        let back = backward(&state.splats, camera, &settings, cx, (self.level, clock), |rgba| {
            let loss = loss(rgba, target, &shown, cx, self.level)?;
            found = Some((loss.value, loss.log_gain, loss.background));
            Ok(loss.picture)
        })?;
        let (value, by_gain, by_background) = found.unwrap_or_default();
        let rates = self.schedule.rates(step, self.extent);
        let start = clock();
        let rows = self.update(state, &back, camera, (&settings, &rates), cx)?;
        self.update_shown(state, shot, (by_gain, by_background), &rates);
        let updated = clock();
        state.step += 1;
        let moved = if self.schedule.relocates(state.step) {
            relocate(state, &self.schedule)
        } else {
            Moved::default()
        };
        let [a, b, c, d, e, f] = back.seconds;
        let seconds = [a, b, c, d, e, f, updated - start, clock() - updated];
        Ok(Progress { loss: value, rows, pairs: back.pairs, blends: back.blends, moved, seconds })
    }

    /// Updates the splats that were blended. Returns their number.
    fn update(
        &self,
        state: &mut State,
        back: &Backward,
        camera: &Camera,
        (settings, rates): (&Settings, &Rates),
        cx: &Context,
    ) -> Result<u64, NodeError> {
        let (step, splats) = (state.step, state.splats.len());
        let sh_degree = state.splats.sh_degree;
        let chain = Chain::new(camera, settings, sh_degree);
        let rows = chunks(state);
        let job = Job { trainer: self, back, chain, rates, step, splats };
        let counts = cx.for_each_tile(back.chunks(), |chunk| {
            let mut rows = rows[chunk].lock().unwrap_or_else(PoisonError::into_inner);
            dispatch!(self.level, simd => job.run(simd, chunk, &mut rows))
        })?;
        Ok(counts.into_iter().sum())
    }

    /// Updates the exposure of the photograph and the background, if they are fitted.
    fn update_shown(
        &self,
        state: &mut State,
        shot: usize,
        (by_gain, by_background): ([f32; 3], [f32; 3]),
        rates: &Rates,
    ) {
        if self.schedule.exposure {
            let own = &mut state.exposures[shot];
            own.updates += 1;
            let correction = self.corrections.of(own.updates);
            update_few(&mut own.log_gain, by_gain, &mut own.moments, rates.log_gain, correction);
        }
        if self.schedule.background {
            let own = &mut state.background;
            own.updates += 1;
            let correction = self.corrections.of(own.updates);
            update_few(&mut own.log_gain, by_background, &mut own.moments, rates.background, correction);
            own.log_gain = own.log_gain.map(|v| v.clamp(0.0, 1.0));
        }
    }
}

/// Update of the splats of a view.
struct Job<'a> {
    trainer: &'a Trainer<'a>,
    back: &'a Backward,
    chain: Chain<'a>,
    rates: &'a Rates,
    step: u32,
    /// Number of splats of the scene.
    splats: usize,
}

/// Largest number of parameters of a splat.
const MOST: usize = SHAPE_LEN + 3 * SH_LEN;

impl Job<'_> {
    /// Updates the splats of a chunk that were blended. Returns their number.
    #[inline(always)]
    fn run<S: Simd>(&self, _simd: S, chunk: usize, rows: &mut Rows<'_>) -> u64 {
        let Self { chain, rates, .. } = self;
        let each = rows.sh.len() / rows.means.len().max(1);
        let (used, stride) = (SHAPE_LEN + 3 * chain.sh_len(), SHAPE_LEN + 3 * each);
        let mut rate_of = [rates.harmonics; MOST];
        rate_of[..3].fill(rates.mean);
        rate_of[3..7].fill(rates.quat);
        rate_of[7..10].fill(rates.log_scale);
        rate_of[10] = rates.logit;
        rate_of[11..14].fill(rates.colour);
        // Gradients of the penalties are those of means over all splats.
        let opaque = OPACITY_WEIGHT / self.splats as f64;
        let large = SCALE_WEIGHT / (3.0 * self.splats as f64 * self.trainer.extent);
        let mut count = 0;
        for row in self.back.rows(chunk) {
            let at = row.splat - rows.first_splat;
            let (scale, opacity) = (rows.scales[at].map(f64::from), f64::from(rows.opacities[at]));
            let values = SplatValues {
                mean: DVec3::from(rows.means[at].map(f64::from)),
                quat: rows.quats[at].map(f64::from),
                scale,
                opacity,
                sh: &rows.sh[at * each..(at + 1) * each],
            };
            let by = chain.gradient(&row, &values);
            let (mut parameters, mut gradient) = ([0.0_f32; MOST], [0.0_f32; MOST]);
            for k in 0..3 {
                gradient[k] = by.mean[k] as f32;
                gradient[7 + k] = (by.log_scale[k] + large * scale[k]) as f32;
            }
            for k in 0..4 {
                gradient[3 + k] = by.quat[k] as f32;
            }
            gradient[10] = (by.logit + opaque * opacity * (1.0 - opacity)) as f32;
            gradient[SHAPE_LEN..].copy_from_slice(by.sh.as_flattened());
            parameters[..3].copy_from_slice(&rows.means[at]);
            parameters[3..7].copy_from_slice(&rows.quats[at]);
            parameters[7..10].copy_from_slice(&rows.log_scales[at]);
            parameters[10] = rows.logits[at];
            let own = rows.sh[at * each..at * each + chain.sh_len()].as_flattened_mut();
            parameters[SHAPE_LEN..used].copy_from_slice(own);
            rows.updates[at] = rows.updates[at].saturating_add(1);
            let moments = (
                &mut rows.first[at * stride..at * stride + used],
                &mut rows.second[at * stride..at * stride + used],
            );
            let correction = self.trainer.corrections.of(rows.updates[at]);
            update(&mut parameters[..used], &gradient[..used], moments, &rate_of[..used], correction);
            own.copy_from_slice(&parameters[SHAPE_LEN..used]);
            let [a, b, c, w, x, y, z, s0, s1, s2, logit, ..] = parameters;
            let quat = [w, x, y, z].map(f64::from);
            let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
            rows.quats[at] = quat.map(|q| (q / length) as f32);
            rows.log_scales[at] = [s0, s1, s2];
            rows.scales[at] = rows.log_scales[at].map(num::f32::exp);
            rows.logits[at] = logit;
            rows.opacities[at] = sigmoid(f64::from(logit)) as f32;
            rows.means[at] = [a, b, c];
            if rows.opacities[at] < STILL {
                self.shake(rows, at);
            }
            count += 1;
        }
        count
    }

    /// Adds noise to the centre of a splat, with the shape of the splat. The noise is larger the more transparent
    /// the splat is (eq. 8 of Kheradmand et al.).
    fn shake(&self, rows: &mut Rows<'_>, at: usize) {
        let opacity = f64::from(rows.opacities[at]);
        let size = f64::from(self.rates.mean) * NOISE * sigmoid(100.0 * ((1.0 - opacity) - 0.995));
        let seed = self.trainer.schedule.seed;
        let splat = (rows.first_splat + at) as u64;
        let noise = DVec3::from(normals(seed, Purpose::Noise, u64::from(self.step), splat)) * size;
        let [w, x, y, z] = rows.quats[at].map(f64::from);
        let turned = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
        let variance = DVec3::from(rows.scales[at].map(|s| f64::from(s) * f64::from(s)));
        let moved = turned * (variance * (turned.transpose() * noise));
        for (to, by) in rows.means[at].iter_mut().zip(moved.to_array()) {
            *to = (f64::from(*to) + by) as f32;
        }
    }
}

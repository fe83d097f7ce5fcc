//! State of a training: the splats, the parameters that the optimiser moves, and its moments.

use scene::math::num;
use scene::types::{SplatEncoding, Splats};

/// Smallest opacity of a splat. Its logit is finite.
const LEAST_OPACITY: f64 = 1e-4;
/// Largest opacity of a splat. Its logit is finite.
const MOST_OPACITY: f64 = 0.9999;
/// Smallest standard deviation, in world units.
const LEAST_SCALE: f64 = 1e-12;

/// Number of parameters of a splat without its spherical harmonics: centre, quaternion, logarithms of standard
/// deviations, and logit of the opacity, in this order.
pub const SHAPE_LEN: usize = 11;

/// The parameters of photographs that are fitted, with the moments of Adam.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Exposure {
    /// Natural logarithms of the gains of red, green and blue.
    pub log_gain: [f32; 3],
    /// First and second moments.
    pub moments: [[f32; 3]; 2],
    /// Number of updates.
    pub updates: u32,
}

/// State of a training after a number of iterations.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Number of iterations so far.
    pub step: u32,
    /// The splats, as the renderer reads them.
    pub splats: Splats,
    /// Natural logarithms of the standard deviations.
    pub log_scales: Vec<[f32; 3]>,
    /// Logits of the opacities.
    pub logits: Vec<f32>,
    /// First moments of Adam: [`SHAPE_LEN`] values per splat, then its spherical harmonics.
    pub first: Vec<f32>,
    /// Second moments, in the same order.
    pub second: Vec<f32>,
    /// Number of updates of each splat.
    pub updates: Vec<u32>,
    /// Fitted exposure of each photograph.
    pub exposures: Vec<Exposure>,
    /// Fitted colour behind all splats, in place of a gain.
    pub background: Exposure,
}

/// Logistic function.
pub fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + num::f64::exp(-x))
}

/// Logit of an opacity, which is clamped so that the logit is finite.
pub fn logit(opacity: f64) -> f64 {
    let o = opacity.clamp(LEAST_OPACITY, MOST_OPACITY);
    num::f64::ln(o / (1.0 - o))
}

impl State {
    /// State before the first iteration. The spherical harmonics get the degree `sh_degree`; new coefficients are
    /// 0.
    pub fn new(start: &Splats, sh_degree: u32, photographs: usize) -> Self {
        let count = start.len();
        let (from, to) = (start.sh_len(), ((sh_degree + 1) * (sh_degree + 1)) as usize);
        let mut sh = vec![[0.0_f32; 3]; count * to];
        for (to, from) in sh.chunks_mut(to).zip(start.sh.chunks(from)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        }
        let means = (0..count).map(|i| start.mean(i).to_array().map(|c| c as f32)).collect();
        let log_scales: Vec<[f32; 3]> = start
            .scales
            .iter()
            .map(|s| s.map(|s| num::f64::ln(f64::from(s).max(LEAST_SCALE)) as f32))
            .collect();
        let logits: Vec<f32> = start.opacities.iter().map(|o| logit(f64::from(*o)) as f32).collect();
        let splats = Splats {
            means,
            means_low: Vec::new(),
            quats: start.quats.clone(),
            scales: log_scales.iter().map(|s| s.map(num::f32::exp)).collect(),
            opacities: logits.iter().map(|x| sigmoid(f64::from(*x)) as f32).collect(),
            sh_degree,
            sh,
            encoding: SplatEncoding::Srgb,
            antialiased: start.antialiased,
        };
        let stride = SHAPE_LEN + 3 * to;
        Self {
            step: 0,
            splats,
            log_scales,
            logits,
            first: vec![0.0; count * stride],
            second: vec![0.0; count * stride],
            updates: vec![0; count],
            exposures: vec![Exposure::default(); photographs],
            background: Exposure::default(),
        }
    }

    /// Number of parameters of a splat.
    pub fn stride(&self) -> usize {
        SHAPE_LEN + 3 * self.splats.sh_len()
    }

    /// Memory of a state with this number of splats, in bytes.
    pub fn bytes_of(splats: u64, sh_degree: u32) -> u64 {
        let parameters = SHAPE_LEN as u64 + 3 * u64::from((sh_degree + 1) * (sh_degree + 1));
        // The parameters, two moments, the logarithms and logits, and the number of updates.
        splats.saturating_mul((3 * parameters + 5) * 4)
    }

    /// Sets the opacity and the logarithms of the standard deviations of a splat, and what the renderer reads.
    pub fn set_shape(&mut self, splat: usize, logit: f32, log_scale: [f32; 3]) {
        self.logits[splat] = logit;
        self.log_scales[splat] = log_scale;
        self.splats.opacities[splat] = sigmoid(f64::from(logit)) as f32;
        self.splats.scales[splat] = log_scale.map(num::f32::exp);
    }

    /// Sets the moments of a splat to 0.
    pub fn forget(&mut self, splat: usize) {
        let stride = self.stride();
        self.first[splat * stride..(splat + 1) * stride].fill(0.0);
        self.second[splat * stride..(splat + 1) * stride].fill(0.0);
        self.updates[splat] = 0;
    }

    /// Copies the parameters of splat `from` to splat `to`, and sets the moments of `to` to 0.
    pub fn copy(&mut self, from: usize, to: usize) {
        self.splats.means[to] = self.splats.means[from];
        self.splats.quats[to] = self.splats.quats[from];
        let each = self.splats.sh_len();
        self.splats.sh.copy_within(from * each..(from + 1) * each, to * each);
        let (logit, log_scale) = (self.logits[from], self.log_scales[from]);
        self.set_shape(to, logit, log_scale);
        self.forget(to);
    }

    /// Adds splats with unspecified parameters, which must be set by [`State::copy`].
    pub fn grow(&mut self, count: usize) {
        let all = self.splats.len() + count;
        let (each, stride) = (self.splats.sh_len(), self.stride());
        let splats = &mut self.splats;
        splats.means.resize(all, [0.0; 3]);
        splats.quats.resize(all, [1.0, 0.0, 0.0, 0.0]);
        splats.scales.resize(all, [0.0; 3]);
        splats.opacities.resize(all, 0.0);
        splats.sh.resize(all * each, [0.0; 3]);
        self.log_scales.resize(all, [0.0; 3]);
        self.logits.resize(all, 0.0);
        self.first.resize(all * stride, 0.0);
        self.second.resize(all * stride, 0.0);
        self.updates.resize(all, 0);
    }
}

//! Learning rates and the schedule of training. Both depend on the number of the iteration only, and never on the
//! number of iterations that will follow.

use scene::math::num;

/// Settings of training that hold for all iterations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Schedule {
    /// Largest number of splats.
    pub max_splats: usize,
    /// Degree of the spherical harmonics at the end, 0 to 3.
    pub sh_degree: u32,
    /// Number of iterations after which the degree in use rises by 1.
    pub sh_every: u32,
    /// Number of iterations in which the learning rate of centres falls to [`CENTRE_END`] of its initial value, at
    /// a constant rate. Later it is constant.
    pub decay: u32,
    /// Iteration after which splats are no longer relocated or added.
    pub grow_until: u32,
    /// True to fit a gain per channel for each photograph.
    pub exposure: bool,
    /// True to fit a colour behind all splats; otherwise it is black.
    pub background: bool,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// Final learning rate of centres, as a share of the initial rate.
pub const CENTRE_END: f64 = 0.01;
/// Number of iterations between relocations.
pub const RELOCATE_EVERY: u32 = 100;
/// First iteration at which splats are relocated.
pub const RELOCATE_FROM: u32 = 500;
/// Growth of the number of splats at each relocation, as a share.
pub const GROWTH: f64 = 0.05;
/// Opacity at or below which a splat counts as faded.
pub const FADED: f32 = 0.005;
/// Weight of the mean opacity in the loss.
pub const OPACITY_WEIGHT: f64 = 0.01;
/// Weight of the mean standard deviation in the loss, with lengths divided by the extent of the cameras.
pub const SCALE_WEIGHT: f64 = 0.01;
/// Factor on the learning rate of centres that gives the size of the noise.
pub const NOISE: f64 = 5e5;

/// Learning rates of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Rate of centres, in world units.
    pub mean: f32,
    /// Rate of quaternions.
    pub quat: f32,
    /// Rate of logarithms of standard deviations.
    pub log_scale: f32,
    /// Rate of logits of opacities.
    pub logit: f32,
    /// Rate of the coefficients of degree 0.
    pub colour: f32,
    /// Rate of the coefficients of higher degrees.
    pub harmonics: f32,
    /// Rate of logarithms of gains.
    pub log_gain: f32,
    /// Rate of the background.
    pub background: f32,
}

impl Schedule {
    /// Degree of the spherical harmonics in use at an iteration.
    pub fn degree(&self, step: u32) -> u32 {
        (step / self.sh_every.max(1)).min(self.sh_degree)
    }

    /// Learning rates of an iteration, in a scene whose cameras have this extent in world units.
    pub fn rates(&self, step: u32, extent: f64) -> Rates {
        let done = f64::from(step.min(self.decay)) / f64::from(self.decay.max(1));
        let mean = 1.6e-4 * extent * num::pow(CENTRE_END, done);
        Rates {
            mean: mean as f32,
            quat: 1e-3,
            log_scale: 5e-3,
            logit: 5e-2,
            colour: 2.5e-3,
            harmonics: 2.5e-3 / 20.0,
            log_gain: 1e-3,
            background: 2.5e-3,
        }
    }

    /// True if splats are relocated and added after this iteration.
    pub fn relocates(&self, step: u32) -> bool {
        step >= RELOCATE_FROM && step < self.grow_until && step.is_multiple_of(RELOCATE_EVERY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_fall_and_degrees_rise_as_iterations_pass() {
        let schedule = Schedule {
            max_splats: 10,
            sh_degree: 2,
            sh_every: 1000,
            decay: 1000,
            grow_until: 1000,
            exposure: false,
            background: false,
            seed: 0,
        };
        let mean = |step| schedule.rates(step, 2.0).mean;
        assert!((mean(0) - 3.2e-4).abs() < 1e-9 && (mean(500) - 3.2e-5).abs() < 1e-9);
        assert_eq!((mean(1000), mean(1000)), (mean(1001), mean(90_000)));
        assert_eq!([0, 999, 1000, 2000, 9000].map(|step| schedule.degree(step)), [0, 0, 1, 2, 2]);
        assert_eq!(
            [0, 400, 500, 550, 900, 1000].map(|step| schedule.relocates(step)),
            [false, false, true, false, true, false]
        );
    }
}

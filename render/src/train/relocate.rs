//! Relocation of faded splats, and growth of the number of splats, as in "3D Gaussian Splatting as Markov Chain Monte Carlo" (Kheradmand et
//! al. 2024, section 3.3 and appendix): a splat is replaced with several copies whose opacity and size are chosen
//! so that the rendered picture changes as little as possible.

use scene::math::num;

use super::random::{Purpose, uniform};
use super::schedule::{FADED, GROWTH, Schedule};
use super::state::{State, logit};

/// Largest number of copies that replace a splat.
const MOST_COPIES: u32 = 51;
/// Minimum opacity of copies.
const LEAST: f64 = FADED as f64;

/// Counts of one relocation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Moved {
    /// Number of splats that were moved to others.
    pub relocated: u64,
    /// Number of splats that were added.
    pub added: u64,
}

/// Opacity of each of `copies` splats that replace one of opacity `opacity`, and the factor on its standard
/// deviations (eq. 9 of the paper).
pub fn split(opacity: f64, copies: u32) -> (f64, f64) {
    let n = copies.clamp(1, MOST_COPIES);
    if n == 1 {
        return (opacity, 1.0);
    }
    let each = 1.0 - num::pow(1.0 - opacity, 1.0 / f64::from(n));
    let mut sum = 0.0;
    for i in 1..=n {
        // Binomial coefficients of i - 1 over k.
        let (mut binomial, mut sign, mut power) = (1.0, 1.0, each);
        for k in 0..i {
            sum += sign * binomial * power / f64::from(k + 1).sqrt();
            binomial *= f64::from(i - 1 - k) / f64::from(k + 1);
            sign = -sign;
            power *= each;
        }
    }
    (each, opacity / sum)
}

/// Number of times that each of the splats in `from` is drawn when `count` are drawn with probabilities in
/// proportion to opacity. The draws are stratified, so each count deviates from its expectation by less than 2.
fn drawn(state: &State, from: &[u32], count: usize, random: impl Fn(u64) -> f64) -> Vec<u32> {
    let opacity = |splat: u32| f64::from(state.splats.opacities[splat as usize]);
    let total: f64 = from.iter().map(|splat| opacity(*splat)).sum();
    let mut counts = vec![0; from.len()];
    let (mut at, mut sum) = (0, opacity(from[0]));
    for i in 0..count {
        let place = (i as f64 + random(i as u64)) / count as f64 * total;
        while sum <= place && at + 1 < from.len() {
            at += 1;
            sum += opacity(from[at]);
        }
        counts[at] += 1;
    }
    counts
}

/// Divides splats into copies: the splat `from[i]` and `counts[i]` of the splats in `free`, in order.
fn divide(state: &mut State, from: &[u32], counts: &[u32], free: &[u32]) {
    let mut free = free.iter();
    for (splat, count) in from.iter().zip(counts).filter(|(_, count)| **count > 0) {
        let splat = *splat as usize;
        let (opacity, factor) = split(f64::from(state.splats.opacities[splat]), count + 1);
        let grown = num::f64::ln(factor) as f32;
        let log_scale = state.log_scales[splat].map(|s| s + grown);
        state.set_shape(splat, logit(opacity.max(LEAST)) as f32, log_scale);
        state.forget(splat);
        for to in free.by_ref().take(*count as usize) {
            state.copy(splat, *to as usize);
        }
    }
}

/// Moves faded splats to others, and adds splats until the budget is reached.
pub fn relocate(state: &mut State, schedule: &Schedule) -> Moved {
    let step = u64::from(state.step);
    let (faded, visible): (Vec<u32>, Vec<u32>) =
        (0..state.splats.len() as u32).partition(|splat| state.splats.opacities[*splat as usize] <= FADED);
    let mut moved = Moved::default();
    if visible.is_empty() {
        return moved;
    }
    if !faded.is_empty() {
        let counts =
            drawn(state, &visible, faded.len(), |i| uniform(schedule.seed, Purpose::Relocation, step, i));
        divide(state, &visible, &counts, &faded);
        moved.relocated = faded.len() as u64;
    }
    let count = state.splats.len();
    let most = (count as f64 * (1.0 + GROWTH)).ceil() as usize;
    let added = most.min(schedule.max_splats).saturating_sub(count);
    if added > 0 {
        let all: Vec<u32> = (0..count as u32).collect();
        let counts = drawn(state, &all, added, |i| uniform(schedule.seed, Purpose::Growth, step, i));
        state.grow(added);
        let free: Vec<u32> = (count as u32..(count + added) as u32).collect();
        divide(state, &all, &counts, &free);
        moved.added = added as u64;
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Splats;

    /// Copies of a splat at the same place give the same opacity at its centre, and nearly the same total alpha
    /// over the plane: the condition from which the factor follows (integral of alpha along a line through the
    /// centre).
    #[test]
    fn copies_look_like_the_splat() {
        for opacity in [0.02, 0.3, 0.9, 0.99] {
            for copies in [2, 3, 10, 51] {
                let (each, factor) = split(opacity, copies);
                let together = |x: f64, o: f64, s: f64, n: u32| {
                    1.0 - num::pow(1.0 - o * num::f64::exp(-0.5 * x * x / (s * s)), f64::from(n))
                };
                assert!((together(0.0, each, factor, copies) - opacity).abs() < 1e-12);
                let integral = |o, s, n| {
                    (-4000..4000)
                        .map(|i| together((f64::from(i) + 0.5) * 0.005, o, s, n) * 0.005)
                        .sum::<f64>()
                };
                let (one, many) = (integral(opacity, 1.0, 1), integral(each, factor, copies));
                assert!((many / one - 1.0).abs() < 1e-6, "{opacity} {copies} {one} {many}");
            }
        }
        assert_eq!(split(0.4, 1), (0.4, 1.0));
    }

    /// Faded splats move to visible ones, growth stops at the budget, and nothing happens if all have faded.
    #[test]
    fn faded_splats_move_and_the_budget_is_reached() {
        let count = 40;
        let start = Splats {
            means: (0..count).map(|i| [i as f32, 0.0, 0.0]).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
            scales: vec![[0.1; 3]; count],
            opacities: (0..count).map(|i| if i < 10 { 0.001 } else { 0.5 }).collect(),
            sh: vec![[0.2; 3]; count],
            ..Splats::empty()
        };
        let schedule = Schedule {
            max_splats: 41,
            sh_degree: 0,
            sh_every: 1,
            decay: 1,
            grow_until: 1,
            exposure: false,
            background: false,
            seed: 3,
        };
        let mut state = State::new(&start, 0, 1);
        assert_eq!(relocate(&mut state, &schedule), Moved { relocated: 10, added: 1 });
        assert_eq!(state.splats.len(), 41);
        assert!(state.splats.opacities.iter().all(|o| *o > FADED));
        assert!(state.splats.means[..10].iter().all(|mean| mean[0] >= 10.0));
        assert_eq!(relocate(&mut state, &schedule), Moved::default());
        let mut state = State::new(&Splats { opacities: vec![0.001; count], ..start }, 0, 1);
        assert_eq!(relocate(&mut state, &schedule), Moved::default());
    }
}

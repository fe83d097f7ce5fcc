//! Counts of samples that were clipped or left out, for notes.

use engine::Notes;

/// Factor by which a sample must exceed `s_max` to count as clipped. Smaller differences are invisible noise.
pub(super) const SEEN: f64 = 1.01;
/// Minimum ratio at which the light added by objects counts as visible. Matte objects hardly brighten the surfaces
/// next to them, so their ratios are lower.
pub(super) const SHONE_ON: f64 = 1.5;
/// Value of `s_max` that keeps the light of most lamps. The ratio exceeds it only at places that are almost dark
/// without the lamp.
const LARGE: f64 = 8.0;
/// Maximum share of all samples that can be clipped fireflies. If more samples are clipped, they are not fireflies.
const MANY: f64 = 1e-3;

/// Counts of the samples of one view.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) samples: u64,
    pub(super) dark: u64,
    pub(super) clipped: u64,
    /// Number of clipped samples in places that objects brighten.
    pub(super) shone_on: u64,
    /// Sums of light over the clipped samples: first with the objects, then without them.
    pub(super) bright: [f64; 2],
    pub(super) broken: u64,
}

impl Tally {
    pub(super) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.dark += other.dark;
        self.clipped += other.clipped;
        self.shone_on += other.shone_on;
        for (sum, more) in self.bright.iter_mut().zip(other.bright) {
            *sum += more;
        }
        self.broken += other.broken;
    }

    /// Adds notes on samples that were left out, with their share of all samples.
    pub(super) fn report(&self, s_max: f64, notes: &mut Notes) {
        if self.broken > 0 {
            notes.warning(
                "not-finite",
                format!("samples that are not finite are left without shadow (count: {})", self.broken),
            );
        }
        if self.samples > 0 && self.dark == self.samples {
            let text = "no sample has enough light for a ratio, so there is no shadow";
            notes.warning("all-dark", text);
        }
        let share = |n: u64| 100.0 * n as f64 / self.samples.max(1) as f64;
        notes.count(
            "too-dark",
            self.dark,
            format_args!("of the samples ({:.2} %) had too little light for a reliable ratio, so the shadow there is weakened or left out", share(self.dark)),
        );
        notes.count(
            "clipped",
            self.clipped,
            format_args!(
                "of the samples ({:.2} %) exceeded the ratio `s_max` = {s_max} by more than 1 %; there, the total light with the objects is {:.3} times the light without them",
                share(self.clipped),
                self.bright[0] / self.bright[1].max(f64::MIN_POSITIVE)
            ),
        );
        if self.shone_on as f64 > MANY * self.samples as f64 {
            let text = format!(
                "the objects light their surroundings, but `s_max` = {s_max} clips that light: without the limit, \
                 {:.2} % of the samples would be more than 50 % brighter",
                share(self.shone_on)
            );
            let hint = match s_max < LARGE {
                true => "raise `s_max` to keep this light (for example to 8)",
                false => "`form: Hybrid` adds this light instead of multiplying by it",
            };
            notes.warning("light-clipped", format!("{text}; {hint}"));
        }
    }
}

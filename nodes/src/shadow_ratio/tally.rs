//! What became of the samples, to be told.

use engine::Notes;

/// What became of the samples of one view.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) samples: u64,
    pub(super) dark: u64,
    pub(super) clipped: u64,
    /// Of the ratios that are clipped the sums of what they are made of: with the objects and without.
    pub(super) bright: [f64; 2],
    pub(super) broken: u64,
}

impl Tally {
    pub(super) fn add(&mut self, other: &Self) {
        self.samples += other.samples;
        self.dark += other.dark;
        self.clipped += other.clipped;
        for (sum, more) in self.bright.iter_mut().zip(other.bright) {
            *sum += more;
        }
        self.broken += other.broken;
    }

    /// Notes of what was left out, and of how much of all it is.
    pub(super) fn tell(&self, s_max: f64, notes: &mut Notes) {
        if self.broken > 0 {
            notes.warning("not-finite", format!("{} samples are not finite and cast no shadow", self.broken));
        }
        if self.samples > 0 && self.dark == self.samples {
            let text = "no sample has light enough for a ratio, so the picture gets no shadow";
            notes.warning("all-dark", text);
        }
        let share = |n: u64| 100.0 * n as f64 / self.samples.max(1) as f64;
        notes.count(
            "too-dark",
            self.dark,
            format_args!("samples ({:.2} %) are too dark for a ratio, or for all of it", share(self.dark)),
        );
        notes.count(
            "clipped",
            self.clipped,
            format_args!(
                "samples ({:.2} %) are brighter with the objects than `s_max` = {s_max} lets through: {:.3} times as bright in sum",
                share(self.clipped),
                self.bright[0] / self.bright[1].max(f64::MIN_POSITIVE)
            ),
        );
    }
}

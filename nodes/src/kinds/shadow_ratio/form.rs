//! How two renders become a ratio, and light to add.

use super::ShadowRatio;
use super::tally::{SEEN, SHONE_ON, Tally};

engine::choices! {
    /// How the two renders become a ratio.
    pub enum RatioForm {
        /// (R1 + e) / (R0 + e) where e and the energy bound are fractions of the picture's median R0, the
        /// mask judged on a 3x3 mean: exactly 1 where nothing changed, the same at any exposure.
        Stable,
        /// R1 / (R0 + epsilon) with absolute bounds judged pixel by pixel, as the paper prints it.
        Paper,
        /// No ratio: the light that the objects take or give, R1 - R0, is `added` (Debevec 1998). Right only
        /// where the receiver's albedo is that of the place; keeps light where R0 is too dark for a ratio.
        Difference,
        /// `Stable` where light is taken, and what is given is `added`.
        Hybrid,
    }
}

engine::choices! {
    /// Of what the ratio is taken.
    pub enum Channels {
        /// Of each colour channel: shadows take the colour of the light that is left.
        Each,
        /// Of luminance: grey shadows, for comparison and for renders too noisy in colour.
        Luminance,
    }
}

impl RatioForm {
    /// The raw ratio of a channel, 1 where there is too little light for one. `a` is without the objects and `b` with
    /// them, `energy` the light around that the bound is for, `shone_on` whether what is around is much brighter with the
    /// objects, too, and `unit` that of the bounds.
    pub(super) fn ratio(
        self,
        params: &ShadowRatio,
        (a, b): (f64, f64),
        energy: impl FnOnce() -> f64,
        shone_on: impl FnOnce() -> bool,
        unit: f64,
        tally: &mut Tally,
    ) -> f64 {
        let (epsilon, least) = (params.epsilon * unit, params.min_energy * unit);
        let (ratio, energy) = match self {
            Self::Difference => return 1.0,
            Self::Paper => (b / (a + epsilon), a),
            Self::Stable | Self::Hybrid => ((b + epsilon) / (a + epsilon), energy()),
        };
        let trust = if energy > 0.0 && energy >= least && ratio.is_finite() {
            self.trust(energy, least)
        } else {
            0.0
        };
        tally.dark += u64::from(trust < 1.0);
        if trust == 0.0 {
            return 1.0;
        }
        // What is brighter with the objects is no ratio of `Hybrid`, which adds it.
        let (ratio, most) = match self {
            Self::Hybrid => (ratio.min(1.0), params.s_max.min(1.0)),
            _ => (ratio, params.s_max),
        };
        if ratio > SEEN * most {
            tally.clipped += 1;
            tally.shone_on += u64::from(ratio > SHONE_ON * most && shone_on());
            tally.bright[0] += b;
            tally.bright[1] += a;
        }
        1.0 + trust * (ratio.clamp(0.0, most) - 1.0)
    }

    /// How much of a ratio counts where the light is at least what it must be: all of it from twice as much on.
    fn trust(self, energy: f64, least: f64) -> f64 {
        if self == Self::Paper || least <= 0.0 { 1.0 } else { (energy / least - 1.0).clamp(0.0, 1.0) }
    }

    /// The light of a channel that is added.
    pub(super) fn added(self, without: f64, with: f64) -> f64 {
        let added = match self {
            Self::Difference => with - without,
            Self::Hybrid => (with - without).max(0.0),
            Self::Stable | Self::Paper => 0.0,
        };
        if added.is_finite() { added } else { 0.0 }
    }
}

//! Formulas that turn two renders into a ratio and added light.

use super::tally::{SEEN, SHONE_ON, Tally};

engine::choices! {
    /// Formula that turns the two renders into a ratio.
    pub enum RatioForm {
        /// `(R1 + e) / (R0 + e)`, where `e` and the bound `min_energy` are fractions of the median of R0, and the
        /// bound is tested on a mean over 3x3 pixels. It is exactly 1 where nothing changed, and does not depend on
        /// exposure.
        Stable,
        /// `R1 / (R0 + epsilon)`, with absolute bounds tested per pixel, as printed in the paper.
        Paper,
        /// No ratio: the output `added` is the difference `R1 - R0`, which is added to the background (Debevec
        /// 1998). It is correct only if the receiver has the albedo of the scene. Light is kept even where R0 is
        /// too dark for a ratio.
        Difference,
        /// `Stable` where the objects remove light; light that the objects add is in the output `added`.
        Hybrid,
    }
}

engine::choices! {
    /// Quantity whose ratio is taken.
    pub enum Channels {
        /// Each colour channel: shadows have the colour of the remaining light.
        Each,
        /// Luminance: shadows are grey. For comparison, and for renders with much colour noise.
        Luminance,
    }
}

/// Parameters of a ratio, in the units of the renders.
pub(super) struct Limits {
    /// Offset of the denominator.
    pub epsilon: f64,
    /// Minimum light for a ratio.
    pub min_energy: f64,
    /// Largest ratio.
    pub s_max: f64,
}

impl RatioForm {
    /// Raw ratio of a channel; 1 where there is too little light for a ratio. `a` is the light without the objects,
    /// and `b` the light with them. `energy` is the mean light around the pixel, which is compared with
    /// `min_energy`. `shone_on` is true if the objects make the surroundings much brighter too, and `unit` is the
    /// unit of `epsilon` and `min_energy`.
    pub(super) fn ratio(
        self,
        limits: &Limits,
        (a, b): (f64, f64),
        energy: impl FnOnce() -> f64,
        shone_on: impl FnOnce() -> bool,
        tally: &mut Tally,
    ) -> f64 {
        let &Limits { epsilon, min_energy: least, s_max } = limits;
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
        // Light added by the objects is not part of the ratio of `Hybrid`, which adds it.
        let (ratio, most) = match self {
            Self::Hybrid => (ratio.min(1.0), s_max.min(1.0)),
            _ => (ratio, s_max),
        };
        if ratio > SEEN * most {
            tally.clipped += 1;
            tally.shone_on += u64::from(ratio > SHONE_ON * most && shone_on());
            tally.bright[0] += b;
            tally.bright[1] += a;
        }
        1.0 + trust * (ratio.clamp(0.0, most) - 1.0)
    }

    /// Weight of a ratio by the mean light around the pixel: 0 up to `least`, and 1 from twice `least`.
    fn trust(self, energy: f64, least: f64) -> f64 {
        if self == Self::Paper || least <= 0.0 { 1.0 } else { (energy / least - 1.0).clamp(0.0, 1.0) }
    }

    /// Light to add to a channel, from its light without and with the objects.
    pub(super) fn added(self, without: f64, with: f64) -> f64 {
        let added = match self {
            Self::Difference => with - without,
            Self::Hybrid => (with - without).max(0.0),
            Self::Stable | Self::Paper => 0.0,
        };
        if added.is_finite() { added } else { 0.0 }
    }
}

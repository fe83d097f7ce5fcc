//! Parametric shaping of a shadow.

use scene::math::num;

use super::{RatioForm, ShadowRatio};

impl ShadowRatio {
    /// Shaped factor of a raw ratio: the paper's parametric shadow shaping.
    pub(super) fn shape(&self, ratio: f64) -> f64 {
        1.0 - self.lambda * (1.0 - self.powered(ratio).max(self.s_min))
    }

    /// Ratio to the power of `gamma`.
    pub(super) fn powered(&self, ratio: f64) -> f64 {
        // Most pixels are 1, as is every power of it.
        if self.gamma == 1.0 || ratio == 1.0 { ratio } else { num::pow(ratio, self.gamma) }
    }

    /// Names of parameters that are set but have no effect because no ratio is taken, separated by commas. `None`
    /// if there are no such parameters.
    pub(super) fn idle(&self) -> Option<String> {
        let unset = Self::default();
        let set = [
            ("`channels`", self.channels != unset.channels),
            ("`epsilon`", self.epsilon != unset.epsilon),
            ("`min_energy`", self.min_energy != unset.min_energy),
            ("`s_max`", self.s_max != unset.s_max),
            ("`gamma`", self.gamma != unset.gamma),
            ("`s_min`", self.s_min != unset.s_min),
        ];
        let names: Vec<&str> = set.into_iter().filter(|(_, set)| *set).map(|(name, _)| name).collect();
        (self.form == RatioForm::Difference && !names.is_empty()).then(|| names.join(", "))
    }
}

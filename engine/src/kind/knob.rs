//! Knobs: parameters that trade work for accuracy.

use serde::Serialize;

/// Type of a knob: the quantity that it controls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum KnobKind {
    /// Number of random samples. The error is noise, which is inversely proportional to the square root of the
    /// work.
    Samples,
    /// Resolution of an intermediate image, not of the final picture.
    Resolution,
    /// Number of terms of a series, such as the number of light bounces.
    Depth,
    /// Relative size below which contributions are left out.
    Cutoff,
    /// Precision of the arithmetic.
    Precision,
    /// Strength of smoothing, which removes noise and detail.
    Filter,
    /// Maximum contribution of a sample, or 0 for no limit. A limit removes noise, but also some light.
    Limit,
}

impl KnobKind {
    /// The name as shown in lists of knobs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Resolution => "resolution",
            Self::Depth => "depth",
            Self::Cutoff => "cutoff",
            Self::Precision => "precision",
            Self::Filter => "filter",
            Self::Limit => "limit",
        }
    }
}

/// Declaration that a parameter is a knob. Each step of its ladder is at least as exact as the step before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Knob {
    /// Type of the knob.
    pub kind: KnobKind,
    /// The value in each of [`PRESETS`](crate::PRESETS), in RON; empty if the preset does not set it.
    pub ladder: [&'static str; 4],
}

impl Knob {
    /// The values to try, from the least work to the smallest error. These are the distinct steps of the ladder.
    /// Between a step a and the next step b, if both are positive integers, the values 2a, 4a, 8a and so on below b
    /// are also tried.
    pub fn values(&self) -> Vec<String> {
        let mut values: Vec<String> = Vec::new();
        for level in self.ladder.iter().filter(|level| !level.is_empty()) {
            let last = values.last().and_then(|text| text.parse::<u64>().ok());
            if let (Some(last @ 1..), Ok(next)) = (last, level.parse::<u64>()) {
                let doubled = std::iter::successors(last.checked_mul(2), |n| n.checked_mul(2));
                values.extend(doubled.take_while(|n| *n < next).map(|n| n.to_string()));
            }
            if values.last().is_none_or(|last| last != level) {
                values.push((*level).to_owned());
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_double_between_rungs_and_do_not_repeat() {
        let of = |ladder| Knob { kind: KnobKind::Samples, ladder }.values();
        assert_eq!(of(["4", "16", "40", "64"]), ["4", "8", "16", "32", "40", "64"]);
        assert_eq!(of(["F32", "F32", "F32", "F64"]), ["F32", "F64"]);
        assert_eq!(of(["", "", "", "0.0"]), ["0.0"]);
        assert_eq!(of(["0", "1", "4", "4"]), ["0", "1", "2", "4"], "nothing is doubled from 0");
    }
}

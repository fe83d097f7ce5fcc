//! Histograms: the type of value.

use lightharmony::engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

/// Number of pixels by luminance, in bins of one stop. Port type `histogram`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Histogram {
    /// Stops of the darkest bin: it counts luminances from `2^first` to `2^(first + 1)`.
    pub first: f64,
    /// Number of pixels in each bin.
    pub counts: Vec<f64>,
    /// Number of pixels darker than the first bin, including black.
    pub darker: f64,
}

impl Artifact for Histogram {
    const TYPE: &'static str = "histogram";
    /// Increase it whenever `encode` writes other bytes.
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.f64(self.first);
        to.f64s(&self.counts);
        to.f64(self.darker);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        Ok(Self { first: from.f64()?, counts: from.f64s()?, darker: from.f64()? })
    }

    fn bytes(&self) -> usize {
        8 * self.counts.len() + 64
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let moved = self.counts.iter().zip(&other.counts).filter(|(a, b)| a != b).count();
        Difference::of(format!("bins with another number of pixels: {moved}"))
    }
}

//! State of a training as a stored value.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};
use render::train::state::{Exposure, State};
use scene::types::{Splats, grouped};

/// Results of a range of iterations.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stretch {
    /// Number of iterations at the end of the range.
    pub iterations: u32,
    /// Number of splats at the end of the range.
    pub splats: u64,
    /// Mean loss of the photographs over the range.
    pub loss: f64,
    /// Number of faded splats that were moved in the range.
    pub relocated: u64,
    /// Mean PSNR of the photographs that are held out, at the end of the range, in dB. `None` if no photograph is
    /// held out, or if all are reproduced exactly.
    pub psnr: Option<f64>,
}

/// State of a training, and the results of all ranges so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Checkpoint {
    /// The state.
    pub state: State,
    /// Results of the ranges, in order.
    pub stretches: Vec<Stretch>,
}

fn encode_exposure(exposure: &Exposure, to: &mut Encoder) {
    to.f32s(&exposure.log_gain);
    to.f32s(exposure.moments.as_flattened());
    to.u32(exposure.updates);
}

fn decode_exposure(from: &mut Decoder<'_>) -> Result<Exposure, Corrupt> {
    let wrong = |_| Corrupt("an exposure does not have three channels".to_owned());
    let log_gain = from.f32s()?.try_into().map_err(wrong)?;
    let moments = grouped::<f32, 3>(from.f32s()?)?;
    let moments = moments.try_into().map_err(|_| Corrupt("an exposure needs two moments".to_owned()))?;
    Ok(Exposure { log_gain, moments, updates: from.u32()? })
}

impl Artifact for Checkpoint {
    const TYPE: &'static str = "training";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        let State { step, splats, log_scales, logits, first, second, updates, exposures, background } =
            &self.state;
        to.u32(*step);
        splats.encode(to);
        to.f32s(log_scales.as_flattened());
        to.f32s(logits);
        to.f32s(first);
        to.f32s(second);
        to.u32s(updates);
        to.u64(exposures.len() as u64);
        exposures.iter().for_each(|exposure| encode_exposure(exposure, to));
        encode_exposure(background, to);
        to.u64(self.stretches.len() as u64);
        for stretch in &self.stretches {
            to.u32(stretch.iterations);
            to.u64(stretch.splats);
            to.f64(stretch.loss);
            to.u64(stretch.relocated);
            to.bool(stretch.psnr.is_some());
            to.f64(stretch.psnr.unwrap_or_default());
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let step = from.u32()?;
        let splats = Splats::decode(from)?;
        let log_scales = grouped(from.f32s()?)?;
        let (logits, first, second) = (from.f32s()?, from.f32s()?, from.f32s()?);
        let updates = from.u32s()?;
        let count = from.length(52)?;
        let exposures = (0..count).map(|_| decode_exposure(from)).collect::<Result<_, _>>()?;
        let background = decode_exposure(from)?;
        let state = State { step, splats, log_scales, logits, first, second, updates, exposures, background };
        let n = state.splats.len();
        let fits = state.log_scales.len() == n
            && state.logits.len() == n
            && state.updates.len() == n
            && state.first.len() == n * state.stride()
            && state.second.len() == state.first.len();
        if !fits {
            return Err(Corrupt("the arrays of the training have unequal lengths".to_owned()));
        }
        let stretch = |from: &mut Decoder<'_>| {
            let (iterations, splats, loss) = (from.u32()?, from.u64()?, from.f64()?);
            let relocated = from.u64()?;
            let (scored, psnr) = (from.bool()?, from.f64()?);
            Ok(Stretch { iterations, splats, loss, relocated, psnr: scored.then_some(psnr) })
        };
        let count = from.length(37)?;
        let stretches = (0..count).map(|_| stretch(from)).collect::<Result<_, _>>()?;
        Ok(Self { state, stretches })
    }

    fn bytes(&self) -> usize {
        let own = self.state.first.len() * 8 + self.state.splats.len() * 20;
        self.state.splats.bytes() + own + self.state.exposures.len() * 40
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let splats = self.state.splats.difference(&other.state.splats);
        if splats.equal { Difference::of("the states of the optimiser differ") } else { splats }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_survive_storage_and_damage_is_found() {
        let start = Splats {
            means: vec![[1.0, 2.0, 3.0]; 3],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            scales: vec![[0.1; 3]; 3],
            opacities: vec![0.5; 3],
            sh: vec![[0.2; 3]; 3],
            ..Splats::empty()
        };
        let mut state = State::new(&start, 2, 2);
        state.step = 9;
        state.first[5] = 0.25;
        state.exposures[1].log_gain = [0.1, 0.2, 0.3];
        state.exposures[1].moments[1] = [4.0, 5.0, 6.0];
        let stretches = vec![Stretch { iterations: 9, splats: 3, loss: 0.5, relocated: 1, psnr: Some(20.0) }];
        let checkpoint = Checkpoint { state, stretches };
        let mut to = Encoder::default();
        checkpoint.encode(&mut to);
        let bytes = to.finish();
        let mut from = Decoder::new(&bytes);
        assert_eq!(Checkpoint::decode(&mut from).expect("is valid"), checkpoint);
        assert!(from.end().is_ok());
        for end in (0..bytes.len()).step_by(7) {
            assert!(Checkpoint::decode(&mut Decoder::new(&bytes[..end])).is_err());
        }
    }
}

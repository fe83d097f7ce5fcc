//! Progress and cancellation of long computations.

use candle_core::Tensor;

use super::error::Result;

/// Follows a computation.
pub trait Watch {
    /// Called between pieces of work; [`Error::Stopped`](super::Error::Stopped) ends it.
    fn check(&mut self) -> Result<()> {
        Ok(())
    }

    /// How much is done, from 0 to 1.
    fn progress(&mut self, _done: f64) {}

    /// An intermediate value, by its name in the layout of `diffusers`; for comparison with other code.
    fn value(&mut self, _name: &str, _value: &Tensor) {}
}

/// Neither follows nor stops.
impl Watch for () {}

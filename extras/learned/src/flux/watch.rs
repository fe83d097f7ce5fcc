//! Progress and cancellation of long computations.

use candle_core::Tensor;

use super::error::Result;

/// Observer of a computation.
pub trait Watch {
    /// Called between units of work. Returning [`Error::Stopped`](super::Error::Stopped) ends the computation.
    fn check(&mut self) -> Result<()> {
        Ok(())
    }

    /// Reports the progress, from 0 to 1.
    fn progress(&mut self, _done: f64) {}

    /// Reports an intermediate value for comparison with other code. `name` is the name of the value in
    /// `diffusers`.
    fn value(&mut self, _name: &str, _value: &Tensor) {}
}

/// An observer that does nothing.
impl Watch for () {}

//! Two kinds of nodes, and the type of value that connects them: a histogram of light.

pub mod draw_histogram;
pub mod histogram;
pub mod measure_histogram;

use lightharmony::Program;

/// The program with the kinds of this crate.
pub fn program() -> Program {
    Program::new().with::<measure_histogram::MeasureHistogram>().with::<draw_histogram::DrawHistogram>()
}

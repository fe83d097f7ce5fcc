//! Computes nodes of a graph for commands that show their results.

use engine::{Engine, Graph, RunOptions};

use super::engine::on_interrupt;
use super::error::Error;
use crate::terminal::{self, Report};

/// Computes nodes whose results are not cached, and prints progress and failures. Returns the exit code of the run.
pub fn compute(engine: &Engine, graph: &Graph, only: Vec<usize>) -> Result<u8, Error> {
    let options = RunOptions { only, cancel: on_interrupt()?, ..RunOptions::default() };
    let mut report = Report::lines(false);
    if report.shows_forecast() {
        report.expect(&engine.plan(graph, &options.only));
    }
    let outcome = engine.run(graph, &options, |event| report.show(&event));
    if let Some(failures) = &outcome.failures {
        terminal::mistakes(failures, false);
    }
    Ok(outcome.totals.exit_code())
}

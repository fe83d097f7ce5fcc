//! `tune`: finds settings of the knobs that reach a given error with little work, by measuring.

use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args;
use engine::{Event, PRESETS};
use serde_json::json;
use trade::Metric;
use trade::bench::Bench;
use trade::plot::tick_text;
use trade::search::Goal;
use trade::tune::{Unit, Wanted, tune};

use crate::session::{EngineArgs, Error, GraphArgs, RemoteArgs, on_interrupt, time};
use crate::terminal;
use crate::terminal::measuring::{Measuring, outlook_text};

/// Measures settings of the knobs to find the one that reaches a given error with the least work.
///
/// Runs the graph at the preset `reference`, which all pictures are compared with, at the other presets, and then
/// at settings near the best of them. Results are kept in the cache, so a setting costs only the work that it does
/// not share with others. Writes the best setting as an overlay.
#[derive(Debug, Args)]
pub struct Tune {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Find the least work with at most this error, such as flip=0.02, psnr=40 or touched.rmse=0.01; `touched.`
    /// counts only pixels that the object changes, `object.` only pixels that it covers, `shadow.` only pixels that
    /// it changes but does not cover
    #[arg(long, value_name = "METRIC=VALUE", conflicts_with_all = ["max_seconds", "max_work"])]
    max_error: Option<String>,
    /// Find the least error with at most this many CPU seconds of node code, as measured when each node last ran
    #[arg(long, value_name = "SECONDS", conflicts_with = "max_work", allow_negative_numbers = true)]
    max_seconds: Option<f64>,
    /// Find the least error with at most this much work, in rays (other counts are weighted as rays)
    #[arg(long, value_name = "RAYS", allow_negative_numbers = true)]
    max_work: Option<f64>,
    /// The measure of error to minimise with `--max-seconds` or `--max-work`: flip (default), flip95, rmse, psnr,
    /// ciede2000, mae, relmse; optionally with the prefix `touched.`, `object.` or `shadow.`
    #[arg(long, value_name = "METRIC", conflicts_with = "max_error")]
    metric: Option<String>,
    /// Maximum number of settings to measure
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = at_least_one)]
    budget: usize,
    /// Maximum time for measuring, such as 10m; when it is over, the best setting so far is written
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// The overlay to write
    #[arg(long, short, value_name = "FILE", default_value = "tuned.ron")]
    out: PathBuf,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl Tune {
    /// Runs the search. Returns exit code 0 if the goal was reached, 1 if it was not, 130 if the search was
    /// interrupted.
    pub fn run(self) -> Result<u8, Error> {
        let begin = Instant::now();
        let wanted = self.wanted()?;
        let limit = self.time.as_deref().map(time).transpose()?;
        let loaded = self.graph.load_to_turn()?;
        loaded.check_output(&self.out)?;
        let cancel = on_interrupt()?;
        let (engine, remote) = self.remote.connect(self.engine.open()?, &cancel, |warning| {
            if let Event::Warning { text, .. } = warning {
                terminal::remark(text);
            }
        })?;
        let mut bench = Bench::new(&engine, &loaded.graph, &loaded.only, cancel.clone())?;
        if let Some(limit) = limit {
            bench.end_at(begin + limit);
        }
        bench.judge_by(&wanted.metric);
        let shown = Measuring::new(None);
        if !self.json {
            let first = bench.outlook(&[bench.preset(PRESETS.len() - 1)]);
            let how = if limit.is_none() { "; `--time` and `--budget` limit the search" } else { "" };
            let (most, first) = (self.budget, outlook_text(&first));
            shown.line(&format!(
                "measuring begins with the preset `reference` ({first}); number of settings: at most {most}{how}"
            ));
            bench.observe(shown.observer());
        }
        bench.leave_out_resized()?;
        let mut tuned = tune(&mut bench, &wanted, |bench, at| {
            bench.new_remarks().iter().for_each(|remark| shown.line(remark));
            if !self.json {
                let point = &bench.points[at];
                let (work, seconds) = (tick_text(point.work), tick_text(point.cpu_seconds));
                let error = wanted.metric.shown(wanted.metric.error(&point.off));
                let name = bench.name(&point.assignment);
                shown.line(&format!("measured work {work:>8}, {seconds:>7} CPU-s, error {error:>8}  {name}"));
            }
        });
        shown.end();
        if tuned.best.is_none()
            && let Some(wrong) = tuned.wrong.take()
        {
            return Err(wrong.into());
        }
        let stopped = cancel.load(Ordering::Relaxed);
        let Some(best) = tuned.best else {
            terminal::error(&tuned.nearest(&wanted, stopped));
            return Ok(if stopped { 130 } else { 1 });
        };
        let summary = tuned.summary(&wanted, stopped);
        let text = format!("// {summary}\n{}", bench.overlay(&tuned.tried[best].assignment));
        cache::publish_file(&self.out, text.as_bytes())?;
        if self.json {
            let mut object = tuned.json(&bench, &wanted.metric, stopped);
            object["overlay"] = json!(self.out);
            terminal::print(&format!("{object}\n"))?;
        } else {
            terminal::print(&terminal::columns(&tuned.rows(&bench, &wanted.metric)))?;
            terminal::print(&format!("{summary}\n{}\n", self.out.display()))?;
        }
        if let Some(wrong) = tuned.wrong {
            terminal::remark(&wrong.to_string());
        }
        remote.and_then(|remote| remote.summary()).iter().for_each(|line| terminal::remark(line));
        Ok(if stopped { 130 } else { 0 })
    }

    fn wanted(&self) -> Result<Wanted, Error> {
        let budget = self.budget;
        if let Some(text) = &self.max_error {
            let (metric, bound) = Metric::bounded(text)?;
            return Ok(Wanted { metric, goal: Goal::Error(bound), unit: Unit::Rays, budget });
        }
        let name = self.metric.as_deref().unwrap_or("flip");
        let metric = Metric::named(name)?;
        let seconds = self.max_seconds.map(|value| ("--max-seconds", value));
        let work = self.max_work.map(|value| ("--max-work", value));
        let (option, value) = seconds.or(work).ok_or_else(no_goal)?;
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::usage(format!("`{option}` must be a number above 0, but is {value}")));
        }
        let unit = if self.max_seconds.is_some() { Unit::CpuSeconds } else { Unit::Rays };
        Ok(Wanted { metric, goal: Goal::Cost(value), unit, budget })
    }
}

fn no_goal() -> Error {
    Error::usage(
        "a goal is missing; add one, such as --max-error flip=0.02, --max-seconds 10 or --max-work 1e8",
    )
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "expected a whole number of 1 or more".to_owned())
}

//! `tune`: settings of the knobs that reach an error with little work, found by measuring.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;
use engine::PRESETS;
use serde_json::json;

use super::knobs::columns;
use crate::report;
use crate::session::{EngineArgs, Error, GraphArgs, on_interrupt};
use crate::trade::Metric;
use crate::trade::below::{Below, below};
use crate::trade::bench::{Bench, Miss};
use crate::trade::plot::tick_text;
use crate::trade::search::{self, Goal, SearchResult, Tried, pareto, search};
use crate::trade::tunables::Assignment;

/// Looks for settings of the knobs that reach an error with little work, by measuring.
///
/// Runs the graph at the preset `reference`, which the pictures are compared with, at the other presets, and then at
/// settings next to the best of them, one knob at a time. What was computed is kept in the cache, so a setting
/// costs what it does not share with others. Writes the best as an overlay.
#[derive(Debug, Args)]
pub struct Tune {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// The least work with at most this error, such as flip=0.02, psnr=40 or touched.rmse=0.01; `touched.` counts
    /// only what the object changes, `object.` of that what it covers, `shadow.` the rest
    #[arg(long, value_name = "METRIC=VALUE", conflicts_with_all = ["max_seconds", "max_work"])]
    max_error: Option<String>,
    /// The least error with at most so many CPU seconds of node code, as measured when it ran
    #[arg(long, value_name = "SECONDS", conflicts_with = "max_work", allow_negative_numbers = true)]
    max_seconds: Option<f64>,
    /// The least error with at most so much work, in rays (other counts are weighed as rays)
    #[arg(long, value_name = "RAYS", allow_negative_numbers = true)]
    max_work: Option<f64>,
    /// What is least where a cost is bounded: flip (default), flip95, rmse, psnr, ciede2000, mae, relmse, with
    /// `touched.`, `object.` or `shadow.` in front
    #[arg(long, value_name = "METRIC", conflicts_with = "max_error")]
    metric: Option<String>,
    /// Most settings to measure
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = at_least_one)]
    budget: usize,
    /// The overlay to write
    #[arg(long, short, value_name = "FILE", default_value = "tuned.ron")]
    out: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl Tune {
    /// Exit code 0 where the goal was reached, 1 where it was not, 130 where it was stopped.
    pub fn run(self) -> Result<u8, Error> {
        let (metric, goal) = self.goal()?;
        let loaded = self.graph.load_to_turn()?;
        loaded.check_output(&self.out)?;
        let engine = self.engine.open()?;
        let cancel = on_interrupt()?;
        let mut bench = Bench::new(&engine, &loaded.graph, &loaded.only, cancel.clone())?;
        bench.tells = !self.json;
        bench.judge_by(&metric);
        bench.leave_out_resized()?;
        let steps = bench.steps();
        // The first one is what others are compared with.
        let starts = [bench.preset(3), bench.preset(2), bench.preset(1), bench.preset(0), bench.now()];
        let mut asked = Measuring { tune: &self, metric: &metric, bench, left: self.budget, wrong: None };
        let SearchResult { mut tried, mut best, finished } =
            search(&starts, &steps, goal, |at| asked.measure(at));
        if best.is_none()
            && let Some(wrong) = asked.wrong.take()
        {
            return Err(wrong);
        }
        let naive = naive(&starts, &tried, goal);
        let mut half = None;
        if let (true, Goal::Error(_), Some(found), Some((_, preset))) = (finished, goal, best, &naive)
            && tried[found].cost >= 0.5 * preset.cost
        {
            half = below(&steps, &tried, 0.5 * preset.cost, self.budget, |at| asked.measure(at));
            for more in half.iter().flat_map(|half| half.all.iter().chain([&half.least])) {
                if !tried.contains(more) {
                    tried.push(more.clone());
                }
            }
            best = search::best(&tried, goal);
        }
        let Measuring { bench, left, wrong, .. } = asked;
        let stopped = cancel.load(Ordering::Relaxed);
        let Some(best) = best else {
            let least = |of: fn(&Tried) -> f64| tried.iter().map(of).reduce(f64::min);
            let nearest = match goal {
                Goal::Error(_) => format!("the least error is {}", metric.told(least(|t| t.error))),
                Goal::Cost(_) => {
                    let unit = self.unit();
                    let (cost, all) =
                        (tick_text(least(|t| t.cost).unwrap_or(0.0)), "every knob at its least");
                    match finished {
                        true => format!("the least cost is {cost} {unit}, that of {all} included"),
                        false => format!("the least cost is {cost} {unit}, and {all} was not measured"),
                    }
                }
            };
            report::error(&match (tried.len(), stopped) {
                (0, _) => "stopped before anything was measured".to_owned(),
                (count, false) => {
                    format!("none of {count} settings that were measured reaches the goal; {nearest}")
                }
                (count, true) => {
                    format!(
                        "stopped; none of {count} settings that were measured reaches the goal; {nearest}"
                    )
                }
            });
            return Ok(if stopped { 130 } else { 1 });
        };
        let found = &tried[best];
        let ended = match (finished, stopped) {
            (true, _) => "no single turn of a knob helps",
            (false, true) => "stopped, so there may be better ones",
            (false, false) if left == 0 => "the budget is spent, so there may be better ones",
            (false, false) => "a setting failed, so there may be better ones",
        };
        let mut summary = summary(&metric, goal, found, self.unit(), naive.as_ref());
        if let (Some(half), Some((_, preset))) = (&half, &naive)
            && found.cost >= 0.5 * preset.cost
        {
            summary.push_str(&format!("; {}", none_below_half(&metric, half)));
        }
        let summary = format!("{summary}; {} settings measured: {ended}", tried.len());
        let text = format!("// {summary}\n{}", bench.overlay(&found.assignment));
        cache::publish_file(&self.out, text.as_bytes())?;
        if self.json {
            let mut told = self.told(&bench, &metric, &tried, best);
            (told["finished"], told["ended"]) = (json!(finished), json!(ended));
            told["below_half"] = half.as_ref().map_or(json!(null), |half| {
                let least =
                    half.all.iter().map(|t| t.error).reduce(f64::min).map(|error| metric.value(error));
                json!({"settings": half.all.len(), "complete": half.complete, "least_error": least, "least_cost": half.least.cost,
                       "pairs": half.saved.pairs, "most_saved": half.saved.most, "margin": half.margin})
            });
            super::print(&format!("{told}\n"))?;
        } else {
            self.print(&bench, &metric, &tried, best)?;
            super::print(&format!("{summary}\n{}\n", self.out.display()))?;
        }
        if let Some(wrong) = wrong {
            report::remark(&wrong.to_string());
        }
        Ok(if stopped { 130 } else { 0 })
    }

    /// What costs are told in.
    fn unit(&self) -> &'static str {
        if self.max_seconds.is_some() { "CPU-s" } else { "rays" }
    }

    fn goal(&self) -> Result<(Metric, Goal), Error> {
        let known = Metric::known();
        if let Some(text) = &self.max_error {
            let (metric, bound) =
                Metric::bound(text).ok_or_else(|| Error::Bound { text: text.clone(), known })?;
            return Ok((metric, Goal::Error(bound)));
        }
        let name = self.metric.as_deref().unwrap_or("flip");
        let metric = Metric::of(name).ok_or_else(|| Error::Metric { text: name.to_owned(), known })?;
        let seconds = self.max_seconds.map(|value| ("--max-seconds", value));
        let work = self.max_work.map(|value| ("--max-work", value));
        let (option, value) = seconds.or(work).ok_or(Error::NoGoal)?;
        if !(value > 0.0 && value.is_finite()) {
            return Err(Error::NoCost { option, value });
        }
        Ok((metric, Goal::Cost(value)))
    }

    fn print(&self, bench: &Bench<'_>, metric: &Metric, tried: &[Tried], best: usize) -> Result<(), Error> {
        let front = pareto(tried);
        let mut rows = vec![["", "work", "CPU-s", "error", "setting"].map(str::to_owned).to_vec()];
        for (index, t) in tried.iter().enumerate() {
            let Some(point) = bench.points.iter().find(|point| point.assignment == t.assignment) else {
                continue;
            };
            let mark = if index == best {
                "best"
            } else if front.contains(&index) {
                "front"
            } else {
                ""
            };
            let (work, seconds, error) =
                (tick_text(point.work), tick_text(point.cpu_seconds), metric.told(Some(t.error)));
            rows.push(vec![mark.to_owned(), work, seconds, error, bench.name(&t.assignment)]);
        }
        super::print(&columns(&rows))
    }

    fn told(&self, bench: &Bench<'_>, metric: &Metric, tried: &[Tried], best: usize) -> serde_json::Value {
        let front = pareto(tried);
        let point = |(index, t): (usize, &Tried)| {
            let point = bench.points.iter().find(|point| point.assignment == t.assignment);
            json!({
                "setting": bench.name(&t.assignment),
                "error": metric.value(t.error),
                "work": point.map(|p| p.work),
                "seconds": point.map(|p| p.seconds),
                "cpu_seconds": point.map(|p| p.cpu_seconds),
                "front": front.contains(&index),
                "best": index == best,
            })
        };
        json!({
            "overlay": self.out,
            "measured": tried.iter().enumerate().map(point).collect::<Vec<_>>(),
        })
    }
}

/// Measures settings, and tells each.
struct Measuring<'t> {
    tune: &'t Tune,
    metric: &'t Metric,
    bench: Bench<'t>,
    /// How many may still be measured.
    left: usize,
    wrong: Option<Error>,
}

impl Measuring<'_> {
    /// Cost and error; `None` where there is no more measuring.
    fn measure(&mut self, assignment: &[usize]) -> Option<(f64, f64)> {
        let assignment = assignment.to_vec();
        let known = self.bench.points.len();
        if self.left == 0 && !self.bench.points.iter().any(|point| point.assignment == assignment) {
            return None;
        }
        let at = match self.bench.measure(&assignment) {
            Ok(at) => at,
            Err(Miss::Stopped) => return None,
            Err(Miss::Failed(why)) => {
                self.wrong = Some(Error::Setting { setting: self.bench.name(&assignment), why });
                return None;
            }
        };
        self.bench.new_remarks().iter().for_each(|remark| report::remark(remark));
        let point = &self.bench.points[at];
        let error = self.metric.error(&point.off);
        if at == known {
            self.left -= 1;
            if !self.tune.json {
                let (work, seconds) = (tick_text(point.work), tick_text(point.cpu_seconds));
                let (error, name) = (self.metric.told(error), self.bench.name(&assignment));
                report::remark(&format!(
                    "measured work {work:>8}, {seconds:>7} CPU-s, error {error:>8}  {name}"
                ));
            }
        }
        if error.is_none() {
            self.wrong =
                Some(Error::NotComputed { metric: self.metric.name.clone(), why: self.metric.needs() });
        }
        let cost = if self.tune.max_seconds.is_some() { point.cpu_seconds } else { point.work };
        Some((cost, error?))
    }
}

/// The preset that one would take without measuring: the cheapest that fits, or the best within a cost.
fn naive(starts: &[Assignment], tried: &[Tried], goal: Goal) -> Option<(&'static str, Tried)> {
    let presets = PRESETS.into_iter().rev().zip(starts);
    let known =
        presets.filter_map(|(name, start)| Some((name, tried.iter().find(|t| t.assignment == *start)?)));
    let (names, tried): (Vec<_>, Vec<_>) = known.map(|(name, t)| (name, t.clone())).unzip();
    search::best(&tried, goal).map(|at| (names[at], tried[at].clone()))
}

/// What was found out of settings that cost less than half of what the preset does, and how far that holds.
fn none_below_half(metric: &Metric, half: &Below) -> String {
    let least = half.all.iter().map(|t| t.error).reduce(f64::min);
    let found = match least {
        Some(_) if !half.complete => {
            let (count, least) = (half.all.len(), metric.told(least));
            format!(
                "{count} settings that cost less than half of it were measured, and none reaches it (least error {least}); there \
                 may be more, for which --budget makes room"
            )
        }
        None if !half.complete => {
            "whether anything costs less than half of it was not found out: --budget makes room for that"
                .to_owned()
        }
        Some(_) => {
            let (count, least) = (half.all.len(), metric.told(least));
            format!(
                "none of the {count} settings that were found to cost less than half of it reaches it (least error {least})"
            )
        }
        None => {
            let cost = tick_text(half.least.cost);
            format!(
                "none was found that costs less than half of it: with every knob at its least it is {cost}"
            )
        }
    };
    let (most, pairs) = (100.0 * half.saved.most, half.saved.pairs);
    let saved = format!("turning knobs up saved at most {most:.1} % elsewhere in {pairs} pairs of settings");
    if half.complete {
        let margin = 100.0 * half.margin;
        format!("{found}; for another one it would have to save more than {margin:.1} %, and {saved}")
    } else {
        format!("{found}; {saved}")
    }
}

fn summary(metric: &Metric, goal: Goal, found: &Tried, unit: &str, naive: Option<&(&str, Tried)>) -> String {
    let error = metric.told(Some(found.error));
    let mut text = format!("{} {error} for {} {unit}", metric.name, tick_text(found.cost));
    if let Some((name, preset)) = naive {
        match goal {
            Goal::Error(_) => {
                let ratio = found.cost / preset.cost;
                text.push_str(&format!(
                    ", {ratio:.2} of that of `{name}`, the cheapest preset that reaches it"
                ));
            }
            Goal::Cost(_) => {
                let other = metric.told(Some(preset.error));
                text.push_str(&format!("; `{name}`, the best preset within it, has {other}"));
            }
        }
    }
    text
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "a whole number of 1 or more is wanted".to_owned())
}

//! `tune`: searches for settings of the knobs, and formats the result as text and as JSON.

use engine::PRESETS;
use serde_json::{Value, json};

use crate::below::{Below, below};
use crate::bench::{Bench, Miss};
use crate::error::Error;
use crate::metric::Metric;
use crate::plot::tick_text;
use crate::search::{self, Goal, SearchResult, Tried, pareto, search};
use crate::tunables::Assignment;

/// The unit of the cost of a setting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Rays. Other deterministic counts are converted to rays.
    Rays,
    /// CPU seconds that the nodes' code took, as measured when the nodes were run.
    CpuSeconds,
}

impl Unit {
    /// The name of the unit: `rays` or `CPU-s`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rays => "rays",
            Self::CpuSeconds => "CPU-s",
        }
    }
}

/// The goal of a search.
#[derive(Debug)]
pub struct Wanted {
    /// The metric that measures the error.
    pub metric: Metric,
    /// The bound on the error or on the cost.
    pub goal: Goal,
    /// The unit of the cost.
    pub unit: Unit,
    /// Maximum number of settings to measure.
    pub budget: usize,
}

/// The result of a search.
pub struct Tuned {
    /// All settings that were measured.
    pub tried: Vec<Tried>,
    /// The index in `tried` of the best setting that reaches the goal.
    pub best: Option<usize>,
    /// If the error is bounded, the cheapest preset that reaches the goal. If the cost is bounded, the preset with
    /// the smallest error within the bound.
    pub naive: Option<(&'static str, Tried)>,
    /// Result of a search for settings that cost less than half as much as the preset in `naive`. `None` if there
    /// was no such search, for example because the best setting already costs less.
    pub half: Option<Below>,
    /// True if the search finished; false if measuring ended first.
    pub finished: bool,
    /// Number of settings that the budget still allows the search to measure.
    pub left: usize,
    /// True if the time for measuring ran out.
    pub late: bool,
    /// The error that ended the search; `None` if no error occurred.
    pub wrong: Option<Error>,
}

/// Searches for the best setting. After every newly measured setting, calls `each` with the index of its point.
pub fn tune(bench: &mut Bench<'_>, wanted: &Wanted, each: impl FnMut(&mut Bench<'_>, usize)) -> Tuned {
    let steps = bench.steps();
    // The first start is the reference, with which the others are compared.
    let starts = [bench.preset(3), bench.preset(2), bench.preset(1), bench.preset(0), bench.now()];
    let mut measuring = Measuring { wanted, bench, left: wanted.budget, late: false, wrong: None, each };
    let SearchResult { mut tried, mut best, finished } =
        search(&starts, &steps, wanted.goal, |at| measuring.measure(at));
    let naive = naive(&starts, &tried, wanted.goal);
    let mut half = None;
    if let (true, Goal::Error(_), Some(found), Some((_, preset))) = (finished, wanted.goal, best, &naive)
        && tried[found].cost >= 0.5 * preset.cost
    {
        half = below(&steps, &tried, 0.5 * preset.cost, wanted.budget, |at| measuring.measure(at));
        for more in half.iter().flat_map(|half| half.all.iter().chain([&half.least])) {
            if !tried.contains(more) {
                tried.push(more.clone());
            }
        }
        best = search::best(&tried, wanted.goal);
    }
    let Measuring { left, late, wrong, .. } = measuring;
    Tuned { tried, best, naive, half, finished, left, late, wrong }
}

/// Measures settings within the budget.
struct Measuring<'t, 'e, E> {
    wanted: &'t Wanted,
    bench: &'t mut Bench<'e>,
    /// Number of settings that may still be measured.
    left: usize,
    /// True if the time for measuring ran out.
    late: bool,
    wrong: Option<Error>,
    each: E,
}

impl<E: FnMut(&mut Bench<'_>, usize)> Measuring<'_, '_, E> {
    /// Returns the cost and error of an assignment. Returns `None` to end the search.
    fn measure(&mut self, assignment: &[usize]) -> Option<(f64, f64)> {
        let assignment = assignment.to_vec();
        let known = self.bench.points.len();
        if self.left == 0 && !self.bench.points.iter().any(|point| point.assignment == assignment) {
            return None;
        }
        let at = match self.bench.measure(&assignment) {
            Ok(at) => at,
            Err(Miss::Stopped) => return None,
            Err(Miss::Late) => {
                self.late = true;
                return None;
            }
            Err(Miss::Failed(why)) => {
                self.wrong = Some(Error::Setting { setting: self.bench.name(&assignment), why });
                return None;
            }
        };
        if at == known {
            self.left -= 1;
            (self.each)(self.bench, at);
        }
        let metric = &self.wanted.metric;
        let point = &self.bench.points[at];
        let error = metric.error(&point.off);
        if error.is_none() {
            self.wrong = Some(Error::NotComputed { metric: metric.name.clone(), needs: metric.needs() });
        }
        let cost = match self.wanted.unit {
            Unit::CpuSeconds => point.cpu_seconds,
            Unit::Rays => point.work,
        };
        Some((cost, error?))
    }
}

impl Tuned {
    /// The reason why the search ended. `stopped` is true if the user interrupted it.
    pub fn ended(&self, stopped: bool) -> &'static str {
        match (self.finished, stopped) {
            (true, _) => "changing a single knob by one step does not improve on this setting",
            (false, true) => "interrupted, so the best setting may not have been found",
            (false, false) if self.late => "the time ran out, so the best setting may not have been found",
            (false, false) if self.left == 0 => {
                "the budget is used up, so the best setting may not have been found"
            }
            (false, false) => "a setting failed, so the best setting may not have been found",
        }
    }

    /// A line that compares the best setting with the presets and says why the search ended. Empty if no setting
    /// reaches the goal.
    pub fn summary(&self, wanted: &Wanted, stopped: bool) -> String {
        let Some(found) = self.best.map(|best| &self.tried[best]) else { return String::new() };
        let mut text = summary(&wanted.metric, wanted.goal, found, wanted.unit.name(), self.naive.as_ref());
        if let (Some(half), Some((_, preset))) = (&self.half, &self.naive)
            && found.cost >= 0.5 * preset.cost
        {
            text.push_str(&format!("; {}", none_below_half(&wanted.metric, half)));
        }
        format!("{text}; settings measured: {}; {}", self.tried.len(), self.ended(stopped))
    }

    /// Describes the setting that is nearest to the goal, if no setting reaches the goal.
    pub fn nearest(&self, wanted: &Wanted, stopped: bool) -> String {
        let least = |of: fn(&Tried) -> f64| self.tried.iter().map(of).reduce(f64::min);
        let nearest = match wanted.goal {
            Goal::Error(_) => format!("the smallest error is {}", wanted.metric.shown(least(|t| t.error))),
            Goal::Cost(_) => {
                let unit = wanted.unit.name();
                let cost = tick_text(least(|t| t.cost).unwrap_or(0.0));
                match self.finished {
                    true => format!("the smallest cost is {cost} {unit}, with every knob at its minimum"),
                    false => {
                        format!(
                            "the smallest cost measured is {cost} {unit}; the setting with every knob at its minimum was not measured"
                        )
                    }
                }
            }
        };
        match (self.tried.len(), stopped) {
            (0, _) => "interrupted before anything was measured".to_owned(),
            (count, false) => format!("no setting reaches the goal (settings measured: {count}); {nearest}"),
            (count, true) => {
                format!(
                    "interrupted before a setting reached the goal (settings measured: {count}); {nearest}"
                )
            }
        }
    }

    /// The rows of a table of the measured settings, starting with the heading. The columns are mark, work, CPU
    /// seconds, error and name.
    pub fn rows(&self, bench: &Bench<'_>, metric: &Metric) -> Vec<Vec<String>> {
        let front = pareto(&self.tried);
        let mut rows = vec![["", "work", "CPU-s", "error", "setting"].map(str::to_owned).to_vec()];
        for (index, t) in self.tried.iter().enumerate() {
            let Some(point) = bench.points.iter().find(|point| point.assignment == t.assignment) else {
                continue;
            };
            let mark = if Some(index) == self.best {
                "best"
            } else if front.contains(&index) {
                "front"
            } else {
                ""
            };
            let (work, seconds, error) =
                (tick_text(point.work), tick_text(point.cpu_seconds), metric.shown(Some(t.error)));
            rows.push(vec![mark.to_owned(), work, seconds, error, bench.name(&t.assignment)]);
        }
        rows
    }

    /// The measured settings and the reason why the search ended, as JSON.
    pub fn json(&self, bench: &Bench<'_>, metric: &Metric, stopped: bool) -> Value {
        let front = pareto(&self.tried);
        let point = |(index, t): (usize, &Tried)| {
            let point = bench.points.iter().find(|point| point.assignment == t.assignment);
            json!({
                "setting": bench.name(&t.assignment),
                "error": metric.value(t.error),
                "work": point.map(|p| p.work),
                "seconds": point.map(|p| p.seconds),
                "cpu_seconds": point.map(|p| p.cpu_seconds),
                "front": front.contains(&index),
                "best": Some(index) == self.best,
            })
        };
        let below_half = self.half.as_ref().map_or(json!(null), |half| {
            let least = half.all.iter().map(|t| t.error).reduce(f64::min).map(|error| metric.value(error));
            json!({"settings": half.all.len(), "complete": half.complete, "least_error": least, "least_cost": half.least.cost,
                   "pairs": half.saved.pairs, "most_saved": half.saved.most, "margin": half.margin})
        });
        json!({
            "measured": self.tried.iter().enumerate().map(point).collect::<Vec<_>>(),
            "finished": self.finished,
            "ended": self.ended(stopped),
            "below_half": below_half,
        })
    }
}

/// The preset that a user would choose without a search. If the error is bounded, this is the cheapest preset that
/// reaches the goal; if the cost is bounded, the preset with the smallest error within the bound.
fn naive(starts: &[Assignment], tried: &[Tried], goal: Goal) -> Option<(&'static str, Tried)> {
    let presets = PRESETS.into_iter().rev().zip(starts);
    let known =
        presets.filter_map(|(name, start)| Some((name, tried.iter().find(|t| t.assignment == *start)?)));
    let (names, tried): (Vec<_>, Vec<_>) = known.map(|(name, t)| (name, t.clone())).unzip();
    search::best(&tried, goal).map(|at| (names[at], tried[at].clone()))
}

/// Describes the result of the search for settings that cost less than half as much as the preset, and the
/// certainty of this result.
fn none_below_half(metric: &Metric, half: &Below) -> String {
    let least = half.all.iter().map(|t| t.error).reduce(f64::min);
    let found = match least {
        Some(_) if !half.complete => {
            let (count, least) = (half.all.len(), metric.shown(least));
            format!(
                "no measured setting at less than half of the cost of this preset reaches the goal (settings: {count}, smallest error: {least}); a larger `--budget` would measure more such settings"
            )
        }
        None if !half.complete => {
            "no setting at less than half of the cost of this preset was measured; a larger `--budget` would include such settings"
                .to_owned()
        }
        Some(_) => {
            let (count, least) = (half.all.len(), metric.shown(least));
            format!(
                "no setting at less than half of the cost of this preset reaches the goal (settings: {count}, smallest error: {least})"
            )
        }
        None => {
            let cost = tick_text(half.least.cost);
            format!(
                "no setting was found at less than half of the cost of this preset: even with every knob at its minimum, the cost is {cost}"
            )
        }
    };
    let (most, pairs) = (100.0 * half.saved.most, half.saved.pairs);
    let saved = format!(
        "raising knobs saved at most {most:.1} % of the cost in the measured pairs of settings (number of pairs: {pairs})"
    );
    if half.complete {
        let margin = 100.0 * half.margin;
        format!(
            "{found}; such a setting could exist only if raising knobs saved more than {margin:.1} % of the cost; {saved}"
        )
    } else {
        format!("{found}; {saved}")
    }
}

fn summary(metric: &Metric, goal: Goal, found: &Tried, unit: &str, naive: Option<&(&str, Tried)>) -> String {
    let error = metric.shown(Some(found.error));
    let mut text = format!("{} {error} for {} {unit}", metric.name, tick_text(found.cost));
    if let Some((name, preset)) = naive {
        match goal {
            Goal::Error(_) => {
                let ratio = found.cost / preset.cost;
                text.push_str(&format!(
                    ", {ratio:.2} of the cost of `{name}`, the cheapest preset that reaches the goal"
                ));
            }
            Goal::Cost(_) => {
                let other = metric.shown(Some(preset.error));
                text.push_str(&format!(
                    "; `{name}`, the best preset within this cost, has an error of {other}"
                ));
            }
        }
    }
    text
}

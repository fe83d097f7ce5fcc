//! `run`: computes the results that are not in the cache and writes the files of the sinks.

mod trace;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use engine::{Engine, Event, Graph, Outcome, RunOptions, State, run_unchanged};
use serde_json::{Value, json};
use trace::Trace;

use crate::session::agreement::{self, Done, Memory};
use crate::session::origin::Origin;
use crate::session::{
    EngineArgs, Error, GraphArgs, Loaded, RemoteArgs, at_end_of_input, budget, cache_folder, locked,
    on_interrupt, time,
};
use crate::terminal::{self, Report};

/// Runs a graph: computes what is not cached and writes the files of its sinks.
#[derive(Debug, Args)]
pub struct Run {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Output folder of the sinks
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Take samples until the standard error of shadow and object is at most this, such as 0.01. The maximum number
    /// of samples is the number in the graph, even if a preset sets fewer. Sets `max_error` of every node that has
    /// this parameter
    #[arg(long, value_name = "ERROR", conflicts_with = "time", allow_negative_numbers = true)]
    max_error: Option<f64>,
    /// Take as many samples as the forecast allows in this time, such as 10s or 5m, but at most as many as the
    /// graph sets. The number is printed and fixed before the run. Without a forecast, 4 samples are taken first
    /// and kept
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// Refuse to run if inputs or kinds differ from the graph's lock, and fail if results differ
    #[arg(long)]
    locked: bool,
    /// Write a trace of all threads, for chrome://tracing or Perfetto
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Print one JSON object per line on standard output
    #[arg(long)]
    pub json: bool,
    /// Also print progress for Open Job Description on standard output, and end with exit code 0 instead of 3 if a
    /// result is degraded
    #[arg(long, conflicts_with = "json")]
    openjd: bool,
    /// Stop when standard input reaches its end, as after Ctrl-C. A program that starts this one and keeps the other
    /// end of a pipe open thus also stops it by ending, even if it is killed
    #[arg(long)]
    stop_at_eof: bool,
    /// Also print cached nodes, counts, and all notes of nodes
    #[arg(long, short)]
    verbose: bool,
}

/// A graph with more nodes than this is not planned only to get a forecast, since planning takes time.
const MOST_PLANNED: usize = 2000;
/// Exit code of a run with a degraded result. Open Job Description has no code of this kind: a task whose exit code
/// is not 0 has failed.
const DEGRADED: u8 = 3;

/// A run that has ended.
struct Executed {
    outcome: Outcome,
    done: Done,
    /// With `--json`, the event of the end: it is printed last, after failures and findings.
    end: Option<Event>,
}

/// Compares the splats, the mesh and the cameras of a run, and shows the findings. If another node failed, what the run
/// has of them is compared.
fn compare_scene(engine: &Engine, graph: &Graph, done: &Done, report: &mut Report) {
    let mut memory = Memory::of_store(engine.store(), &graph.source, &graph.root);
    let found = agreement::findings(engine, graph, done, &mut memory);
    memory.keep(engine.store(), &graph.source, done, &found);
    for (id, text) in found {
        report.show(&Event::Warning { id, text });
    }
}

impl Run {
    /// Runs the graph and returns the exit code of the run.
    pub fn run(self) -> Result<u8, Error> {
        let openjd = self.openjd;
        let code = self.run_graph()?;
        Ok(if openjd && code == DEGRADED { 0 } else { code })
    }

    fn run_graph(self) -> Result<u8, Error> {
        let begin = Instant::now();
        let time = self.time.as_deref().map(time).transpose()?;
        if time.is_some_and(|time| time.is_zero()) {
            return Err(Error::usage("`--time` must be above 0"));
        }
        if self.stop_at_eof && self.graph.graph == Path::new("-") {
            return Err(Error::usage(
                "`--stop-at-eof` cannot be used with a graph from standard input; write the graph to a file",
            ));
        }
        let mut texts = Vec::new();
        let origin = self.graph.read(&mut texts)?;
        if let Some(outcome) = self.unchanged(&origin)? {
            return Ok(outcome.totals.exit_code());
        }
        let (mut loaded, engine) = self.graph.check_with(origin, &texts, &self.engine)?;
        loaded.check_outputs(&self.out)?;
        self.trace.as_deref().map_or(Ok(()), |trace| loaded.check_output(trace))?;
        let cancel = on_interrupt()?;
        if self.stop_at_eof {
            let stop = cancel.clone();
            at_end_of_input(move || stop.store(true, Ordering::Relaxed));
        }
        let (engine, remote) = self.remote.connect(engine, &cancel, |warning| self.report().show(warning))?;
        loaded = self.to_error(loaded)?;
        if let Some(time) = time {
            if let Some(code) = self.pilot(&loaded, &engine, &cancel)? {
                return Ok(code);
            }
            loaded = self.in_time(loaded, &engine, time.saturating_sub(begin.elapsed()))?;
        }
        let (graph, only) = (&loaded.graph, &loaded.only);
        let locked = self.locked.then(|| locked::read(&loaded)).transpose()?;
        if let Some(lock) = &locked {
            locked::refuse(&engine, graph, only, lock)?;
        }
        let mut report = self.report();
        if let Some(text) = terminal::no_file(graph, only) {
            report.show(&Event::Warning { id: "no-file", text });
        }
        let options = RunOptions {
            out: self.out.clone(),
            texts: loaded.texts.clone(),
            only: only.clone(),
            cancel,
            trace: self.trace.is_some(),
            ..RunOptions::default()
        };
        if report.shows_forecast() && graph.nodes.len() <= MOST_PLANNED {
            report.expect(&engine.plan(graph, only));
        }
        let Executed { outcome, done, end } = self.execute(&engine, graph, &options, &mut report)?;
        if let Some(failures) = &outcome.failures {
            terminal::mistakes(failures, self.json);
        }
        if !outcome.totals.stopped {
            compare_scene(&engine, graph, &done, &mut report);
        }
        if let Some(time) = time.filter(|time| begin.elapsed() > *time) {
            let [took, asked] =
                [begin.elapsed(), time].map(|time| terminal::seconds_text(time.as_secs_f64()));
            report.show(&Event::Warning {
                id: "time-missed",
                text: format!("the run took {took}, longer than the {asked} that `--time` allows"),
            });
        }
        match &remote {
            Some(remote) if self.json => terminal::json_line(&remote.json()),
            Some(remote) => remote.summary().iter().for_each(|line| terminal::remark(line)),
            None => {}
        }
        end.iter().for_each(|end| report.show(end));
        if let Some(lock) = &locked {
            let now = engine.lock(graph, only)?;
            let results = lock.differences(&now).results;
            if !results.is_empty() {
                terminal::error(&format!("the results differ from the lock:\n{}", results.join("\n")));
                return Ok(1);
            }
        }
        // The process ends: freeing a large graph would only take time.
        std::mem::forget(loaded.graph);
        Ok(outcome.totals.exit_code())
    }

    /// The graph with the settings of `--max-error`; unchanged without this option.
    fn to_error(&self, loaded: Loaded) -> Result<Loaded, Error> {
        let Some(error) = self.max_error else { return Ok(loaded) };
        let sets_error =
            |set: &&String| set.split('=').next().is_some_and(|field| field.trim().ends_with(".max_error"));
        if let Some(set) = self.graph.set.iter().find(sets_error) {
            let text = format!("`--max-error` and `--set {set}` both set `max_error`; remove one of them");
            return Err(Error::usage(text));
        }
        let (loaded, chosen) = budget::to_error(loaded, error)?;
        if !chosen.is_empty() {
            let why = "with `--max-error`, the maximum number of samples is taken from the graph, not from a preset";
            self.print_chosen(json!({"max_error": error}), &chosen, why);
        }
        Ok(loaded)
    }

    /// Runs the graph, shows its events, and writes the trace.
    fn execute(
        &self,
        engine: &Engine,
        graph: &Graph,
        options: &RunOptions,
        report: &mut Report,
    ) -> Result<Executed, Error> {
        let mut trace = Trace::default();
        let (mut end, mut done) = (None, Done::default());
        let mut stale = Vec::new();
        let outcome = engine.run(graph, options, |event| {
            trace.add(&event);
            done.add(&event);
            match &event {
                Event::Node { id, state: State::Failed | State::Skipped, .. } => {
                    stale.extend(earlier_file(graph, id, &options.out));
                }
                Event::Done(totals) if !totals.stopped => {
                    stale.drain(..).for_each(|path| report.show(&Event::Stale { path }));
                }
                _ => {}
            }
            match event {
                Event::Done(_) if self.json => end = Some(event),
                event => report.show(&event),
            }
        });
        if let Some(path) = &self.trace {
            cache::publish_file(path, &trace.finish())?;
        }
        Ok(Executed { outcome, done, end })
    }

    /// If nothing has changed since the last run, reports the outcome of that run again; see [`run_unchanged`].
    /// Returns `None` if something has changed, or for options that need the graph.
    fn unchanged(&self, origin: &Origin) -> Result<Option<Outcome>, Error> {
        let asked = self.max_error.is_some() || self.time.is_some() || self.locked || self.trace.is_some();
        if asked || !self.graph.only.is_empty() || self.graph.frames.is_some() {
            return Ok(None);
        }
        self.engine.memory()?;
        let mut report = self.report();
        let (folder, kinds) = (cache_folder(self.engine.cache.as_deref())?, nodes::registry());
        let (mut events, mut done) = (Vec::new(), Done::default());
        let keep = |event: Event| {
            done.add(&event);
            events.push(event);
        };
        let Some(outcome) = run_unchanged(&folder, &origin.source, &kinds, &origin.root, &self.out, keep)
        else {
            return Ok(None);
        };
        let memory = Memory::of_folder(&folder, &origin.source, &origin.root);
        let Some(found) = memory.of_unchanged(&origin.source, &done) else { return Ok(None) };
        let warnings = found.into_iter().map(|(id, text)| Event::Warning { id, text });
        // The totals come last.
        let end = events.pop();
        events.into_iter().chain(warnings).chain(end).for_each(|event| report.show(&event));
        Ok(Some(outcome))
    }

    fn report(&self) -> Report {
        match (self.json, self.openjd) {
            (true, _) => Report::json(),
            (false, true) => Report::openjd(self.verbose),
            (false, false) => Report::lines(self.verbose),
        }
    }

    /// If the time per sample is unknown, runs all nodes except the sinks, with the minimum number of samples.
    /// Returns an exit code if this run failed or was interrupted.
    fn pilot(&self, loaded: &Loaded, engine: &Engine, cancel: &Arc<AtomicBool>) -> Result<Option<u8>, Error> {
        let Some((graph, chosen)) = budget::pilot(loaded, engine)? else { return Ok(None) };
        let why = "the time per sample is not known yet, so these samples are taken first and kept";
        self.print_chosen(json!({"pilot": true}), &chosen, why);
        let targets = if loaded.only.is_empty() { graph.targets() } else { loaded.only.clone() };
        let wanted = graph.above(&targets);
        let only: Vec<usize> =
            (0..wanted.len()).filter(|&node| wanted[node] && graph.nodes[node].sink_path.is_none()).collect();
        let options =
            RunOptions { rough: only.clone(), only, cancel: cancel.clone(), ..RunOptions::default() };
        let mut report = self.report();
        let outcome = engine.run(&graph, &options, |mut event| {
            // The run that follows reports the notes.
            if let Event::Node { notes, degraded, .. } = &mut event {
                notes.clear();
                *degraded = false;
            }
            if !matches!(event, Event::Done(_)) {
                report.show(&event);
            }
        });
        if let Some(failures) = &outcome.failures {
            terminal::mistakes(failures, self.json);
        }
        Ok((outcome.totals.stopped || outcome.failures.is_some()).then(|| outcome.totals.exit_code()))
    }

    /// Returns the graph with the largest number of samples whose forecast fits the time, and prints that number.
    fn in_time(&self, loaded: Loaded, engine: &Engine, time: Duration) -> Result<Loaded, Error> {
        let seconds = time.as_secs_f64();
        let (loaded, chosen, forecast) = budget::to_time(loaded, engine, seconds)?;
        let object = json!({"forecast": forecast, "time": seconds});
        self.print_chosen(object, &chosen, &terminal::forecast_text(&forecast));
        if forecast.seconds > seconds && !self.json {
            terminal::remark("the forecast for the minimum number of samples is longer than `--time`");
        }
        Ok(loaded)
    }

    /// Prints the settings that override the graph, and the reason.
    fn print_chosen(&self, mut object: Value, chosen: &[String], why: &str) {
        if self.json {
            (object["event"], object["settings"]) = (json!("chosen"), json!(chosen));
            return terminal::json_line(&object);
        }
        let settings: Vec<String> = chosen.iter().map(|setting| format!("--set {setting}")).collect();
        terminal::remark(&format!("{}: {why}", settings.join(" ")));
    }
}

/// The file of a sink if it exists. Files of several views have several names and are not looked for.
fn earlier_file(graph: &Graph, id: &str, out: &Path) -> Option<PathBuf> {
    let sink = graph.nodes.iter().find(|node| node.id == id)?.sink_path.as_ref()?;
    Some(out.join(sink)).filter(|path| path.is_file())
}

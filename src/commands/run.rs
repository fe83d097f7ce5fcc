//! `run`: computes what is not known and writes the files of the sinks.

use std::path::PathBuf;

use clap::Args;
use engine::{Engine, Event, Outcome, RunOptions, run_unchanged};
use serde_json::json;

use super::lock;
use crate::budget;
use crate::origin::Origin;
use crate::report::{self, Report};
use crate::session::{EngineArgs, Error, GraphArgs, Loaded, cache_folder, on_interrupt};
use crate::trace::Trace;

/// Runs a graph: computes what is not known and writes the files of its sinks.
#[derive(Debug, Args)]
pub struct Run {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// Folder that sinks write to
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Take samples until the standard error of the shadow and of the object is this, 0.01 say, at most as many as the
    /// graph says: sets `max_error` of every node that has one
    #[arg(long, value_name = "ERROR", conflicts_with = "time")]
    max_error: Option<f64>,
    /// Take as many samples, at most as many as the graph says, as there is time for by the forecast, such as 10s or
    /// 5m; the number is told and fixed before the run
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// Refuse inputs and kinds that are not those of the graph's lock, and fail where results are not
    #[arg(long)]
    locked: bool,
    /// Write what each thread did when, for chrome://tracing or Perfetto
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// One JSON object a line on standard output
    #[arg(long)]
    pub json: bool,
    /// Also tell nodes whose result was known
    #[arg(long, short)]
    verbose: bool,
}

impl Run {
    /// Runs the graph; gives the exit code of the run.
    pub fn run(self) -> Result<u8, Error> {
        let seconds = self.time.as_deref().map(super::cache::time).transpose()?;
        let mut texts = Vec::new();
        let origin = self.graph.read(&mut texts)?;
        if let Some(outcome) = self.unchanged(&origin)? {
            return Ok(outcome.totals.exit_code());
        }
        let (mut loaded, engine) = self.graph.check_with(origin, &texts, &self.engine)?;
        if let Some(error) = self.max_error {
            loaded = budget::to_error(loaded, error)?;
        }
        if let Some(seconds) = seconds {
            loaded = self.in_time(loaded, &engine, seconds.as_secs_f64())?;
        }
        loaded.check_outputs(&self.out)?;
        self.trace.as_deref().map_or(Ok(()), |trace| loaded.check_output(trace))?;
        let (graph, only) = (&loaded.graph, &loaded.only);
        let locked = self.locked.then(|| lock::read(&loaded)).transpose()?;
        if let Some(lock) = &locked {
            lock::refuse(&engine, graph, only, lock)?;
        }
        let cancel = on_interrupt()?;
        let mut report = self.report();
        if let Some(text) = report::no_file(graph, only) {
            report.tell(&Event::Warning { id: "no-file", text });
        }
        let options = RunOptions {
            out: self.out,
            texts: loaded.texts.clone(),
            only: only.clone(),
            cancel,
            trace: self.trace.is_some(),
            ..RunOptions::default()
        };
        let mut trace = Trace::default();
        // What failed comes before the end, which is the last line of JSON.
        let mut end = None;
        let outcome = engine.run(graph, &options, |event| {
            trace.tell(&event);
            match event {
                Event::Done(_) if self.json => end = Some(event),
                event => report.tell(&event),
            }
        });
        if let Some(path) = &self.trace {
            cache::publish_file(path, &trace.finish())?;
        }
        if let Some(failures) = &outcome.failures {
            report::mistakes(failures, self.json);
        }
        end.iter().for_each(|end| report.tell(end));
        if let Some(lock) = &locked {
            let now = engine.lock(graph, only).map_err(Error::Sources)?;
            let results = lock.differences(&now).results;
            if !results.is_empty() {
                report::error(&format!("the results are not those of the lock:\n{}", results.join("\n")));
                return Ok(1);
            }
        }
        // The process ends: to take a large graph apart, piece by piece, would only take time.
        std::mem::forget(loaded.graph);
        Ok(outcome.totals.exit_code())
    }

    /// Tells what the last run told, where nothing is to be done; see [`run_unchanged`]. What asks more than that of
    /// a run needs the graph.
    fn unchanged(&self, origin: &Origin) -> Result<Option<Outcome>, Error> {
        let asked = self.max_error.is_some() || self.time.is_some() || self.locked || self.trace.is_some();
        if asked || !self.graph.only.is_empty() {
            return Ok(None);
        }
        self.engine.memory()?;
        let mut report = self.report();
        let (folder, kinds) = (cache_folder(self.engine.cache.as_deref())?, nodes::registry());
        let tell = |event| report.tell(&event);
        Ok(run_unchanged(&folder, &origin.source, &kinds, &origin.root, &self.out, tell))
    }

    fn report(&self) -> Report {
        if self.json { Report::json() } else { Report::lines(self.verbose) }
    }

    /// The graph with the samples that there is time for, which are told.
    fn in_time(&self, loaded: Loaded, engine: &Engine, seconds: f64) -> Result<Loaded, Error> {
        let (loaded, chosen, forecast) = budget::to_time(loaded, engine, seconds)?;
        if self.json {
            let told = json!({"event": "chosen", "settings": chosen, "forecast": forecast, "time": seconds});
            report::json_line(&told);
            return Ok(loaded);
        }
        let settings: Vec<String> = chosen.iter().map(|setting| format!("--set {setting}")).collect();
        let text = report::forecast_text(&forecast);
        report::remark(&format!("{}: {text}", settings.join(" ")));
        if forecast.seconds > seconds {
            report::remark("even the fewest samples are forecast to take longer than that");
        }
        Ok(loaded)
    }
}

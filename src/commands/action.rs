//! `action`: computes one node in another process or on another machine.

use std::path::PathBuf;

use cache::Store;
use clap::{Args, Subcommand};
use engine::{ActionDone, ActionError, Engine, Event, Level, bytes_text};

use crate::session::{EngineArgs, Error, GraphArgs, compute, find, on_interrupt};
use crate::terminal::{self, Report, seconds_text};

/// Computes one node in another process or on another machine.
#[derive(Debug, Args)]
pub struct Action {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Create a folder with everything that a node reads
    Write(Write),
    /// Compute the node from such a folder and write its outputs; needs no graph and no cache
    Run(Run),
    /// Verify the outputs of a computed node and add them to the cache
    Take(Take),
}

#[derive(Debug, Args)]
struct Write {
    #[command(flatten)]
    graph: GraphArgs,
    /// Name of the node; the nodes that it reads are computed first if necessary
    node: String,
    /// The folder to create
    folder: PathBuf,
    #[command(flatten)]
    engine: EngineArgs,
}

#[derive(Debug, Args)]
struct Run {
    /// The folder of the action
    folder: PathBuf,
    /// The folder to create for the outputs
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// Number of threads; 0 (the default) means one per core
    #[arg(long, short, value_name = "N", value_parser = clap::value_parser!(u16).range(..=1024))]
    jobs: Option<u16>,
    /// Memory for the node and its inputs, such as 4G; 0 (the default) means three quarters of the free memory
    #[arg(long, value_name = "SIZE")]
    memory: Option<String>,
    /// Print one JSON object per line on standard output
    #[arg(long)]
    json: bool,
    /// With `--json`, print only the last object
    #[arg(long, hide = true, requires = "json")]
    brief: bool,
}

#[derive(Debug, Args)]
struct Take {
    /// The folder of the action
    folder: PathBuf,
    /// The folder of the outputs
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    engine: EngineArgs,
}

impl Action {
    /// True if the command prints JSON to standard output.
    pub fn prints_json(&self) -> bool {
        matches!(&self.verb, Verb::Run(run) if run.json)
    }

    /// Runs the command. Returns exit code 1 if the node failed, and 3 if its result is degraded.
    pub fn run(self) -> Result<u8, Error> {
        match self.verb {
            Verb::Write(verb) => verb.run(),
            Verb::Run(verb) => verb.run(),
            Verb::Take(verb) => verb.run(),
        }
    }
}

impl Write {
    fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let graph = &loaded.graph;
        let node = find(graph, &self.node)?;
        loaded.check_output(&self.folder)?;
        let engine = self.engine.open()?;
        let above = graph.reads(node).to_vec();
        // An empty list would stand for every sink.
        if !above.is_empty() {
            let code = compute(&engine, graph, above)?;
            if !matches!(code, 0 | 3) {
                return Ok(code);
            }
        }
        let key = engine.write_action(graph, node, &self.folder)?;
        terminal::print(&format!("{key}\n"))?;
        Ok(0)
    }
}

impl Run {
    fn run(self) -> Result<u8, Error> {
        let memory = self.memory.as_deref().map_or(Ok(0), crate::session::size)?;
        let store = Store::unavailable("an action does not use a cache".to_owned());
        let engine = Engine::new(store, self.jobs.map_or(0, usize::from), memory);
        let cancel = on_interrupt()?;
        let mut report = if self.json { Report::json() } else { Report::lines(false) };
        let show = |event: Event| {
            if !self.brief {
                report.show(&event);
            }
        };
        match engine.run_action(&nodes::registry(), &self.folder, &self.out, &cancel, show) {
            Ok(done) => finish(&done, self.json),
            Err(error) if error.is_cancelled() => Ok(130),
            Err(error) if error.is_of_node() => {
                if self.json {
                    let mut object = serde_json::json!({"event": "failed", "message": error.to_string()});
                    match &error {
                        ActionError::Failed { error, .. } => {
                            object["hint"] = serde_json::json!(error.advice());
                        }
                        ActionError::Memory { needs, .. } => object["needs"] = serde_json::json!(needs),
                        _ => {}
                    }
                    terminal::json_line(&object);
                } else {
                    terminal::error(&described(&error));
                }
                Ok(1)
            }
            Err(error) => Err(error.into()),
        }
    }
}

impl Take {
    fn run(self) -> Result<u8, Error> {
        let engine = self.engine.open()?;
        if let Some(why) = engine.store().why_read_only() {
            return Err(Error::usage(format!("the cache cannot be written: {why}")));
        }
        finish(&engine.take_outputs(&nodes::registry(), &self.folder, &self.out)?, false)
    }
}

/// Text of an error, with the advice if the code of the node failed.
fn described(error: &ActionError) -> String {
    match error {
        ActionError::Failed { error: inner, .. } => match inner.advice() {
            Some(advice) => format!("{error}; {advice}"),
            None => error.to_string(),
        },
        _ => error.to_string(),
    }
}

/// Prints the result of an action and returns the exit code.
fn finish(done: &ActionDone, json: bool) -> Result<u8, Error> {
    let degraded = done.notes.is_degraded();
    if json {
        terminal::json_line(&serde_json::json!({
            "event": "done", "kind": done.kind, "key": done.key.to_string(), "seconds": done.seconds,
            "bytes": done.bytes, "degraded": degraded, "notes": done.notes,
        }));
    } else {
        for note in done.notes.iter().filter(|note| note.level >= Level::Warning) {
            terminal::remark(&note.text);
        }
        let (seconds, bytes) = (seconds_text(done.seconds), bytes_text(done.bytes));
        terminal::print(&format!("{} {}: {seconds}, {bytes}\n", done.kind, done.key))?;
    }
    Ok(if degraded { 3 } else { 0 })
}

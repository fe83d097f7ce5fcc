//! One file a verb.

mod cache;
mod check;
mod completions;
mod convert;
mod diff;
mod explain;
mod graph;
mod init;
mod inspect;
mod knobs;
mod lock;
mod nodes;
mod pack;
mod plan;
mod report;
mod run;
#[cfg(feature = "learned")]
mod train_exposure;
#[cfg(not(feature = "learned"))]
#[path = "train_exposure/absent.rs"]
mod train_exposure;
mod tune;
mod unpack;
mod verify;
mod watch;

use clap::{CommandFactory, Parser, Subcommand};

use crate::session::Error;

/// What the verbs end with, for scripts.
const EXIT_STATUS: &str = "Exit status: 0 done; 1 a node failed, or what was asked is not so (check, diff, verify, tune); 2 a \
mistake in the graph or the command line; 3 done, but with less than was asked for (a note says `degraded`); 130 stopped.";

/// Inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Command {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Runs a graph: computes what is not known and writes the files of its sinks
    #[command(after_help = EXIT_STATUS)]
    Run(run::Run),
    /// Runs a graph again whenever it or a file it reads changes
    Watch(watch::Watch),
    /// Reads a graph and reports every mistake in it
    Check(check::Check),
    /// Tells what a run would compute, why, and about how long it takes
    Plan(plan::Plan),
    /// Lists what trades work for accuracy in a graph, and which outputs it reaches
    Knobs(knobs::Knobs),
    /// Looks for settings of the knobs that reach an error with little work, by measuring
    Tune(tune::Tune),
    /// Writes one page on what a graph costs, how far its pictures are off, and which node is to blame
    Report(report::MakeReport),
    /// Tells what a node's result is made of and why it would run again
    Explain(explain::Explain),
    /// Tells how two graphs, bundles or pictures differ, and where their results begin to
    Diff(diff::Diff),
    /// Lists the kinds of nodes, or describes one
    Nodes(nodes::Nodes),
    /// Draws a graph with the state of its results
    Graph(graph::Draw),
    /// Looks after the cache: what is in it, whether it is whole, what may go
    Cache(cache::Cache),
    /// Makes a folder to begin in
    Init(init::Init),
    /// Writes down what a graph is made of, by digest
    Lock(lock::MakeLock),
    /// Packs a graph with all it needs into one file
    Pack(pack::Pack),
    /// Unpacks such a file
    Unpack(unpack::Unpack),
    /// Computes some of such a file anew and compares
    Verify(verify::Verify),
    /// Writes a scene of splats in another format
    Convert(convert::Convert),
    /// Tells what a scene of splats is like: size, floor, up, what looks wrong
    Inspect(inspect::Inspect),
    /// Trains the learned exposure prediction on HDR panoramas (in builds with the feature `learned`)
    TrainExposure(train_exposure::TrainExposure),
    /// Prints completions for a shell
    Completions(completions::Completions),
    /// Prints the manual page, or writes one for each verb
    Manual(completions::Manual),
}

/// `run` alone.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = EXIT_STATUS)]
struct RunCommand {
    #[command(subcommand)]
    verb: RunVerb,
}

#[derive(Debug, Subcommand)]
enum RunVerb {
    /// Runs a graph: computes what is not known and writes the files of its sinks
    #[command(after_help = EXIT_STATUS)]
    Run(run::Run),
}

impl Command {
    /// What the command line says; ends the process where that is a mistake or a question.
    pub fn read() -> Self {
        // A run that finds nothing to do is over before the table of all verbs is made.
        if std::env::args_os().nth(1).is_some_and(|verb| verb == "run") {
            let RunVerb::Run(run) = RunCommand::parse().verb;
            return Self { verb: Verb::Run(run) };
        }
        Self::parse()
    }

    /// True where standard output belongs to a program, which is told mistakes there, too.
    pub fn tells_json(&self) -> bool {
        match &self.verb {
            Verb::Run(verb) => verb.json,
            Verb::Check(verb) => verb.json,
            Verb::Plan(verb) => verb.json,
            Verb::Explain(verb) => verb.json,
            Verb::Inspect(verb) => verb.json,
            Verb::Watch(verb) => verb.json,
            Verb::Knobs(verb) => verb.json,
            Verb::Tune(verb) => verb.json,
            Verb::Report(verb) => verb.json,
            _ => false,
        }
    }

    /// Runs the verb; gives the exit code.
    pub fn run(self) -> Result<u8, Error> {
        match self.verb {
            Verb::Run(verb) => verb.run(),
            Verb::Watch(verb) => verb.run(),
            Verb::Check(verb) => verb.run(),
            Verb::Plan(verb) => verb.run(),
            Verb::Knobs(verb) => verb.run(),
            Verb::Tune(verb) => verb.run(),
            Verb::Report(verb) => verb.run(),
            Verb::Explain(verb) => verb.run(),
            Verb::Nodes(verb) => verb.run(),
            Verb::Graph(verb) => verb.run(),
            Verb::Cache(verb) => verb.run(),
            Verb::Convert(verb) => verb.run(),
            Verb::Inspect(verb) => verb.run(),
            Verb::Diff(verb) => verb.run(),
            Verb::Init(verb) => verb.run(),
            Verb::Lock(verb) => verb.run(),
            Verb::Pack(verb) => verb.run(),
            Verb::Unpack(verb) => verb.run(),
            Verb::Verify(verb) => verb.run(),
            Verb::TrainExposure(verb) => verb.run(),
            Verb::Completions(verb) => verb.run(Self::command()),
            Verb::Manual(verb) => verb.run(Self::command()),
        }
    }
}

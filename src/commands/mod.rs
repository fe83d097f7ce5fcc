//! The commands of the program, such as `run` and `check`, with one file or folder for each.

mod action;
mod bench;
mod cache;
mod check;
mod completions;
mod convert;
mod diff;
mod explain;
mod export;
mod graph;
mod init;
mod inspect;
#[cfg(feature = "remote")]
mod key;
#[cfg(not(feature = "remote"))]
#[path = "key/absent.rs"]
mod key;
mod knobs;
mod lock;
mod nodes;
mod pack;
mod pick;
mod plan;
mod report;
mod run;
mod show;
#[cfg(feature = "learned")]
mod train_exposure;
#[cfg(not(feature = "learned"))]
#[path = "train_exposure/absent.rs"]
mod train_exposure;
mod tune;
mod unpack;
mod verify;
mod watch;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::session::Error;

/// Exit codes, as shown in the help of each command.
const EXIT_STATUS: &str = "Exit status: 0 done; 1 a node failed, or a difference or damage was found, or a goal was not reached; 2 a \
mistake in the graph or the command line; 3 done, but degraded (a note explains why); 130 interrupted.";

/// The groups of commands in `--help`, with their titles.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Begin", &["init", "nodes", "inspect", "convert"]),
    ("Run a graph", &["run", "watch", "check", "plan", "explain", "show", "pick", "graph"]),
    ("Measure", &["knobs", "tune", "report", "bench"]),
    ("Share and reproduce", &["pack", "unpack", "verify", "lock", "diff", "action", "key", "export"]),
    ("Maintain", &["cache", "completions", "manual", "train-exposure"]),
];

/// The example in `--help`.
const EXAMPLE: &str = "Example:
  lightharmony init chair && cd chair
  lightharmony run graph.ron                         # writes out/picture.png
  lightharmony run graph.ron --set pose.yaw_deg=60   # computes only what that changes";

const TEMPLATE: &str = "{about-with-newline}
{usage-heading} {usage}

{before-help}
Options:
{options}{after-help}";

/// Inserts 3D objects into captured Gaussian splat scenes with light and shadow that match.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Command {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run a graph: compute what is not cached and write its files
    #[command(after_help = EXIT_STATUS)]
    Run(run::Run),
    /// Run a graph again whenever it or a file it reads changes
    Watch(watch::Watch),
    /// Report every mistake in a graph without running it
    Check(check::Check),
    /// Show what a run would compute, why, and about how long it takes
    Plan(plan::Plan),
    /// List the parameters that trade work for accuracy, and the outputs that each changes
    Knobs(knobs::Knobs),
    /// Measure settings of the knobs to find the one that reaches a given error with the least work
    Tune(tune::Tune),
    /// Write a page on what a graph costs, how large its error is, and which node causes it
    Report(report::MakeReport),
    /// Score insertions into scenes whose truth is known
    Bench(bench::Bench),
    /// Show why a node would run again, and what its key consists of
    Explain(explain::Explain),
    /// Show how two graphs, bundles or pictures differ
    Diff(diff::Diff),
    /// List the kinds of nodes, describe one, or search them
    Nodes(nodes::Nodes),
    /// Write the picture of any node, without editing the graph
    Show(show::Show),
    /// Print the point of the scene that a pixel of a view shows, and a pose to paste
    Pick(pick::Pick),
    /// Draw a graph with the state of its results
    Graph(graph::Draw),
    /// Maintain the cache: print its contents, find damage, limit its size
    Cache(cache::Cache),
    /// Create a folder with a first graph
    Init(init::Init),
    /// Write a lock file: inputs, kinds and results of a graph by digest
    Lock(lock::MakeLock),
    /// Pack a graph, its inputs and results into one file, a bundle
    Pack(pack::Pack),
    /// Unpack a bundle
    Unpack(unpack::Unpack),
    /// Recompute nodes of a bundle and compare the results
    Verify(verify::Verify),
    /// Compute one node in another process or on another machine
    Action(action::Action),
    /// Make the key that signs your results, and list the keys whose results you use (in builds with the feature
    /// `remote`)
    Key(key::Key),
    /// Write a graph as a job of another scheduler
    Export(export::Export),
    /// Write a scene of splats, or a mesh, in another format
    Convert(convert::Convert),
    /// Print the properties of splats, a mesh or a picture: size, up axis, floor, probable mistakes
    Inspect(inspect::Inspect),
    /// Train the learned exposure prediction on HDR panoramas (in builds with the feature `learned`)
    TrainExposure(train_exposure::TrainExposure),
    /// Print completions for a shell
    Completions(completions::Completions),
    /// Print the manual page, or write one per command
    Manual(completions::Manual),
}

/// The command line with `run` as its only command.
#[derive(Debug, Parser)]
#[command(version, about, max_term_width = 100, after_help = EXIT_STATUS)]
struct RunCommand {
    #[command(subcommand)]
    verb: RunVerb,
}

#[derive(Debug, Subcommand)]
enum RunVerb {
    /// Runs a graph: computes what is not cached and writes the files of its sinks
    #[command(after_help = EXIT_STATUS)]
    Run(run::Run),
}

impl Command {
    /// Parses the command line. Ends the process if it has a mistake or contains `--help`.
    pub fn read() -> Self {
        // `run` does not build clap's definition of all commands, which would be most of the time of a run with
        // nothing to do.
        if std::env::args_os().nth(1).is_some_and(|verb| verb == "run") {
            let RunVerb::Run(run) = RunCommand::parse().verb;
            return Self { verb: Verb::Run(run) };
        }
        let matches = Self::grouped().get_matches();
        Self::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
    }

    /// The definition of the command line, with its commands in groups in the help.
    fn grouped() -> clap::Command {
        let command = Self::command();
        let about = |verb: &&str| {
            let about = command.find_subcommand(verb).and_then(clap::Command::get_about);
            format!("  {verb:<15} {}\n", about.map(ToString::to_string).unwrap_or_default())
        };
        let mut text = String::new();
        for (title, verbs) in GROUPS {
            text.push_str(&format!("{title}:\n{}\n", verbs.iter().map(about).collect::<String>()));
        }
        text.push_str(EXAMPLE);
        command.before_help(text).help_template(TEMPLATE)
    }

    /// True if standard output is JSON, so that errors are printed there as JSON as well.
    pub fn prints_json(&self) -> bool {
        match &self.verb {
            Verb::Run(verb) => verb.json,
            Verb::Action(verb) => verb.prints_json(),
            Verb::Check(verb) => verb.json,
            Verb::Plan(verb) => verb.json,
            Verb::Explain(verb) => verb.json,
            Verb::Inspect(verb) => verb.json,
            Verb::Nodes(verb) => verb.json,
            Verb::Watch(verb) => verb.json,
            Verb::Knobs(verb) => verb.json,
            Verb::Tune(verb) => verb.json,
            Verb::Report(verb) => verb.json,
            _ => false,
        }
    }

    /// Runs the command and returns the exit code.
    pub fn run(self) -> Result<u8, Error> {
        match self.verb {
            Verb::Run(verb) => verb.run(),
            Verb::Watch(verb) => verb.run(),
            Verb::Check(verb) => verb.run(),
            Verb::Plan(verb) => verb.run(),
            Verb::Knobs(verb) => verb.run(),
            Verb::Tune(verb) => verb.run(),
            Verb::Report(verb) => verb.run(),
            Verb::Bench(verb) => verb.run(),
            Verb::Explain(verb) => verb.run(),
            Verb::Nodes(verb) => verb.run(),
            Verb::Show(verb) => verb.run(),
            Verb::Pick(verb) => verb.run(),
            Verb::Graph(verb) => verb.run(),
            Verb::Cache(verb) => verb.run(),
            Verb::Action(verb) => verb.run(),
            Verb::Key(verb) => verb.run(),
            Verb::Export(verb) => verb.run(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_verb_is_in_one_group_of_the_help() {
        let command = Command::command();
        let verbs = command.get_subcommands().map(clap::Command::get_name).filter(|name| *name != "help");
        for verb in verbs {
            let groups = GROUPS.iter().filter(|(_, verbs)| verbs.contains(&verb)).count();
            assert_eq!(groups, 1, "{verb}");
        }
        assert!(
            GROUPS.iter().flat_map(|(_, verbs)| *verbs).all(|verb| command.find_subcommand(verb).is_some())
        );
    }
}

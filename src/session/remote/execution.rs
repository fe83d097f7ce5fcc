//! Settings for nodes that the workers of a server compute.

use clap::Args;
use engine::{Canary, Digest, Graph, Source, SourceRoot};
use remote::Config;
use remote::reapi::{WorkerOptions, WorkerProgram};

use super::super::engine::time;
use super::super::error::Error;

/// Environment variable that turns execution on.
const VARIABLE: &str = "LIGHTHARMONY_REMOTE_EXECUTE";
/// Arguments of the program on a worker.
const ARGUMENTS: [&str; 7] = ["action", "run", ".", "--out", "out", "--json", "--brief"];
/// Default of the maximum number of nodes in progress.
const IN_FLIGHT: usize = 32;

/// Options for nodes that the workers of a server compute.
#[derive(Debug, Clone, Args)]
pub struct ExecutionArgs {
    /// Have nodes computed by the workers of the server; `plan` with this option shows which nodes [env:
    /// LIGHTHARMONY_REMOTE_EXECUTE]
    #[arg(long)]
    pub remote_execute: bool,
    /// Compute this share of the nodes here as well and compare, such as 2%; a difference fails the run and names the
    /// worker
    #[arg(long, value_name = "SHARE")]
    pub verify_remote: Option<String>,
}

/// Valid settings.
pub struct Execution(pub WorkerOptions);

impl ExecutionArgs {
    /// The settings from the options, the environment and the file; `None` if no nodes are sent.
    pub fn execution(&self, config: &Config) -> Result<Option<Execution>, Error> {
        let named = std::env::var(VARIABLE).is_ok_and(|value| !matches!(value.as_str(), "" | "0" | "none"));
        if !(self.remote_execute || named || config.execute) {
            return match &self.verify_remote {
                Some(_) => Err(Error::usage("`--verify-remote` needs `--remote-execute`")),
                None => Ok(None),
            };
        }
        let share = self.verify_remote.as_ref().or(config.verify.as_ref());
        let program = match &config.program {
            Some(program) => WorkerProgram::Installed(program.clone()),
            None => WorkerProgram::Sent(std::env::current_exe().map_err(|error| {
                Error::usage(format!("cannot find the file of this program, which workers run: {error}"))
            })?),
        };
        let memory = match (&config.memory_property, config.memory_gib.as_slice()) {
            (None, []) => None,
            (Some(name), amounts @ [_, ..]) if amounts.is_sorted() => Some((name.clone(), amounts.to_vec())),
            _ => {
                return Err(Error::usage(
                    "`remote.ron`: `memory_property` names a property, and `memory_gib` lists its values in \
                     increasing order, such as [2, 8, 32]; both are needed",
                ));
            }
        };
        Ok(Some(Execution(WorkerOptions {
            program,
            arguments: ARGUMENTS.map(str::to_owned).to_vec(),
            properties: config.properties.clone().into_iter().collect(),
            memory,
            in_flight: config.in_flight.unwrap_or(IN_FLIGHT),
            priority: config.priority,
            timeout: config.timeout.as_deref().map(time).transpose()?,
            checked: share.map_or(Ok(0.0), |share| fraction(share))?,
            canary: Some(canary()?),
        })))
    }
}

/// A node whose result is known: a small scene, which is computed with the same code as pictures.
const CANARY: &str = r#"Graph(version: 1, scene: (up: "+z", metres_per_unit: 1.0, seed: 1), nodes: (
    canary: DemoScene(
        splats: 2000, width_px: 32, height_px: 16, truth_width_px: 16, capture: 2, capture_width_px: 16,
    ),
))"#;
/// The digests of the outputs of the canary, in the order of the outputs of `demo-scene`. They change with its version;
/// the test of this file prints the new ones.
const EXPECTED: [&str; 6] = [
    "cdfa9f59287f6047d6453104e544be4c0bb816eaee4915c59d5083cafa06a40a",
    "563b397711dd6ac75cd56942a1b7082b8ee867775fa62f0ebf88a6efd75173a7",
    "4f668a3ee0faaa7e340ec4cd5fd816b58549327e984ccb9dd817eba6d2da6fef",
    "5a712a5f0b6690d8b1a22f391ab98c40a8497eb05245499e490a639fa94d625a",
    "258afb69e5de6ccb92799793534d7e68a433372bf13b72ddf36267f4a0089f26",
    "1a7e7c5d3ba90d8a4d6ad742c059e24caeddc4f60990891a40c35fd576a4f6e0",
];

fn graph() -> Result<Graph, Error> {
    let source = Source::new("canary.ron", CANARY);
    Graph::parse(source, &nodes::registry(), SourceRoot::new(".")).map_err(Error::Graph)
}

fn canary() -> Result<Canary, Error> {
    let graph = graph()?;
    let expected = EXPECTED.iter().filter_map(|hex| Digest::from_hex(hex)).collect();
    Canary::new(&graph, expected).map_err(|error| Error::usage(error.to_string()))
}

/// Parses a share such as `2%` or `0.02`.
fn fraction(text: &str) -> Result<f64, Error> {
    let (number, per) = match text.strip_suffix('%') {
        Some(number) => (number, 100.0),
        None => (text, 1.0),
    };
    let value = number.trim().parse::<f64>().ok().map(|number| number / per);
    value.filter(|value| (0.0..=1.0).contains(value)).ok_or_else(|| {
        Error::usage(format!("`{text}` is not a share; write a number from 0% to 100%, such as 2%"))
    })
}

#[cfg(test)]
mod tests {
    use engine::{Engine, RunOptions, StoredOutput};

    use super::*;

    /// This machine computes the digests that workers must return. This test fails if a digest is wrong, or if the key of
    /// the canary is not that of the node.
    #[test]
    fn the_canary_has_the_digests_that_this_machine_computes() {
        let (graph, canary) = (graph().expect("is valid"), canary().expect("has a key"));
        let engine = Engine::new(cache::Store::in_memory(), 2, 1 << 30);
        let options = RunOptions { only: vec![0], ..RunOptions::default() };
        engine.run(&std::sync::Arc::new(graph.clone()), &options, |_| ());
        let outputs =
            engine.outputs(&graph.nodes[0], &canary.key).expect("the node ran, with the key of the canary");
        let digests: Vec<Digest> = outputs.iter().map(|StoredOutput { digest, .. }| *digest).collect();
        let shown: Vec<String> = digests.iter().map(Digest::to_string).collect();
        assert_eq!(canary.expected, digests, "the digests are now {shown:#?}");
    }
}

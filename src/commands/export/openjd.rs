//! `export openjd`: a job template and its bundle in a folder.

use std::path::PathBuf;

use clap::Args;
use engine::{Engine, Forecast, Graph, Results};

use super::template::{Job, template};
use crate::session::{EngineArgs, Error, GraphArgs};
use crate::terminal::{self, remark};

/// Name of the bundle in the folder of the job.
const BUNDLE: &str = "scene.lhb";
/// Name of the template in the folder of the job.
const TEMPLATE: &str = "template.json";

/// Writes a job for Open Job Description.
#[derive(Debug, Args)]
pub struct OpenJd {
    #[command(flatten)]
    graph: GraphArgs,
    /// The folder of the job, which is created if needed
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Server of shared results that the tasks use and write to, such as grpc://cache.farm:8980. With a server, a
    /// first step computes once what all tasks need
    #[arg(long, value_name = "URL")]
    remote: Option<String>,
    /// Minimum number of CPUs of a worker
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=4096))]
    cpus: u32,
    #[command(flatten)]
    engine: EngineArgs,
}

impl OpenJd {
    /// Writes the template and the bundle, and prints what the job consists of.
    pub fn run(self) -> Result<u8, Error> {
        let loaded = self.graph.load()?;
        let (graph, engine) = (&loaded.graph, self.engine.open()?);
        let targets = if loaded.only.is_empty() { graph.targets() } else { loaded.only.clone() };
        let external = (0..graph.nodes.len()).filter(|&index| graph.nodes[index].kind.runs_programs);
        let external: Vec<&str> = external.map(|index| graph.nodes[index].id.as_str()).collect();
        if !external.is_empty() {
            return Err(Error::usage(format!(
                "{} run programs that are installed on this machine, which a farm must not run; write their results \
                 to files (`WriteMesh`, `WriteSplats`) and load these in the graph of the job",
                external.join(", ")
            )));
        }
        let name = self.graph.graph.file_stem().map_or("graph".into(), |stem| stem.to_string_lossy());
        let cost = Cost::of(&engine, graph, &targets);
        let job = Job {
            name: &name,
            bundle: BUNDLE,
            remote: self.remote.as_deref(),
            cpus: self.cpus,
            memory_bytes: cost.memory,
            seconds: cost.seconds,
        };
        let (text, summary) = template(graph, &targets, &job)?;
        std::fs::create_dir_all(&self.out)?;
        let bundle = self.out.join(BUNDLE);
        loaded.check_output(&bundle)?;
        let named = |error: engine::BundleError| Error::of_file(&bundle, &error);
        cache::publish_through(&bundle, |mut to| {
            engine.pack(graph, &loaded.only, Results::Digests, &mut to).map_err(named)?;
            Ok::<(), Error>(())
        })?;
        let path = self.out.join(TEMPLATE);
        cache::publish_file(&path, format!("{text:#}\n").as_bytes())?;
        terminal::print(&format!("wrote {}\nwrote {}\n{summary}", bundle.display(), path.display()))?;
        if cost.memory.is_none() {
            remark(
                "the job does not state the memory that a worker needs, since no node has run yet; run one frame and export again",
            );
        }
        Ok(0)
    }
}

/// Cost of a run, as far as it is known.
struct Cost {
    /// Largest estimated memory of a node in its last run, in bytes.
    memory: Option<u64>,
    /// Forecast of the time of all nodes that a run computes, in seconds. `None` if a node was never timed.
    seconds: Option<f64>,
}

impl Cost {
    fn of(engine: &Engine, graph: &Graph, targets: &[usize]) -> Self {
        let plan = engine.plan(graph, targets);
        let spent = plan.iter().enumerate().filter_map(|(index, node)| engine.past(graph, index, node).spent);
        let memory = spent.map(|spent| spent.memory).max();
        let forecast = Forecast::of(&plan);
        Self { memory, seconds: (forecast.untimed == 0 && forecast.open > 0).then_some(forecast.seconds) }
    }
}

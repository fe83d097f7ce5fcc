//! `bench`: scores insertions into scenes whose truth is known.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use benchmark::graph::{Composed, Wanted, compose};
use benchmark::method::Method;
use benchmark::page::{Content, page};
use benchmark::scores::{Scores, read};
use benchmark::set::Set;
use benchmark::summary::summarise;
use benchmark::tables::{blocks, by_tag, csv, latex, markdown, rows_csv};
use benchmark::tier::Tier;
use benchmark::write::write;
use benchmark::{checksums, pictures};
use clap::Args;
use engine::{Engine, Event, Fate, Forecast, Graph, Planned, RunOptions, Setting, Source, SourceRoot};

use crate::session::{EngineArgs, Error, on_interrupt};
use crate::terminal::{self, Report};

/// Inserts the object of every case of a benchmark set and scores the pictures.
///
/// Runs a graph over all cases, in parallel and through the cache, and compares its pictures with the truth by region:
/// object, shadow, reflection, rest. Baselines are always scored: nothing inserted, the object without its shadow, the
/// object in light clipped at white, and the true shadow ratio. Writes tables with 95 % bootstrap intervals over scenes
/// (Markdown, CSV, LaTeX), the scores of every view, and a page with pictures. docs/benchmark.md describes the format of
/// a set.
#[derive(Debug, Args)]
pub struct Bench {
    /// Folder of the set
    folder: PathBuf,
    /// The graph to score: it declares its inputs in `parameters`, and its node `final` makes the pictures; default: the
    /// insertion of this program
    #[arg(long, value_name = "FILE")]
    graph: Option<PathBuf>,
    /// Set one field of the graph in all cases: node.field=value; may be repeated
    #[arg(long = "set", value_name = "NODE.FIELD=VALUE")]
    set: Vec<String>,
    /// Pictures of other methods to score: METHOD/CASE/VIEW.png in this folder
    #[arg(long, value_name = "DIR")]
    methods: Option<PathBuf>,
    /// Run only these cases, separated by commas
    #[arg(long = "case", value_name = "NAMES", value_delimiter = ',')]
    cases: Vec<String>,
    /// Tiers to run, separated by commas: true-light (true background and light), recovered-light (true background, light
    /// recovered from the splats), splats (the splats as background)
    #[arg(long = "tier", value_name = "NAMES", value_delimiter = ',', default_value = "true-light")]
    tiers: Vec<String>,
    /// Samples per pixel of the baselines, and of the graph if it declares `samples`
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1_048_576))]
    samples: u32,
    /// Weights of LPIPS (safetensors), as for `compare`; without them, LPIPS is not computed
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// Output folder
    #[arg(long, default_value = "bench", value_name = "DIR")]
    out: PathBuf,
    /// Only check the set, including the digests in SHA256SUMS
    #[arg(long)]
    check: bool,
    /// Only print what would be rendered and about how long it takes
    #[arg(long, conflicts_with = "check")]
    plan: bool,
    #[command(flatten)]
    engine: EngineArgs,
    /// Also print cached nodes, counts, and all notes of nodes
    #[arg(long, short)]
    verbose: bool,
}

/// The sink paths of pictures are not printed one by one, since there are thousands of them.
fn is_shown(event: &Event) -> bool {
    !matches!(event, Event::File { .. } | Event::Done(_))
}

impl Bench {
    /// Runs the benchmark. Exit code 0 if all pictures have scores, 1 if a node failed, 3 if a result is degraded, 130 if
    /// it was interrupted.
    pub fn run(self) -> Result<u8, Error> {
        let set = Set::load(&self.folder)?.only(&self.cases)?;
        if self.check {
            let files = checksums::check(&set.folder)?;
            terminal::print(&format!(
                "the set has no mistakes (cases: {}, files: {files})\n",
                set.cases.len()
            ))?;
            return Ok(0);
        }
        let tiers = self.tiers()?;
        let method = self.graph.as_deref().map_or_else(|| Ok(Method::built_in()), Method::read)?;
        let mut taken = vec![method.name.as_str()];
        taken.extend(benchmark::graph::BASELINES.map(|(name, _)| name));
        let given =
            self.methods.as_deref().map(|folder| pictures::given(folder, &set, &taken)).transpose()?;
        let given = given.unwrap_or_default();
        let lpips = self.lpips.as_deref().map(absolute).transpose()?;
        let folder = self.out.join("graph");
        cache::publish_file(&folder.join(".keep"), b"")?;
        let folder = absolute(&folder)?;
        let wanted = Wanted {
            set: &set,
            method: &method,
            given: &given,
            tiers: &tiers,
            samples: self.samples,
            lpips: lpips.as_deref(),
        };
        let made = compose(&wanted, &folder)?;
        let path = write(&made, &set, &folder)?;
        let (graph, texts) = self.graph_of(&made, &path, &folder)?;
        graph.check_outputs(&[], &self.out, &texts).map_err(Error::Graph)?;
        let engine = self.engine.open()?;
        let mut remarks: Vec<String> = made
            .left_out
            .iter()
            .map(|out| format!("Case `{}` is left out of tier {}: {}.", out.case, out.tier, out.why))
            .collect();
        for other in given.iter().filter(|other| !other.missing.is_empty()) {
            let (name, list) = (&other.name, other.missing.join(", "));
            remarks.push(format!(
                "Pictures of `{name}` are missing, and their cases are left out of its rows: {list}."
            ));
        }
        remarks.iter().for_each(|remark| terminal::remark(remark));
        let targets = targets(&graph, &made);
        let plan = engine.plan(&graph, &targets);
        terminal::remark(&outline(&set, &made, &tiers, &plan));
        if self.plan {
            return Ok(0);
        }
        let code = self.run_graph(&engine, &graph, targets, &texts, &plan)?;
        if code == INTERRUPTED {
            terminal::remark("interrupted; results of finished nodes are kept in the cache");
            return Ok(code);
        }
        let scores = read(&engine, &graph, &made, &set);
        for name in &scores.failed {
            remarks.push(format!("There are no scores of: {name}."));
        }
        self.write_tables(&set, &method, &made, &scores, remarks)?;
        Ok(code)
    }

    fn tiers(&self) -> Result<Vec<Tier>, Error> {
        let (mut tiers, mut wrong) = (BTreeSet::new(), Vec::new());
        for name in &self.tiers {
            match Tier::named(name.trim()) {
                Ok(tier) => drop(tiers.insert(tier)),
                Err(why) => wrong.push(why),
            }
        }
        if wrong.is_empty() { Ok(tiers.into_iter().collect()) } else { Err(Error::usage(wrong.join("\n"))) }
    }

    /// The checked graph with the settings, and the files from which it was read.
    fn graph_of(&self, made: &Composed, path: &Path, folder: &Path) -> Result<(Graph, Vec<PathBuf>), Error> {
        let root = SourceRoot::new(folder);
        let source = Source::new(path.display().to_string(), made.text.as_str());
        let (mut settings, mut wrong) = (Vec::<Setting>::new(), Vec::new());
        for text in &self.set {
            for prefix in &made.methods {
                match format!("{prefix}.{text}").parse() {
                    Ok(setting) => settings.push(setting),
                    Err(_) => {
                        wrong
                            .push(format!("`--set {text}` is not a setting; write `--set node.field=value`"));
                    }
                }
            }
        }
        wrong.dedup();
        if !wrong.is_empty() {
            return Err(Error::usage(wrong.join("\n")));
        }
        let (source, included) = engine::apply(&source, &settings).including(&root);
        let texts = std::iter::once(path.to_owned()).chain(included).collect();
        let graph = Graph::parse(source, &nodes::registry(), root).map_err(Error::Graph)?;
        Ok((graph, texts))
    }

    /// Runs the graph and returns the exit code of the run.
    fn run_graph(
        &self,
        engine: &Engine,
        graph: &Graph,
        targets: Vec<usize>,
        texts: &[PathBuf],
        plan: &[Planned],
    ) -> Result<u8, Error> {
        let options = RunOptions {
            out: self.out.clone(),
            texts: texts.to_vec(),
            only: targets,
            cancel: on_interrupt()?,
            ..RunOptions::default()
        };
        let mut report = Report::lines(self.verbose);
        if report.shows_forecast() {
            report.expect(plan);
        }
        let mut end = None;
        let outcome = engine.run(graph, &options, |event| match event {
            Event::Done(_) => end = Some(event),
            event if is_shown(&event) => report.show(&event),
            _ => {}
        });
        if let Some(failures) = &outcome.failures {
            terminal::mistakes(failures, false);
        }
        end.iter().for_each(|end| report.show(end));
        Ok(outcome.totals.exit_code())
    }

    /// Writes the tables and the page, and prints their paths.
    fn write_tables(
        &self,
        set: &Set,
        method: &Method,
        made: &Composed,
        scores: &Scores,
        remarks: Vec<String>,
    ) -> Result<(), Error> {
        let rows = &scores.rows;
        let entries = summarise(rows, set, |_| true);
        let (blocks, tags) = (blocks(&entries), by_tag(rows, set, &method.name));
        let mut about = vec![INTERVALS.to_owned()];
        about.extend(remarks);
        let title = format!("Benchmark {} {}", set.name, set.version);
        let content =
            Content { set, made, method: &method.name, rows, blocks: &blocks, tags: &tags, remarks: &about };
        let files = [
            ("tables.md", markdown(&title, &about, &blocks, &tags)),
            ("tables.csv", csv(&entries)),
            ("tables.tex", latex(&blocks)),
            ("scores.csv", rows_csv(rows, set)),
            ("index.html", page(&content)),
        ];
        for (name, text) in files {
            let path = self.out.join(name);
            cache::publish_file(&path, text.as_bytes())?;
            terminal::print(&format!("{}\n", path.display()))?;
        }
        Ok(())
    }
}

/// Exit code of an interrupted run.
const INTERRUPTED: u8 = 130;
/// Explanation of the numbers in the tables.
const INTERVALS: &str = "Each number is a mean over scenes, with a 95 % bootstrap interval over scenes (10,000 resamples). \
The views of a case are averaged, then the cases of a scene. PSNR above 100 dB counts as 100 dB. The log-ratio error is the mean of \
|ln S - ln S'| in the shadow, where S is the picture divided by its background.";

/// The sinks of the graph, and the nodes whose reports are read, which have no sink.
fn targets(graph: &Graph, made: &Composed) -> Vec<usize> {
    let reports = made.scored.iter().flat_map(|scored| [&scored.colours, &scored.shade]);
    let mut targets: BTreeSet<usize> = graph.targets().into_iter().collect();
    targets.extend(reports.filter_map(|name| graph.find(name)));
    targets.into_iter().collect()
}

fn absolute(path: &Path) -> Result<PathBuf, Error> {
    path.canonicalize().map_err(|error| Error::unreadable("path", path, &error))
}

/// The work of a run: `cases: 4, scenes: 2, views: 8, tiers: true-light; to do: at most 12 path traces and 0 renders of
/// splats; 80 of 200 nodes may run, about 3 min 20 s`.
fn outline(set: &Set, made: &Composed, tiers: &[Tier], plan: &[Planned]) -> String {
    let used: BTreeSet<usize> = made.scored.iter().map(|scored| scored.case).collect();
    let scenes: BTreeSet<&str> = used.iter().map(|case| set.cases[*case].scene.as_str()).collect();
    let views: usize = used.iter().map(|case| set.cases[*case].views.len()).sum();
    let open = |kind: &str| {
        let open = |node: &&Planned| !matches!(node.fate, Fate::Known | Fate::Unwanted);
        plan.iter().filter(|node| node.kind == kind).filter(open).count()
    };
    let tiers: Vec<&str> = tiers.iter().map(|tier| tier.name()).collect();
    format!(
        "cases: {}, scenes: {}, views: {views}, tiers: {}; to do: at most {} path traces and {} renders of splats; {}",
        used.len(),
        scenes.len(),
        tiers.join(", "),
        open("path-trace"),
        open("splat-render"),
        terminal::forecast_text(&Forecast::of(plan))
    )
}

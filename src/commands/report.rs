//! `report`: writes a page on the cost of a graph, its error, and the nodes that cause the error.

use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use trade::Metric;
use trade::bench::{Bench, Miss};
use trade::plot::tick_text;
use trade::report::{Stop, as_json, measure_all, page, settings};

use crate::session::{EngineArgs, Error, GraphArgs, on_interrupt, time};
use crate::terminal;
use crate::terminal::measuring::{Measuring, outlook_text};

/// Writes one page on what a graph costs, how large its error is, and which node causes it.
///
/// Measures the graph at its presets and with its own settings, then with one node at a time at the reference, and
/// with all nodes but one at the reference. Prints beforehand how long that takes. Everything is compared with the
/// preset `reference`, so give the graph its own `reference` preset if the built-in one takes too long, or limit
/// the time with `--time`. Results are kept in the cache, so a second report measures only what changed.
#[derive(Debug, Args)]
pub struct MakeReport {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// The page to write, a self-contained HTML file
    #[arg(long, short, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// The measure of error: flip, flip95, rmse, psnr, ciede2000, mae or relmse; the prefix `touched.` counts only
    /// pixels that the object changes, `object.` only pixels that it covers, `shadow.` only pixels that it changes
    /// but does not cover
    #[arg(long, value_name = "METRIC", default_value = "flip")]
    metric: String,
    /// Do not measure the settings in which all nodes but one are at the reference; these are the most expensive
    #[arg(long)]
    no_reverse: bool,
    /// Maximum time for measuring, such as 10m; the reference and the graph's own settings are measured in any case
    #[arg(long, value_name = "TIME")]
    time: Option<String>,
    /// Also print all numbers as one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl MakeReport {
    /// Writes the page.
    pub fn run(self) -> Result<u8, Error> {
        let begin = Instant::now();
        let metric = Metric::named(&self.metric)?;
        let limit = self.time.as_deref().map(time).transpose()?;
        let loaded = self.graph.load_to_turn()?;
        loaded.check_output(&self.out)?;
        let engine = self.engine.open()?;
        let mut bench = Bench::new(&engine, &loaded.graph, &loaded.only, on_interrupt()?)?;
        if let Some(limit) = limit {
            bench.end_at(begin + limit);
        }
        bench.judge_by(&metric);
        let all = settings(&bench, !self.no_reverse);
        let shown = Measuring::new(Some(all.len()));
        let outlook = bench.outlook(&all);
        shown.expect(outlook);
        if !self.json {
            let how = if limit.is_none() { "; `--time` limits the time" } else { "" };
            shown.line(&format!("{}{how}", outlook_text(&outlook)));
            bench.observe(shown.observer());
        }
        bench.leave_out_resized()?;
        // Leaving out pictures may leave out knobs.
        let all = settings(&bench, !self.no_reverse);
        let measured = measure_all(&mut bench, &metric, !self.no_reverse, |bench, at| {
            bench.new_remarks().iter().for_each(|remark| shown.line(remark));
            let point = &bench.points[at];
            let (name, error) = (bench.name(&point.assignment), metric.shown(metric.error(&point.off)));
            shown.line(&format!("measured {name}: work {}, error {error}", tick_text(point.work)));
            shown.expect(bench.outlook(&all));
        });
        shown.end();
        let measured = match measured {
            Ok(measured) => measured,
            Err(Stop::Asked) => return Ok(130),
            Err(Stop::Late) => {
                terminal::error(
                    "the time ran out before the preset `reference` and the current settings were measured; raise `--time`, or give the graph its own `reference` preset with fewer samples",
                );
                return Ok(1);
            }
            Err(Stop::Wrong(error)) => return Err(error.into()),
        };
        if measured.late {
            let (done, all) = (bench.points.len(), all.len());
            terminal::remark(&format!("the time ran out (settings measured: {done} of {all})"));
        }
        let name = loaded.graph.source.name.clone();
        let page = page(&bench, &metric, &measured).map_err(|miss| match miss {
            Miss::Stopped | Miss::Late => Error::Output(std::io::ErrorKind::Interrupted.into()),
            Miss::Failed(why) => trade::Error::Setting { setting: "current settings".to_owned(), why }.into(),
        })?;
        cache::publish_file(&self.out, page.finish(&format!("Work and error of {name}")).as_bytes())?;
        if self.json {
            let numbers = as_json(&bench, &metric, measured.now, &measured.attributions);
            terminal::print(&format!("{numbers}\n"))?;
        } else {
            terminal::print(&format!("{}\n", self.out.display()))?;
        }
        Ok(0)
    }
}

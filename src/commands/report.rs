//! `report`: one page on what a graph costs, how far it is off, and which node is to blame.

use std::path::PathBuf;

use clap::Args;
use trade::Metric;
use trade::bench::{Bench, Miss};
use trade::plot::tick_text;
use trade::report::{Measured, Stop, as_json, measure_all, page};

use crate::session::{EngineArgs, Error, GraphArgs, on_interrupt};
use crate::terminal;

/// Writes one page on what a graph costs, how far its pictures are off, and which node is to blame.
///
/// Runs the graph at its presets and as it is, then with each node that has knobs set to the reference alone, and
/// the reverse. Everything is compared with the preset `reference`, so give the graph one of its own where that
/// of the program takes too long.
#[derive(Debug, Args)]
pub struct MakeReport {
    #[command(flatten)]
    graph: GraphArgs,
    #[command(flatten)]
    engine: EngineArgs,
    /// The page to write, with everything in it
    #[arg(long, short, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// What errors are told in: flip, flip95, rmse, psnr, ciede2000, mae, relmse; `touched.` in front counts only
    /// what the object changes, `object.` of that what it covers, `shadow.` the rest
    #[arg(long, value_name = "METRIC", default_value = "flip")]
    metric: String,
    /// Leave out the runs in which all but one node are at the reference, which cost most
    #[arg(long)]
    no_reverse: bool,
    /// Also tell all numbers as one JSON object on standard output
    #[arg(long)]
    pub json: bool,
}

impl MakeReport {
    /// Writes the page.
    pub fn run(self) -> Result<u8, Error> {
        let metric = Metric::named(&self.metric)?;
        let loaded = self.graph.load_to_turn()?;
        loaded.check_output(&self.out)?;
        let engine = self.engine.open()?;
        let mut bench = Bench::new(&engine, &loaded.graph, &loaded.only, on_interrupt()?)?;
        if !self.json {
            bench.observe(terminal::measuring::forecast_of_the_first());
        }
        bench.judge_by(&metric);
        bench.leave_out_resized()?;
        let measured = measure_all(&mut bench, &metric, !self.no_reverse, |bench, at| {
            bench.new_remarks().iter().for_each(|remark| terminal::remark(remark));
            let point = &bench.points[at];
            let (name, error) = (bench.name(&point.assignment), metric.shown(metric.error(&point.off)));
            terminal::remark(&format!("measured {name}: work {}, error {error}", tick_text(point.work)));
        });
        let Measured { presets, now, attributions } = match measured {
            Ok(measured) => measured,
            Err(Stop::Asked) => return Ok(130),
            Err(Stop::Wrong(error)) => return Err(error.into()),
        };
        let name = loaded.graph.source.name.clone();
        let page = page(&bench, &metric, &presets, now, &attributions).map_err(|miss| match miss {
            Miss::Stopped => Error::Output(std::io::ErrorKind::Interrupted.into()),
            Miss::Failed(why) => trade::Error::Setting { setting: "as it is".to_owned(), why }.into(),
        })?;
        cache::publish_file(&self.out, page.finish(&format!("Work and error of {name}")).as_bytes())?;
        if self.json {
            terminal::print(&format!("{}\n", as_json(&bench, &metric, now, &attributions)))?;
        } else {
            terminal::print(&format!("{}\n", self.out.display()))?;
        }
        Ok(0)
    }
}

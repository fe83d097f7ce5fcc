//! `report`: one page on what a graph costs, how far it is off, and which node is to blame.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use engine::{Level, PRESETS};
use nodes::types::{Cell, Images, Picture, Report, Table};
use serde_json::{Value, json};

use crate::report;
use crate::session::{EngineArgs, Error, GraphArgs, on_interrupt};
use crate::trade::attribution::{Attribution, Blame, attributions};
use crate::trade::bench::{Bench, Miss, Point};
use crate::trade::judge::Off;
use crate::trade::left_out::{LeftOut, left_out};
use crate::trade::page::Page;
use crate::trade::plot::{self, Dot, tick_text};
use crate::trade::search::{Tried, pareto};
use crate::trade::tunables::Assignment;
use crate::trade::{Metric, number};

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
        let unknown = || Error::Metric { text: self.metric.clone(), known: Metric::known() };
        let metric = Metric::of(&self.metric).ok_or_else(unknown)?;
        let loaded = self.graph.load_to_turn()?;
        loaded.check_output(&self.out)?;
        let engine = self.engine.open()?;
        let mut bench = Bench::new(&engine, &loaded.graph, &loaded.only, on_interrupt()?)?;
        bench.tells = !self.json;
        bench.judge_by(&metric);
        bench.leave_out_resized()?;
        let measured = measure_all(&mut bench, &metric, !self.no_reverse);
        let Measured { presets, now, attributions } = match measured {
            Ok(measured) => measured,
            Err(Stop::Asked) => return Ok(130),
            Err(Stop::Wrong(error)) => return Err(error),
        };
        let name = loaded.graph.source.name.clone();
        let page = page(&bench, &metric, &presets, now, &attributions).map_err(|miss| match miss {
            Miss::Stopped => Error::Output(std::io::ErrorKind::Interrupted.into()),
            Miss::Failed(why) => Error::Setting { setting: "as it is".to_owned(), why },
        })?;
        cache::publish_file(&self.out, page.finish(&format!("Work and error of {name}")).as_bytes())?;
        if self.json {
            super::print(&format!("{}\n", told(&bench, &metric, now, &attributions)))?;
        } else {
            super::print(&format!("{}\n", self.out.display()))?;
        }
        Ok(0)
    }
}

/// Why measuring ended early.
enum Stop {
    /// By the user.
    Asked,
    Wrong(Error),
}

/// Indices of points, and who is to blame for the error of the graph as it is.
struct Measured {
    presets: Vec<usize>,
    now: usize,
    attributions: Vec<Attribution>,
}

fn measure_all(bench: &mut Bench<'_>, metric: &Metric, reverse: bool) -> Result<Measured, Stop> {
    let measure = |bench: &mut Bench<'_>, assignment: Assignment| -> Result<usize, Stop> {
        let name = bench.name(&assignment);
        let known = bench.points.len();
        let at = bench.measure(&assignment).map_err(|miss| match miss {
            Miss::Stopped => Stop::Asked,
            Miss::Failed(why) => Stop::Wrong(Error::Setting { setting: name.clone(), why }),
        })?;
        bench.new_remarks().iter().for_each(|remark| report::remark(remark));
        // What is known was told when it was measured.
        if at == known {
            let point = &bench.points[at];
            let error = metric.told(metric.error(&point.off));
            report::remark(&format!("measured {name}: work {}, error {error}", tick_text(point.work)));
        }
        Ok(at)
    };
    let mut presets = Vec::new();
    // The first one is what others are compared with.
    for level in (0..PRESETS.len()).rev() {
        presets.insert(0, measure(bench, bench.preset(level))?);
    }
    let now = measure(bench, bench.now())?;
    let attributions = attributions(bench, metric, reverse, measure)?;
    Ok(Measured { presets, now, attributions })
}

/// The tables of a node's report.
fn tables(report: &Report) -> Value {
    let cell = |cell: &Cell| match cell {
        Cell::Text(text) => json!(text),
        Cell::Count(n) => json!(n),
        Cell::Number(value) => number(*value),
        Cell::Missing => Value::Null,
    };
    let rows = |table: &Table| -> Vec<Vec<Value>> {
        table.rows.iter().map(|row| row.iter().map(cell).collect()).collect()
    };
    let one = |table: &Table| json!({"name": table.name, "columns": table.columns, "rows": rows(table)});
    json!(report.tables.iter().map(one).collect::<Vec<_>>())
}

/// Everything that was measured, for programs.
fn told(bench: &Bench<'_>, metric: &Metric, now: usize, attributions: &[Attribution]) -> Value {
    let error = |error: Option<f64>| error.map(|error| metric.value(error));
    let values = |values: &BTreeMap<String, f64>| -> BTreeMap<String, Value> {
        values.iter().map(|(name, value)| (name.clone(), number(*value))).collect()
    };
    let point = |(index, point): (usize, &Point)| {
        let off: Vec<Value> = point
            .off
            .iter()
            .map(|row| {
                json!({"output": row.output, "view": row.view, "region": row.region, "picture": row.judged,
                       "pixels": row.pixels, "values": values(&row.values)})
            })
            .collect();
        let nodes: Vec<Value> = point
            .nodes
            .iter()
            .map(|node| {
                json!({"id": node.id, "kind": node.kind, "work": node.work, "seconds": node.seconds,
                       "cpu_seconds": node.cpu_seconds, "counts": node.counts, "notes": node.notes})
            })
            .collect();
        json!({"setting": bench.name(&point.assignment), "as_it_is": index == now, "work": point.work, "nodes_run": actions(point),
               "seconds": point.seconds, "cpu_seconds": point.cpu_seconds, "error": error(metric.error(&point.off)), "off": off, "nodes": nodes})
    };
    let attribution = |b: &Attribution| {
        json!({"node": b.node, "error_with_it_alone_at_the_reference": error(b.alone),
               "error_with_all_else_at_the_reference": error(b.all_but), "work": b.work_alone})
    };
    let skipped = |row: &LeftOut| {
        json!({"what": row.what, "nodes": row.nodes, "left_out": row.left_out, "found": row.found,
               "check": row.check, "forced_by": row.force})
    };
    let reports = bench.reports_at(now);
    json!({
        "metric": metric.name,
        "points": bench.points.iter().enumerate().map(point).collect::<Vec<_>>(),
        "attribution": attributions.iter().map(attribution).collect::<Vec<_>>(),
        "reports": reports.iter().map(|(name, report)| (name.clone(), tables(report)))
            .collect::<serde_json::Map<_, _>>(),
        "left_out": bench.unjudged,
        "remarks": bench.remarks,
        "not_modelled": left_out(&bench.points[now].nodes, &reports).iter().map(skipped).collect::<Vec<_>>(),
    })
}

fn page(
    bench: &Bench<'_>,
    metric: &Metric,
    presets: &[usize],
    now: usize,
    attributions: &[Attribution],
) -> Result<Page, Miss> {
    let mut page = Page::default();
    facts(&mut page, bench, metric, now, attributions);
    page.words(&format!(
        "Errors are {} against the preset `reference`, the worst of all views. Work is in rays; other counts are \
         weighed as rays. Work and errors are the same in every run. CPU-s are the CPU seconds of the nodes' code on \
         all threads when it ran: one measurement, which differs by some per cent from run to run, and which \
         nothing here is decided by. Wall times are not told.",
        metric.name
    ));
    if !bench.remarks.is_empty() {
        page.words(&format!("Of the pictures: {}.", bench.remarks.join("; ")));
    }
    pictures(&mut page, bench, presets, now)?;
    plots(&mut page, bench, metric, presets, now);
    page.heading("Presets");
    let mut rows = Vec::new();
    for (name, &at) in PRESETS.iter().chain(&["as it is"]).zip(presets.iter().chain([&now])) {
        let point = &bench.points[at];
        let mut row = vec![(*name).to_owned(), tick_text(point.work), tick_text(point.cpu_seconds)];
        for region in ["whole", "touched"] {
            for of in ["flip", "rmse"] {
                let column = Metric::of(&format!("{region}.{of}"));
                row.push(column.map(|m| m.told(m.error(&point.off))).unwrap_or_default());
            }
        }
        rows.push(row);
    }
    let columns = ["preset", "work", "CPU-s", "FLIP, whole", "RMSE, whole", "FLIP, touched", "RMSE, touched"];
    page.table(&columns, &rows);
    attribution(&mut page, bench, metric, now, attributions);
    baselines(&mut page, bench, now);
    let reports = bench.reports_at(now);
    unmodelled(&mut page, &left_out(&bench.points[now].nodes, &reports));
    costs(&mut page, &bench.points[now]);
    notes(&mut page, &bench.points[now]);
    page.heading("What nodes found");
    for (name, report) in reports {
        page.report(&name, &report);
    }
    page.heading("Settings");
    page.words("The graph as it is, as an overlay: `run --overlay` takes it, `tune` writes one like it.");
    page.code(&bench.overlay(&bench.points[now].assignment));
    Ok(page)
}

/// How many nodes a run has: those of equal keys are one.
fn actions(point: &Point) -> usize {
    point.nodes.iter().filter_map(|node| node.key).collect::<BTreeSet<_>>().len()
}

/// What one asks first.
fn facts(page: &mut Page, bench: &Bench<'_>, metric: &Metric, now: usize, attributions: &[Attribution]) {
    let point = &bench.points[now];
    let worst = point.nodes.iter().flat_map(|node| &node.notes).map(|note| note.level).max();
    let stands = match worst {
        Some(Level::Degraded) => "degraded",
        Some(Level::Warning) => "with warnings",
        _ => "as asked",
    };
    let bottleneck = match Blame::of(attributions, metric.error(&point.off)) {
        Blame::Makes(node, _) | Blame::Helps(node) => node.to_owned(),
        Blame::None => "none".to_owned(),
        Blame::Unknown => "not known".to_owned(),
    };
    page.facts(&[
        ("error", format!("{} {}", metric.name, metric.told(metric.error(&point.off)))),
        ("work", format!("{} rays", tick_text(point.work))),
        ("code ran", format!("{} CPU-s", tick_text(point.cpu_seconds))),
        ("nodes", actions(point).to_string()),
        ("bottleneck", bottleneck),
        ("result", stands.to_owned()),
    ]);
}

fn pictures(page: &mut Page, bench: &Bench<'_>, presets: &[usize], now: usize) -> Result<(), Miss> {
    let reference = bench.pictures_at(presets[3])?;
    let pictures = bench.pictures_at(now)?;
    let maps = bench.flip_maps(&pictures);
    page.heading("Pictures");
    page.words("As it is, the reference, and FLIP between them: black is 0, white 1, along the root.");
    for (index, (name, images)) in pictures.iter().enumerate() {
        let map = maps.get(index).and_then(|map| map.as_ref().ok());
        if let Some(Err(why)) = maps.get(index) {
            page.words(&format!("There is no map of FLIP of `{name}`: {why}."));
        }
        for why in map.iter().flat_map(|map| &map.missing) {
            page.words(&format!("There is no map of FLIP of `{name}`, {why}."));
        }
        for view in &images.0 {
            if map.is_some_and(|map| map.missing.is_empty() && map.maps.view(&view.name).is_none()) {
                let why = "it takes colours, all of them finite";
                page.words(&format!("There is no map of FLIP of `{name} {}`: {why}.", view.name));
            }
            let other = |of: Option<&Arc<Images>>| of.and_then(|images| images.view(&view.name)).cloned();
            let reference = other(reference.get(index).map(|(_, images)| images));
            let row = [
                (Some(view.picture.clone()), "as it is"),
                (reference, "reference"),
                (other(map.map(|map| &map.maps)), "FLIP"),
            ];
            let row: Vec<(Picture, String)> = row
                .into_iter()
                .filter_map(|(picture, what)| Some((picture?, format!("{name} {}, {what}", view.name))))
                .collect();
            let row: Vec<_> = row.iter().map(|(picture, text)| (picture, text.clone())).collect();
            page.pictures(&row, 520);
        }
    }
    Ok(())
}

fn unmodelled(page: &mut Page, rows: &[LeftOut]) {
    page.heading("Left out, and the check behind it");
    page.words(
        "What is modelled only where the scene needs it. Whatever a check leaves out can be had all the same, by the \
         last column; `docs/trade.md` has the error of each.",
    );
    let told = |row: &LeftOut| {
        let nodes = match row.nodes.as_slice() {
            [first, second, third, rest @ ..] if !rest.is_empty() => {
                format!("{first}, {second}, {third} and {} more", rest.len())
            }
            nodes => nodes.join(", "),
        };
        let left_out = match row.left_out {
            Some(true) => "left out",
            Some(false) => "modelled",
            None => "not asked",
        };
        [row.what, &nodes, left_out, &row.found, row.check, row.force].map(str::to_owned).to_vec()
    };
    let columns = ["what", "at", "here", "what was found", "left out where", "forced by"];
    page.table(&columns, &rows.iter().map(told).collect::<Vec<_>>());
}

fn notes(page: &mut Page, point: &Point) {
    page.heading("What was decided");
    let levels = |level: Level| match level {
        Level::Count => "count",
        Level::Decision => "decision",
        Level::Warning => "warning",
        Level::Degraded => "degraded",
    };
    let notes = point.nodes.iter().flat_map(|node| {
        node.notes.iter().map(|note| {
            vec![node.id.clone(), levels(note.level).to_owned(), note.id.clone(), note.text.clone()]
        })
    });
    page.words("What each node assumed, passed over or chose by itself, and what it saw that it did.");
    page.table(&["node", "sort", "check", "what it found"], &notes.collect::<Vec<_>>());
}

fn plots(page: &mut Page, bench: &Bench<'_>, metric: &Metric, presets: &[usize], now: usize) {
    let mut outputs: Vec<&str> = bench.points[now].off.iter().map(|row| row.output.as_str()).collect();
    outputs.dedup();
    let mut plots = Vec::new();
    for output in outputs {
        let error = |point: &Point| {
            let rows: Vec<_> = point.off.iter().filter(|row| row.output == output).cloned().collect();
            metric.error(&rows)
        };
        let points = bench.points.iter().enumerate().filter(|(_, point)| error(point).is_some());
        let tried: Vec<(usize, Tried)> = points
            .map(|(index, point)| {
                let assignment = point.assignment.clone();
                (index, Tried { assignment, cost: point.work, error: error(point).unwrap_or_default() })
            })
            .collect();
        let plain: Vec<Tried> = tried.iter().map(|(_, t)| t.clone()).collect();
        let front = pareto(&plain);
        let dots: Vec<Dot> = tried
            .iter()
            .enumerate()
            .map(|(at, (index, t))| Dot {
                cost: t.cost,
                error: t.error,
                name: if *index == now && !presets.contains(index) {
                    "as it is".to_owned()
                } else {
                    bench.name(&t.assignment)
                },
                front: front.contains(&at),
                named: presets.contains(index) || *index == now,
            })
            .collect();
        let axis = format!("error ({})", metric.name);
        let svg = plot::svg(&dots, "work (rays)", &axis, |error| metric.told(Some(error)), None);
        plots.extend(svg.map(|svg| (output, svg)));
    }
    page.heading("Error over work");
    page.plots(&plots);
}

fn baselines(page: &mut Page, bench: &Bench<'_>, now: usize) {
    page.heading("Regions");
    page.words(
        "As it is, beside two baselines against the same reference: nothing inserted, and the reference's object without \
         its shadow. `touched` is what the object covers, shades or lights in the reference, `object` the part that it \
         covers by more than half, `shadow` the rest.",
    );
    let rows = &bench.points[now].off;
    let has = |output: &str| rows.iter().any(|row| row.output == output && row.judged != "image");
    let bare: BTreeSet<&str> = rows.iter().map(|row| &*row.output).filter(|output| !has(output)).collect();
    if !bare.is_empty() {
        let names: Vec<String> = bare.iter().map(|name| format!("`{name}`")).collect();
        page.words(&format!(
            "Baselines and these regions are not computed of {}: no `composite` makes it.",
            names.join(", ")
        ));
    }
    let cell = |row: &Off, column: &str| row.value(column).map_or("not computed".to_owned(), tick_text);
    let rows: Vec<Vec<String>> = bench.points[now]
        .off
        .iter()
        .map(|row| {
            let mut cells =
                vec![format!("{} {}", row.output, row.view), row.judged.clone(), row.region.clone()];
            cells.push(row.pixels.to_string());
            let columns = ["psnr (dB)", "ssim_3dgs_zero_pad", "flip mean", "flip p95", "ciede2000 mean"];
            cells.extend(columns.map(|column| cell(row, column)));
            cells
        })
        .collect();
    let columns = ["view", "picture", "region", "pixels", "PSNR dB", "SSIM", "FLIP", "FLIP p95", "CIEDE2000"];
    page.table(&columns, &rows);
}

fn attribution(
    page: &mut Page,
    bench: &Bench<'_>,
    metric: &Metric,
    now: usize,
    attributions: &[Attribution],
) {
    page.heading("Which node is to blame");
    let error = metric.error(&bench.points[now].off);
    let both = attributions.iter().any(|b| b.all_but.is_some());
    let mut text = format!("As it is the error is {}. ", metric.told(error));
    text.push_str("First column: what it falls to when this node alone is set to the reference");
    text.push_str(if both {
        "; second: what is left when all others are. What neither tells is interaction."
    } else {
        "."
    });
    page.words(&text);
    page.words(&match Blame::of(attributions, error) {
        Blame::Makes(node, own) => {
            let own = metric.told(Some(own));
            format!("`{node}` is the bottleneck: by itself it makes an error of {own}.")
        }
        Blame::Helps(node) => format!("Setting `{node}` to the reference helps most."),
        Blame::None if both => "No node makes an error by itself.".to_owned(),
        Blame::None => "Setting a node to the reference helps nowhere.".to_owned(),
        Blame::Unknown => {
            format!("No node can be named: {} was not computed. It needs {}.", metric.name, metric.needs())
        }
    });
    let row = |b: &Attribution| {
        let all_but = both.then(|| metric.told(b.all_but));
        [b.node.clone(), metric.told(b.alone)].into_iter().chain(all_but).chain([tick_text(b.work_alone)])
    };
    let rows: Vec<Vec<String>> = attributions.iter().map(|b| row(b).collect()).collect();
    let mut columns = vec!["node", "it alone at the reference", "work with it alone"];
    if both {
        columns.insert(2, "all but it at the reference");
    }
    page.table(&columns, &rows);
}

fn costs(page: &mut Page, point: &Point) {
    page.heading("Cost of each node");
    let mut nodes: Vec<_> = point.nodes.iter().collect();
    nodes.sort_by(|a, b| b.work.total_cmp(&a.work).then(b.cpu_seconds.total_cmp(&a.cpu_seconds)));
    let rows: Vec<Vec<String>> = nodes
        .iter()
        .map(|node| {
            let share = format!("{:.1} %", 100.0 * node.work / point.work.max(1e-300));
            let counts: Vec<String> =
                node.counts.iter().map(|(name, n)| format!("{name} {}", tick_text(*n as f64))).collect();
            let (id, kind) = (node.id.clone(), node.kind.to_owned());
            vec![id, kind, tick_text(node.work), share, tick_text(node.cpu_seconds), counts.join(", ")]
        })
        .collect();
    page.table(&["node", "kind", "work", "share", "CPU-s", "counts"], &rows);
}

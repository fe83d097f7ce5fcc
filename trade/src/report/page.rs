//! The HTML page of the subcommand `report`.

use std::collections::BTreeSet;
use std::sync::Arc;

use engine::{Level, PRESETS};
use scene::types::{Images, Picture};

use super::measure::Measured;
use crate::attribution::{Attribution, Blame};
use crate::bench::{Bench, Miss, Point};
use crate::html::Page;
use crate::left_out::{LeftOut, left_out};
use crate::metric::Metric;
use crate::off::Off;
use crate::plot::{self, Dot, tick_text};
use crate::search::{Tried, pareto};

/// Creates the HTML page of a measured graph.
pub fn page(bench: &Bench<'_>, metric: &Metric, measured: &Measured) -> Result<Page, Miss> {
    let Measured { presets, now, attributions, .. } = measured;
    let now = *now;
    let mut page = Page::default();
    facts(&mut page, bench, metric, now, attributions);
    page.words(&format!(
        "Each error is the value of {} in the worst view, compared with the preset `reference`. Work is given in rays; other counts \
         are converted to rays. Work and errors are the same in every run. CPU-s is the CPU time in seconds that the nodes' code took on \
         all threads: a single measurement, which varies by a few per cent between runs and is not used for any decision here. Wall times are not shown.",
        metric.name
    ));
    if !bench.remarks.is_empty() {
        page.words(&format!("About the pictures: {}.", bench.remarks.join("; ")));
    }
    if measured.late {
        page.words("The time ran out before everything was measured, so some values below are missing.");
    }
    pictures(&mut page, bench, measured)?;
    plots(&mut page, bench, metric, measured);
    page.heading("Presets");
    let mut rows = Vec::new();
    for (name, at) in PRESETS.iter().chain(&["current settings"]).zip(presets.iter().chain([&Some(now)])) {
        let Some(at) = at else { continue };
        let point = &bench.points[*at];
        let mut row = vec![(*name).to_owned(), tick_text(point.work), tick_text(point.cpu_seconds)];
        for region in ["whole", "touched"] {
            for of in ["flip", "rmse"] {
                let column = Metric::of(&format!("{region}.{of}"));
                row.push(column.map(|m| m.shown(m.error(&point.off))).unwrap_or_default());
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
    page.heading("Reports of the nodes");
    for (name, report) in reports {
        page.report(&name, &report);
    }
    page.heading("Settings");
    page.words("The current settings as an overlay for `run --overlay`, in the same form as overlays that `tune` writes.");
    page.code(&bench.overlay(&bench.points[now].assignment));
    Ok(page)
}

/// Adds the most important values to the top of the page.
fn facts(page: &mut Page, bench: &Bench<'_>, metric: &Metric, now: usize, attributions: &[Attribution]) {
    let point = &bench.points[now];
    let worst = point.nodes.iter().flat_map(|node| &node.notes).map(|note| note.level).max();
    let stands = match worst {
        Some(Level::Degraded) => "degraded",
        Some(Level::Warning) => "with warnings",
        _ => "as requested",
    };
    let bottleneck = match Blame::of(attributions, metric.error(&point.off)) {
        Blame::Makes(node, _) | Blame::Helps(node) => node.to_owned(),
        Blame::None => "none".to_owned(),
        Blame::Unknown => "unknown".to_owned(),
    };
    page.facts(&[
        ("error", format!("{} {}", metric.name, metric.shown(metric.error(&point.off)))),
        ("work", format!("{} rays", tick_text(point.work))),
        ("CPU time", format!("{} CPU-s", tick_text(point.cpu_seconds))),
        ("nodes", point.actions().to_string()),
        ("bottleneck", bottleneck),
        ("result", stands.to_owned()),
    ]);
}

fn pictures(page: &mut Page, bench: &Bench<'_>, measured: &Measured) -> Result<(), Miss> {
    let reference = bench.pictures_at(measured.reference)?;
    let pictures = bench.pictures_at(measured.now)?;
    let maps = bench.flip_maps(&pictures);
    page.heading("Pictures");
    page.words(
        "Current result, reference, and FLIP difference (on a square-root scale; black is 0, white is 1).",
    );
    for (index, (name, images)) in pictures.iter().enumerate() {
        let map = maps.get(index).and_then(|map| map.as_ref().ok());
        if let Some(Err(why)) = maps.get(index) {
            page.words(&format!("There is no FLIP map of `{name}`: {why}."));
        }
        for why in map.iter().flat_map(|map| &map.missing) {
            page.words(&format!("A part of the FLIP map of `{name}` is missing: {why}."));
        }
        for view in &images.0 {
            if map.is_some_and(|map| map.missing.is_empty() && map.maps.view(&view.name).is_none()) {
                let why = "FLIP can be computed only for finite colours";
                page.words(&format!("There is no FLIP map of `{name} {}`: {why}.", view.name));
            }
            let other = |of: Option<&Arc<Images>>| of.and_then(|images| images.view(&view.name)).cloned();
            let reference = other(reference.get(index).map(|(_, images)| images));
            let row = [
                (Some(view.picture.clone()), "current settings"),
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

fn plots(page: &mut Page, bench: &Bench<'_>, metric: &Metric, measured: &Measured) {
    let now = measured.now;
    let is_preset = |point: usize| measured.presets.contains(&Some(point));
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
                name: if *index == now && !is_preset(*index) {
                    "current settings".to_owned()
                } else {
                    bench.name(&t.assignment)
                },
                front: front.contains(&at),
                named: is_preset(*index) || *index == now,
            })
            .collect();
        let axis = format!("error ({})", metric.name);
        let svg = plot::svg(&dots, "work (rays)", &axis, |error| metric.shown(Some(error)), None);
        plots.extend(svg.map(|svg| (output, svg)));
    }
    page.heading("Error against work");
    page.plots(&plots);
}

fn attribution(
    page: &mut Page,
    bench: &Bench<'_>,
    metric: &Metric,
    now: usize,
    attributions: &[Attribution],
) {
    page.heading("Error of each node");
    let error = metric.error(&bench.points[now].off);
    let both = attributions.iter().any(|b| b.all_but.is_some());
    let mut text = format!("The error of the current settings is {}. ", metric.shown(error));
    text.push_str("The first column is the error with only this node at its reference settings");
    text.push_str(if both {
        ", and the second column is the error with all other nodes at their reference settings. The errors in the second column need not add up to the error of the current settings, since nodes interact."
    } else {
        "."
    });
    page.words(&text);
    page.words(&match Blame::of(attributions, error) {
        Blame::Makes(node, own) => {
            let own = metric.shown(Some(own));
            format!("`{node}` is the bottleneck: with all other nodes at their reference settings, the error is {own}.")
        }
        Blame::Helps(node) => {
            format!("The error falls most if only `{node}` is set to its reference settings.")
        }
        Blame::None if both => "No node causes an error if all other nodes are at their reference settings.".to_owned(),
        Blame::None => "Setting a single node to its reference settings does not reduce the error.".to_owned(),
        Blame::Unknown => {
            format!(
                "The bottleneck is unknown, since the metric `{}` was not computed. This metric needs {}.",
                metric.name,
                metric.needs()
            )
        }
    });
    let row = |b: &Attribution| {
        let all_but = both.then(|| metric.shown(b.all_but));
        [b.node.clone(), metric.shown(b.alone)].into_iter().chain(all_but).chain([tick_text(b.work_alone)])
    };
    let rows: Vec<Vec<String>> = attributions.iter().map(|b| row(b).collect()).collect();
    let mut columns = vec![
        "node",
        "only this node at its reference settings",
        "work with only this node at its reference settings",
    ];
    if both {
        columns.insert(2, "all other nodes at their reference settings");
    }
    page.table(&columns, &rows);
}

fn baselines(page: &mut Page, bench: &Bench<'_>, now: usize) {
    page.heading("Regions");
    page.words(
        "The current result and two baselines, compared with the same reference. The baselines are: nothing inserted, and the \
         reference's object without its shadow. The region `touched` is what the object covers, shades or lights in the reference; \
         `object` consists of the pixels of this region that the object covers by more than half, and `shadow` of the remaining pixels.",
    );
    let rows = &bench.points[now].off;
    let has = |output: &str| rows.iter().any(|row| row.output == output && row.judged != "image");
    let bare: BTreeSet<&str> = rows.iter().map(|row| &*row.output).filter(|output| !has(output)).collect();
    if !bare.is_empty() {
        let names: Vec<String> = bare.iter().map(|name| format!("`{name}`")).collect();
        page.words(&format!(
            "Baselines and these regions are not computed for {}, since only pictures of a `composite` have them.",
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

fn unmodelled(page: &mut Page, rows: &[LeftOut]) {
    page.heading("Skipped work and its checks");
    page.words(
        "Optional work, which is done only if the scene needs it. The last column shows how to force the work to be done; `docs/trade.md` lists the errors that result from skipping it.",
    );
    let reported = |row: &LeftOut| {
        let nodes = match row.nodes.as_slice() {
            [first, second, third, rest @ ..] if !rest.is_empty() => {
                format!("{first}, {second}, {third} and {} more", rest.len())
            }
            nodes => nodes.join(", "),
        };
        let left_out = match row.left_out {
            Some(true) => "skipped",
            Some(false) => "done",
            None => "not checked",
        };
        [row.what, &nodes, left_out, &row.found, row.check, row.force].map(str::to_owned).to_vec()
    };
    let columns = ["work", "nodes", "in this run", "finding", "check", "forced by"];
    page.table(&columns, &rows.iter().map(reported).collect::<Vec<_>>());
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

fn notes(page: &mut Page, point: &Point) {
    page.heading("Notes of the nodes");
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
    page.words("Assumptions and choices of each node, work that it skipped, and the reasons.");
    page.table(&["node", "level", "note", "text"], &notes.collect::<Vec<_>>());
}

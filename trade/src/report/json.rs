//! The measurements of the subcommand `report` as JSON.

use std::collections::BTreeMap;

use scene::types::{Cell, Report, Table};
use serde_json::{Value, json};

use crate::attribution::Attribution;
use crate::bench::{Bench, Point};
use crate::left_out::{LeftOut, left_out};
use crate::metric::{Metric, number};

/// Returns all measurements of a report as JSON.
pub fn as_json(bench: &Bench<'_>, metric: &Metric, now: usize, attributions: &[Attribution]) -> Value {
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
        json!({"setting": bench.name(&point.assignment), "as_it_is": index == now, "work": point.work, "nodes_run": point.actions(),
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

/// The tables of a node's report as JSON.
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

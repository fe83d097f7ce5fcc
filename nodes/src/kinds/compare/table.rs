//! Tables of the report: their columns, and the cells of a row.

use scene::types::{Cell, Report, Table};

use super::pair::Row;
use super::params::{Compare, Space};

/// Columns at the start of both tables. The columns of each table follow them.
pub(super) const COMMON: [&str; 5] = ["view", "picture", "region", "pixels", "share of all pixels"];
const COLOUR: [&str; 10] = [
    "psnr (dB)",
    "ssim_3dgs_zero_pad",
    "ssim_valid",
    "flip mean",
    "flip p95",
    "ciede2000 mean",
    "lpips",
    "mean absolute error",
    "largest error",
    "relative mse (linear, eps 0.01)",
];
/// Index of the first FLIP column.
const FLIP: usize = 3;
/// Names of the FLIP columns with `Linear`.
const HDR_FLIP: [&str; 2] = ["hdr-flip mean", "hdr-flip p95"];
const RATIO: [&str; 5] = [
    "psnr (dB)",
    "mean absolute error",
    "largest error",
    "mean |ln a - ln b| (values below 0.001 count as 0.001)",
    "shadow IoU (pixels below 0.98)",
];
/// Builds the report from the rows of the two tables.
pub(super) fn report(p: &Compare, colour: Vec<Vec<Cell>>, ratio: Vec<Vec<Cell>>) -> Report {
    let space = match p.space {
        Space::Display if p.quantise => "8-bit display values",
        Space::Display => "display values",
        Space::Linear => "linear light, with HDR-FLIP",
    };
    let title = match (colour.is_empty(), ratio.is_empty()) {
        (true, false) => "Difference from the reference, in data values".to_owned(),
        (false, false) => format!("Difference from the reference (colours in {space}, data in data values)"),
        (_, true) => format!("Difference from the reference, in {space}"),
    };
    let table =
        |name: &str, columns: &[&str], rows| Table::new(name, COMMON.iter().chain(columns).copied(), rows);
    let mut tables = Vec::new();
    if !colour.is_empty() || ratio.is_empty() {
        let mut columns = COLOUR;
        if p.space == Space::Linear {
            columns[FLIP..].iter_mut().zip(HDR_FLIP).for_each(|(column, hdr)| *column = hdr);
        }
        tables.push(table("compare", &columns, colour));
    }
    if !ratio.is_empty() {
        tables.push(table("ratio", &RATIO, ratio));
    }
    if !p.scores.is_empty() {
        tables.push(prompt(&p.scores));
    }
    Report { title, tables }
}

fn number(value: Option<f64>) -> Cell {
    match value {
        Some(value) if value.is_finite() => Cell::Number(value),
        Some(value) if value.is_infinite() => Cell::Text(value.to_string()),
        _ => Cell::Missing,
    }
}

/// Cells of a row without values: the names, followed by missing cells.
pub(super) fn unknown(names: [&str; 3], colour: bool) -> Vec<Cell> {
    let mut cells: Vec<Cell> = names.iter().map(|name| Cell::Text((*name).to_owned())).collect();
    cells.resize(COMMON.len() + if colour { COLOUR.len() } else { RATIO.len() }, Cell::Missing);
    cells
}

/// Cells of the row of a region. Their values are missing if the region contains no pixel.
pub(super) fn cells(names: [&str; 3], row: Option<Row>, colour: bool, pixels: usize) -> Vec<Cell> {
    let mut cells: Vec<Cell> = names.iter().map(|name| Cell::Text((*name).to_owned())).collect();
    let count = row.as_ref().map_or(0, |row| row.errors.pixels);
    cells.push(Cell::Count(count));
    cells.push(number(Some(count as f64 / pixels.max(1) as f64)));
    let Some(row) = row else {
        let more = if colour { COLOUR.len() } else { RATIO.len() };
        cells.resize(cells.len() + more, Cell::Missing);
        return cells;
    };
    let (psnr, absolute, largest) =
        (Some(row.errors.psnr()), Some(row.errors.mean_absolute), Some(row.errors.largest));
    let values: &[Option<f64>] = if colour {
        &[
            psnr,
            row.ssim,
            row.ssim_valid,
            row.flip,
            row.flip_p95,
            row.ciede2000,
            row.lpips,
            absolute,
            largest,
            row.relative,
        ]
    } else {
        &[psnr, absolute, largest, row.log_error, row.iou]
    };
    cells.extend(values.iter().map(|value| number(*value)));
    cells
}

/// Table of the scores, with the share of the positive score in each pair. A pair whose two scores are 0 has no
/// share and is left out of the means.
fn prompt(scores: &[[f64; 2]]) -> Table {
    let share = |[positive, negative]: [f64; 2]| {
        (positive + negative > 0.0).then(|| positive / (positive + negative))
    };
    let row = |name: String, [a, b]: [f64; 2], share: Option<f64>| {
        vec![Cell::Text(name), Cell::Number(a), Cell::Number(b), number(share)]
    };
    let mut rows: Vec<Vec<Cell>> =
        scores.iter().enumerate().map(|(i, s)| row((i + 1).to_string(), *s, share(*s))).collect();
    let shares: Vec<f64> = scores.iter().filter_map(|s| share(*s)).collect();
    let count = shares.len().max(1) as f64;
    let mean = (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / count);
    // Scores are not negative, so those without a share add nothing to the sums.
    let sums = scores.iter().fold([0.0; 2], |sum, s| [sum[0] + s[0], sum[1] + s[1]]);
    rows.push(row("mean over all pairs except (0, 0)".to_owned(), sums.map(|s| s / count), mean));
    rows.push(row("sum over all pairs".to_owned(), sums, share(sums)));
    Table::new("prompt", ["pair", "positive", "negative", "positive / (positive + negative)"], rows)
}

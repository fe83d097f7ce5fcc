//! Scores of each view, read from the results of a run.

use engine::{Engine, Graph, Wire};
use scene::types::{Cell, Report, Table};

use crate::graph::{Composed, Scored};
use crate::set::Set;
use crate::tier::Tier;

/// A measure of the error of a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Metric {
    /// Peak signal-to-noise ratio of 8-bit display values, in dB.
    Psnr,
    /// Structural similarity, as in the code of 3D Gaussian splatting.
    Ssim,
    /// Mean of FLIP.
    Flip,
    /// Mean of CIEDE2000.
    Ciede2000,
    /// LPIPS, for whole pictures.
    Lpips,
    /// Mean of `|ln S - ln S'|` for the ratio of the shadow.
    LogRatio,
    /// Intersection over union of the two shadows.
    Iou,
}

impl Metric {
    /// All metrics, in the order of the tables.
    pub const ALL: [Self; 7] =
        [Self::Psnr, Self::Ssim, Self::Flip, Self::Ciede2000, Self::Lpips, Self::LogRatio, Self::Iou];

    /// Name in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR (dB)",
            Self::Ssim => "SSIM",
            Self::Flip => "FLIP",
            Self::Ciede2000 => "CIEDE2000",
            Self::Lpips => "LPIPS",
            Self::LogRatio => "log-ratio error",
            Self::Iou => "shadow IoU",
        }
    }

    /// Number of decimals in the tables.
    pub fn decimals(self) -> usize {
        match self {
            Self::Psnr => 1,
            Self::Ciede2000 => 2,
            Self::LogRatio | Self::Iou => 3,
            _ => 4,
        }
    }

    /// True if a larger value is better.
    pub fn grows(self) -> bool {
        matches!(self, Self::Psnr | Self::Ssim | Self::Iou)
    }

    /// Start of the heading of its column in a report of `compare`, and true if the report compares ratios.
    fn column(self) -> (&'static str, bool) {
        match self {
            Self::Psnr => ("psnr (dB)", false),
            Self::Ssim => ("ssim_3dgs_zero_pad", false),
            Self::Flip => ("flip mean", false),
            Self::Ciede2000 => ("ciede2000 mean", false),
            Self::Lpips => ("lpips", false),
            Self::LogRatio => ("mean |ln a - ln b|", true),
            Self::Iou => ("shadow IoU", true),
        }
    }
}

/// PSNR above this value counts as this value, in dB, so that equal pictures have a mean.
pub const MOST_PSNR: f64 = 100.0;

/// Scores of a region of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The tier.
    pub tier: Tier,
    /// Index of the case in the set.
    pub case: usize,
    /// Name of the view.
    pub view: String,
    /// Name of the method or the baseline.
    pub picture: String,
    /// Name of the region.
    pub region: String,
    /// Number of pixels.
    pub pixels: u64,
    /// Value of each of [`Metric::ALL`]; `None` if it is not defined there.
    pub values: [Option<f64>; 7],
}

/// Scores of all pictures, and the pictures of which scores are missing, because a node failed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Scores {
    /// The rows, in the order of the graph.
    pub rows: Vec<Row>,
    /// Tier, case and picture without scores.
    pub failed: Vec<String>,
}

/// Reads the results of the last run of a graph.
pub fn read(engine: &Engine, graph: &Graph, made: &Composed, set: &Set) -> Scores {
    let mut scores = Scores::default();
    let report = |name: &str| -> Option<Report> {
        let node = graph.find(name)?;
        engine.value::<Report>(graph, Wire { node, port: 0 })
    };
    for scored in &made.scored {
        match (report(&scored.colours), report(&scored.shade)) {
            (Some(colours), Some(shade)) => scores.rows.extend(rows(scored, &colours, &shade)),
            _ => {
                let Scored { tier, picture, case, .. } = scored;
                scores.failed.push(format!("{tier}, {}, {picture}", set.cases[*case].name));
            }
        }
    }
    scores
}

/// The rows of the two reports of a picture.
fn rows(scored: &Scored, colours: &Report, shade: &Report) -> Vec<Row> {
    let Some(table) = colours.tables.iter().find(|table| table.name == "compare") else { return Vec::new() };
    let ratio = shade.tables.iter().find(|table| table.name == "ratio");
    let text = |table: &Table, row: usize, heading: &str| match cell(table, row, heading) {
        Some(Cell::Text(text)) => text.clone(),
        _ => String::new(),
    };
    let row = |at: usize| {
        let (view, region) = (text(table, at, "view"), text(table, at, "region"));
        let other = ratio.and_then(|ratio| {
            let same =
                |&row: &usize| text(ratio, row, "view") == view && text(ratio, row, "region") == region;
            (0..ratio.rows.len()).find(same).map(|row| (ratio, row))
        });
        let values = Metric::ALL.map(|metric| {
            let value = match metric.column() {
                (heading, false) => number(cell(table, at, heading)),
                (heading, true) if region == "shadow" => {
                    other.and_then(|(t, row)| number(cell(t, row, heading)))
                }
                _ => None,
            };
            if metric == Metric::Psnr { value.map(|value| value.min(MOST_PSNR)) } else { value }
        });
        let pixels = match cell(table, at, "pixels") {
            Some(Cell::Count(pixels)) => *pixels,
            _ => 0,
        };
        let Scored { tier, case, picture, .. } = scored.clone();
        Row { tier, case, view, picture, region, pixels, values }
    };
    (0..table.rows.len()).filter(|at| text(table, *at, "picture") == "image").map(row).collect()
}

fn cell<'t>(table: &'t Table, row: usize, heading: &str) -> Option<&'t Cell> {
    let column = table.columns.iter().position(|column| column.starts_with(heading))?;
    table.rows[row].get(column)
}

/// The number in a cell. An infinite PSNR is a text.
fn number(cell: Option<&Cell>) -> Option<f64> {
    match cell? {
        Cell::Number(value) => Some(*value),
        Cell::Count(value) => Some(*value as f64),
        Cell::Text(text) => text.parse().ok().filter(|value: &f64| !value.is_nan()),
        Cell::Missing => None,
    }
}

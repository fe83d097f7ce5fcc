//! Tables as Markdown, CSV and LaTeX.

use std::fmt::Write as _;

use crate::bootstrap::Interval;
use crate::scores::{Metric, Row};
use crate::set::Set;
use crate::summary::{Entry, find, summarise};
use crate::tier::Tier;

/// A table of one region in one tier: rows are pictures, columns are metrics.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// The tier.
    pub tier: Tier,
    /// Name of the region.
    pub region: String,
    /// The metrics that are defined there.
    pub metrics: Vec<Metric>,
    /// Each picture with its number of cases and the interval of each metric.
    pub rows: Vec<(String, usize, Vec<Option<Interval>>)>,
}

/// Arranges entries in tables, in their order.
pub fn blocks(entries: &[Entry]) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    for entry in entries {
        if !blocks.iter().any(|block| block.tier == entry.tier && block.region == entry.region) {
            let here = || entries.iter().filter(|e| e.tier == entry.tier && e.region == entry.region);
            let metrics: Vec<Metric> =
                Metric::ALL.into_iter().filter(|metric| here().any(|e| e.metric == *metric)).collect();
            let mut rows: Vec<(String, usize, Vec<Option<Interval>>)> = Vec::new();
            for e in here() {
                if !rows.iter().any(|(picture, ..)| *picture == e.picture) {
                    let of = |metric: &Metric| {
                        find(entries, e.tier, &e.region, &e.picture, *metric).map(|entry| entry.interval)
                    };
                    rows.push((e.picture.clone(), e.cases, metrics.iter().map(of).collect()));
                }
            }
            blocks.push(Block { tier: entry.tier, region: entry.region.clone(), metrics, rows });
        }
    }
    blocks
}

/// A mean and its interval: `31.2 [29.8, 33.0]`. The mean of one scene has no interval.
pub fn cell(interval: Option<Interval>, metric: Metric) -> String {
    let digits = metric.decimals();
    match interval {
        None => "not computed".to_owned(),
        Some(Interval { mean, scenes: 1, .. }) => format!("{mean:.digits$}"),
        Some(Interval { mean, low, high, .. }) => {
            format!("{mean:.digits$} [{low:.digits$}, {high:.digits$}]")
        }
    }
}

/// Heading of a column, with the direction of better values.
pub fn heading(metric: Metric) -> String {
    format!("{} {}", metric.name(), if metric.grows() { "↑" } else { "↓" })
}

/// A table row in Markdown.
fn line(cells: impl IntoIterator<Item = String>) -> String {
    let cells: Vec<String> = cells.into_iter().map(|cell| cell.replace('|', "\\|")).collect();
    format!("| {} |\n", cells.join(" | "))
}

/// All tables as Markdown.
pub fn markdown(title: &str, remarks: &[String], blocks: &[Block], tags: &[Tagged]) -> String {
    let mut text = format!("# {title}\n");
    remarks.iter().for_each(|remark| text.push_str(&format!("\n{remark}\n")));
    let mut last = None;
    for block in blocks {
        if last.replace(block.tier) != Some(block.tier) {
            let _ = write!(text, "\n## {}\n\n{}\n", block.tier, block.tier.description());
        }
        let _ = write!(text, "\n### {}\n\n", block.region);
        let heads = ["picture".to_owned(), "cases".to_owned()].into_iter();
        text.push_str(&line(heads.chain(block.metrics.iter().map(|m| heading(*m)))));
        text.push_str(&line(std::iter::repeat_n("---".to_owned(), 2 + block.metrics.len())));
        for (picture, cases, values) in &block.rows {
            let cells = values.iter().zip(&block.metrics).map(|(value, metric)| cell(*value, *metric));
            text.push_str(&line([picture.clone(), cases.to_string()].into_iter().chain(cells)));
        }
    }
    if !tags.is_empty() {
        text.push_str("\n## By tag\n\n");
        text.push_str(&line(TAG_COLUMNS.map(str::to_owned)));
        text.push_str(&line(std::iter::repeat_n("---".to_owned(), TAG_COLUMNS.len())));
        tags.iter().for_each(|tagged| text.push_str(&line(tagged.cells())));
    }
    text
}

/// Columns of the table by tag.
pub const TAG_COLUMNS: [&str; 6] = [
    "tier",
    "tag",
    "cases",
    "PSNR of the object (dB) ↑",
    "PSNR of the shadow (dB) ↑",
    "log-ratio error of the shadow ↓",
];

/// Scores of the method for the cases with a tag.
#[derive(Debug, Clone, PartialEq)]
pub struct Tagged {
    tier: Tier,
    tag: String,
    cases: usize,
    values: [Option<Interval>; 3],
}

impl Tagged {
    /// The cells of its row.
    pub fn cells(&self) -> [String; 6] {
        let [object, shadow, log] = self.values;
        [
            self.tier.to_string(),
            self.tag.clone(),
            self.cases.to_string(),
            cell(object, Metric::Psnr),
            cell(shadow, Metric::Psnr),
            cell(log, Metric::LogRatio),
        ]
    }
}

/// Scores of a method for each tag of the set.
pub fn by_tag(rows: &[Row], set: &Set, method: &str) -> Vec<Tagged> {
    let mut tags: Vec<&String> = set.cases.iter().flat_map(|case| &case.tags).collect();
    tags.sort();
    tags.dedup();
    let mut tagged = Vec::new();
    let mut tiers: Vec<Tier> = rows.iter().map(|row| row.tier).collect();
    tiers.sort_unstable();
    tiers.dedup();
    let all: Vec<_> = tags
        .into_iter()
        .map(|tag| (tag, summarise(rows, set, |case| set.cases[case].tags.contains(tag))))
        .collect();
    for tier in tiers {
        for (tag, entries) in &all {
            let of = |region, metric| find(entries, tier, region, method, metric);
            let object = of("object", Metric::Psnr);
            let Some(cases) = object.map(|entry| entry.cases) else { continue };
            let values = [object, of("shadow", Metric::Psnr), of("shadow", Metric::LogRatio)];
            let values = values.map(|entry| entry.map(|entry| entry.interval));
            tagged.push(Tagged { tier, tag: (*tag).clone(), cases, values });
        }
    }
    tagged
}

/// A field of CSV, quoted if necessary.
fn field(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// The means as CSV, with every digit.
pub fn csv(entries: &[Entry]) -> String {
    let mut text = "tier,region,picture,metric,mean,low,high,scenes,cases\n".to_owned();
    for Entry { tier, region, picture, metric, interval, cases } in entries {
        let Interval { mean, low, high, scenes } = interval;
        let (picture, metric) = (field(picture), metric.name());
        let _ = writeln!(text, "{tier},{region},{picture},{metric},{mean},{low},{high},{scenes},{cases}");
    }
    text
}

/// The scores of each view as CSV, with every digit. A value that is not defined is empty.
pub fn rows_csv(rows: &[Row], set: &Set) -> String {
    let mut text = "tier,scene,case,view,picture,region,pixels".to_owned();
    Metric::ALL.iter().for_each(|metric| text.push_str(&format!(",{}", metric.name())));
    text.push('\n');
    for row in rows {
        let case = &set.cases[row.case];
        let (view, picture) = (field(&row.view), field(&row.picture));
        let _ = write!(
            text,
            "{},{},{},{view},{picture},{},{}",
            row.tier, case.scene, case.name, row.region, row.pixels
        );
        for value in row.values {
            text.push(',');
            if let Some(value) = value {
                let _ = write!(text, "{value}");
            }
        }
        text.push('\n');
    }
    text
}

/// Text with the special characters of LaTeX escaped.
fn tex(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, c| {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '\\' => out.push_str("\\textbackslash{}"),
            '↑' => out.push_str("$\\uparrow$"),
            '↓' => out.push_str("$\\downarrow$"),
            c => out.push(c),
        }
        out
    })
}

/// All tables as LaTeX, for the package `booktabs`. The best mean of each column is bold; "perfect ratio", which uses
/// the truth, does not compete.
pub fn latex(blocks: &[Block]) -> String {
    let mut text = "% Tables of `lightharmony bench`; need \\usepackage{booktabs}.\n".to_owned();
    for block in blocks {
        let best: Vec<Option<f64>> =
            block.metrics.iter().enumerate().map(|(at, metric)| best(block, at, *metric)).collect();
        let columns = "r".repeat(1 + block.metrics.len());
        let _ = write!(
            text,
            "\\begin{{table}}\n\\centering\n\\begin{{tabular}}{{l{columns}}}\n\\toprule\npicture & cases"
        );
        block.metrics.iter().for_each(|metric| text.push_str(&format!(" & {}", tex(&heading(*metric)))));
        text.push_str(" \\\\\n\\midrule\n");
        for (picture, cases, values) in &block.rows {
            let _ = write!(text, "{} & {cases}", tex(picture));
            for ((value, metric), best) in values.iter().zip(&block.metrics).zip(&best) {
                let shown = cell(*value, *metric);
                let is_best = value.is_some_and(|value| Some(value.mean) == *best) && picture != PERFECT;
                let _ =
                    if is_best { write!(text, " & \\textbf{{{shown}}}") } else { write!(text, " & {shown}") };
            }
            text.push_str(" \\\\\n");
        }
        let (tier, region) = (tex(block.tier.name()), tex(&block.region));
        let _ = write!(
            text,
            "\\bottomrule\n\\end{{tabular}}\n\\caption{{Tier {tier}, region {region}: means over scenes with 95\\,\\% bootstrap \
             intervals.}}\n\\end{{table}}\n"
        );
    }
    text
}

/// Name of the baseline that uses the true ratio.
const PERFECT: &str = "perfect ratio";

/// The best mean of a column.
fn best(block: &Block, at: usize, metric: Metric) -> Option<f64> {
    let rows = block.rows.iter().filter(|(picture, ..)| picture != PERFECT);
    let means = rows.filter_map(|(_, _, values)| values[at].map(|value| value.mean));
    means.reduce(|a, b| if metric.grows() { a.max(b) } else { a.min(b) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(picture: &str, metric: Metric, mean: f64) -> Entry {
        let interval = Interval { mean, low: mean - 1.0, high: mean + 1.0, scenes: 3 };
        let (tier, region, picture) = (Tier::TrueLight, "shadow".to_owned(), picture.to_owned());
        Entry { tier, region, picture, metric, interval, cases: 4 }
    }

    // This test fails if the best of a column is the largest for errors too, or if the ceiling competes.
    #[test]
    fn tables_have_a_row_per_picture_and_mark_the_best() {
        let entries = [
            entry("ours & theirs", Metric::Psnr, 31.25),
            entry("ours & theirs", Metric::Flip, 0.5),
            entry("none", Metric::Psnr, 20.0),
            entry("none", Metric::Flip, 0.25),
            entry(PERFECT, Metric::Psnr, 40.0),
        ];
        let blocks = blocks(&entries);
        assert_eq!(blocks.len(), 1);
        let text = markdown("t", &["r".to_owned()], &blocks, &[]);
        assert!(text.contains("| picture | cases | PSNR (dB) ↑ | FLIP ↓ |"), "{text}");
        assert!(text.contains("| none | 4 | 20.0 [19.0, 21.0] | 0.2500 [-0.7500, 1.2500] |"), "{text}");
        assert!(text.contains("| perfect ratio | 4 | 40.0 [39.0, 41.0] | not computed |"), "{text}");
        let text = latex(&blocks);
        assert!(text.contains("ours \\& theirs & 4 & \\textbf{31.2 [30.2, 32.2]} & 0.5000"), "{text}");
        assert!(text.contains("none & 4 & 20.0 [19.0, 21.0] & \\textbf{0.2500"), "{text}");
        assert!(csv(&entries).contains("true-light,shadow,ours & theirs,PSNR (dB),31.25,30.25,32.25,3,4\n"));
    }
}

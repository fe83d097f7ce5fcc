//! The page with tables and pictures. It refers to the pictures by relative paths.

use trade::html::Page;

use crate::graph::{Composed, Scored, truth_path};
use crate::scores::{Metric, Row};
use crate::set::Set;
use crate::tables::{Block, TAG_COLUMNS, Tagged, cell, heading};

/// Content of the page.
pub struct Content<'a> {
    /// The set, with the cases that were run.
    pub set: &'a Set,
    /// The graph that was run.
    pub made: &'a Composed,
    /// Name of the method.
    pub method: &'a str,
    /// Scores of each view.
    pub rows: &'a [Row],
    /// The tables.
    pub blocks: &'a [Block],
    /// Scores by tag.
    pub tags: &'a [Tagged],
    /// Remarks, such as missing pictures.
    pub remarks: &'a [String],
}

/// Makes the HTML file.
pub fn page(content: &Content<'_>) -> String {
    let set = content.set;
    let mut page = Page::default();
    let mut scenes: Vec<&str> = set.cases.iter().map(|case| case.scene.as_str()).collect();
    scenes.sort_unstable();
    scenes.dedup();
    page.facts(&[
        ("set", format!("{} {}", set.name, set.version)),
        ("cases", set.cases.len().to_string()),
        ("scenes", scenes.len().to_string()),
        ("method", content.method.to_owned()),
    ]);
    content.remarks.iter().for_each(|remark| page.words(remark));
    let mut last = None;
    for block in content.blocks {
        if last.replace(block.tier) != Some(block.tier) {
            page.heading(&format!("Tier {}", block.tier));
            page.words(block.tier.description());
        }
        page.words(&format!("Region {}:", block.region));
        let columns: Vec<String> = ["picture", "cases"]
            .into_iter()
            .map(str::to_owned)
            .chain(block.metrics.iter().map(|m| heading(*m)))
            .collect();
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let row = |(picture, cases, values): &(String, usize, Vec<_>)| -> Vec<String> {
            let cells = values.iter().zip(&block.metrics).map(|(value, metric)| cell(*value, *metric));
            [picture.clone(), cases.to_string()].into_iter().chain(cells).collect()
        };
        page.table(&columns, &block.rows.iter().map(row).collect::<Vec<_>>());
    }
    if !content.tags.is_empty() {
        page.heading("By tag");
        page.table(
            &TAG_COLUMNS,
            &content.tags.iter().map(|tagged| tagged.cells().to_vec()).collect::<Vec<_>>(),
        );
    }
    pictures(&mut page, content);
    page.finish(&format!("Benchmark {} {}", set.name, set.version))
}

/// The pictures of each view, the view with the largest error of the method first.
fn pictures(page: &mut Page, content: &Content<'_>) {
    page.heading("Pictures");
    page.words(
        "In decreasing order of the error of the method: FLIP, the mean of the regions object and shadow.",
    );
    let flip = Metric::ALL.iter().position(|metric| *metric == Metric::Flip).unwrap_or_default();
    let mut views: Vec<(f64, &Scored, &str)> = Vec::new();
    for scored in content.made.scored.iter().filter(|scored| scored.picture == content.method) {
        for view in &content.set.cases[scored.case].views {
            let of = |row: &&Row| {
                row.tier == scored.tier
                    && row.case == scored.case
                    && row.picture == scored.picture
                    && row.view == view.name
                    && ["object", "shadow"].contains(&row.region.as_str())
            };
            let values: Vec<f64> =
                content.rows.iter().filter(of).filter_map(|row| row.values[flip]).collect();
            if !values.is_empty() {
                views.push((values.iter().sum::<f64>() / values.len() as f64, scored, &view.name));
            }
        }
    }
    views.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (error, scored, view) in views {
        let case = &content.set.cases[scored.case];
        let at = |path: &str| path.replace("{view}", view);
        page.words(&format!("`{}` `{view}`, tier {}: FLIP {error:.4}", case.name, scored.tier));
        let mut shown = vec![
            (at(&scored.path), content.method.to_owned()),
            (at(&truth_path(case, "with")), "truth".to_owned()),
            (at(&scored.flip), format!("FLIP of {}", content.method)),
        ];
        let others = content.made.scored.iter().filter(|other| {
            other.tier == scored.tier && other.case == scored.case && other.picture != scored.picture
        });
        shown.extend(others.map(|other| (at(&other.path), other.picture.clone())));
        page.linked(&shown);
    }
}

//! `write-report`: reports as JSON, CSV, Markdown or text.

use std::fmt::Write as _;
use std::sync::Arc;

use engine::{Context, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
use scene::types::{Cell, Report, Table};

engine::params! {
    /// Writes a report as JSON, CSV, Markdown or plain text, depending on the extension of the path.
    ///
    /// JSON and CSV keep every digit; in Markdown and text, numbers are rounded to five digits.
    pub struct WriteReport {
        /// The file: `.json`, `.csv`, `.md` or `.txt`.
        path: OutputFile, other("\"b.csv\"");
    }
}
engine::inputs! {
    /// Report to write.
    pub struct In {
        /// The report.
        report: Arc<Report>,
    }
}
engine::outputs! {
    /// Outputs of [`WriteReport`].
    pub struct Out {
        /// List of one file.
        files: Arc<Files>,
    }
}

impl Kind for WriteReport {
    const NAME: &'static str = "write-report";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.path.0.contains("{view}") {
            let error = NodeError::new(
                "`{view}` is not allowed here: the report is written to a single file for all views",
            )
            .at("path");
            return Err(error.hint("remove `{view}` from `path`"));
        }
        match p.path.extension().as_str() {
            "json" | "csv" | "md" | "txt" => Ok(()),
            other => Err(NodeError::new(format!("cannot write a report as `.{other}`"))
                .at("path")
                .hint("end the path in `.json`, `.csv`, `.md` or `.txt`")),
        }
    }

    fn run(p: &Self, inputs: In, _cx: &Context) -> Result<(Out, Notes), NodeError> {
        let report = &inputs.report;
        let text = match p.path.extension().as_str() {
            "json" => serde_json::to_string_pretty(&**report)? + "\n",
            "csv" => report.tables.iter().map(csv).collect::<Vec<_>>().join("\n"),
            "md" => prose(report, "# ", "## ", true),
            _ => prose(report, "", "", false),
        };
        let file = FileBytes { view: String::new(), bytes: text.into_bytes() };
        Ok((Out { files: Arc::new(Files(vec![file])) }, Notes::none()))
    }
}

/// Formats a cell with all digits. A number has the shortest form that parses to the same value.
fn exact(cell: &Cell) -> String {
    match cell {
        Cell::Text(text) => text.clone(),
        Cell::Count(n) => n.to_string(),
        Cell::Number(x) => format!("{x:?}"),
        Cell::Missing => String::new(),
    }
}

/// Formats a cell for people to read. A number has about five digits.
fn short(cell: &Cell) -> String {
    match cell {
        Cell::Number(x) if *x == 0.0 => "0".to_owned(),
        Cell::Number(x) if (0.001..100_000.0).contains(&x.abs()) => {
            let whole = x.abs() as u64;
            let digits = if whole == 0 { 0 } else { whole.to_string().len() };
            format!("{x:.*}", 5_usize.saturating_sub(digits).min(5))
        }
        Cell::Number(x) => format!("{x:.4e}"),
        Cell::Missing => "not computed".to_owned(),
        other => exact(other),
    }
}

/// Formats one table as described in RFC 4180, with its name in the first column so that several tables can
/// share a file.
fn csv(table: &Table) -> String {
    let quoted = |text: &str| {
        if text.contains([',', '"', '\n', '\r']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_owned()
        }
    };
    let line = |first: &str, cells: Vec<String>| {
        let cells: Vec<String> = std::iter::once(first.to_owned()).chain(cells).map(|c| quoted(&c)).collect();
        cells.join(",") + "\r\n"
    };
    let mut out = line("table", table.columns.clone());
    for row in &table.rows {
        out += &line(&table.name, row.iter().map(exact).collect());
    }
    out
}

fn prose(report: &Report, title: &str, heading: &str, markdown: bool) -> String {
    let mut out = format!("{title}{}\n", report.title);
    for table in &report.tables {
        let cell = |text: String| if markdown { text.replace('|', "\\|").replace('\n', " ") } else { text };
        let mut rows = vec![table.columns.iter().cloned().map(cell).collect::<Vec<_>>()];
        rows.extend(table.rows.iter().map(|row| row.iter().map(short).map(cell).collect()));
        let widths: Vec<usize> = (0..table.columns.len())
            .map(|c| {
                rows.iter().filter_map(|row| row.get(c)).map(|text| text.chars().count()).max().unwrap_or(0)
            })
            .collect();
        let _ = write!(out, "\n{heading}{}\n\n", table.name);
        for (index, row) in rows.iter().enumerate() {
            let padded: Vec<String> = row
                .iter()
                .zip(&widths)
                .enumerate()
                .map(|(c, (text, width))| {
                    let right = index > 0 && !matches!(table.rows[index - 1].get(c), Some(Cell::Text(_)));
                    if right { format!("{text:>width$}") } else { format!("{text:<width$}") }
                })
                .collect();
            let line = if markdown { format!("| {} |", padded.join(" | ")) } else { padded.join("  ") };
            out.push_str(line.trim_end());
            out.push('\n');
            if index == 0 && markdown {
                let rule: Vec<String> = widths.iter().map(|width| "-".repeat((*width).max(3))).collect();
                let _ = writeln!(out, "| {} |", rule.join(" | "));
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use testing::context;

    fn write(path: &str) -> String {
        let p = WriteReport { path: OutputFile(path.into()) };
        WriteReport::check(&p).expect("a known ending");
        let table = Table {
            name: "emitters".into(),
            columns: vec!["name".into(), "solid angle (sr)".into(), "pixels".into()],
            rows: vec![
                vec![Cell::Text("sun, \"low\"".into()), Cell::Number(1.0 / 3.0), Cell::Count(12)],
                vec![Cell::Text("a|b".into()), Cell::Number(6.7e-5), Cell::Missing],
            ],
        };
        let report = Arc::new(Report { title: "Light".into(), tables: vec![table] });
        let (out, _) = WriteReport::run(&p, In { report }, &context()).expect("runs");
        String::from_utf8(out.files.0[0].bytes.clone()).expect("text")
    }

    #[test]
    fn a_report_is_one_file() {
        let p = WriteReport { path: OutputFile("light_{view}.md".into()) };
        assert!(WriteReport::check(&p).expect_err("no views").to_string().contains("single file"));
    }

    #[test]
    fn json_holds_every_digit_and_null_for_what_is_missing() {
        let json: serde_json::Value = serde_json::from_str(&write("a.json")).expect("JSON");
        assert_eq!(json["tables"][0]["rows"][0][1], 1.0 / 3.0);
        assert!(json["tables"][0]["rows"][1][2].is_null());
    }

    #[test]
    fn csv_quotes_and_tables_align() {
        let csv = write("a.csv");
        assert_eq!(csv.lines().nth(1), Some("emitters,\"sun, \"\"low\"\"\",0.3333333333333333,12"));
        assert_eq!(csv.lines().nth(2), Some("emitters,a|b,6.7e-5,"));
        let md = write("a.md");
        assert!(md.starts_with("# Light\n\n## emitters\n\n| name "), "{md}");
        assert!(md.contains("| a\\|b ") && md.contains("6.7000e-5") && md.contains("not computed"));
        let widths: Vec<usize> = md.lines().skip(4).map(|l| l.chars().count()).collect();
        assert!(widths.windows(2).all(|w| w[0] == w[1]), "{md}");
        assert!(write("a.txt").contains("0.33333"));
    }

    #[test]
    fn unknown_endings_are_refused() {
        assert!(WriteReport::check(&WriteReport { path: OutputFile("a.pdf".into()) }).is_err());
    }
}

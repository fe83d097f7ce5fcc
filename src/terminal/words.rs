//! Formatting of numbers, times and tables.

use engine::{Counts, Forecast, Totals};

/// Formats a forecast: `5 of 14 nodes may run, about 8.0 s`. The time of a node whose kind has never run is
/// unknown, not 0.
pub fn forecast_text(forecast: &Forecast) -> String {
    let Forecast { open, wanted, seconds, untimed } = forecast;
    let mut text = format!("{open} of {wanted} nodes may run");
    let known = (*seconds >= 0.05).then(|| format!("about {}", seconds_text(*seconds)));
    match (*untimed, known) {
        (0, None) => {}
        (0, Some(known)) => text.push_str(&format!(", {known}")),
        (n, None) => text.push_str(&format!(", time unknown (nodes whose kind has never run: {n})")),
        (n, Some(known)) => {
            text.push_str(&format!(
                ", {known} plus the time of nodes whose kind has never run (number of these nodes: {n})"
            ));
        }
    }
    text
}

/// Formats seconds with a unit.
pub fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if s < 0.0995 => format!("{:.1} ms", s * 1000.0),
        s if s < 99.5 => format!("{s:.2} s"),
        s => format!("{:.0} min {:02.0} s", (s / 60.0).floor(), s % 60.0),
    }
}

/// Formats counts, such as `   rays 1.2 M, ..`. Returns an empty string if there are no counts.
pub fn counts_text(counts: &Counts) -> String {
    let texts: Vec<String> = counts.iter().map(|(name, n)| format!("{name} {}", number_text(*n))).collect();
    if texts.is_empty() { String::new() } else { format!("   {}", texts.join(", ")) }
}

fn number_text(n: u64) -> String {
    match n {
        0..=9_999 => n.to_string(),
        10_000..=9_999_999 => format!("{:.1} k", n as f64 / 1e3),
        10_000_000..=9_999_999_999 => format!("{:.1} M", n as f64 / 1e6),
        _ => format!("{:.1} G", n as f64 / 1e9),
    }
}

/// Formats totals: `3 ran, 9 cached in 2.1 s`.
pub fn totals_text(totals: &Totals) -> String {
    let mut parts = vec![format!("{} ran", totals.ran), format!("{} cached", totals.cached)];
    for (n, word) in [
        (totals.remade, "of these recomputed"),
        (totals.failed, "failed"),
        (totals.skipped, "skipped"),
        (totals.degraded, "degraded"),
    ] {
        if n > 0 {
            parts.push(format!("{n} {word}"));
        }
    }
    if totals.stopped {
        parts.push("interrupted; finished results are kept".to_owned());
    }
    format!("{} in {}", parts.join(", "), seconds_text(totals.seconds))
}

/// Lays out rows of cells as lines, each column as wide as its widest cell.
pub fn columns(rows: &[Vec<String>]) -> String {
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &Vec<String>, at: usize| row.get(at).map_or(0, |text| text.chars().count());
    let widths: Vec<usize> =
        (0..count).map(|at| rows.iter().map(|row| cell(row, at)).max().unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths).map(|(text, width)| format!("{text:<width$}"));
        format!("{}\n", cells.collect::<Vec<_>>().join("  ").trim_end())
    };
    rows.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_never_ran_has_no_forecast() {
        let text = |open, seconds, untimed| forecast_text(&Forecast { open, wanted: 9, seconds, untimed });
        assert_eq!(text(0, 0.0, 0), "0 of 9 nodes may run");
        assert_eq!(text(5, 8.0, 0), "5 of 9 nodes may run, about 8.00 s");
        assert_eq!(text(5, 0.0, 5), "5 of 9 nodes may run, time unknown (nodes whose kind has never run: 5)");
        let some = text(5, 0.43, 2);
        assert_eq!(
            some,
            "5 of 9 nodes may run, about 0.43 s plus the time of nodes whose kind has never run (number of these nodes: 2)"
        );
    }
}

//! Metrics: measures of error, selected by name.

use serde_json::{Value, json};

use crate::error::Error;
use crate::off::Off;
use crate::plot;

/// A measure of error in a region of the picture. A smaller value is better.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// Name as the user wrote it, such as `touched.flip`.
    pub name: String,
    region: &'static str,
    of: Of,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Of {
    /// A column of the report of `compare`.
    Column(&'static str),
    /// Root mean square error of display values.
    Rmse,
    /// Like `Rmse`, but shown as PSNR in decibels.
    Psnr,
}

/// The regions of a picture for which errors are measured.
const REGIONS: [&str; 4] = ["whole", "touched", "object", "shadow"];

/// Description of the prefixes that select a region, for error messages.
const IN_FRONT: &str = "optionally with the prefix `touched.` for the pixels that the object changes, `object.` for the pixels that it covers, or `shadow.` for the pixels that it changes but does not cover";

/// The name of each metric, and how it is computed.
const METRICS: [(&str, Of); 7] = [
    // For a picture in linear light, this is the column of HDR-FLIP.
    ("flip", Of::Column("flip mean")),
    ("flip95", Of::Column("flip p95")),
    ("rmse", Of::Rmse),
    ("psnr", Of::Psnr),
    ("ciede2000", Of::Column("ciede2000 mean")),
    ("mae", Of::Column("mean absolute error")),
    ("relmse", Of::Column("relative mse (linear, eps 0.01)")),
];

impl Metric {
    /// The metric with a name such as `flip` or `touched.rmse`. The prefix `whole.` may be omitted.
    pub fn of(name: &str) -> Option<Self> {
        let (region, metric) = name.split_once('.').unwrap_or(("whole", name));
        let region = REGIONS.into_iter().find(|known| *known == region)?;
        let (_, of) = METRICS.iter().find(|(known, _)| *known == metric)?;
        Some(Self { name: name.to_owned(), region, of: *of })
    }

    /// Like [`of`](Self::of()), but returns an error that lists the known metrics if the name is unknown.
    pub fn named(name: &str) -> Result<Self, Error> {
        let unknown = || Error::Metric { text: name.to_owned(), known: Self::known(), regions: IN_FRONT };
        Self::of(name).ok_or_else(unknown)
    }

    /// Like [`bound`](Self::bound), but returns an error that explains the syntax if the bound is invalid.
    pub fn bounded(text: &str) -> Result<(Self, f64), Error> {
        let wrong = || Error::Bound { text: text.to_owned(), known: Self::known(), regions: IN_FRONT };
        Self::bound(text).ok_or_else(wrong)
    }

    /// Parses a bound such as `flip=0.02`. A bound on PSNR, given in dB, is converted to a bound on the root mean
    /// square error.
    pub fn bound(text: &str) -> Option<(Self, f64)> {
        let (name, value) = text.split_once('=')?;
        let metric = Self::of(name.trim())?;
        let value: f64 = value.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0)?;
        let bound = if metric.of == Of::Psnr { scene::math::num::pow(10.0, -value / 20.0) } else { value };
        Some((metric, bound))
    }

    /// Formats an error. PSNR is formatted in dB, where a larger value is better. `None` becomes "not computed".
    pub fn shown(&self, error: Option<f64>) -> String {
        match error {
            None => "not computed".to_owned(),
            Some(error) if self.of == Of::Psnr => format!("{} dB", plot::tick_text(decibels(error))),
            Some(error) => plot::tick_text(error),
        }
    }

    /// The error as a JSON value. PSNR is in dB.
    pub fn value(&self, error: f64) -> Value {
        number(if self.of == Of::Psnr { decibels(error) } else { error })
    }

    /// Id of the note in which `compare` reports that the metric cannot be computed for a colour picture; `None` if
    /// the metric can be computed for every colour picture.
    pub fn missing_note(&self) -> Option<&'static str> {
        match self.of {
            Of::Column("flip mean" | "flip p95") => Some("no-flip"),
            Of::Column("ciede2000 mean") => Some("no-ciede2000"),
            _ => None,
        }
    }

    /// Requirement of the metric, in words, for error messages.
    pub fn needs(&self) -> &'static str {
        match (self.region, self.of) {
            ("touched" | "object" | "shadow", _) => {
                "a `composite` with a background, and an object that is visible in at least one view"
            }
            (_, Of::Rmse | Of::Psnr) => "pictures whose values are finite",
            _ => "pictures of colours, not of data",
        }
    }

    /// The names of all metrics, for error messages.
    pub fn known() -> String {
        METRICS.map(|(name, _)| name).join(", ")
    }

    /// The largest error over all outputs and views in which the region is visible. `None` if the region is visible
    /// nowhere, or if one of these errors was not computed.
    pub fn error(&self, off: &[Off]) -> Option<f64> {
        self.worst(off, "image")
    }

    /// Like [`error`](Self::error), but only for errors whose [`Off::judged`] is `judged`, for example the name of
    /// a baseline.
    pub fn worst(&self, off: &[Off], judged: &str) -> Option<f64> {
        let rows =
            off.iter().filter(|row| row.region == self.region && row.judged == judged && row.pixels > 0);
        let value = |row: &Off| match self.of {
            Of::Column(column) => row.value(column),
            Of::Rmse | Of::Psnr => row.value("psnr (dB)").map(|db| scene::math::num::pow(10.0, -db / 20.0)),
        };
        let counting =
            rows.map(|row| (row.counts, value(row))).filter(|(counts, value)| *counts || value.is_some());
        counting.map(|(_, value)| value).reduce(|a, b| Some(a?.max(b?))).flatten()
    }
}

/// PSNR in dB for a root mean square error of values with a maximum of 1.
fn decibels(rmse: f64) -> f64 {
    // The subtraction from 0 avoids -0 dB for an error of 1.
    if rmse > 0.0 { 0.0 - 20.0 * scene::math::num::f64::log10(rmse) } else { f64::INFINITY }
}

/// A number as a JSON value. Infinity, which JSON cannot represent, becomes text.
pub fn number(value: f64) -> Value {
    if value.is_finite() { json!(value) } else { json!(value.to_string()) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_read_and_the_worst_view_counts() {
        let (metric, bound) = Metric::bound("touched.psnr = 40").unwrap();
        assert!((bound - 0.01).abs() < 1e-15 && metric.region == "touched");
        for wrong in ["flip", "flip=-1", "flip=x", "sky.flip=1", "flop=1", "flip=NaN"] {
            assert_eq!(Metric::bound(wrong), None, "{wrong}");
        }
        let row = |region: &str, psnr: f64| Off {
            output: "final".to_owned(),
            view: "a".to_owned(),
            region: region.to_owned(),
            judged: "image".to_owned(),
            pixels: 1,
            values: [("psnr (dB)".to_owned(), psnr)].into(),
            counts: true,
        };
        // In one view the object is not visible, so nothing can be computed there.
        let unseen = Off { pixels: 0, values: [].into(), ..row("touched", 0.0) };
        assert_eq!(metric.error(std::slice::from_ref(&unseen)), None);
        let off = [row("touched", 20.0), row("touched", 40.0), row("whole", 10.0), unseen];
        assert!((metric.error(&off).unwrap() - 0.1).abs() < 1e-15);
        assert_eq!(metric.error(&[row("touched", f64::INFINITY)]), Some(0.0));
        let reported = [Some(0.1), Some(0.0), Some(1.0), None].map(|error| metric.shown(error));
        assert_eq!(reported, ["20 dB", "inf dB", "0 dB", "not computed"]);
        assert!(
            (metric.value(0.1).as_f64().unwrap() - 20.0).abs() < 1e-9 && metric.value(0.0) == json!("inf")
        );
        assert_eq!(Metric::of("rmse").unwrap().shown(Some(0.1)), "0.1");
        assert_eq!(Metric::of("flip").unwrap().error(&off), None, "not computed is not 0");
    }
}

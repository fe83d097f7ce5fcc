//! Means over scenes with their intervals.

use crate::bootstrap::{Interval, interval};
use crate::scores::{Metric, Row};
use crate::set::Set;
use crate::tier::Tier;

/// Mean of a metric over the scenes of a set.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The tier.
    pub tier: Tier,
    /// Name of the region.
    pub region: String,
    /// Name of the method or the baseline.
    pub picture: String,
    /// The metric.
    pub metric: Metric,
    /// Mean and interval.
    pub interval: Interval,
    /// Number of cases.
    pub cases: usize,
}

/// The distinct values of `of` in the order of their first row.
fn distinct<'r, T: PartialEq + 'r>(rows: &'r [Row], of: impl Fn(&'r Row) -> T) -> Vec<T> {
    let mut found = Vec::new();
    for row in rows {
        let value = of(row);
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

/// Order of the regions in the tables.
const REGIONS: [&str; 5] = ["object", "shadow", "reflection", "rest", "whole"];

/// Means over scenes, for the cases for which `kept` is true. The views of a case are averaged, then the cases of a
/// scene, then the scenes, so that every scene has the same weight. Views in which a region is empty are left out.
pub fn summarise(rows: &[Row], set: &Set, kept: impl Fn(usize) -> bool) -> Vec<Entry> {
    let mut entries = Vec::new();
    let pictures = distinct(rows, |row| row.picture.as_str());
    for tier in distinct(rows, |row| row.tier) {
        for region in REGIONS {
            for &picture in &pictures {
                let of = |row: &&Row| {
                    row.tier == tier && row.region == region && row.picture == picture && kept(row.case)
                };
                let rows: Vec<&Row> = rows.iter().filter(of).collect();
                for (at, metric) in Metric::ALL.into_iter().enumerate() {
                    let cases = means(rows.iter().filter_map(|row| Some((row.case, row.values[at]?))));
                    let scenes = means(cases.iter().map(|&(case, value)| (&set.cases[case].scene, value)));
                    let values: Vec<f64> = scenes.into_iter().map(|(_, value)| value).collect();
                    let Some(interval) = interval(&values, set.seed) else { continue };
                    let (region, picture, cases) = (region.to_owned(), picture.to_owned(), cases.len());
                    entries.push(Entry { tier, region, picture, metric, interval, cases });
                }
            }
        }
    }
    entries
}

/// The mean of the values of each key, in the order in which the keys first appear.
fn means<K: PartialEq>(values: impl Iterator<Item = (K, f64)>) -> Vec<(K, f64)> {
    let mut sums: Vec<(K, f64, f64)> = Vec::new();
    for (key, value) in values {
        match sums.iter_mut().find(|(known, ..)| *known == key) {
            Some((_, sum, count)) => {
                *sum += value;
                *count += 1.0;
            }
            None => sums.push((key, value, 1.0)),
        }
    }
    sums.into_iter().map(|(key, sum, count)| (key, sum / count)).collect()
}

/// The entry of a picture.
pub fn find<'e>(
    entries: &'e [Entry],
    tier: Tier,
    region: &str,
    picture: &str,
    metric: Metric,
) -> Option<&'e Entry> {
    entries.iter().find(|entry| {
        entry.tier == tier && entry.region == region && entry.picture == picture && entry.metric == metric
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    // This test fails if cases or views are averaged without regard to their scene.
    #[test]
    fn every_scene_has_the_same_weight() {
        let nested = [("a", 1.0), ("a", 3.0), ("b", 10.0)];
        assert_eq!(means(nested.into_iter()), [("a", 2.0), ("b", 10.0)]);
    }
}

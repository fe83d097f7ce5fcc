//! The report of `fit-lights`, and its decisions as notes.

use engine::Notes;
use render::light::emitters::Emitters;
use render::light::measure::{angles_deg, luminance};
use scene::math::num;
use scene::types::{Cell, Environment, Report, Table};

use super::sources::Kind;
use super::strengths::{Fitted, Strengths, Verdict as Outcome};
use super::sun::{RIVAL_DEG, Sun, Verdict};

/// True for emitters that were compared with the place, and for those that its mesh lacks.
fn was_tried(one: &Fitted) -> bool {
    one.error_stops.is_some() || matches!(one.verdict, Outcome::Misplaced | Outcome::Mismatched)
}

/// Notes that say which emitters were fitted.
pub(super) fn decide(strengths: &Strengths, notes: &mut Notes) {
    let count = |verdict: Outcome| strengths.emitters.iter().filter(|one| one.verdict == verdict).count();
    let fitted = count(Outcome::Fitted);
    if strengths.accepted {
        let text = match count(Outcome::Uninformed) {
            0 => String::new(),
            n => format!("; of {n} more, the shading does not show the strength"),
        };
        notes.decision(
            "emitters",
            format!("the shading of the place corrected the light of some emitters (count: {fitted}){text}"),
        );
    } else if let Some(one) = strengths.emitters.iter().find(|one| was_tried(one)) {
        notes.decision(
            "emitters-kept",
            format!("the emitters keep their predicted light: {}", one.verdict.text()),
        );
    }
}

/// The report: the sun, and the emitters.
pub(super) fn report(
    env: &Environment,
    emitters: &Emitters,
    sun: Option<&Sun>,
    verdict: Verdict,
    strengths: &Strengths,
) -> Report {
    let tables = vec![suns(env, sun, verdict), table(env, emitters, strengths), fit(strengths)];
    Report { title: "Lights fitted to the shading of the place".to_owned(), tables }
}

fn suns(env: &Environment, sun: Option<&Sun>, verdict: Verdict) -> Table {
    let rows = sun.map(|sun| {
        let (azimuth, elevation) = angles_deg(env.up, sun.direction);
        let [red, green, blue] = sun.irradiance;
        let numbers = [azimuth, elevation, red, green, blue, sun.error_stops, sun.glow, sun.gain, sun.rival]
            .map(Cell::Number);
        numbers.into_iter().chain([Cell::Text(verdict.reason().to_owned())]).collect()
    });
    let rival = format!("best gain of a direction more than {RIVAL_DEG} degrees from this one");
    let columns = [
        "azimuth (deg, clockwise from forward)",
        "elevation (deg)",
        "irradiance (red)",
        "irradiance (green)",
        "irradiance (blue)",
        "standard error of the irradiance (stops)",
        "radiance of clipped surfaces and sky, relative to their displayed value",
        "gain",
        rival.as_str(),
        "verdict",
    ];
    Table::new("sun", columns, rows.into_iter().collect())
}

fn table(env: &Environment, emitters: &Emitters, strengths: &Strengths) -> Table {
    let fluxes: Vec<[[f64; 3]; 2]> = strengths
        .emitters
        .iter()
        .map(|one| {
            [one.source.hidden, one.flux].map(|hidden| [0, 1, 2].map(|c| hidden[c] + one.source.shown[c]))
        })
        .collect();
    let before = luminance(emitters.total);
    let change: f64 = fluxes.iter().map(|[before, after]| luminance(*after) - luminance(*before)).sum();
    let rows = strengths.emitters.iter().zip(&fluxes).map(|(one, [old, new])| {
        let (azimuth, elevation) = angles_deg(env.up, emitters.list[one.emitter].direction);
        let place = match one.source.kind {
            Kind::Surface => "flat surface",
            Kind::Body => "body",
            Kind::Opening => "opening",
            Kind::Distant => "distant",
        };
        let distance = Some(one.source.distance).filter(|distance| distance.is_finite());
        let stops = num::f64::log2(luminance(*new) / luminance(*old));
        let numbers = [
            Some(luminance(*old) / before),
            Some(luminance(*new) / (before + change)),
            Some(stops),
            one.error_stops.map(|[after, _]| after),
            one.error_stops.map(|[_, before]| before),
            Some(old[0]),
            Some(old[1]),
            Some(old[2]),
            Some(new[0]),
            Some(new[1]),
            Some(new[2]),
        ];
        let number =
            |value: Option<f64>| value.filter(|value| value.is_finite()).map_or(Cell::Missing, Cell::Number);
        let mut row = vec![number(Some(azimuth)), number(Some(elevation)), Cell::Text(place.to_owned())];
        row.push(number(distance));
        row.extend(numbers.map(number));
        row.push(Cell::Text(one.verdict.text().to_owned()));
        row
    });
    let columns = [
        "azimuth (deg, clockwise from forward)",
        "elevation (deg)",
        "place",
        "distance (world units)",
        "share of all light as predicted",
        "share of all light",
        "strength, log2(fitted / predicted)",
        "standard error of the hidden light (stops)",
        "the same as predicted (stops)",
        "predicted flux (red)",
        "predicted flux (green)",
        "predicted flux (blue)",
        "flux (red)",
        "flux (green)",
        "flux (blue)",
        "verdict",
    ];
    Table::new("emitters", columns, rows.collect())
}

fn fit(strengths: &Strengths) -> Table {
    let [before, after] = strengths.explained.map_or([Cell::Missing, Cell::Missing], |e| e.map(Cell::Number));
    let [red, green, blue] = strengths.known.map(Cell::Number);
    let columns = [
        "share of the differences of colour that the prediction explains",
        "share that the estimate explains",
        "factor of the light of visible surfaces (red)",
        "factor (green)",
        "factor (blue)",
        "difference between the colours of the mesh and of the panorama, relative to their spread",
    ];
    let mismatch = strengths.mismatch.map_or(Cell::Missing, Cell::Number);
    Table::new("fit", columns, vec![vec![before, after, red, green, blue, mismatch]])
}

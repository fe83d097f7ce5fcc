//! The lights that fusion recovered, and the energy before and after.

use engine::{Notes, Up};
use glam::DVec3;

use super::{Fused, Gain};
use crate::color::luminance;
use crate::equirect::{axes, direction, pixel_solid_angle};
use crate::light::linear::LinearPixels;
use crate::light::{measure, regions};
use crate::num;
use crate::types::{Cell, Image, Linear, Report, Table};

/// Lights listed one by one; the rest are summed in a last row.
const LISTED: usize = 32;
/// The ramp may be made up for by at most this factor within a light.
const LARGEST_COMPENSATION: f64 = 8.0;

/// Connected regions of pixels that fusion made brighter.
pub(super) struct Lights {
    pub members: Vec<Vec<usize>>,
}

pub(super) fn luminance_of(pixels: &LinearPixels, at: usize) -> f64 {
    f64::from(luminance(pixels.rgb[at]))
}

impl Lights {
    pub(super) fn find(pixels: &LinearPixels, fused: &[Fused]) -> Self {
        let mask: Vec<bool> =
            fused.iter().enumerate().map(|(at, f)| f.luminance > luminance_of(pixels, at)).collect();
        let labels = regions::label(&mask, pixels.width);
        let mut members = vec![Vec::new(); labels.count];
        for (at, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(at);
            }
        }
        Self { members }
    }

    /// The ramp holds back part of what was predicted for pixels that are barely clipped; gives it back to
    /// the clipped pixels of the same light, so that each light has the predicted flux.
    pub(super) fn keep_flux(
        &self,
        pixels: &LinearPixels,
        log2_gain: &[f32],
        fused: &mut [Fused],
        notes: &mut Notes,
    ) {
        let mut short = 0;
        for members in &self.members {
            let (mut wanted, mut got) = (0.0, 0.0);
            for &at in members {
                let own = luminance_of(pixels, at);
                let held = f64::from(luminance(pixels.rgb[at].map(|v| v.min(1.0))));
                let predicted = held * num::f64::exp2(f64::from(log2_gain[at]));
                let size = pixel_solid_angle(pixels.width, pixels.height, at / pixels.width);
                wanted += size * (predicted - own).max(0.0);
                got += size * (fused[at].luminance - own);
            }
            let scale = if got > 0.0 { (wanted / got).max(1.0) } else { 1.0 };
            short += u64::from(scale > LARGEST_COMPENSATION);
            let scale = scale.min(LARGEST_COMPENSATION);
            for &at in members {
                let own = luminance_of(pixels, at);
                fused[at].luminance = own + scale * (fused[at].luminance - own);
            }
        }
        if short > 0 {
            let text = format!(
                "{short} lights are barely clipped and get less than was predicted; a lower `threshold` gives all"
            );
            notes.warning("flux-held-back", text);
        }
    }

    /// The tables of lights and of energy.
    pub(super) fn report(
        &self,
        up: Up,
        pixels: &LinearPixels,
        image: &Image<Linear>,
        fused: &[Fused],
        evs: &[f64],
        gain: Gain,
    ) -> Report {
        let sources = match gain {
            Gain::Direct => vec!["from the gain map".to_owned()],
            Gain::Brackets => evs.iter().map(|ev| format!("from EV {ev}")).collect(),
        };
        let mut columns: Vec<String> = [
            "azimuth (deg, clockwise from forward)",
            "elevation (deg)",
            "solid angle (sr)",
            "irradiance before (facing it)",
            "irradiance after (facing it)",
            "peak luminance",
            "share from EV 0",
        ]
        .map(String::from)
        .to_vec();
        columns.extend(sources.iter().map(|s| format!("share {s}")));
        columns.push("share that is a lower bound".to_owned());
        let mut lights: Vec<Light> =
            self.members.iter().map(|m| Light::of(m, up, pixels, fused, sources.len())).collect();
        // Brightest first; equal ones stay in the order of their first pixel.
        lights.sort_by(|a, b| b.after.total_cmp(&a.after));
        let rows = lights.iter().take(LISTED).map(|light| light.row(up)).collect();
        let emitters = Table { name: "emitters".to_owned(), columns, rows };
        let unlisted = lights.get(LISTED..).unwrap_or_default();
        let ledger = ledger(up, pixels, image, lights.len(), unlisted);
        Report { title: "Recovered light".to_owned(), tables: vec![emitters, ledger] }
    }
}

struct Light {
    direction: DVec3,
    solid_angle: f64,
    before: f64,
    after: f64,
    peak: f64,
    /// Flux by source, the base last; then that of lower bounds.
    by_source: Vec<f64>,
    bound: f64,
    flux: f64,
}

impl Light {
    fn of(members: &[usize], up: Up, pixels: &LinearPixels, fused: &[Fused], sources: usize) -> Self {
        let (w, h) = (pixels.width, pixels.height);
        let toward =
            |at: usize| direction(up, ((at % w) as f64 + 0.5) / w as f64, ((at / w) as f64 + 0.5) / h as f64);
        let size = |at: usize| pixel_solid_angle(w, h, at / w);
        let sum =
            members.iter().fold(DVec3::ZERO, |s, &at| s + toward(at) * (size(at) * fused[at].luminance));
        let centre = sum.try_normalize().unwrap_or(axes(up)[2]);
        let mut light = Light {
            direction: centre,
            solid_angle: 0.0,
            before: 0.0,
            after: 0.0,
            peak: 0.0,
            by_source: vec![0.0; sources + 1],
            bound: 0.0,
            flux: 0.0,
        };
        for &at in members {
            let (own, new, size) = (luminance_of(pixels, at), fused[at].luminance, size(at));
            let facing = toward(at).dot(centre).max(0.0) * size;
            light.solid_angle += size;
            light.before += own * facing;
            light.after += new * facing;
            light.peak = light.peak.max(new);
            light.flux += new * size;
            light.by_source[sources] += own * size;
            light.by_source[fused[at].source.min(sources - 1)] += (new - own) * size;
            light.bound += if fused[at].saturated { new * size } else { 0.0 };
        }
        light
    }

    fn row(&self, up: Up) -> Vec<Cell> {
        let (azimuth, elevation) = measure::angles_deg(up, self.direction);
        let share = |part: f64| if self.flux > 0.0 { part / self.flux } else { 0.0 };
        let (base, predicted) = self.by_source.split_last().map_or((0.0, &[][..]), |(b, p)| (*b, p));
        let mut row =
            vec![azimuth, elevation, self.solid_angle, self.before, self.after, self.peak, share(base)];
        row.extend(predicted.iter().map(|p| share(*p)));
        row.push(share(self.bound));
        row.into_iter().map(Cell::Number).collect()
    }
}

/// Total power and irradiance of the ground, before and after.
fn ledger(up: Up, pixels: &LinearPixels, image: &Image<Linear>, lights: usize, unlisted: &[Light]) -> Table {
    let (w, h) = (pixels.width, pixels.height);
    let above = axes(up)[2];
    let sums = |value: &dyn Fn(usize) -> f64| {
        let (mut power, mut ground, mut peak) = (0.0, 0.0, 0.0_f64);
        for y in 0..h {
            let size = pixel_solid_angle(w, h, y);
            let facing = direction(up, 0.5, (y as f64 + 0.5) / h as f64).dot(above).max(0.0) * size;
            for at in y * w..(y + 1) * w {
                let luminance = value(at);
                power += luminance * size;
                ground += luminance * facing;
                peak = peak.max(luminance);
            }
        }
        [power, ground, peak]
    };
    let row = |name: &str, sums: [f64; 3], count: Cell| {
        let mut row = vec![Cell::Text(name.to_owned())];
        row.extend(sums.map(Cell::Number));
        row.push(count);
        row
    };
    let before = sums(&|at| luminance_of(pixels, at));
    let after = sums(&|at| f64::from(luminance(image.rgb(at % w, at / w))));
    let rest: f64 = unlisted.iter().map(|light| light.flux).sum();
    let columns = ["", "power (sr)", "irradiance of the ground", "peak luminance", "lights"];
    Table {
        name: "energy".to_owned(),
        columns: columns.map(String::from).to_vec(),
        rows: vec![
            row("panorama", before, Cell::Missing),
            row("environment", after, Cell::Count(lights as u64)),
            vec![
                Cell::Text("of it, lights not listed".to_owned()),
                Cell::Number(rest),
                Cell::Missing,
                Cell::Missing,
                Cell::Count(unlisted.len() as u64),
            ],
        ],
    }
}

//! The report of fusion: the recovered lights, and the energy before and after.

use engine::{Notes, Up};
use glam::DVec3;
use render::light::energy::Energy;
use render::light::linear::{LinearPixels, max3};
use render::light::{measure, regions};
use scene::math::color::luminance;
use scene::math::equirect::{axes, direction, pixel_solid_angle};
use scene::math::num;
use scene::types::{Cell, Report, Table};

use super::fused::Fused;
use super::gain::Gain;

/// Number of lights that are listed individually. All other lights are summed in the last row.
pub(super) const LISTED: usize = 32;
/// Maximum share of the predicted light that may be left out, and of all light that may be removed, without a
/// warning.
const UNUSED: f64 = 0.01;
/// Largest factor by which a light is scaled to compensate for the gradual transition of `Blend::Ramp`.
const LARGEST_COMPENSATION: f64 = 8.0;

/// Connected regions of pixels that fusion made brighter, with their light after each step of the fusion.
pub(super) struct Lights {
    pub members: Vec<Vec<usize>>,
    /// Pixels that fusion made darker, which do not count as lights.
    darker: Vec<usize>,
    /// Pixels that fusion left unchanged although light was predicted for them.
    left: Vec<usize>,
    /// Name of each step, and the luminance of pixels after it: one list for each light, then one list for the
    /// pixels made darker, and one for the pixels left unchanged.
    steps: Vec<(&'static str, Vec<Vec<f64>>)>,
    /// Index of the first step with an added sky, and the pixels of the sky with their luminance. `None` if no sky
    /// was added.
    sky: Option<(usize, Vec<(usize, f64)>)>,
}

pub(super) fn luminance_of(pixels: &LinearPixels, at: usize) -> f64 {
    f64::from(luminance(pixels.rgb[at]))
}

impl Lights {
    /// Finds the lights of a fused panorama. `predicted` returns the luminance of a pixel according to the gain
    /// map.
    pub(super) fn find(pixels: &LinearPixels, fused: &[Fused], predicted: impl Fn(usize) -> f64) -> Self {
        let mask: Vec<bool> =
            fused.iter().enumerate().map(|(at, f)| f.luminance > luminance_of(pixels, at)).collect();
        let labels = regions::label(&mask, pixels.width);
        let mut members = vec![Vec::new(); labels.count];
        for (at, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(at);
            }
        }
        let own = |at: usize| luminance_of(pixels, at);
        let darker = (0..fused.len()).filter(|&at| fused[at].luminance < own(at)).collect();
        let kept = |&at: &usize| fused[at].luminance == own(at) && predicted(at) > own(at);
        let left = (0..fused.len()).filter(kept).collect();
        let mut lights = Self { members, darker, left, steps: Vec::new(), sky: None };
        lights.record("panorama", |at| luminance_of(pixels, at));
        lights
    }

    /// Records the luminance after a step.
    pub(super) fn record(&mut self, step: &'static str, luminance: impl Fn(usize) -> f64) {
        let of_light = |members: &Vec<usize>| members.iter().map(|&at| luminance(at)).collect();
        let values = self.groups().map(of_light).collect();
        self.steps.push((step, values));
    }

    /// Records an added sky, and the luminance of the lights after it.
    pub(super) fn record_sky(&mut self, pixels: Vec<(usize, f64)>, luminance: impl Fn(usize) -> f64) {
        self.sky = Some((self.steps.len(), pixels));
        self.record("sky", luminance);
    }

    /// Pixels of each light, then the two groups of pixels that are not lights.
    fn groups(&self) -> impl Iterator<Item = &Vec<usize>> {
        self.members.iter().chain([&self.darker, &self.left])
    }

    /// Warns if exposures darker than the panorama reduced its light.
    pub(super) fn report_darker(&self, pixels: &LinearPixels, fused: &[Fused], notes: &mut Notes) {
        let size = |at: usize| pixel_solid_angle(pixels.width, pixels.height, at / pixels.width);
        let own = |at: usize| luminance_of(pixels, at) * size(at);
        let lost: f64 = self.darker.iter().map(|&at| own(at) - fused[at].luminance * size(at)).sum();
        let all: f64 = (0..pixels.rgb.len()).map(own).sum();
        if lost > UNUSED * all {
            let text = format!(
                "the exposures are darker than the panorama at pixels above `threshold` (count: {}), which removes {:.1} % of the panorama's power; `blend: Ramp` removes no light",
                self.darker.len(),
                100.0 * lost / all
            );
            notes.warning("made-darker", text);
        }
    }

    /// Warns if light was predicted for pixels that do not count as clipped here.
    pub(super) fn report_unused(
        &self,
        threshold: f32,
        pixels: &LinearPixels,
        log2_gain: &[f32],
        notes: &mut Notes,
    ) {
        let mut used = vec![false; log2_gain.len()];
        self.members.iter().flatten().for_each(|&at| used[at] = true);
        let (mut all, mut unused, mut count) = (0.0, 0.0, 0_u64);
        for (at, gain) in log2_gain.iter().enumerate().filter(|(_, gain)| **gain > 0.0) {
            let size = pixel_solid_angle(pixels.width, pixels.height, at / pixels.width);
            let light = luminance_of(pixels, at) * (num::f64::exp2(f64::from(*gain)) - 1.0) * size;
            all += light;
            if !used[at] {
                (unused, count) = (unused + light, count + 1);
            }
        }
        if unused > UNUSED * all {
            let percent = 100.0 * unused / all;
            let clipped = |(rgb, gain): &(&[f32; 3], &f32)| max3(**rgb) > threshold && **gain == 0.0;
            let without = match pixels.rgb.iter().zip(log2_gain).filter(clipped).count() {
                0 => String::new(),
                _ if !pixels.ceiling => String::new(),
                n => format!(
                    "; no light was predicted for some clipped pixels (count: {n}); check that the prediction was made for `base`"
                ),
            };
            notes.warning(
                "prediction-unused",
                format!("{percent:.1} % of the predicted light belongs to pixels below `threshold` (count: {count}) and is left out; `threshold` should be below `white` of the prediction{without}"),
            );
        }
    }

    /// Restores the predicted flux of each light. The gradual transition of `Blend::Ramp` removes part of the
    /// prediction for barely clipped pixels. The removed flux is added to the clipped pixels of the same light.
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
                "lights that are barely clipped become less bright than predicted (count: {short}); a lower `threshold` gives them the predicted brightness"
            );
            notes.warning("flux-held-back", text);
        }
    }

    /// Number of lights that are summed in the last row of the report.
    pub(super) fn unlisted(&self) -> u64 {
        self.members.len().saturating_sub(LISTED) as u64
    }

    /// Builds the report. Its tables list the lights, the energy before and after fusion, and the energy and the
    /// light of each light after each step.
    pub(super) fn report(
        &self,
        up: Up,
        pixels: &LinearPixels,
        fused: &[Fused],
        evs: &[f64],
        gain: Gain,
    ) -> Report {
        let sources = match gain {
            Gain::Direct => vec!["the gain map".to_owned()],
            Gain::Brackets => evs.iter().map(|ev| format!("EV {ev}")).collect(),
        };
        let mut columns: Vec<String> = [
            "azimuth (deg, clockwise from forward)",
            "elevation (deg)",
            "solid angle (sr)",
            "irradiance on a plane facing the light, before fusion",
            "irradiance on a plane facing the light, after fusion",
            "peak luminance",
            "share of the power from EV 0",
        ]
        .map(String::from)
        .to_vec();
        columns.extend(sources.iter().map(|s| format!("share of the power from {s}")));
        columns.push("share of the power that is a lower bound".to_owned());
        let mut lights: Vec<Light> =
            (0..self.members.len()).map(|i| self.light(i, up, pixels, fused, sources.len())).collect();
        // Brightest first; lights of equal brightness in the order of their first pixel.
        lights.sort_by(|a, b| b.after().total_cmp(&a.after()));
        let rows = lights.iter().take(LISTED).map(|light| light.row(up)).collect();
        let emitters = Table::new("emitters", columns, rows);
        let whole: Vec<Energy> = (0..self.steps.len()).map(|step| self.energy(step, up, pixels)).collect();
        let unlisted = lights.get(LISTED..).unwrap_or_default();
        let energy = energy(&whole, lights.len(), unlisted);
        let steps = self.table(&whole, &lights);
        Report { title: "Recovered light".to_owned(), tables: vec![emitters, energy, steps] }
    }

    /// Total energy after a step. Pixels that belong to no group have the light of the panorama.
    fn energy(&self, step: usize, up: Up, pixels: &LinearPixels) -> Energy {
        let mut luminance: Vec<f64> = (0..pixels.rgb.len()).map(|at| luminance_of(pixels, at)).collect();
        for (members, values) in self.groups().zip(&self.steps[step].1) {
            members.iter().zip(values).for_each(|(&at, value)| luminance[at] = *value);
        }
        let sky = self.sky.iter().filter(|(first, _)| step >= *first).flat_map(|(_, sky)| sky);
        sky.for_each(|&(at, value)| luminance[at] = value);
        Energy::of(up, pixels.width, &luminance)
    }

    /// Table with one column per step. It has a row for the total, one for each listed light, and one for all other
    /// lights.
    fn table(&self, whole: &[Energy], lights: &[Light]) -> Table {
        let row = |name: String, values: Vec<f64>| {
            std::iter::once(Cell::Text(name)).chain(values.into_iter().map(Cell::Number)).collect()
        };
        let each = |name: &str, of: fn(&Energy) -> f64| row(name.to_owned(), whole.iter().map(of).collect());
        let mut rows: Vec<Vec<Cell>> = vec![
            each("power over the whole sphere (sr)", |energy| energy.power),
            each("irradiance on a plane that faces up", |energy| energy.ground),
            each("peak luminance", |energy| energy.peak),
        ];
        let listed = lights.iter().take(LISTED).enumerate();
        rows.extend(listed.map(|(i, light)| {
            row(format!("irradiance from light {} on a plane that faces it", i + 1), light.irradiance.clone())
        }));
        if let Some(rest) = lights.get(LISTED..).filter(|rest| !rest.is_empty()) {
            let power = |step: usize| rest.iter().map(|light| light.power[step]).sum();
            let name = "power of the lights that are not listed (sr)".to_owned();
            rows.push(row(name, (0..self.steps.len()).map(power).collect()));
        }
        let names = self.steps.iter().map(|(name, _)| (*name).to_owned());
        Table::new("steps", std::iter::once("quantity".to_owned()).chain(names), rows)
    }

    fn light(&self, i: usize, up: Up, pixels: &LinearPixels, fused: &[Fused], sources: usize) -> Light {
        let (w, h, members) = (pixels.width, pixels.height, &self.members[i]);
        let toward =
            |at: usize| direction(up, ((at % w) as f64 + 0.5) / w as f64, ((at / w) as f64 + 0.5) / h as f64);
        let size = |at: usize| pixel_solid_angle(w, h, at / w);
        let sum =
            members.iter().fold(DVec3::ZERO, |s, &at| s + toward(at) * (size(at) * fused[at].luminance));
        let centre = sum.try_normalize().unwrap_or(axes(up)[2]);
        let facing: Vec<f64> = members.iter().map(|&at| toward(at).dot(centre).max(0.0) * size(at)).collect();
        let sizes: Vec<f64> = members.iter().map(|&at| size(at)).collect();
        let weighed = |by: &[f64]| -> Vec<f64> {
            let sum = |values: &Vec<f64>| values.iter().zip(by).map(|(value, weight)| value * weight).sum();
            self.steps.iter().map(|(_, lights)| sum(&lights[i])).collect()
        };
        let mut light = Light {
            direction: centre,
            solid_angle: 0.0,
            irradiance: weighed(&facing),
            power: weighed(&sizes),
            peak: 0.0,
            by_source: vec![0.0; sources + 1],
            bound: 0.0,
        };
        for &at in members {
            let (own, new, size) = (luminance_of(pixels, at), fused[at].luminance, size(at));
            light.solid_angle += size;
            light.peak = light.peak.max(new);
            light.by_source[sources] += own * size;
            light.by_source[fused[at].source.min(sources - 1)] += (new - own) * size;
            light.bound += if fused[at].saturated { new * size } else { 0.0 };
        }
        light
    }
}

struct Light {
    direction: DVec3,
    solid_angle: f64,
    /// Irradiance on a plane that faces the light, after each step.
    irradiance: Vec<f64>,
    /// Luminance integrated over solid angle, after each step.
    power: Vec<f64>,
    peak: f64,
    /// Flux from each source. The last source is the base.
    by_source: Vec<f64>,
    /// Flux of pixels whose light is a lower bound.
    bound: f64,
}

impl Light {
    /// Irradiance on a plane that faces the light, before fusion.
    fn before(&self) -> f64 {
        self.irradiance.first().copied().unwrap_or(0.0)
    }

    fn after(&self) -> f64 {
        self.irradiance.last().copied().unwrap_or(0.0)
    }

    fn flux(&self) -> f64 {
        self.power.last().copied().unwrap_or(0.0)
    }

    fn row(&self, up: Up) -> Vec<Cell> {
        let (azimuth, elevation) = measure::angles_deg(up, self.direction);
        let flux = self.flux();
        let share = |part: f64| if flux > 0.0 { part / flux } else { 0.0 };
        let (base, predicted) = self.by_source.split_last().map_or((0.0, &[][..]), |(b, p)| (*b, p));
        let mut row =
            vec![azimuth, elevation, self.solid_angle, self.before(), self.after(), self.peak, share(base)];
        row.extend(predicted.iter().map(|p| share(*p)));
        row.push(share(self.bound));
        row.into_iter().map(Cell::Number).collect()
    }
}

/// Table of the total power and of the irradiance on the ground, before and after fusion.
fn energy(whole: &[Energy], lights: usize, unlisted: &[Light]) -> Table {
    let row = |name: &str, energy: Option<&Energy>, count: Cell| {
        let Energy { power, ground, peak } = energy.copied().unwrap_or_default();
        let mut row = vec![Cell::Text(name.to_owned())];
        row.extend([power, ground, peak].map(Cell::Number));
        row.push(count);
        row
    };
    let rest: f64 = unlisted.iter().map(Light::flux).sum();
    let rows = vec![
        row("panorama", whole.first(), Cell::Missing),
        row("environment", whole.last(), Cell::Count(lights as u64)),
        vec![
            Cell::Text("lights that are not listed".to_owned()),
            Cell::Number(rest),
            Cell::Missing,
            Cell::Missing,
            Cell::Count(unlisted.len() as u64),
        ],
    ];
    Table::new(
        "energy",
        ["item", "power (sr)", "irradiance on a plane that faces up", "peak luminance", "lights"],
        rows,
    )
}

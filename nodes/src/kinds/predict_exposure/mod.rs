//! `predict-exposure`: estimates the brightness of the clipped parts of a panorama.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, Former, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, Up,
};
use glam::DVec3;

use self::clipping::{Clipping, Prediction};
use self::grid::Grid;
use self::photographs::Photographs;
use self::spread::Given;

use crate::error::Error;
use crate::light::energy_table::EnergyTable;
use crate::light::linear::{LinearPixels, Transfer, linear_pixels, max3};
use crate::light::measure;
use crate::light::regions::{self, Regions};
use crate::math::color::{luminance, srgb_from_linear};
use crate::math::equirect::{axes, pixel_solid_angle};
use crate::math::num;
use crate::types::{
    Brackets, Cell, Data, Image, Images, NamedImage, Panorama, Picture, Report, Table, Taken,
};

mod ceiling;
mod clipping;
mod enlarged;
mod grid;
mod kontext;
#[cfg(feature = "learned")]
pub mod lora;
mod manual;
mod method;
mod network;
mod photographs;
mod region;
mod spread;
mod sun;
#[cfg(feature = "learned")]
pub mod training;
pub use method::Method;

engine::params! {
    /// Estimates the true brightness of the clipped parts of a panorama.
    ///
    /// A capture clips the sun, lamps and windows to white. This node estimates the hidden light as a gain per
    /// pixel, and derives the photographs that a camera would take at darker exposures. Unclipped pixels are not
    /// changed.
    pub struct PredictExposure {
        /// Exposures to derive, relative to the panorama (which is EV 0), in any order; for `Photographs`, the
        /// exposures of the files, in the order of the files.
        evs: Vec<f64> = vec![-6.0, -3.0], range(-24.0, -0.1), unit("EV"), other("[-9.0, -4.0]");
        /// Method of estimating hidden light.
        method: Method = Method::Learned, other("Skip");
        /// Minimum linear value at which a channel counts as clipped, where white is 1. Lower it for pictures whose
        /// white level is below 1, which can happen in splat renders and video.
        white: f32 = CLIPPED, range(0.5, 1.0), other("0.9");
        /// Weights file for `Learned`, written by `train-exposure`. It replaces the built-in weights.
        weights: Option<InputFile> = None, other("\"exposure.safetensors\"");
    }
}

engine::inputs! {
    /// Inputs of `predict-exposure`.
    pub struct In {
        /// Panorama whose lights may be clipped.
        pano: Arc<Panorama>,
    }
}

engine::outputs! {
    /// Outputs of `predict-exposure`.
    pub struct Out {
        /// The log2 gain per pixel, the exposures derived from it, and the regions.
        brackets: Arc<Brackets>,
        /// The exposures as pictures, one view each, with names such as `ev_-6`.
        exposures: Arc<Images>,
        /// The regions, and the energy of the panorama before and after the prediction, in total and for each light
        /// source.
        report: Arc<Report>,
    }
}

/// Minimum linear value at which a channel counts as clipped. In the data of the regression, clipping begins
/// gradually between 0.9 and 1; the middle of this range is used.
pub const CLIPPED: f32 = 0.95;
/// Maximum number of exposures. Exposures take memory, and more than a few add no information.
const MOST_EXPOSURES: usize = 64;
/// Maximum angle over which averaging onto the grid spreads a light, in radians: the width of two cells.
const SPREAD: f64 = 0.05;
/// Minimum alpha of a pixel that may count as clipped. Pixels with a smaller alpha were filled, so their
/// colours were not captured.
const SEEN: f32 = 0.5;
/// Number of columns below which a warning is given. With pixels of 5.6 degrees, many lamps are averaged with
/// their surroundings and do not clip.
const COARSE: usize = 64;

impl Kind for PredictExposure {
    const NAME: &'static str = "predict-exposure";
    const VERSION: u32 = 14;
    const READS: &'static [ContextField] = &[ContextField::Exhaustive];
    const DATA: &'static [u8] = network::WEIGHTS;
    const SUPPLIED: Option<&'static str> = kontext::SUPPLIED;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let pano = &inputs.pano.alpha;
        let pixels = pano.samples.len() as u64;
        let model = params.method.kontext().map_or(0, |kontext| kontext.memory(pano.width));
        let read = match &params.method {
            Method::Photographs { files } => (pixels, 48 + 16 * files.len() as u64),
            // Enlarged, at most 510 columns by as many rows.
            Method::Learned if pano.width < grid::WIDTH => (136, 510 * 510),
            _ => (0, 0),
        };
        Cost::of([(pixels, 136 + 12 * params.evs.len() as u64), read, (model, 1)])
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        let evs = sorted(&params.evs);
        if evs.len() > MOST_EXPOSURES {
            let text = format!("{} exposures are listed, but the limit is {MOST_EXPOSURES}", evs.len());
            return Err(NodeError::new(text)
                .at("evs")
                .hint("list fewer exposures; the gain map contains all of the light"));
        }
        if evs.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(NodeError::new("an exposure is listed twice")
                .at("evs")
                .hint("list each exposure once"));
        }
        if let Method::Manual { emitters } = &params.method {
            manual::check(emitters)?;
        }
        if let Method::Photographs { files } = &params.method {
            photographs::check(files, &params.evs)?;
        }
        match params.method.kontext() {
            Some(kontext) => kontext.check().and_then(|()| kontext.check_numbers()),
            None => Ok(()),
        }
    }

    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        match (&params.method, params.method.kontext()) {
            (Method::Learned, _) => Ok(params.weights.iter().map(|file| root.file(file)).collect()),
            (Method::Photographs { files }, _) => Ok(files.iter().map(|file| root.file(file)).collect()),
            (_, Some(kontext)) => kontext.sources(root),
            _ => Ok(Vec::new()),
        }
    }

    fn former(name: &str, _: &[(&str, &str)]) -> Option<Former> {
        (name == "force").then(|| Former::exhaustive(&["force"], 11))
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let clipping = Clipping::find(params, &inputs.pano, &mut notes, cx)?;
        let (width, height) = (clipping.pixels.width, clipping.pixels.height);
        let own: Vec<f64> = clipping.pixels.rgb.iter().map(|rgb| f64::from(luminance(*rgb))).collect();
        let mut table = EnergyTable::new(inputs.pano.up, width, &own, SPREAD);
        table.record_panorama("panorama", width, &own, cx)?;
        let Prediction { log2_gain, regions } = clipping.predict(&mut table, &mut notes, cx)?;
        let light = |(own, gain): (&f64, &f32)| own * num::f64::exp2(f64::from(*gain));
        let predicted: Vec<f64> = own.iter().zip(&log2_gain).map(light).collect();
        table.record_panorama("predicted", width, &predicted, cx)?;
        drop(predicted);
        let regions = clipping.report(regions, &log2_gain, &mut notes);
        let evs = sorted(&params.evs);
        let taken = clipping.photographs.as_ref().map_or(Taken::Derived, Photographs::taken);
        let exposures = match &clipping.photographs {
            Some(taken) => taken.pictures(&clipping.pixels, &log2_gain, cx)?,
            None => cx.for_each_tile(evs.len(), |i| {
                Image::from_samples(width, height, 3, expose(&clipping.pixels, &log2_gain, evs[i]))
            })?,
        };
        let log2_gain = Image::<Data>::from_samples(width, height, 1, log2_gain);
        let mut report = report(clipping.method(), clipping.clipped, clipping.mask.len() as u64, &regions);
        report.tables.extend(table.tables());
        let named = evs
            .iter()
            .zip(&exposures)
            .map(|(ev, image)| NamedImage { name: format!("ev_{ev}"), picture: image.clone().into() });
        let pictures = Arc::new(Images(named.collect()));
        let table = Arc::new(report.clone());
        let brackets = Arc::new(Brackets { log2_gain, evs, exposures, taken, report });
        Ok((Out { brackets, exposures: pictures, report: table }, notes))
    }
}

/// Clipped parts of a panorama, on the grid.
struct Clipped<'a> {
    up: Up,
    pixels: &'a LinearPixels,
    mask: &'a [bool],
    /// White level of the panorama, above 0 and at most 1.
    ceiling: f64,
    grid: Grid,
    labels: Regions,
    /// Cells of each region.
    members: Vec<Vec<usize>>,
}

/// Estimate of the hidden light of one region.
struct RegionLight {
    sun: bool,
    azimuth_deg: f64,
    elevation_deg: f64,
    solid_angle: f64,
    mean_log2_gain: f64,
    peak_log2_gain: f64,
    /// Standard deviation of the mean gain, in stops; `None` if unknown.
    uncertainty: Option<f64>,
}

impl<'a> Clipped<'a> {
    fn new(up: Up, alpha: &[f32], (pixels, mask, ceiling): (&'a LinearPixels, &'a [bool], f64)) -> Self {
        let grid = Grid::new(pixels, mask, alpha);
        let labels = regions::label(&grid.clipped, grid.width);
        let mut members = vec![Vec::new(); labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(cell);
            }
        }
        Self { up, pixels, mask, ceiling, grid, labels, members }
    }

    /// Regions, each with the predicted gain of its pixels.
    fn with_gain(&self, log2_gain: &[f32]) -> Vec<RegionLight> {
        let n = self.labels.count;
        let (mut size, mut before, mut after) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let mut peak = vec![0.0_f64; n];
        for at in (0..self.mask.len()).filter(|&at| self.mask[at]) {
            let Some(i) = self.labels.of[self.grid.cell_of[at] as usize] else { continue };
            let (i, gain) = (i as usize, f64::from(log2_gain[at]));
            let own = pixel_solid_angle(self.pixels.width, self.pixels.height, at / self.pixels.width);
            let flux = own * f64::from(luminance(self.pixels.rgb[at]));
            size[i] += own;
            before[i] += flux;
            after[i] += flux * num::f64::exp2(gain);
            peak[i] = peak[i].max(gain);
        }
        let mean = |i: usize| if before[i] > 0.0 { num::f64::log2(after[i] / before[i]) } else { 0.0 };
        let given = |i: usize| Given { mean_log2_gain: mean(i), peak_log2_gain: peak[i] };
        (0..n).map(|i| self.found(i, size[i], given(i))).collect()
    }

    /// Estimate for region `i`, from the solid angle of its clipped pixels and the light given to it.
    fn found(&self, i: usize, solid_angle: f64, given: Given) -> RegionLight {
        let toward = |&c: &usize| self.grid.direction(self.up, c) * self.grid.clipped_angle(c);
        let centre: DVec3 = self.members[i].iter().map(toward).sum();
        let centre = centre.try_normalize().unwrap_or(axes(self.up)[2]);
        let (azimuth_deg, elevation_deg) = measure::angles_deg(self.up, centre);
        RegionLight {
            sun: false,
            azimuth_deg,
            elevation_deg,
            solid_angle,
            mean_log2_gain: given.mean_log2_gain,
            peak_log2_gain: given.peak_log2_gain,
            uncertainty: None,
        }
    }
}

fn sorted(evs: &[f64]) -> Vec<f64> {
    let mut evs = evs.to_vec();
    evs.sort_by(f64::total_cmp);
    evs
}

/// Linear light of the panorama, limited to white if the panorama is display-encoded.
fn clipped_light(pano: &Panorama, notes: &mut Notes) -> Result<LinearPixels, NodeError> {
    if matches!(pano.image, Picture::Data(_)) {
        return Err(Error::Mismatch("the panorama holds data, not colour".to_owned()).into());
    }
    let (width, height, channels) = pano.image.size();
    if channels != 3 || width == 0 || height == 0 || pano.alpha.samples.len() != width * height {
        return Err(Error::Mismatch(format!("the panorama needs 3 channels and an alpha value for each pixel, but has {width}x{height} pixels (channels: {channels})")).into());
    }
    let mut pixels = linear_pixels(&pano.image, Transfer::Srgb);
    if matches!(pano.image, Picture::Srgb(_)) {
        for rgb in &mut pixels.rgb {
            *rgb = rgb.map(|v| v.min(1.0));
        }
    }
    if pixels.broken > 0 {
        notes.warning(
            "not-finite",
            format!("samples that are not finite count as black (count: {})", pixels.broken),
        );
    }
    Ok(pixels)
}

fn clip_mask(pano: &Panorama, pixels: &LinearPixels, white: f32) -> Vec<bool> {
    let clipped = |rgb: [f32; 3]| pixels.ceiling && max3(rgb) > white;
    pixels.rgb.iter().zip(&pano.alpha.samples).map(|(rgb, alpha)| *alpha >= SEEN && clipped(*rgb)).collect()
}

/// Reports white pixels whose colour was mostly filled in, since they are transparent. They do not count as clipped
/// and get no light.
fn report_unseen(pixels: &LinearPixels, alpha: &[f32], white: f32, notes: &mut Notes) {
    let unseen = |(rgb, alpha): &(&[f32; 3], &f32)| **alpha < SEEN && **alpha > 0.0 && max3(**rgb) > white;
    let count = pixels.rgb.iter().zip(alpha).filter(unseen).count();
    if pixels.ceiling && count > 0 {
        let text = format!(
            "white pixels that are more than half transparent do not count as clipped and are not changed (count: {count})"
        );
        notes.decision("white-unseen", text);
    }
}

/// Warns about a coarse panorama: a lamp smaller than a pixel may not clip, and another light may then seem
/// to be the strongest.
fn report_coarse(width: usize, notes: &mut Notes) {
    if width < COARSE {
        let text = format!(
            "a pixel of the panorama is {:.1} degrees wide; smaller lights may not clip and are then missed: use {COARSE} columns or more",
            360.0 / width as f64
        );
        notes.decision("coarse", text);
    }
}

fn report_nothing_clipped(
    pixels: &LinearPixels,
    alpha: &[f32],
    (params, exhaustive): (&PredictExposure, bool),
    notes: &mut Notes,
) {
    let seen = pixels.rgb.iter().zip(alpha).filter(|(_, alpha)| **alpha >= SEEN);
    let brightest = seen.map(|(rgb, _)| max3(*rgb)).fold(0.0, f32::max);
    let why = if pixels.ceiling {
        format!(
            "no pixel is clipped: the brightest pixel reaches {brightest:.3} of white, but only pixels of at least `white` = {} count as clipped",
            params.white
        )
    } else {
        let equal = pixels.rgb.iter().filter(|rgb| max3(**rgb) == brightest).count();
        format!(
            "the panorama contains light above white, so none of its pixels counts as clipped; the brightest value is {brightest:.3} (pixels with this value: {equal})"
        )
    };
    if let Method::Manual { emitters } = &params.method
        && !emitters.is_empty()
        && !exhaustive
    {
        let text = format!("the given lights (count: {}) have no effect: {why}", emitters.len());
        notes.warning(
            "nothing-to-light",
            format!("{text}; a lower `white` lets more pixels count as clipped"),
        );
        return;
    }
    let then =
        if exhaustive { "the method runs anyway, because of `--exhaustive`" } else { "nothing is predicted" };
    notes.decision("nothing-clipped", format!("{why}; {then}"));
}

/// Photograph that a camera would take at `ev`: display-encoded, limited to white.
fn expose(pixels: &LinearPixels, log2_gain: &[f32], ev: f64) -> Vec<f32> {
    pixels.rgb.iter().zip(log2_gain).flat_map(|(rgb, gain)| exposed(*rgb, *gain, ev, 1.0)).collect()
}

/// Same as [`expose`] for one pixel, limited to `white`.
fn exposed(rgb: [f32; 3], log2_gain: f32, ev: f64, white: f32) -> [f32; 3] {
    let scale = num::f64::exp2(f64::from(log2_gain) + ev);
    rgb.map(|v| srgb_from_linear(((f64::from(v) * scale) as f32).min(white)))
}

fn report(method: &Method, clipped: u64, pixels: u64, regions: &[RegionLight]) -> Report {
    let name = match method {
        Method::Learned => "learned",
        Method::Region => "region regression",
        Method::Manual { .. } => "manual",
        Method::Photographs { .. } => "photographs",
        Method::Skip => "skip",
        Method::FluxKontext { .. } => "Flux.1 Kontext",
    };
    let counts = [clipped, pixels, regions.len() as u64].map(Cell::Count);
    let row = [Cell::Text(name.to_owned())].into_iter().chain(counts).collect();
    let summary = Table::new("prediction", ["method", "clipped pixels", "pixels", "regions"], vec![row]);
    let columns = [
        "azimuth (deg, clockwise from forward)",
        "elevation (deg)",
        "solid angle (sr)",
        "mean gain (stops)",
        "peak gain (stops)",
        "uncertainty of the mean gain (stops)",
        "treated as",
    ];
    let row = |r: &RegionLight| {
        let numbers = [r.azimuth_deg, r.elevation_deg, r.solid_angle, r.mean_log2_gain, r.peak_log2_gain];
        let uncertainty = r.uncertainty.map_or(Cell::Missing, Cell::Number);
        let name = if r.sun { "the sun" } else { "a light" };
        numbers.map(Cell::Number).into_iter().chain([uncertainty, Cell::Text(name.to_owned())]).collect()
    };
    let table = Table::new("regions", columns, regions.iter().map(row).collect());
    Report { title: "Light hidden by clipping".to_owned(), tables: vec![summary, table] }
}

#[cfg(test)]
mod tests;

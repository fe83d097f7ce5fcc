//! `predict-exposure`: estimates the brightness of the clipped parts of a panorama.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Former, Kind, NodeError, Notes, SourceFile, SourceRoot};
use render::light::energy_table::EnergyTable;
use render::light::hidden::diffusion::WHERE;
use render::light::hidden::{grid, network};
use scene::math::color::luminance;
use scene::math::num;
use scene::types::{Brackets, Cell, Data, Image, Images, NamedImage, Report, Table, Taken};

use self::clipping::{Clipping, Prediction};
use self::exposures::expose;
use self::photographs::Photographs;
pub use render::light::hidden::clip::CLIPPED;
use render::light::hidden::clipped::RegionLight;

mod ceiling;
mod clipping;
mod enlarged;
mod exposures;
mod interface;
mod kontext;
mod manual;
mod method;
mod photographs;
mod reporting;
pub use interface::{In, Out, PredictExposure};
pub use method::Method;

/// Maximum number of exposures. Exposures take memory, and more than a few add no information.
const MOST_EXPOSURES: usize = 64;
/// Maximum angle over which averaging onto the grid spreads a light, in radians: the width of two cells.
const SPREAD: f64 = 0.05;

impl Kind for PredictExposure {
    const NAME: &'static str = "predict-exposure";
    const VERSION: u32 = 17;
    const READS: &'static [ContextField] = &[ContextField::Exhaustive];
    const DATA: &'static [u8] = network::WEIGHTS;
    const SUPPLIED: Option<&'static str> = Some(WHERE);
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
        Cost::of([(pixels, 148 + 12 * params.evs.len() as u64), read, (model, 1)])
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
        let Prediction { log2_gain, colour, regions } = clipping.predict(&mut table, &mut notes, cx)?;
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
                Image::from_samples(
                    width,
                    height,
                    3,
                    expose(&clipping.pixels, &log2_gain, colour.as_ref(), evs[i]),
                )
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
        let brackets = Arc::new(Brackets { log2_gain, colour, evs, exposures, taken, report });
        Ok((Out { brackets, exposures: pictures, report: table }, notes))
    }
}

fn sorted(evs: &[f64]) -> Vec<f64> {
    let mut evs = evs.to_vec();
    evs.sort_by(f64::total_cmp);
    evs
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
        "red of the hidden light (luminance 1)",
        "green",
        "blue",
    ];
    let row = |r: &RegionLight| {
        let numbers = [r.azimuth_deg, r.elevation_deg, r.solid_angle, r.mean_log2_gain, r.peak_log2_gain];
        let uncertainty = r.uncertainty.map_or(Cell::Missing, Cell::Number);
        let name = if r.sun { "the sun" } else { "a light" };
        let channel = |c: usize| r.colour.map_or(Cell::Missing, |rgb| Cell::Number(rgb[c]));
        let mut cells: Vec<Cell> = numbers.map(Cell::Number).into();
        cells.extend([uncertainty, Cell::Text(name.to_owned()), channel(0), channel(1), channel(2)]);
        cells
    };
    let table = Table::new("regions", columns, regions.iter().map(row).collect());
    Report { title: "Light hidden by clipping".to_owned(), tables: vec![summary, table] }
}

#[cfg(test)]
mod tests;

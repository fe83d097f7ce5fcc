//! `predict-exposure`: how bright the clipped parts of a panorama really are.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes, SourceFile, SourceRoot};

use crate::color::srgb_from_linear;
use crate::error::Error;
use crate::light::linear::{LinearPixels, Transfer, linear_pixels, max3};
use crate::num;
use crate::types::{Brackets, Cell, Data, Image, Images, NamedImage, Panorama, Picture, Report, Srgb, Table};

mod kontext;
#[cfg(feature = "learned")]
pub mod lora;
mod method;
mod region;
pub use method::Method;

engine::params! {
    /// Predicts how bright the clipped parts of a panorama really are.
    /// A capture cannot hold the sun, a lamp or a window: they clip to white. This estimates the light
    /// that clipping hid, as a gain for every pixel, and from it what a camera would have taken at any
    /// darker exposure. Where nothing is clipped nothing is changed.
    pub struct PredictExposure {
        /// Exposures to derive, in stops below the panorama (which is EV 0), in any order.
        evs: Vec<f64> = vec![-6.0, -3.0], range(-24.0, -0.1), unit("EV"), other("[-9.0, -4.0]");
        /// How hidden light is estimated.
        method: Method = Method::Region, other("Skip");
    }
}

engine::inputs! {
    /// Inputs of `predict-exposure`.
    pub struct In {
        /// The panorama, in which light may be clipped.
        pano: Arc<Panorama>,
    }
}

engine::outputs! {
    /// Outputs of `predict-exposure`.
    pub struct Out {
        /// The log2 gain of every pixel, the exposures derived from it, and each region found.
        brackets: Arc<Brackets>,
        /// The exposures as pictures, one view each: `ev_-6`.
        exposures: Arc<Images>,
        /// The regions, as a table.
        report: Arc<Report>,
    }
}

/// A pixel counts as clipped when its brightest channel is above this, in linear light where white is
/// 1: the middle of the ramp from 0.9 to 1 on which the regression was fitted.
const CLIPPED: f32 = 0.95;
/// A linear panorama can hold more than white; what lies above this was not clipped.
const ABOVE_WHITE: f32 = 1.05;
/// Pixels seen less than this were filled in, so they say nothing about clipping.
const SEEN: f32 = 0.5;

impl Kind for PredictExposure {
    const NAME: &'static str = "predict-exposure";
    const VERSION: u32 = 2;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let pixels = inputs.pano.alpha.samples.len();
        Cost { bytes: (pixels * (40 + 12 * params.evs.len())) as u64 }
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        let evs = sorted(&params.evs);
        if evs.windows(2).any(|pair| pair[0] >= pair[1]) {
            return Err(NodeError::new("an exposure is listed twice").at("evs").hint("name each one once"));
        }
        params.method.kontext().map_or(Ok(()), |kontext| kontext.check())
    }

    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        params.method.kontext().map_or(Ok(Vec::new()), |kontext| kontext.sources(root))
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let pano = &inputs.pano;
        let mut notes = Notes::none();
        let pixels = clipped_light(pano, &mut notes)?;
        let mask = clip_mask(pano, &pixels);
        let clipped = mask.iter().filter(|&&m| m).count() as u64;
        cx.check()?;
        cx.count("pixels", mask.len() as u64);
        let (log2_gain, regions) = if params.method == Method::Skip {
            if clipped > 0 {
                notes.warning("clipping-kept", format!("{clipped} clipped pixels stay as they are (Skip)"));
            }
            (vec![0.0; mask.len()], Vec::new())
        } else if clipped == 0 {
            notes.decision("nothing-clipped", "no pixel is clipped, so nothing is predicted");
            (vec![0.0; mask.len()], Vec::new())
        } else if let Some(kontext) = params.method.kontext() {
            let darkest = params.evs.iter().copied().fold(0.0, f64::min);
            (kontext.predict(&pixels, &mask, darkest, &mut notes, cx)?, Vec::new())
        } else {
            region::predict(pano.up, &pixels, &mask, &pano.alpha.samples, cx)?
        };
        if regions.iter().any(|region| region.sun) {
            notes.decision("sun", "a small clipped region in a blue sky is taken for the sun");
        }
        if !regions.is_empty() {
            notes.count("clipped-regions", regions.len() as u64, "clipped regions");
        }
        let (width, height) = (pixels.width, pixels.height);
        let evs = sorted(&params.evs);
        let rows = cx.for_each_tile(evs.len(), |i| expose(&pixels, &log2_gain, evs[i]))?;
        let exposures: Vec<Image<Srgb>> =
            rows.into_iter().map(|samples| Image::<Srgb>::from_samples(width, height, 3, samples)).collect();
        let log2_gain = Image::<Data>::from_samples(width, height, 1, log2_gain);
        let report = report(&params.method, clipped, mask.len() as u64, &regions);
        let named = evs
            .iter()
            .zip(&exposures)
            .map(|(ev, image)| NamedImage { name: format!("ev_{ev}"), picture: image.clone().into() });
        let pictures = Arc::new(Images(named.collect()));
        let table = Arc::new(report.clone());
        let brackets = Arc::new(Brackets { log2_gain, evs, exposures, report });
        Ok((Out { brackets, exposures: pictures, report: table }, notes))
    }
}

fn sorted(evs: &[f64]) -> Vec<f64> {
    let mut evs = evs.to_vec();
    evs.sort_by(f64::total_cmp);
    evs
}

/// Linear light as a camera holds it: no more than white where the panorama is display-encoded.
fn clipped_light(pano: &Panorama, notes: &mut Notes) -> Result<LinearPixels, NodeError> {
    if matches!(pano.image, Picture::Data(_)) {
        return Err(Error::Mismatch("the panorama holds data, not colour".to_owned()).into());
    }
    let (width, height, channels) = pano.image.size();
    if channels != 3 || width == 0 || height == 0 || pano.alpha.samples.len() != width * height {
        return Err(Error::Mismatch(format!("a {width}x{height} panorama of {channels} channels")).into());
    }
    let mut pixels = linear_pixels(&pano.image, Transfer::Srgb);
    if matches!(pano.image, Picture::Srgb(_)) {
        for rgb in &mut pixels.rgb {
            *rgb = rgb.map(|v| v.min(1.0));
        }
    }
    if pixels.broken > 0 {
        notes.warning("not-finite", format!("{} samples are not finite and count as black", pixels.broken));
    }
    Ok(pixels)
}

fn clip_mask(pano: &Panorama, pixels: &LinearPixels) -> Vec<bool> {
    let linear = matches!(pano.image, Picture::Linear(_));
    let clipped = |rgb: [f32; 3]| max3(rgb) > CLIPPED && !(linear && max3(rgb) > ABOVE_WHITE);
    pixels.rgb.iter().zip(&pano.alpha.samples).map(|(rgb, alpha)| *alpha >= SEEN && clipped(*rgb)).collect()
}

/// What a camera would take at `ev`: display-encoded, no more than white.
fn expose(pixels: &LinearPixels, log2_gain: &[f32], ev: f64) -> Vec<f32> {
    let mut samples = Vec::with_capacity(pixels.rgb.len() * 3);
    for (rgb, gain) in pixels.rgb.iter().zip(log2_gain) {
        let scale = num::f64::exp2(f64::from(*gain) + ev);
        samples.extend(rgb.map(|v| srgb_from_linear(((f64::from(v) * scale) as f32).min(1.0))));
    }
    samples
}

fn report(method: &Method, clipped: u64, pixels: u64, regions: &[region::Found]) -> Report {
    let name = match method {
        Method::Region => "region regression",
        Method::Skip => "skip",
        Method::FluxKontext { .. } => "Flux.1 Kontext",
    };
    let summary = Table {
        name: "prediction".to_owned(),
        columns: ["method", "clipped pixels", "pixels", "regions"].map(String::from).to_vec(),
        rows: vec![vec![
            Cell::Text(name.to_owned()),
            Cell::Count(clipped),
            Cell::Count(pixels),
            Cell::Count(regions.len() as u64),
        ]],
    };
    let columns = [
        "azimuth (deg, clockwise from forward)",
        "elevation (deg)",
        "solid angle (sr)",
        "mean gain (stops)",
        "peak gain (stops)",
        "taken for",
    ];
    let row = |r: &region::Found| {
        let numbers = [r.azimuth_deg, r.elevation_deg, r.solid_angle, r.mean_log2_gain, r.peak_log2_gain];
        let name = if r.sun { "the sun" } else { "a light" };
        numbers.map(Cell::Number).into_iter().chain([Cell::Text(name.to_owned())]).collect()
    };
    let table = Table {
        name: "regions".to_owned(),
        columns: columns.map(String::from).to_vec(),
        rows: regions.iter().map(row).collect(),
    };
    Report { title: "Light hidden by clipping".to_owned(), tables: vec![summary, table] }
}

#[cfg(test)]
mod tests;

//! The clipped pixels of a panorama, and their gain by each method.

use engine::{Context, NodeError, Notes};
use render::light::energy_table::EnergyTable;
use render::light::linear::LinearPixels;
use scene::io::foreign::refuse_placeholder;
use scene::types::{Data, Image, Panorama, Picture};

use super::ceiling::ceiling;
use super::enlarged::Enlarged;
use super::interface::PredictExposure;
use super::manual;
use super::method::Method;
use super::photographs::Photographs;
use super::reporting::{report_coarse, report_nothing_clipped, report_unseen};
use render::light::hidden::clip::{clip_mask, clipped_light};
use render::light::hidden::clipped::{Clipped, RegionLight};
use render::light::hidden::{network, region, sun};

/// Gain that the method predicts for a panorama.
pub(super) struct Prediction {
    /// log2 of the gain of each pixel; 0 for pixels that are not clipped.
    pub log2_gain: Vec<f32>,
    /// RGB of the hidden light of each pixel, at a luminance of 1; `None` if the method does not predict it.
    pub colour: Option<Image<Data>>,
    /// Regions that the method estimated; empty if the method estimates each pixel separately.
    pub regions: Vec<RegionLight>,
}

/// A panorama with its clipped pixels, and the files that the method reads.
pub(super) struct Clipping<'a> {
    params: &'a PredictExposure,
    pano: &'a Panorama,
    pub pixels: LinearPixels,
    /// True for each clipped pixel.
    pub mask: Vec<bool>,
    /// Number of clipped pixels.
    pub clipped: u64,
    /// True if the method runs even if no pixel is clipped; see [`Context::exhaustive`].
    exhaustive: bool,
    /// White level of the panorama.
    ceiling: f64,
    /// Networks of the method `Learned`; `None` for other methods.
    network: Option<network::Network>,
    /// Photographs of the method `Photographs`; `None` for other methods.
    pub photographs: Option<Photographs>,
}

impl<'a> Clipping<'a> {
    /// Finds the clipped pixels, and adds notes about their unusual properties.
    pub fn find(
        params: &'a PredictExposure,
        pano: &'a Panorama,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let pixels = clipped_light(pano, notes)?;
        let network = learned(params, notes, cx)?;
        let mut mask = clip_mask(pano, &pixels, params.white);
        let photographs = params.method.photographs(&params.evs, pano, notes, cx)?;
        if let Some(photographs) = &photographs {
            photographs.compare((&pixels, &pano.alpha.samples), params.white, notes, cx)?;
            photographs.add_clipped(&pixels, &mut mask, notes, cx)?;
        }
        let clipped = mask.iter().filter(|&&m| m).count() as u64;
        cx.check()?;
        cx.count("pixels", mask.len() as u64);
        report_unseen(&pixels, &pano.alpha.samples, params.white, notes);
        report_coarse(pixels.width, notes);
        if clipped == 0 {
            report_nothing_clipped(&pixels, &pano.alpha.samples, (params, cx.exhaustive()), notes);
        }
        let ceiling = ceiling(&pixels, &mask, params.white);
        let exhaustive = cx.exhaustive();
        Ok(Self { params, pano, pixels, mask, clipped, exhaustive, ceiling, network, photographs })
    }

    /// The method that is used. If no pixel is clipped, it is `Skip`, unless the run is exhaustive.
    pub fn method(&self) -> &Method {
        if self.clipped == 0 && !self.exhaustive { &Method::Skip } else { &self.params.method }
    }

    /// The clipped regions, as cells of the grid.
    fn on_grid(&self) -> Clipped<'_> {
        Clipped::new(self.pano.up, &self.pano.alpha.samples, (&self.pixels, &self.mask, self.ceiling))
    }

    /// Predicts the gain of every pixel by the method that is used.
    pub fn predict(
        &self,
        table: &mut EnergyTable,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Prediction, NodeError> {
        let of_pixels = |log2_gain| Prediction { log2_gain, colour: None, regions: Vec::new() };
        match self.method() {
            Method::Skip => Ok(self.nothing()),
            Method::Learned | Method::Region => self.by_regression(table, notes, cx),
            Method::Manual { emitters } => {
                manual::predict(emitters, (&self.pixels, &self.mask), self.pano.up, notes, cx).map(of_pixels)
            }
            Method::Photographs { .. } => self.by_photographs(notes, cx).map(of_pixels),
            Method::FluxKontext { .. } => self.by_diffusion(table, notes, cx).map(of_pixels),
        }
    }

    /// Prediction in which no pixel has a gain.
    fn nothing(&self) -> Prediction {
        Prediction { log2_gain: vec![0.0; self.mask.len()], colour: None, regions: Vec::new() }
    }

    /// Prediction by the method `Learned` if there is a network, and by `Region` otherwise.
    fn by_regression(
        &self,
        table: &mut EnergyTable,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Prediction, NodeError> {
        let clipped = self.on_grid();
        if !clipped.grid.anything_visible() {
            let text =
                "all pixels are clipped or black: hidden light cannot be estimated without visible light";
            notes.warning("nothing-visible", text);
            return Ok(self.nothing());
        }
        sun::report_doubtful(&clipped.grid, clipped.up, &clipped.members, notes);
        let Some(network) = &self.network else {
            let (log2_gain, regions) = region::predict(&clipped, cx)?;
            return Ok(Prediction { log2_gain, colour: None, regions });
        };
        let Some(large) = Enlarged::new(&self.pixels, &self.mask, &self.pano.alpha.samples) else {
            let network::Predicted { log2_gain, colour, regions } =
                network::predict(network, &clipped, table, cx)?;
            return Ok(Prediction { log2_gain, colour: Some(colour), regions });
        };
        let clipped = Clipped::new(self.pano.up, &large.alpha, (&large.pixels, &large.mask, self.ceiling));
        let network::Predicted { log2_gain, colour, regions } =
            network::predict(network, &clipped, table, cx)?;
        let colour = Some(large.gathered_colour(&colour));
        Ok(Prediction { log2_gain: large.gathered(&log2_gain), colour, regions })
    }

    /// log2 gain of each pixel, measured from the photographs.
    fn by_photographs(&self, notes: &mut Notes, cx: &Context) -> Result<Vec<f32>, NodeError> {
        let taken = self.photographs.as_ref();
        let gain = taken.map(|taken| taken.gains((&self.pixels, &self.mask), notes, cx)).transpose()?;
        Ok(gain.unwrap_or_default())
    }

    /// log2 gain of each pixel, predicted by `FluxKontext`.
    fn by_diffusion(
        &self,
        table: &mut EnergyTable,
        notes: &mut Notes,
        cx: &Context,
    ) -> Result<Vec<f32>, NodeError> {
        let darkest = self.params.evs.iter().copied().fold(0.0, f64::min);
        let kontext = self.params.method.kontext();
        let gain = kontext
            .map(|kontext| kontext.predict(&self.pixels, &self.mask, darkest, table, notes, cx))
            .transpose()?;
        Ok(gain.unwrap_or_default())
    }

    /// Adds notes about the prediction. Returns `regions`; if the method estimated no regions, returns the clipped
    /// regions of the panorama with the gain of their pixels.
    pub fn report(
        &self,
        regions: Vec<RegionLight>,
        log2_gain: &[f32],
        notes: &mut Notes,
    ) -> Vec<RegionLight> {
        let clipped = self.clipped;
        if clipped > 0 && matches!(self.pano.image, Picture::Linear(_)) {
            let text = "the panorama holds linear light without values above white, so white pixels count as clipped; if they are not, use `method: Skip`";
            notes.warning("linear-white", text);
        }
        let kept =
            self.mask.iter().zip(log2_gain).filter(|(clipped, gain)| **clipped && **gain == 0.0).count();
        if kept > 0 && matches!(self.params.method, Method::Skip | Method::Manual { .. }) {
            notes.warning(
                "clipping-kept",
                format!("clipped pixels that are not changed: {kept} of {clipped}"),
            );
        }
        let regions =
            if clipped > 0 && regions.is_empty() { self.on_grid().with_gain(log2_gain) } else { regions };
        if regions.iter().any(|region| region.sun) {
            notes.decision(
                "sun",
                "a small clipped region above the horizon, in a sky bluer than the ground, counts as the sun",
            );
        }
        let what = if regions.len() == 1 { "clipped region" } else { "clipped regions" };
        notes.count("clipped-regions", regions.len() as u64, what);
        regions
    }
}

/// Networks for the method `Learned`: the built-in networks, or those in the user's file. `None` for other methods.
/// The file is read even if nothing is clipped, so that an invalid file is reported.
fn learned(
    params: &PredictExposure,
    notes: &mut Notes,
    cx: &Context,
) -> Result<Option<network::Network>, NodeError> {
    if !matches!(params.method, Method::Learned) {
        if let Some(file) = &params.weights {
            let text = format!(
                "the weights file `{}` is ignored, since only `method: Learned` uses `weights`",
                file.0
            );
            notes.warning("weights-unused", text);
        }
        return Ok(None);
    }
    let parsed = match &params.weights {
        Some(file) => {
            let bytes = cx.read(file)?;
            refuse_placeholder(&file.0, &bytes).and_then(|()| network::parse(&file.0, &bytes))
        }
        None => network::parse(network::FILE, network::WEIGHTS),
    };
    Ok(Some(parsed.map_err(|error| NodeError::from(error).at("weights"))?))
}

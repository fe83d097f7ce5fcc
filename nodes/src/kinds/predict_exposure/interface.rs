//! Parameters, inputs and outputs of `predict-exposure`.

use std::sync::Arc;

use engine::InputFile;
use scene::types::{Brackets, Images, Panorama, Report};

use super::method::Method;
use render::light::hidden::clip::CLIPPED;

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
        /// The log2 gain and the colour of hidden light per pixel, the exposures derived from them, and the regions.
        brackets: Arc<Brackets>,
        /// The exposures as pictures, one view each, with names such as `ev_-6`.
        exposures: Arc<Images>,
        /// The regions, and the energy of the panorama before and after the prediction, in total and for each light
        /// source.
        report: Arc<Report>,
    }
}

//! Evaluation of networks on held-out panoramas.

use scene::error::Error;
use scene::io::exr::{self, Channel, Depth};
use scene::math::num;

use super::truth::{Example, WIDTH};
use render::light::hidden::network::{Network as Forward, hidden};

/// Errors for one held-out panorama, in stops.
#[derive(Debug, Clone)]
pub struct Score {
    /// Name of the panorama.
    pub name: String,
    /// log2 of the mean irradiance divided by its true value: first for the photograph without a prediction, then
    /// with the prediction.
    pub irradiance: [f64; 2],
    /// log2 of the contrast of the dominant light divided by its true value: first for the photograph without a
    /// prediction, then with the prediction.
    pub contrast: [f64; 2],
}

/// Residual error that is stored if there is no cross-validation, in stops; see [`residual`]. Cross-validation of an
/// earlier training, on 74 panoramas, measured this value.
pub(super) const RESIDUAL: f64 = 2.0;

/// Minimum share of the hidden light of a panorama that a region must have to be used in [`residual`].
const MATTERS: f64 = 0.05;
/// Largest absolute error of a region, in stops. Larger errors are clamped.
const LARGEST_ERROR: f64 = 4.0;

/// Header of the lines of [`Judged::lines`].
pub(super) const COLUMNS: &str = "panorama,part,open,sun,visible,hidden,predicted,given,disagreement\n";

/// Predicted and true fluxes of one clipped region.
struct Region {
    sun: f64,
    visible: f64,
    hidden: f64,
    /// Hidden flux predicted by the networks alone.
    predicted: f64,
    /// Hidden flux predicted by the networks, with the rule for suns applied.
    given: f64,
    /// Disagreement of the networks about the hidden flux, in stops.
    disagreement: f64,
}

impl Region {
    /// Square of the error of the predicted flux in stops, minus the square of the disagreement of the networks.
    fn square(&self) -> f64 {
        let error = num::f64::log2(self.predicted.max(1e-12) / self.hidden);
        let error = error.clamp(-LARGEST_ERROR, LARGEST_ERROR);
        error * error - self.disagreement * self.disagreement
    }
}

/// Evaluation on one panorama of networks that were trained without its location.
pub(super) struct Judged {
    pub score: Score,
    regions: Vec<Region>,
    /// Visible unclipped flux.
    open: f64,
    /// Light recovered from the unmodified photograph, as EXR.
    pub recovered: Vec<u8>,
}

impl Judged {
    pub fn new(name: &str, example: &Example, network: &Forward) -> Result<Self, Error> {
        let scene = &example.scene;
        let count = scene.cells.iter().map(|cell| cell.region + 1).max().unwrap_or(0);
        let predicted = hidden(network, scene, count);
        let region = |i: usize| {
            let (sun, disagreement) = (scene.suns[i], predicted.disagreement[i]);
            Region { sun, visible: 0.0, hidden: 0.0, predicted: 0.0, given: 0.0, disagreement }
        };
        let mut regions: Vec<Region> = (0..count).map(region).collect();
        for (i, cell) in scene.cells.iter().enumerate() {
            let region = &mut regions[cell.region];
            region.visible += cell.flux;
            region.hidden += example.hidden[i];
            region.predicted += predicted.cells[i];
        }
        let given = predicted.with_suns(scene).cells;
        let score = score(name, example, &given);
        for (cell, light) in scene.cells.iter().zip(&given) {
            regions[cell.region].given += light;
        }
        let colours: Vec<[f64; 3]> = scene.colours.iter().map(|features| network.colour(features)).collect();
        Ok(Self { score, regions, open: scene.open_flux, recovered: recovered(example, &given, &colours)? })
    }

    /// Regions that are used in [`residual`]: regions with at least the share [`MATTERS`] of the hidden light.
    fn matter(&self) -> impl Iterator<Item = &Region> {
        let total: f64 = self.regions.iter().map(|region| region.hidden).sum();
        self.regions.iter().filter(move |region| total > 0.0 && region.hidden > MATTERS * total)
    }

    /// Data of the regions as comma-separated values, one line per region. `part` is the index of the fold of the
    /// cross-validation.
    pub fn lines(&self, part: usize) -> String {
        let line = |r: &Region| {
            let (name, open) = (&self.score.name, self.open);
            let Region { sun, visible, hidden, predicted, given, disagreement } = r;
            format!("{name},{part},{open},{sun},{visible},{hidden},{predicted},{given},{disagreement}\n")
        };
        self.regions.iter().map(line).collect()
    }
}

/// Errors for a photograph, without a prediction and with the prediction of `network`. The rule for suns is
/// applied.
pub(super) fn judged(name: &str, example: &Example, network: &Forward) -> Score {
    let scene = &example.scene;
    score(name, example, &hidden(network, scene, scene.suns.len()).with_suns(scene).cells)
}

/// Errors of the photograph itself, and of the photograph with `cells` added. `cells` holds the flux to add to each
/// clipped cell.
fn score(name: &str, example: &Example, cells: &[f64]) -> Score {
    let none = vec![0.0; cells.len()];
    let [before, after] = [none.as_slice(), cells].map(|cells| errors(example, cells));
    Score { name: name.to_owned(), irradiance: [before[0], after[0]], contrast: [before[1], after[1]] }
}

/// Root-mean-square error of the predicted hidden flux over the regions, in stops, after subtracting the part that
/// the disagreement of the networks explains.
pub(super) fn residual(held: &[Judged]) -> f64 {
    let squares: Vec<f64> = held.iter().flat_map(Judged::matter).map(Region::square).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).max(0.0).sqrt()
}

/// log2 of the ratio of predicted to true mean irradiance, and log2 of the ratio of predicted to true contrast, if
/// the fluxes `cells` are added to the clipped cells.
fn errors(example: &Example, cells: &[f64]) -> [f64; 2] {
    let mut sums = example.visible;
    for (hidden, toward) in cells.iter().zip(&example.toward) {
        sums[0] += hidden;
        sums[1] += hidden * toward[0];
        sums[2] += hidden * toward[1];
    }
    let contrast = |[_, near, far]: [f64; 3]| (near / far.max(1e-9)).max(1e-4);
    let log = |a: f64, b: f64| num::f64::log2(a / b);
    [log(sums[0], example.truth[0]), log(contrast(sums), contrast(example.truth))]
}

/// Encodes the unmodified photograph as EXR, after adding the fluxes `cells` to its clipped cells. `colours` holds the
/// RGB of the light of each region at a luminance of 1.
fn recovered(example: &Example, cells: &[f64], colours: &[[f64; 3]]) -> Result<Vec<u8>, Error> {
    let mut samples: Vec<f32> = example.rgb.iter().flat_map(|rgb| rgb.map(|v| v as f32)).collect();
    for (cell, hidden) in example.scene.cells.iter().zip(cells) {
        let light = hidden / cell.size.max(1e-12);
        let rgb = samples[3 * cell.index..][..3].iter_mut();
        rgb.zip(colours[cell.region]).for_each(|(v, colour)| *v = (f64::from(*v) + light * colour) as f32);
    }
    let channel = |(c, name): (usize, &str)| {
        let samples = samples.iter().skip(c).step_by(3).copied().collect();
        (Channel { name: name.to_owned(), samples }, Depth::Float)
    };
    let channels = ["R", "G", "B"].into_iter().enumerate().map(channel).collect();
    Ok(exr::write(WIDTH, WIDTH / 2, channels, "linear", None)?.0)
}

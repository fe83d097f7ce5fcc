//! `fit-lights`: corrects the lights of an environment by the shading of the captured place.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes, Sizes};
use glam::DVec3;
use render::light::emitters;
use render::light::measure::angles_deg;
use scene::error::Error;
use scene::types::{Environment, Mesh, Report, Splats};

mod estimate;
mod incident;
mod pairs;
mod place;
mod relight;
mod reporting;
mod shading;
mod sources;
mod strengths;
mod sun;
mod system;

use self::estimate::Prior;
use self::place::PlaceMesh;
use self::shading::Shading;
use self::strengths::Given;
use self::sun::{Sun, Verdict};

engine::params! {
    /// Corrects the lights of a recovered environment by the shading of the captured place: the direction of the sun,
    /// and the strength and colour of every emitter.
    ///
    /// A panorama clips lamps, windows and the sun, so a prediction can only estimate the light that they hide. The
    /// captured colours of the place show this light: they change abruptly where a shadow ends, and gradually with
    /// the distance from a lamp. The colours of two neighbouring points of similar orientation are compared: their
    /// ratio should be the ratio of the light that both receive. The light from surfaces and sky that are not clipped
    /// is known, including all bounces, because the capture shows it. The comparison is robust: differences in albedo
    /// reduce its precision, but do not bias it.
    ///
    /// *The sun.* For each direction in the clipped regions, `fit-lights` computes which surface points would be in
    /// the sun, and which the receiver mesh would shadow. If one direction explains the colours clearly better than
    /// all others, the sun is placed in that direction with its fitted irradiance and colour, and the clipped region
    /// around it gets the fitted glow in place of the predicted light. Clipped mesh colours count as openings, so the
    /// sun may shine through a window.
    ///
    /// *Emitters* (`strengths: true`). Each region of the environment that is at least as bright as white is an
    /// emitter. It is on the mesh where the panorama shows it, in an opening of the mesh, or infinitely far away. Of
    /// the six strongest, the hidden light in red, green and blue is estimated. The prediction is the prior, with a
    /// standard deviation of `prior_stops` for each emitter and of 0.6 times this value for their sum. The report
    /// states a standard error for each. The light is unchanged if the estimate does not explain the colours clearly
    /// better than constant light and better than the prediction, if it contradicts the known light, or if the mesh is
    /// dark where the panorama shows the lights. The overall scale follows from the known light.
    pub struct FitLights {
        /// Number of surface points to compare.
        points: u32 = 12000, range(200, 200000), other("400"), inert("the panorama of the test graph is not clipped above the horizon");
        /// Minimum fraction by which a sun must reduce the error of the explained colours to be accepted. Real suns
        /// in open places reduce it by 0.1 to 0.3; a sun found by chance reduces it by less than 0.01.
        min_gain: f64 = 0.03, range(0.0, 1.0), other("0.9"), inert("the light of the test graph has no sun at either value");
        /// True to correct the strength and colour of the emitters; `false` only searches for the sun.
        strengths: bool = true, other("false"), inert("the panorama of the test graph is not clipped");
        /// Standard deviation of the predicted hidden light of an emitter. A smaller value keeps the result
        /// closer to the prediction.
        prior_stops: f64 = 1.5, range(0.05, 6.0), unit("stops"), other("0.1"), inert("the panorama of the test graph is not clipped");
        /// Standard deviation of one channel of this light, compared with the other channels.
        prior_colour_stops: f64 = 0.7, range(0.05, 6.0), unit("stops"), other("0.1"), inert("the panorama of the test graph is not clipped");
    }
}

engine::inputs! {
    /// Inputs of `fit-lights`.
    pub struct In {
        /// The recovered light, with its point of capture.
        env: Arc<Environment>,
        /// The mesh of the place; its vertex colours are used if `splats` is not wired.
        receiver: Arc<Mesh>,
        /// The splats of the place, which show its colours in finer detail than the vertices of a mesh.
        splats: Option<Arc<Splats>>,
    }
}

engine::outputs! {
    /// Outputs of `fit-lights`.
    pub struct Out {
        /// The corrected light, or the unchanged input if the place does not show that it is wrong.
        env: Arc<Environment>,
        /// The sun that was found, or the best candidate, and how well it explains the colours of the place; each
        /// emitter with its place, share, strength and colour before and after, and their errors.
        report: Arc<Report>,
    }
}

/// Standard deviation of the predicted hidden light of all emitters together, relative to that of one emitter. On
/// unseen places, the sum is predicted better than its parts.
const TOTAL: f64 = 0.6;
/// Standard deviation of the light that visible surfaces send, compared with the light that the capture shows there, in
/// stops: errors of the mesh and of its colours. This light determines the scale of the estimate.
const KNOWN: f64 = 0.05;
/// The same for one channel, compared with the others.
const KNOWN_COLOUR: f64 = 0.02;

impl Kind for FitLights {
    const NAME: &'static str = "fit-lights";
    const VERSION: u32 = 7;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let tree = (inputs.receiver.triangles.len() as u64).saturating_mul(260);
        let splats = inputs.splats.as_ref().map_or(0, |splats| splats.len() as u64).saturating_mul(16);
        let texels = (inputs.env.image.samples.len() as u64).saturating_mul(4);
        Cost {
            bytes: tree
                .saturating_add(splats)
                .saturating_add(texels)
                .saturating_add(u64::from(params.points) * 2000),
        }
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        f64::from(params.points) * 2000.0 + sizes.total()
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let In { env, receiver, splats } = inputs;
        let mut notes = Notes::none();
        let Some(origin) = env.origin else {
            let what = "the environment has no point of capture, so it cannot be compared with the place";
            return Err(NodeError::from(Error::Mismatch(what.to_owned()))
                .at("env")
                .hint("set `origin` in the node that loads the environment"));
        };
        if splats.is_none() && receiver.colours.is_empty() {
            let what = "the mesh has no vertex colours";
            return Err(NodeError::from(Error::Mismatch(what.to_owned()))
                .at("receiver")
                .hint("wire `splats`, which show the colours of the place"));
        }
        let place = PlaceMesh::new(&receiver);
        let shading = Shading::sample(&place, splats.as_deref(), origin, params.points as usize, cx)?;
        cx.count("points", shading.points.len() as u64);
        let incident = incident::incident(&place, &shading, &env, cx)?;
        let found = sun::find(&place, &shading, &incident, &env, cx)?;
        let verdict = judge(params, found.as_ref(), &place, origin);
        let sun = found.as_ref().filter(|_| verdict == Verdict::Accepted);
        let env = match sun {
            Some(sun) => {
                let (azimuth, elevation) = angles_deg(env.up, sun.direction);
                notes.decision(
                    "sun",
                    format!(
                        "the shadows of the place show a sun at azimuth {azimuth:.1}, elevation {elevation:.1} degrees; it was added to the environment with an irradiance of {:.2}",
                        sun.luminance()
                    ),
                );
                Arc::new(relight::with_sun(&env, sun))
            }
            None => {
                notes.decision("no-sun", format!("no sun was added: {}", verdict.reason()));
                env
            }
        };
        let emitters = emitters::find(&env);
        let given = Given {
            place: &place,
            shading: &shading,
            incident: &incident,
            env: &env,
            emitters: &emitters,
            origin,
            sun: sun.map(|sun| sun.direction),
        };
        let strengths = strengths::fit(&given, params.strengths.then(|| params.prior()).as_ref(), cx)?;
        reporting::decide(&strengths, &mut notes);
        let report = reporting::report(&env, &emitters, found.as_ref(), verdict, &strengths);
        let env = if strengths.accepted {
            let changed = strengths.emitters.iter().filter(|one| one.flux != one.source.hidden);
            let fluxes: Vec<_> = changed.map(|one| (&emitters.list[one.emitter], one.flux)).collect();
            Arc::new(relight::with_fluxes(&env, &fluxes))
        } else {
            env
        };
        Ok((Out { env, report: Arc::new(report) }, notes))
    }
}

impl FitLights {
    fn prior(&self) -> Prior {
        Prior {
            emitter: self.prior_stops,
            colour: self.prior_colour_stops,
            total: TOTAL * self.prior_stops,
            known: KNOWN,
            known_colour: KNOWN_COLOUR,
        }
    }
}

/// Decides whether the best candidate is accepted as a sun that lights the point of capture.
fn judge(params: &FitLights, found: Option<&Sun>, place: &PlaceMesh, origin: DVec3) -> Verdict {
    match found {
        None => Verdict::NothingToCompare,
        Some(sun) if sun.gain < params.min_gain => Verdict::Unexplained,
        Some(sun) if sun.rival > 0.6 * sun.gain => Verdict::Ambiguous,
        Some(sun) if !place.is_open(origin, sun.direction) => Verdict::Hidden,
        Some(_) => Verdict::Accepted,
    }
}

#[cfg(test)]
mod tests;

//! The output transform of ACES 2.0 for displays of standard dynamic range: white is 100 cd/m2, in a dim surround
//! (Academy of Motion Picture Arts and Sciences, *ACES 2.0 output transform*, 2025; the reference implementation is
//! in `aces-core`). The steps and constants are those of the specification; tables are finer at the corners of the
//! gamut.
//!
//! Colours become correlates of lightness J, colourfulness M and hue h. A tone curve maps J; M is scaled with it,
//! then compressed towards white and black; colours outside the gamut of the display move into it along lines of
//! constant hue.

mod appearance;
mod chroma;
mod gamut;
mod tone;

use crate::math::color::primaries::{AP1, Matrix, Primaries, REC709, product_vector};

use appearance::{Appearance, Jmh};
use gamut::Gamut;

/// The transform into the gamut of one display.
#[derive(Debug, Clone)]
pub(super) struct Aces {
    to_ap1: Matrix,
    to_rec709: Matrix,
    scene: Appearance,
    display: Appearance,
    tone: tone::ToneCurve,
    gamut: Gamut,
}

impl Aces {
    /// The transform for a display whose gamut has the given primaries.
    pub fn new(limit: &Primaries) -> Self {
        let (scene, display, tone) = (Appearance::new(&AP1), Appearance::new(limit), tone::ToneCurve::new());
        let gamut = Gamut::new(&scene, &display);
        Self { to_ap1: REC709.to(&AP1), to_rec709: limit.to(&REC709), scene, display, tone, gamut }
    }

    /// Light of the display in linear Rec.709, where 1 is its white, for scene light in linear Rec.709. Within the
    /// gamut of the display, its own components lie between 0 and 1.
    pub fn formed(&self, light: [f64; 3]) -> [f64; 3] {
        // The tone curve is flat above this light.
        let bounded = product_vector(&self.to_ap1, light).map(|v| v.clamp(0.0, tone::BRIGHTEST));
        let seen = self.scene.jmh(bounded);
        let limits = self.gamut.limits(seen.h);
        let toned = self.tone.lightness(seen.j);
        let m = chroma::compressed(seen, toned, &limits);
        let inside = self.gamut.compressed(Jmh { j: toned, m, h: seen.h }, &limits);
        let shown = self.display.rgb(inside).map(|v| v.clamp(0.0, 1.0));
        product_vector(&self.to_rec709, shown)
    }
}

//! The layered material of an object: clearcoat over sheen over base.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;
use scene::math::color::luminance;

use super::frame::{Frame, cosine};
use super::glass::Glass;
use super::gloss::{Gloss, Interface};
use super::lobe::{Lobe, Scatter};
use super::params::BsdfParams;
use super::{albedo, glass, sheen};

/// Index of the matte lobe. A random number chooses among the lobes in the order of their indices.
const MATTE: usize = 0;
const THROUGH: usize = 1;
const SHEEN: usize = 2;
const GLOSS: usize = 3;
const GLASS: usize = 4;
const COAT: usize = 5;

/// Minimum probability of a lobe whose weight is above 0, before normalisation.
const LEAST: f32 = 0.1;

/// Index of refraction of the clearcoat, as defined by KHR_materials_clearcoat.
const COAT_INDEX: f32 = 1.5;

/// The clearcoat.
#[derive(Debug, Clone, Copy)]
struct Coat {
    frame: Frame,
    out: Vec3,
    gloss: Gloss,
    share: f32,
    /// Share of light that the clearcoat transmits to the layers below.
    under: f32,
}

/// The sheen over the base.
#[derive(Debug, Clone, Copy)]
struct Sheen {
    /// Direction to the viewer in the frame of the matte lobes.
    out: Vec3,
    /// Colour, limited so that energy is conserved.
    colour: Vec3,
    roughness: f32,
    /// Directional albedo towards the viewer.
    albedo: Vec3,
}

impl Sheen {
    /// Sheen of a surface towards a viewer. `None` if it has no sheen.
    fn new(params: &BsdfParams, out: Vec3) -> Option<Self> {
        let (colour, roughness) = params.sheen;
        ((colour != Vec3::ZERO || params.every_lobe) && !params.inside).then(|| {
            let white = albedo::sheen(out.z, roughness);
            Self { out, colour: colour / white.max(1.0), roughness, albedo: colour * white.min(1.0) }
        })
    }

    /// Share of light that the sheen transmits to the base. As KHR_materials_sheen specifies, only the largest
    /// channel of the albedo counts.
    fn under(&self) -> f32 {
        1.0 - self.albedo.max_element()
    }
}

/// Transmittance of a surface for light that continues in the same direction. `cosine` is the cosine of the angle
/// of incidence.
pub fn straight(params: &BsdfParams, cosine: f32) -> Vec3 {
    let out = Vec3::new((1.0 - cosine * cosine).max(0.0).sqrt(), 0.0, cosine.max(1e-4));
    let gloss = |params: &BsdfParams| Gloss::new(params, &Interface::new(params, out), out);
    let (share, roughness) = params.coat;
    let coat = if share > 0.0 { 1.0 - share * (1.0 - gloss(&clear(roughness)).left.x) } else { 1.0 };
    let sheen = Sheen::new(params, out).map_or(1.0, |sheen| sheen.under());
    glass::tint(params) * gloss(params).left * (params.transmission * (1.0 - params.metallic) * sheen * coat)
}

/// Parameters of a clearcoat with the given roughness.
fn clear(roughness: f32) -> BsdfParams {
    BsdfParams { roughness, ior: COAT_INDEX, ..BsdfParams::default() }
}

/// All lobes of a material, for one direction to the viewer.
#[derive(Debug, Clone, Copy)]
pub struct Layers {
    /// Frame of the specular lobes.
    frame: Frame,
    geometric: Vec3,
    /// Direction to the viewer in `frame`.
    out: Vec3,
    /// Frame of the matte lobes. Unlike `frame`, it does not depend on the direction to the viewer.
    matte_frame: Frame,
    matte: Vec3,
    through: Vec3,
    interface: Interface,
    /// Product of [`Gloss::left`] and [`Interface::between`]. It applies to the light of the matte lobes.
    coupling: Vec3,
    gloss: Gloss,
    glass: Option<Glass>,
    sheen: Option<Sheen>,
    coat: Option<Coat>,
    /// Share of the light that clearcoat and sheen transmit to the base.
    under: f32,
    shares: [f32; 6],
    every_lobe: bool,
}

impl Layers {
    /// Same as [`Bsdf::lit_side`](super::Bsdf::lit_side).
    pub fn lit_side(&self) -> Option<Vec3> {
        let passes = self.glass.is_some_and(|glass| glass.passes()) || self.through != Vec3::ZERO;
        let frame = if self.matte == Vec3::ZERO { self.frame } else { self.matte_frame };
        (!passes).then(|| frame.normal())
    }

    /// Share of the light that clearcoat and sheen transmit to the base, which is also the share of the base's
    /// emission that they transmit.
    pub fn under(&self) -> f32 {
        self.under
    }

    /// Layers of a material. The array contains three frames: for the matte lobes, for the other lobes of the base,
    /// and for the clearcoat. The geometric normal and the normals of the last two frames are on the side of the
    /// unit direction `out`.
    pub fn new(
        [matte_frame, frame, coated]: [Frame; 3],
        geometric: Vec3,
        out: Vec3,
        params: &BsdfParams,
    ) -> Self {
        let viewer = frame.viewer(out);
        let mut interface = Interface::new(params, viewer);
        let gloss = Gloss::new(params, &interface, viewer);
        if params.inside {
            interface = Interface::default();
        }
        let coupling = gloss.left * interface.between();
        let below = (1.0 - params.metallic) * (1.0 - params.transmission);
        let (passing, colour) = params.through;
        let matte = params.base * (below * (1.0 - passing));
        let through = colour * (below * passing);
        let glass = Glass::new(params, &gloss);
        let sheen = Sheen::new(params, matte_frame.viewer(out));
        let coat = ((params.coat.0 > 0.0 || params.every_lobe) && !params.inside).then(|| {
            let (share, roughness) = params.coat;
            let (params, out) = (clear(roughness), coated.viewer(out));
            let gloss = Gloss::new(&params, &Interface::new(&params, out), out);
            Coat { frame: coated, out, gloss, share, under: 1.0 - share * (1.0 - gloss.left.x) }
        });
        let under = coat.map_or(1.0, |coat| coat.under) * sheen.map_or(1.0, |sheen| sheen.under());
        let mut layers = Self {
            frame,
            geometric,
            out: viewer,
            matte_frame,
            matte,
            through,
            interface,
            coupling,
            gloss,
            glass,
            sheen,
            coat,
            under,
            shares: [0.0; 6],
            every_lobe: params.every_lobe,
        };
        layers.share();
        layers
    }

    /// Sets the probabilities of the lobes approximately in proportion to their albedo.
    fn share(&mut self) {
        let mut weights = [
            self.matte * self.gloss.left * self.under,
            self.through * self.gloss.left * self.under,
            self.sheen.map_or(Vec3::ZERO, |sheen| sheen.albedo),
            self.gloss.albedo * self.under,
            self.glass.map_or(Vec3::ZERO, |glass| glass.albedo) * self.under,
            Vec3::splat(self.coat.map_or(0.0, |coat| 1.0 - coat.under)),
        ]
        .map(|weight| luminance(weight.to_array()));
        if self.glass.is_some_and(|glass| glass.is_body()) {
            // One lobe chooses the facet, which then reflects or refracts.
            weights[GLOSS] += std::mem::take(&mut weights[GLASS]);
        }
        let lift = |sum: f32, w: f32| if w > 0.0 { (w / sum).max(LEAST) } else { 0.0 };
        let sum = weights.iter().sum();
        let lifted = weights.map(|w| lift(sum, w));
        let sum: f32 = lifted.iter().sum();
        if sum > 0.0 {
            self.shares = lifted.map(|w| w / sum);
        }
    }

    /// Samples the gloss at least as often as everything else together. On the receiver, reflections are faint but sharp,
    /// while light samples and rays towards the objects find most of the matte light.
    pub fn reflecting(mut self) -> Self {
        let gloss = self.shares[GLOSS];
        if gloss > 0.0 && gloss < 0.5 {
            let others = 0.5 / (1.0 - gloss);
            self.shares = self.shares.map(|share| share * others);
            self.shares[GLOSS] = 0.5;
        }
        self
    }

    fn evaluates(&self, lobe: usize) -> bool {
        self.shares[lobe] > 0.0 || self.every_lobe
    }

    /// Same as [`Bsdf::eval`](super::Bsdf::eval).
    pub fn eval(&self, incident: Vec3) -> [Scatter; 2] {
        let (i, m) = (self.frame.to(incident), self.matte_frame.to(incident));
        let above = incident.dot(self.geometric) > 0.0;
        let [mut diffuse, mut specular] = [Scatter::default(); 2];
        let add = |class: &mut Scatter, lobe: usize, value: Vec3, pdf: f32| {
            class.value += value;
            class.pdf += self.shares[lobe] * pdf;
        };
        if above && m.z > 0.0 {
            if self.evaluates(MATTE) {
                let pdf = m.z * FRAC_1_PI;
                let coupling = self.coupling * (1.0 - self.interface.albedo(m.z));
                add(&mut diffuse, MATTE, self.matte * coupling * (self.under * pdf), pdf);
            }
            if let Some(fibres) = self.sheen {
                let value = fibres.colour * sheen::value(fibres.out, m, fibres.roughness);
                let under = self.coat.map_or(1.0, |coat| coat.under);
                add(&mut diffuse, SHEEN, value * under, sheen::UNIFORM);
            }
        }
        if above && i.z > 0.0 && self.evaluates(GLOSS) {
            let (s, facing) = self.gloss.eval(self.out, i);
            let mirrors = self.glass.and_then(|glass| glass.reflection_probability(facing)).unwrap_or(1.0);
            add(&mut specular, GLOSS, s.value * self.under, s.pdf * mirrors);
        }
        if !above && m.z < 0.0 && self.evaluates(THROUGH) {
            let pdf = -m.z * FRAC_1_PI;
            let coupling = self.coupling * (1.0 - self.interface.albedo(-m.z));
            add(&mut diffuse, THROUGH, self.through * coupling * (self.under * pdf), pdf);
        }
        if let Some(glass) = self.glass.as_ref().filter(|_| !above && i.z < 0.0) {
            let s = glass.eval(&self.gloss.ggx, self.out, i);
            add(&mut specular, if glass.is_body() { GLOSS } else { GLASS }, s.value * self.under, s.pdf);
        }
        if let Some(coat) = &self.coat {
            let i = coat.frame.to(incident);
            if above && i.z > 0.0 {
                let (s, _) = coat.gloss.eval(coat.out, i);
                add(&mut specular, COAT, s.value * coat.share, s.pdf);
            }
        }
        [diffuse, specular]
    }

    /// Samples a direction from the lobe that `choice` selects. Returns the class of the lobe and the direction.
    pub fn sample(&self, point: [f32; 2], mut choice: f32) -> Option<(Lobe, Vec3)> {
        // The last present lobe takes the rounding error.
        let last = self.shares.iter().rposition(|share| *share > 0.0)?;
        let mut lobe = 0;
        while lobe < last && choice >= self.shares[lobe] {
            choice -= self.shares[lobe];
            lobe += 1;
        }
        choice /= self.shares[lobe];
        let class = if lobe < GLOSS { Lobe::Diffuse } else { Lobe::Specular };
        let mut frame = if lobe < GLOSS { &self.matte_frame } else { &self.frame };
        let direction = match lobe {
            MATTE => cosine(point),
            THROUGH => -cosine(point),
            SHEEN => sheen::uniform(point),
            GLOSS => match self.glass.as_ref().filter(|glass| glass.is_body()) {
                Some(body) => body.sample_facet(&self.gloss.ggx, self.out, point, choice)?,
                None => self.gloss.ggx.reflect(self.out, point),
            },
            GLASS => self.glass.as_ref()?.through(&self.gloss.ggx, self.out, point),
            _ => {
                let coat = self.coat.as_ref()?;
                frame = &coat.frame;
                coat.gloss.ggx.reflect(coat.out, point)
            }
        };
        // Each lobe keeps to its side; another lobe of the class may produce that direction.
        let below = match lobe {
            GLOSS if self.glass.is_some_and(|glass| glass.is_body()) => direction.z < 0.0,
            _ => matches!(lobe, THROUGH | GLASS),
        };
        let incident = frame.from(direction);
        let stays = (direction.z < 0.0) == below && (incident.dot(self.geometric) < 0.0) == below;
        stays.then_some((class, incident))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::sampling::{Points, unit};

    /// Values, densities and sampled directions are the same, bit for bit, whether or not absent layers are
    /// evaluated. This test fails if the share of an absent coat is 1e-3.
    #[test]
    fn layers_of_no_strength_change_no_bit_where_they_are_evaluated() {
        let upright = Frame::around(Vec3::Z);
        let gold =
            BsdfParams { base: Vec3::splat(0.9), metallic: 1.0, roughness: 0.1, ..BsdfParams::default() };
        let paint = BsdfParams { base: Vec3::new(0.7, 0.4, 0.1), roughness: 0.3, ..BsdfParams::default() };
        for (params, tilt) in [
            (BsdfParams::default(), 0.2_f32),
            (paint, 0.9),
            (BsdfParams { thick: true, ..paint }, 0.6),
            (gold, 0.5),
            (BsdfParams { ior: 1.0, ..BsdfParams::default() }, 0.7),
            (BsdfParams { transmission: 0.6, thick: true, roughness: 0.2, ..paint }, 0.4),
        ] {
            let out = Vec3::new(tilt, 0.1, 1.0).normalize();
            let [left_out, forced] = [false, true].map(|every_lobe| {
                Layers::new([upright; 3], Vec3::Z, out, &BsdfParams { every_lobe, ..params })
            });
            assert!(left_out.sheen.is_none() && left_out.coat.is_none());
            assert!(forced.sheen.is_some() && forced.coat.is_some() && forced.glass.is_some());
            assert_eq!((forced.shares, forced.lit_side()), (left_out.shares, left_out.lit_side()));
            for i in 0..400 {
                let points = Points::new(3, i);
                let ([u, v], [choice, _]) = (points.pair(0), points.pair(1));
                let incident =
                    if unit(i.wrapping_mul(0x9e37_79b9)) < 0.8 { cosine([u, v]) } else { -cosine([u, v]) };
                for (a, b) in forced.eval(incident).into_iter().zip(left_out.eval(incident)) {
                    assert!(a.value == b.value && a.pdf == b.pdf, "{a:?} {b:?}");
                }
                assert_eq!(forced.sample([u, v], choice), left_out.sample([u, v], choice));
            }
        }
    }
}

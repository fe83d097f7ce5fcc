//! `denoise`: less noise in the ratio of light and in the objects, from the same samples.

mod firefly;
mod means;

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes};
use glam::Vec3;

use crate::color::luminance;
use crate::layers::{linear, matching};
use crate::types::{Image, Images, Linear, NamedImage, Picture};
use means::{Field, Pixel, Reach, VALUES};

engine::params! {
    /// Takes noise out of what `path-trace` renders, between it and `shadow-ratio`.
    ///
    /// Every pixel becomes the mean of those around it whose surroundings look the same, to the noise that
    /// `variance` tells. `without` and `with` are averaged with the same weights, which come from their ratio
    /// and its variance: the texture of the place does not matter, a pixel whose surroundings no object
    /// touches stays as it is, bit for bit, and an edge of the shadow stays where it is stronger than
    /// the noise. A single pixel that a lucky path has lit far beyond all around it takes their ratio, and is
    /// counted. The object's colour is averaged within its alpha, which stays. With more samples the filter
    /// fades by itself.
    pub struct Denoise {
        /// How far pixels may differ to be averaged, relative to their noise; 0 leaves all as it is.
        strength: f64 = 1.0, range(0.0, 4.0), other("0.0"), knob(Filter, "", "", "", "0.0");
        /// How far away pixels are looked for.
        radius_px: u32 = 7, range(1, 24), unit("px"), other("1"), knob(Depth, "3", "5", "7", "7");
    }
}
engine::inputs! {
    /// The layers of one path-trace.
    pub struct In {
        /// The receiver without the objects (R0).
        without: Arc<Images>,
        /// The receiver with the objects (R1).
        with: Arc<Images>,
        /// The objects, premultiplied.
        object: Arc<Images>,
        /// Depth of what is in front.
        depth: Arc<Images>,
        /// Normal of what is in front.
        normal: Arc<Images>,
        /// Variance of the other layers and, last, of the ratio.
        variance: Arc<Images>,
    }
}
engine::outputs! {
    /// The same layers with less noise.
    pub struct Out {
        /// R0, averaged as R1 is.
        without: Arc<Images>,
        /// R1.
        with: Arc<Images>,
        /// The objects.
        object: Arc<Images>,
    }
}

/// Standard deviations at strength 1 for the ratio and the object; the best of a few tried on the case of
/// `docs/bench.md`, flat within a factor of 1.5.
const STRENGTHS: [f64; 2] = [0.7, 0.5];
/// Cosines that normals may differ by: the receiver's mesh is rough and its normals shade nothing but the
/// ratio, the object's shade what is filtered.
const BENDS: [f32; 2] = [0.5, 0.05];
/// Objects are averaged over half as far, for their textures and highlights.
const OBJECT_RADIUS: usize = 2;
/// Largest ratio that is told from larger ones.
const MOST: f32 = 8.0;

/// Layers of one view.
struct View<'a> {
    without: &'a Image<Linear>,
    with: &'a Image<Linear>,
    object: &'a Image<Linear>,
    depth: &'a Picture,
    normal: &'a Picture,
    variance: &'a Picture,
}

impl View<'_> {
    /// A field with the surfaces of the guides filled in, and the rest by `fill` from pixel and alpha.
    fn field(&self, fill: impl Fn(usize, f32, &mut Pixel)) -> Field {
        let (width, height) = (self.without.width, self.without.height);
        let pixel = |i: usize| {
            let normal = &self.normal.samples()[i * 3..i * 3 + 3];
            let depth = self.depth.samples()[i];
            let near = if depth > 0.0 && depth.is_finite() { 1.0 / depth } else { 0.0 };
            let normal = Vec3::new(normal[0], normal[1], normal[2]);
            let mut pixel = Pixel {
                normal: if normal.is_finite() { normal } else { Vec3::ZERO },
                nearness: [near, 0.0, 0.0],
                ..Pixel::default()
            };
            fill(i, self.object.samples[i * 4 + 3], &mut pixel);
            pixel
        };
        let mut field = Field { width, height, pixels: (0..width * height).map(pixel).collect() };
        field.find_slopes();
        field
    }

    /// R0 and R1, told apart by their ratio, and how many fireflies were taken out.
    fn receiver(&self) -> (Field, u64) {
        let mut field = self.field(|i, alpha, pixel| {
            let colour = |image: &Image<Linear>| -> [f32; 3] {
                let at = i * image.channels;
                [image.samples[at], image.samples[at + 1], image.samples[at + 2]]
            };
            let (r0, r1) = (colour(self.without), colour(self.with));
            pixel.values = [r0[0], r0[1], r0[2], r1[0], r1[1], r1[2]];
            let variance = self.variance.samples()[i * 4 + 3];
            // Beyond the receiver there is nothing that objects change, whatever lies beside it.
            let met = pixel.nearness[0] > 0.0;
            pixel.there = met && pixel.values.iter().all(|v| v.is_finite()) && luminance(r0) > 0.0;
            if pixel.there {
                let ratio = |k: usize| if r0[k] > 0.0 { (r1[k] / r0[k]).clamp(0.0, MOST) } else { 1.0 };
                pixel.signal = [ratio(0), ratio(1), ratio(2)];
                pixel.variance = known(variance);
            }
            // In front is the object; which part of the receiver lies behind is not known.
            if alpha > 0.0 {
                pixel.normal = Vec3::ZERO;
            }
        });
        // Only what is brighter than it would be without objects: in a shadow few paths may bring all there is.
        let fireflies = field.quench(1.0, |values, ratio| {
            (0..3).for_each(|k| values[3 + k] = values[k] * ratio[k]);
        });
        // A few chunks of samples tell a variance with few degrees of freedom.
        field.smooth_variance(3);
        (field, fireflies)
    }

    /// A power of two that brings the mean light of the object near 1, so that what is too little to count is a share
    /// of it, and light of any strength is filtered alike, bit for bit.
    fn exposure(&self) -> f32 {
        let (mut sum, mut cover) = (0.0, 0.0);
        for o in self.object.samples.chunks_exact(4).filter(|o| o[3] > 0.0 && o.iter().all(|v| v.is_finite()))
        {
            sum += f64::from(luminance([o[0], o[1], o[2]]));
            cover += f64::from(o[3]);
        }
        let mean = (sum / cover) as f32;
        // The exponent alone, of what is a normal number.
        let exponent = mean.to_bits() >> 23;
        if mean.is_normal() && (1..=253).contains(&exponent) {
            f32::from_bits((254 - exponent) << 23)
        } else {
            1.0
        }
    }

    /// The object, by its colour.
    fn inserted(&self) -> Field {
        let exposure = self.exposure();
        let mut field = self.field(|i, alpha, pixel| {
            let o = &self.object.samples[i * 4..i * 4 + 4];
            let variance = self.variance.samples()[i * 4 + 2] / (alpha * alpha);
            pixel.values = [o[0], o[1], o[2], o[3], 0.0, 0.0];
            pixel.there = alpha > 0.0 && o.iter().all(|v| v.is_finite());
            if pixel.there {
                pixel.signal = [0, 1, 2].map(|k| o[k] / alpha * exposure);
                pixel.variance = known(variance) * exposure * exposure;
            }
        });
        field.smooth_variance(1);
        field
    }
}

impl Denoise {
    fn reach(&self, layer: usize) -> Reach {
        let radius = self.radius_px as usize;
        Reach {
            radius: if layer == 0 { radius } else { radius.div_ceil(OBJECT_RADIUS) },
            strength: (self.strength * STRENGTHS[layer]) as f32,
            bend: BENDS[layer],
        }
    }

    /// The layers with less noise, how many fireflies they had, and whether there is something to filter and no
    /// variance to tell how.
    fn view(&self, view: &View<'_>, cx: &Context) -> Result<([Image<Linear>; 3], u64, bool), NodeError> {
        let mut out = [view.without.clone(), view.with.clone(), view.object.clone()];
        if self.strength == 0.0 {
            return Ok((out, 0, false));
        }
        // Where no variance is known, no pixel is like another and none is a firefly: all stay.
        if !view.variance.samples().iter().any(|v| known(*v) > 0.0) {
            let covered = |o: &[f32]| o[3] > 0.0 && o.iter().all(|v| v.is_finite());
            let inserted = view.object.samples.chunks_exact(4).any(covered);
            return Ok((out, 0, inserted || view.with.samples != view.without.samples));
        }
        let set = |image: &mut Image<Linear>, i: usize, rgb: &[f32]| {
            let at = i * image.channels;
            image.samples[at..at + 3].copy_from_slice(rgb);
        };
        let (field, fireflies) = view.receiver();
        let is_noisy = |field: &Field| field.pixels.iter().any(|pixel| pixel.there && pixel.variance > 0.0);
        let mut noisy = is_noisy(&field);
        let averages: Vec<[f32; VALUES]> = field.average(self.reach(0), cx)?;
        for (i, values) in averages.iter().enumerate().filter(|(i, _)| field.pixels[*i].there) {
            set(&mut out[0], i, &values[..3]);
            set(&mut out[1], i, &values[3..]);
        }
        let field = view.inserted();
        noisy |= is_noisy(&field);
        let inserted =
            field.pixels.iter().any(|pixel| pixel.there) || view.with.samples != view.without.samples;
        for (i, values) in field.average(self.reach(1), cx)?.iter().enumerate() {
            let pixel = &field.pixels[i];
            if pixel.there && pixel.variance > 0.0 {
                // The mean of colours, each with the weight of its alpha, over this pixel's own.
                let share = pixel.values[3] / values[3];
                set(&mut out[2], i, &[values[0] * share, values[1] * share, values[2] * share]);
            }
        }
        Ok((out, fireflies, inserted && !noisy))
    }
}

/// A variance, or 0 where it is not known: what stands at the largest number may be more.
fn known(variance: f32) -> f32 {
    if variance < f32::MAX { variance.max(0.0) } else { 0.0 }
}

/// A guide of the given number of channels.
fn guide<'a>(
    images: &'a Images,
    port: &'static str,
    name: &str,
    size: (usize, usize),
    channels: usize,
) -> Result<&'a Picture, NodeError> {
    let picture = matching(images, port, name, size)?;
    if picture.size().2 == channels {
        return Ok(picture);
    }
    let what = format!("`{port}` has {} channels, not {channels}", picture.size().2);
    Err(NodeError::new(what).at(port).hint("wire every input to the output of that name of one path-trace"))
}

impl Kind for Denoise {
    const NAME: &'static str = "denoise";
    const VERSION: u32 = 3;
    // The time grows with its square; a preview has so few samples that the nearest pixels show as much.
    const ROUGH: &'static [(&'static str, &'static str)] = &[("radius_px", "2")];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_: &Self, inputs: &In) -> Cost {
        let sizes = inputs.without.0.iter().map(|view| view.picture.size());
        let pixels: usize = sizes.map(|(width, height, _)| width * height).sum();
        // Copies of three layers of every view; fields, averages and their copies of one at a time.
        Cost { bytes: (pixels * (10 * 4 + 200)) as u64 }
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut sets: [Vec<NamedImage>; 3] = Default::default();
        let views = &inputs.without.0;
        let (mut notes, mut fireflies) = (Notes::none(), 0);
        for (index, view) in views.iter().enumerate() {
            cx.check()?;
            let without = linear(&view.picture, "without")?;
            let size = (without.width, without.height);
            let name = &view.name;
            let with = linear(matching(&inputs.with, "with", name, size)?, "with")?;
            let layers = View {
                without: &without,
                with: &with,
                object: &*linear(guide(&inputs.object, "object", name, size, 4)?, "object")?,
                depth: guide(&inputs.depth, "depth", name, size, 1)?,
                normal: guide(&inputs.normal, "normal", name, size, 3)?,
                variance: guide(&inputs.variance, "variance", name, size, 4)?,
            };
            let (images, found, blind) = params.view(&layers, cx)?;
            fireflies += found;
            if blind {
                let text = "`variance` is 0 everywhere, as after 1 sample, so the layers stay as they are";
                notes
                    .warning("no-variance", format!("`{name}`: {text}; give `path-trace` 2 samples or more"));
            }
            for (set, image) in sets.iter_mut().zip(images) {
                set.push(NamedImage { name: name.clone(), picture: image.into() });
            }
            cx.progress((index + 1) as f32 / views.len() as f32);
        }
        let [without, with, object] = sets.map(|set| Arc::new(Images(set)));
        if fireflies > 0 {
            let what =
                "pixels of `with` were lit by a lucky path alone; they take the ratio of those around them";
            notes.count("fireflies", fireflies, what);
        }
        Ok((Out { without, with, object }, notes))
    }
}

#[cfg(test)]
mod tests;

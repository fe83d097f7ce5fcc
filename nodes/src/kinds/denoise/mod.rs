//! `denoise`: removes noise from the ratio of light and from the objects.

mod firefly;
mod means;
mod method;
mod oidn;
mod points;
mod view;

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes, SourceFile, SourceRoot};
use means::{Field, Reach, VALUES};
pub use method::Method;
use render::transport::picture::splat_rays::SplatPixels;
use scene::types::layers::{linear, matching};
use scene::types::{Image, Images, Linear, NamedImage, Picture, Splats};
use view::{ViewLayers, known};

engine::params! {
    /// Removes noise from the output of `path-trace`, before `shadow-ratio`.
    ///
    /// Every pixel becomes the mean of nearby pixels whose surroundings look the same, within the noise given by
    /// `variance`. The more samples there are, the less the filter changes.
    ///
    /// `without` and `with` are averaged with the same weights, which are computed from their ratio and its
    /// variance. So the texture of the scene does not matter, a pixel that no object affects nearby stays the same
    /// bit for bit, and an edge of the shadow is kept if it is stronger than the noise. A firefly (a single pixel
    /// that one improbable path makes far brighter than its surroundings) is replaced by the ratio around it, and
    /// counted.
    ///
    /// The colour of the object is averaged within its alpha, which does not change. A pixel of the object whose
    /// variance is much larger than the variance of other pixels keeps its light and does not contribute to them.
    ///
    /// `Oidn` filters the ratio and the object with Open Image Denoise instead, at the same noisy pixels.
    pub struct Denoise {
        /// Allowed difference of pixels that are averaged, relative to their noise; 0 switches the filter off. With
        /// `Oidn`, all values above 0 have the same effect.
        strength: f64 = 1.0, range(0.0, 4.0), other("0.0"), knob(Filter, "", "", "", "0.0");
        /// Radius of the search window; ignored by `Oidn`.
        radius_px: u32 = 7, range(1, 24), unit("px"), other("1"), knob(Depth, "3", "5", "7", "7");
        /// Denoising method.
        method: Method = Method::Means;
    }
}
engine::inputs! {
    /// Outputs of one `path-trace` node.
    pub struct In {
        /// Render of the receiver without the objects (R0).
        without: Arc<Images>,
        /// Render of the receiver with the objects (R1).
        with: Arc<Images>,
        /// The objects, premultiplied.
        object: Arc<Images>,
        /// Depth of the visible surface.
        depth: Arc<Images>,
        /// Normal of the visible surface.
        normal: Arc<Images>,
        /// Variance of the other layers. The last channel is the variance of the ratio.
        variance: Arc<Images>,
        /// The splats, if they are the `points` of `path-trace`. Then neighbours in space are averaged, not neighbours in
        /// the image; `method` and `radius_px` have no effect.
        points: Option<Arc<Splats>>,
    }
}
engine::outputs! {
    /// The same layers with less noise.
    pub struct Out {
        /// R0, averaged with the same weights as R1.
        without: Arc<Images>,
        /// R1, averaged with the same weights as R0.
        with: Arc<Images>,
        /// The objects, premultiplied.
        object: Arc<Images>,
    }
}

/// Factors by which `strength` is multiplied for the ratio and for the object, in standard deviations. They are the
/// best of several values for the case in `docs/evidence/bench.md`. The error hardly changes if these factors are
/// changed by up to a factor of 1.5.
const STRENGTHS: [f64; 2] = [0.7, 0.5];
/// Allowed differences of normals for the ratio and the object, as 1 - cosine. The receiver's mesh is rough and its
/// normals affect only the ratio; the normals of the object affect the shading that is filtered.
const BENDS: [f32; 2] = [0.5, 0.05];
/// Divisor of the search radius for objects. Their textures and highlights need a smaller radius.
const OBJECT_RADIUS: usize = 2;
impl Denoise {
    fn reach(&self, layer: usize) -> Reach {
        let radius = self.radius_px as usize;
        Reach {
            radius: if layer == 0 { radius } else { radius.div_ceil(OBJECT_RADIUS) },
            strength: (self.strength * STRENGTHS[layer]) as f32,
            bend: BENDS[layer],
        }
    }

    /// Filters one view. Returns the denoised layers, the number of fireflies, and whether there are samples
    /// to filter but no variance.
    fn view(
        &self,
        view: &ViewLayers<'_>,
        cx: &Context,
    ) -> Result<([Image<Linear>; 3], u64, bool), NodeError> {
        let mut out = [view.without.clone(), view.with.clone(), view.object.clone()];
        if self.strength == 0.0 {
            return Ok((out, 0, false));
        }
        // Without a variance, no pixel is similar to another and there are no fireflies: all pixels stay unchanged.
        if self.method == Method::Means && !view.variance.samples().iter().any(|v| known(*v) > 0.0) {
            let covered = |o: &[f32]| o[3] > 0.0 && o.iter().all(|v| v.is_finite());
            let inserted = view.object.samples.chunks_exact(4).any(covered);
            return Ok((out, 0, inserted || view.with.samples != view.without.samples));
        }
        let set = |image: &mut Image<Linear>, i: usize, rgb: &[f32]| {
            let at = i * image.channels;
            image.samples[at..at + 3].copy_from_slice(rgb);
        };
        let (receiver, fireflies) = view.receiver();
        let object = view.inserted();
        let is_noisy = |field: &Field| field.pixels.iter().any(|pixel| pixel.is_noisy());
        let noisy = is_noisy(&receiver) || is_noisy(&object);
        let [lit, inserted]: [Vec<[f32; VALUES]>; 2] = match self.method {
            Method::Means => [receiver.average(self.reach(0), cx)?, object.average(self.reach(1), cx)?],
            Method::Oidn => oidn::filter(view, [&receiver, &object], cx)?,
        };
        for (i, values) in lit.iter().enumerate().filter(|(i, _)| receiver.pixels[*i].there) {
            set(&mut out[0], i, &values[..3]);
            set(&mut out[1], i, &values[3..]);
        }
        for (i, values) in inserted.iter().enumerate() {
            let pixel = &object.pixels[i];
            if pixel.is_noisy() {
                // The mean of colours weighted by their alpha, divided by the alpha of this pixel.
                let share = pixel.values[3] / values[3];
                let colour = [0, 1, 2].map(|k| (values[k] * share).min(f32::MAX));
                set(&mut out[2], i, &colour);
            }
        }
        let any = object.pixels.iter().any(|pixel| pixel.there) || view.with.samples != view.without.samples;
        Ok((out, fireflies, any && !noisy))
    }
}

/// Returns a guide layer, and checks that it has the given number of channels.
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
    let what = format!("the channel count of `{port}` must be {channels}, but is {}", picture.size().2);
    Err(NodeError::new(what)
        .at(port)
        .hint("wire every input to the output of the same name of a single `path-trace` node"))
}

impl Kind for Denoise {
    const NAME: &'static str = "denoise";
    const VERSION: u32 = 7;
    // The time grows with the square of the radius; a preview has so few samples that the nearest pixels are
    // enough.
    const PREVIEW: engine::Preview =
        engine::Preview { rough: &[("radius_px", "2")], ..engine::Preview::NONE };
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let sizes = inputs.without.0.iter().map(|view| view.picture.size());
        let pixels: usize = sizes.map(|(width, height, _)| width * height).sum();
        // Copies of three layers of every view; fields, averages and their copies for one view at a time.
        // For each splat, itself, its neighbours, and sums.
        let points = inputs.points.as_ref().map_or(0, |splats| splats.len() as u64);
        Cost::of([(pixels as u64, 10 * 4 + 200), (params.method.bytes(pixels), 1), (points, 480)])
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        params.method.check()
    }

    fn sources(params: &Self, _: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        params.method.sources()
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut sets: [Vec<NamedImage>; 3] = Default::default();
        let views = &inputs.without.0;
        let (mut notes, mut fireflies) = (Notes::none(), 0);
        params.method.report(&mut notes)?;
        for (index, view) in views.iter().enumerate() {
            cx.check()?;
            let without = linear(&view.picture, "without")?;
            let size = (without.width, without.height);
            let name = &view.name;
            let with = linear(matching(&inputs.with, "with", name, size)?, "with")?;
            let layers = ViewLayers {
                without: &without,
                with: &with,
                object: &*linear(guide(&inputs.object, "object", name, size, 4)?, "object")?,
                depth: guide(&inputs.depth, "depth", name, size, 1)?,
                normal: guide(&inputs.normal, "normal", name, size, 3)?,
                variance: guide(&inputs.variance, "variance", name, size, 4)?,
            };
            let (images, found, blind) = match &inputs.points {
                Some(splats) => {
                    let (images, is_blind) = points::filter(splats, (name, &layers), params.strength, cx)?;
                    (images, 0, is_blind)
                }
                None if SplatPixels::are_named(name) => {
                    let text =
                        "the layers were traced at splats, so neighbours in the image may be far apart";
                    let hint = "wire the splats to `points`, as in `path-trace`";
                    return Err(NodeError::new(text).at("points").hint(hint));
                }
                None => params.view(&layers, cx)?,
            };
            fireflies += found;
            if blind {
                let text = "`variance` is 0 everywhere, which happens if each pixel has 1 sample, so nothing is filtered";
                notes
                    .warning("no-variance", format!("`{name}`: {text}; give `path-trace` 2 samples or more"));
            }
            for (set, image) in sets.iter_mut().zip(images) {
                set.push(NamedImage { name: name.clone(), picture: image.into() });
            }
            cx.progress((index + 1) as f32 / views.len() as f32);
        }
        let [without, with, object] = sets.map(|set| Arc::new(Images(set)));
        let what = "of the pixels of `with` had a firefly (light from one improbable path) and received the mean ratio of the pixels around it";
        notes.count("fireflies", fireflies, what);
        Ok((Out { without, with, object }, notes))
    }
}

#[cfg(test)]
mod tests;

//! `composite`: composites the inserted objects over the background, which is darkened by their shadow.

use std::borrow::Cow;
use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes, ViewCount};
use scene::math::color::luminance;
use scene::math::num;
use scene::types::layers::{linear, linear_on, matching};
use scene::types::{Data, Image, Images, Linear, NamedImage, Picture};

mod grain;
mod sharpness;

engine::choices! {
    /// Sharpness of the objects.
    pub enum Sharpness {
        /// Leaves the objects as rendered.
        Keep,
        /// Blurs the objects until their edges are as soft as the sharpest edges of the background around them,
        /// measured in each view.
        Match,
        /// Blurs the objects by `blur_px`.
        Blur,
    }
}

engine::choices! {
    /// Grain of the objects.
    pub enum Grain {
        /// Leaves the objects as rendered.
        Keep,
        /// Adds grain of the power that the background has around the objects, measured for each channel in each view.
        Match,
    }
}

engine::params! {
    /// Composites the rendered objects over the background, after darkening it by the shadow.
    ///
    /// A pixel of the result is `(B * S + A * b) * (1 - M) + O` in linear light, where `B` is the background,
    /// premultiplied by its alpha `b`, `S` the shadow, `A` the added light, and `O` the object, premultiplied by its alpha
    /// `M`. If `front` is wired, with colour `F` and alpha `a`, a pixel is
    /// `((B - K) * S + A * b * (1 - a) + K) * (1 - M) + F * M + O * (1 - a)`: the background already shows `F`, so
    /// `K`, which is `F` limited to at most `B`, is subtracted from `B` before the shadow. The colours of a
    /// splat render are un-premultiplied before they are decoded. Holes of the background show `backdrop`; with
    /// `backdrop: None` they stay transparent.
    ///
    /// The objects are first changed by `object_stops` and `object_tint`, then blurred, then get grain. The outputs
    /// `object`, `shadow` and `added` are the layers as they were used, so the formula holds for them exactly.
    pub struct Composite {
        /// Linear colour behind the holes of the background; `None` keeps the alpha channel.
        backdrop: Option<[f64; 3]> = Some([0.0; 3]), range(0.0, 1e6), other("(0.5, 0.25, 1.0)");
        /// Sharpness of the objects and their shadow. Renders are usually sharper than captures; `Match` blurs the
        /// objects and their shadow to the sharpness of the background.
        sharpness: Sharpness = Sharpness::Keep, other("Match"), inert("a picture of a few pixels has no edges to measure");
        /// Standard deviation of the blur with `sharpness: Blur`.
        blur_px: f64 = 1.0, range(0.0, 64.0), unit("px"), other("2.0"), inert("only with `sharpness: Blur`");
        /// Grain of the objects. Renders have none, photographs do.
        grain: Grain = Grain::Keep, other("Match"), inert("a picture of a few pixels has no grain to measure");
        /// Seed of the grain. In a sequence, a different seed in each frame makes the grain move.
        grain_seed: u64 = 0, other("7"), inert("only with `grain: Match`");
        /// Exposure of the objects; 1 doubles their light.
        object_stops: f64 = 0.0, range(-24.0, 24.0), unit("EV"), other("1.0");
        /// Factors for red, green and blue of the objects, such as a white balance.
        object_tint: [f64; 3] = [1.0, 1.0, 1.0], range(0.0, 1e6), other("(1.0, 0.9, 0.7)");
    }
}

engine::inputs! {
    /// Inputs of [`Composite`].
    pub struct In {
        /// View without the objects: a splat render or a photograph.
        background: Arc<Images>,
        /// The objects, linear, premultiplied, with alpha.
        object: Arc<Images>,
        /// Factor by which each channel of the background is multiplied. If this input is not wired, there is no
        /// shadow.
        shadow: Option<Arc<Images>>,
        /// Light that the objects add to the background (negative where they remove it), from `shadow-ratio`.
        added: Option<Arc<Images>>,
        /// The part of the background that lies in front of the objects, premultiplied, with alpha: a
        /// `splat-render` with `limit: "trace.nearest"`. It covers the objects and their shadow. A mesh in front of
        /// the objects does not need it, since their alpha already accounts for the mesh.
        front: Option<Arc<Images>>,
        /// Variance of the trace from which the object and the shadow come: the output `variance` of `path-trace`.
        /// Needed for the output `error`.
        variance: Option<Arc<Images>>,
    }
}

engine::outputs! {
    /// Outputs of [`Composite`].
    pub struct Out {
        /// The picture in linear light: RGB over the backdrop, or premultiplied RGBA if there is no backdrop.
        image: Arc<Images>,
        /// Standard error of the luminance of `image` due to the noise of the trace, linear, in the unit of
        /// `image`; 0 without `variance`. It assumes the default form of `shadow-ratio` without further shaping,
        /// and is an upper estimate if `denoise` was applied in between. It excludes the noise of `added` light and
        /// of alpha (antialiased outlines, and blended surfaces in front of a brighter background).
        error: Arc<Images>,
        /// The objects as they were used, linear, premultiplied, with alpha.
        object: Arc<Images>,
        /// The shadow as it was used; empty if `shadow` is not wired.
        shadow: Arc<Images>,
        /// The added light as it was used; empty if `added` is not wired.
        added: Arc<Images>,
    }
}

/// The layers of one view, all of the same size.
struct Layers<'a> {
    background: &'a Image<Linear>,
    object: &'a Image<Linear>,
    shadow: Option<Image<Linear>>,
    added: Option<Image<Linear>>,
    front: Option<Cow<'a, Image<Linear>>>,
    variance: Option<&'a Picture>,
    /// Luminance of the gain of the objects, by which their noise is scaled.
    gain: f32,
}

impl Layers<'_> {
    /// Colour of the front layer at a pixel, limited to the colour of the background, and alpha of the front layer.
    fn in_front(&self, x: usize, y: usize) -> ([f32; 3], f32) {
        let Some(front) = &self.front else { return ([0.0; 3], 0.0) };
        let (b, f) = (self.background.pixel(x, y), front.pixel(x, y));
        (std::array::from_fn(|c| f[c].min(b[c]).max(0.0)), f[3])
    }

    /// Standard error of the luminance of each pixel. In `(B - F) S (1 - M) + O (1 - a)`, where `F` is the
    /// part of the background in front of the objects and `a` its alpha, only `S` and `O` are noisy.
    fn error(&self) -> Image<Data> {
        let Image { width, height, .. } = *self.background;
        let mut error = Image::new(width, height, 1);
        let Some(variance) = self.variance else { return error };
        for (index, reported) in variance.samples().chunks_exact(4).enumerate() {
            let (x, y) = (index % width, index / width);
            let (b, o) = (self.background.pixel(x, y), self.object.pixel(x, y));
            let cover = if self.object.channels == 4 { o[3] } else { 1.0 };
            let (kept, front) = self.in_front(x, y);
            let behind = std::array::from_fn(|c| b[c] - kept[c]);
            let shaded = if self.shadow.is_some() { luminance(behind) * (1.0 - cover) } else { 0.0 };
            let seen = (1.0 - front) * self.gain;
            let square = shaded * shaded * reported[3] + seen * seen * reported[2];
            error.pixel_mut(x, y)[0] = if square.is_finite() { square.max(0.0).sqrt() } else { 0.0 };
        }
        error
    }
}

impl Composite {
    /// Composites one view. Returns the picture and the number of its samples that were not finite.
    fn view(&self, layers: &Layers<'_>, cx: &Context) -> Result<(Image<Linear>, u64), NodeError> {
        let Layers { background, object, .. } = *layers;
        let (width, height) = (background.width, background.height);
        let keep_alpha = self.backdrop.is_none() && background.channels == 4;
        let channels = if keep_alpha { 4 } else { 3 };
        let rows = cx.for_each_tile(height, |y| {
            let (mut row, mut broken) = (vec![0.0; channels * width], 0);
            for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                let b = background.pixel(x, y);
                let o = object.pixel(x, y);
                let behind = if background.channels == 4 { b[3] } else { 1.0 };
                let cover = if object.channels == 4 { o[3] } else { 1.0 };
                let (kept, hidden) = layers.in_front(x, y);
                for c in 0..3 {
                    let factor = layers.shadow.as_ref().map_or(1.0, |s| s.pixel(x, y)[c]);
                    // The shadow falls on the background behind the front layer; a factor of 1 changes no bit.
                    let mut under = b[c] * factor + kept[c] * (1.0 - factor);
                    if let Some(added) = &layers.added {
                        let light = added.pixel(x, y)[c] * behind * (1.0 - hidden);
                        under = kept[c] + (under - kept[c] + light).max(0.0);
                    }
                    if let (Some(backdrop), true) = (self.backdrop, behind < 1.0) {
                        under += (1.0 - behind) * backdrop[c] as f32;
                    }
                    let over = match &layers.front {
                        Some(front) => {
                            let front = front.pixel(x, y);
                            front[c] * cover + o[c] * (1.0 - front[3])
                        }
                        None => o[c],
                    };
                    let value = under * (1.0 - cover) + over;
                    broken += u64::from(!value.is_finite());
                    pixel[c] = if value.is_finite() { value } else { 0.0 };
                }
                if keep_alpha {
                    let alpha = behind * (1.0 - cover) + cover;
                    pixel[3] = if alpha.is_finite() { alpha } else { 0.0 };
                }
            }
            (row, broken)
        })?;
        let broken = rows.iter().map(|(_, broken)| broken).sum();
        let samples = rows.into_iter().flat_map(|(row, _)| row).collect();
        Ok((Image::from_samples(width, height, channels, samples), broken))
    }
}

/// Smallest blur that is applied, in pixels. Smaller blurs are not visible.
const LEAST_BLUR: f64 = 0.1;

impl Kind for Composite {
    const NAME: &'static str = "composite";
    const VERSION: u32 = 4;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["background"])
    }

    fn estimate(params: &Self, inputs: &In) -> Cost {
        // The picture and its error, layers as factors of three channels, and changed layers with their copies. Unchanged
        // layers are passed on.
        let pixels = |images: &Images| {
            let pixels = |image: &NamedImage| image.picture.size().0 as u64 * image.picture.size().1 as u64;
            images.0.iter().map(pixels).sum::<u64>()
        };
        let copies = 4 + 6 + if params.keeps_layers() { 0 } else { 4 + 6 };
        Cost::of([(pixels(&inputs.background), 4 * (4 + 1 + copies))])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut broken = 0;
        let mut views = Vec::with_capacity(inputs.background.0.len());
        let mut errors = Vec::with_capacity(inputs.background.0.len());
        let (mut blurs, mut grains) = (Vec::new(), Vec::new());
        let mut used = Used::default();
        let is_linear = |image: &NamedImage| matches!(image.picture, Picture::Linear(_));
        let keeps = params.keeps_layers() && inputs.object.0.iter().all(is_linear);
        for (index, view) in inputs.background.0.iter().enumerate() {
            cx.check()?;
            let background = linear_on(&view.picture, "background", cx)?;
            let size = (background.width, background.height);
            let mut object = linear(matching(&inputs.object, "object", &view.name, size)?, "object")?;
            let data = |images: &Option<Arc<Images>>, port| match images {
                Some(images) => factors(matching(images, port, &view.name, size)?, port).map(Some),
                None => Ok(None),
            };
            let front = match &inputs.front {
                Some(images) => Some(linear_on(matching(images, "front", &view.name, size)?, "front", cx)?),
                None => None,
            };
            if front.as_ref().is_some_and(|image| image.channels != 4) {
                let error = NodeError::new("`front` needs an alpha channel").at("front");
                return Err(
                    error.hint("wire the output `colour` of a `splat-render` node whose `limit` is wired")
                );
            }
            let variance = match &inputs.variance {
                Some(images) => Some(matching(images, "variance", &view.name, size)?),
                None => None,
            };
            if let Some((_, _, channels)) = variance.map(Picture::size).filter(|size| size.2 != 4) {
                let error =
                    NodeError::new(format!("`variance` needs 4 channels, but has {channels}")).at("variance");
                return Err(error.hint("wire the output `variance` of a `path-trace` node"));
            }
            let (mut shadow, mut added) = (data(&inputs.shadow, "shadow")?, data(&inputs.added, "added")?);
            params.expose(&mut object);
            if params.sharpness != Sharpness::Keep {
                let blur = match params.sharpness {
                    Sharpness::Match => {
                        let grain = grain::of_background(&background, &object, cx)?;
                        let found = sharpness::of_background(&background, &object, grain, cx)?;
                        found.map_or(0.0, sharpness::missing)
                    }
                    _ => params.blur_px,
                };
                let blur = if blur > LEAST_BLUR { blur } else { 0.0 };
                blurs.push(blur);
                if blur > 0.0 {
                    object = Cow::Owned(sharpness::blurred(&object, blur, cx)?);
                    for layer in [&mut shadow, &mut added].into_iter().flatten() {
                        *layer = sharpness::blurred(layer, blur, cx)?;
                    }
                }
            }
            if params.grain == Grain::Match {
                let sigma = grain::of_background(&background, &object, cx)?;
                if let Some(sigma) = sigma {
                    object = Cow::Owned(grain::added(&object, sigma, (params.grain_seed, index), cx)?);
                }
                grains.push(sigma);
            }
            let gain = params.gain();
            // Exactly 1 where nothing is changed.
            let gain = if gain == [1.0; 3] { 1.0 } else { luminance(gain.map(|gain| gain as f32)) };
            let (background, object) = (&*background, &*object);
            let layers = Layers { background, object, shadow, added, front, variance, gain };
            let (image, lost) = params.view(&layers, cx)?;
            broken += lost;
            if !keeps {
                used.keep(&view.name, &layers);
            }
            errors.push(NamedImage { name: view.name.clone(), picture: layers.error().into() });
            views.push(NamedImage { name: view.name.clone(), picture: image.into() });
        }
        let mut notes = Notes::none();
        if broken > 0 {
            notes.warning("not-finite", format!("samples that were not finite are black (count: {broken})"));
        }
        report_grain(&grains, &mut notes);
        if let Some(most) = blurs.iter().copied().reduce(f64::max) {
            let least = blurs.iter().copied().fold(most, f64::min);
            let text =
                format!("the objects are blurred by {least:.2} to {most:.2} pixels{}", params.blur_reason());
            notes.decision("sharpness", text);
        }
        let [image, error] = [views, errors].map(|views| Arc::new(Images(views)));
        let layer = |input: Option<Arc<Images>>, used: Vec<NamedImage>| match input {
            Some(input) if keeps => input,
            Some(_) => Arc::new(Images(used)),
            None => Arc::default(),
        };
        let object = layer(Some(inputs.object), used.object);
        let (shadow, added) = (layer(inputs.shadow, used.shadow), layer(inputs.added, used.added));
        Ok((Out { image, error, object, shadow, added }, notes))
    }
}

/// The layers of all views as they were used.
#[derive(Default)]
struct Used {
    object: Vec<NamedImage>,
    shadow: Vec<NamedImage>,
    added: Vec<NamedImage>,
}

impl Used {
    /// Keeps the layers of a view.
    fn keep(&mut self, name: &str, layers: &Layers<'_>) {
        let named = |picture: Picture| NamedImage { name: name.to_owned(), picture };
        let data = |layer: &Image<Linear>| {
            let Image { width, height, channels, .. } = *layer;
            named(Image::<Data>::from_samples(width, height, channels, layer.samples.clone()).into())
        };
        self.shadow.extend(layers.shadow.as_ref().map(data));
        self.added.extend(layers.added.as_ref().map(data));
        self.object.push(named(layers.object.clone().into()));
    }
}

impl Composite {
    /// True if the layers are used as they come.
    fn keeps_layers(&self) -> bool {
        self.sharpness == Sharpness::Keep && self.grain == Grain::Keep && self.gain() == [1.0; 3]
    }

    /// Factors for red, green and blue of the objects.
    fn gain(&self) -> [f64; 3] {
        self.object_tint.map(|tint| num::f64::exp2(self.object_stops) * tint)
    }

    /// Multiplies the colours of the objects by `gain`.
    fn expose(&self, object: &mut Cow<'_, Image<Linear>>) {
        let gain = self.gain();
        if gain == [1.0; 3] {
            return;
        }
        let object = object.to_mut();
        let channels = object.channels;
        for pixel in object.samples.chunks_exact_mut(channels) {
            pixel.iter_mut().zip(gain).for_each(|(v, gain)| *v = (f64::from(*v) * gain) as f32);
        }
    }

    fn blur_reason(&self) -> &'static str {
        if self.sharpness == Sharpness::Match { ", to match the background" } else { "" }
    }
}

/// Adds a note about the grain of each view, in display values.
fn report_grain(grains: &[Option<[f64; 3]>], notes: &mut Notes) {
    let unknown = grains.iter().filter(|grain| grain.is_none()).count() as u64;
    notes.count(
        "grain-unknown",
        unknown,
        "of the views have too few free pixels around the objects to measure grain, so the objects get none",
    );
    let all = || grains.iter().flatten();
    if all().next().is_some() {
        let most = [0, 1, 2].map(|c| 100.0 * all().map(|grain| grain[c]).fold(0.0, f64::max));
        let [r, g, b] = most;
        let text = format!(
            "the objects get grain with standard deviations of up to {r:.2}, {g:.2} and {b:.2} % of white (display values of red, green, blue), to match the background"
        );
        notes.decision("grain", text);
    }
}

/// Reads a shadow or added light as plain numbers, whatever encoding it is tagged with, since it is not a
/// colour.
fn factors(picture: &Picture, port: &'static str) -> Result<Image<Linear>, NodeError> {
    let (width, height, channels) = picture.size();
    match channels {
        3.. => Ok(Image::from_samples(width, height, channels, picture.samples().to_vec())),
        1 => {
            let samples = picture.samples().iter().flat_map(|&v| [v; 3]).collect();
            Ok(Image::from_samples(width, height, 3, samples))
        }
        _ => Err(NodeError::new(format!("`{port}` needs 1 or 3 channels, but has {channels}")).at(port)),
    }
}

#[cfg(test)]
mod tests;

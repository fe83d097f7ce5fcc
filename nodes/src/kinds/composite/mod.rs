//! `composite`: composites the inserted objects over the background, which is darkened by their shadow.

use std::borrow::Cow;
use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, ViewCount};
use scene::math::color::luminance;
use scene::types::layers::{linear, matching};
use scene::types::{Data, Image, Images, Linear, NamedImage, Picture};

mod sharpness;

engine::choices! {
    /// Sharpness of the objects.
    pub enum Sharpness {
        /// Leaves the objects as rendered.
        Keep,
        /// Blurs the objects until their edges are as soft as the sharpest edges of the background around them,
        /// measured in each view.
        Match,
    }
}

engine::params! {
    /// Composites the rendered objects over the background, after darkening it by the shadow.
    ///
    /// A pixel of the result is `(B * S + A) * (1 - M) + O` in linear light, where `B` is the background, `S` the
    /// shadow, `A` the added light, and `O` the object, premultiplied by its alpha `M`. If `front` is wired, with
    /// colour `F` and alpha `a`, a pixel is `((B - F) * S + A * (1 - a)) * (1 - M) + F + O * (1 - a)`: the
    /// background already shows `F`, so `F`, limited to at most `B`, is first subtracted from `B`. The colours of a
    /// splat render are un-premultiplied before they are decoded. Holes of the background show `backdrop`; with
    /// `backdrop: None` they stay transparent.
    pub struct Composite {
        /// Linear colour behind the holes of the background; `None` keeps the alpha channel.
        backdrop: Option<[f64; 3]> = Some([0.0; 3]), range(0.0, 1e6), other("(0.5, 0.25, 1.0)");
        /// Sharpness of the objects and their shadow. Renders are usually sharper than captures; `Match` blurs the
        /// objects and their shadow to the sharpness of the background.
        sharpness: Sharpness = Sharpness::Keep, other("Match"), inert("a picture of a few pixels has no edges to measure");
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
            let square = shaded * shaded * reported[3] + (1.0 - front) * (1.0 - front) * reported[2];
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
    const VERSION: u32 = 3;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["background"])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut broken = 0;
        let mut views = Vec::with_capacity(inputs.background.0.len());
        let mut errors = Vec::with_capacity(inputs.background.0.len());
        let mut blurs = Vec::new();
        for view in &inputs.background.0 {
            cx.check()?;
            let background = linear(&view.picture, "background")?;
            let size = (background.width, background.height);
            let mut object = linear(matching(&inputs.object, "object", &view.name, size)?, "object")?;
            let data = |images: &Option<Arc<Images>>, port| match images {
                Some(images) => factors(matching(images, port, &view.name, size)?, port).map(Some),
                None => Ok(None),
            };
            let front = match &inputs.front {
                Some(images) => Some(linear(matching(images, "front", &view.name, size)?, "front")?),
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
            if params.sharpness == Sharpness::Match {
                match sharpness::of_background(&background, &object, cx)?.map(sharpness::missing) {
                    Some(blur) if blur > LEAST_BLUR => {
                        object = Cow::Owned(sharpness::blurred(&object, blur, cx)?);
                        for layer in [&mut shadow, &mut added].into_iter().flatten() {
                            *layer = sharpness::blurred(layer, blur, cx)?;
                        }
                        blurs.push(blur);
                    }
                    _ => blurs.push(0.0),
                }
            }
            let layers = Layers { background: &background, object: &object, shadow, added, front, variance };
            let (image, lost) = params.view(&layers, cx)?;
            broken += lost;
            errors.push(NamedImage { name: view.name.clone(), picture: layers.error().into() });
            views.push(NamedImage { name: view.name.clone(), picture: image.into() });
        }
        let mut notes = Notes::none();
        if broken > 0 {
            notes.warning("not-finite", format!("samples that were not finite are black (count: {broken})"));
        }
        if let Some(most) = blurs.iter().copied().reduce(f64::max) {
            let least = blurs.iter().copied().fold(most, f64::min);
            let text =
                format!("the objects are blurred by {least:.2} to {most:.2} pixels, to match the background");
            notes.decision("sharpness", text);
        }
        Ok((Out { image: Arc::new(Images(views)), error: Arc::new(Images(errors)) }, notes))
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
mod tests {
    use super::*;
    use scene::types::Srgb;
    use testing::{context, row};

    fn one(picture: impl Into<Picture>) -> Arc<Images> {
        Arc::new(Images::single("v", picture))
    }

    fn run(backdrop: Option<[f64; 3]>, b: Picture, o: [f32; 4], s: [f32; 3]) -> Vec<f32> {
        let inputs = In {
            background: one(b),
            object: one(Image::<Linear>::from_samples(1, 1, 4, o.to_vec())),
            shadow: Some(one(Image::<Data>::from_samples(1, 1, 3, s.to_vec()))),
            added: None,
            front: None,
            variance: None,
        };
        let (out, _) = Composite::run(&Composite { backdrop, ..Composite::default() }, inputs, &context())
            .expect("runs");
        out.image.0[0].picture.samples().to_vec()
    }

    fn rgb(c: [f32; 3]) -> Picture {
        Image::<Linear>::from_samples(1, 1, 3, c.to_vec()).into()
    }

    /// The background stays the same bit for bit if there is no shadow.
    #[test]
    fn full_and_empty_masks_are_exact() {
        let (b, s) = ([0.1, 0.7, 3.3], [0.25, 0.5, 1.0]);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], s), [0.1 * 0.25, 0.7 * 0.5, 3.3]);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], [1.0; 3]), b);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.2, 0.3, 0.001, 1.0], s), [0.2, 0.3, 0.001]);
    }

    /// An object pixel whose alpha is 0 adds its light to the background, as a glow does.
    #[test]
    fn glow_is_added() {
        assert_eq!(run(None, rgb([0.5; 3]), [0.25, 0.0, 0.0, 0.0], [1.0; 3]), [0.75, 0.5, 0.5]);
    }

    /// A premultiplied object gives the same result as the formula for straight alpha.
    #[test]
    fn premultiplied_is_straight_times_alpha() {
        let (b, colour) = (0.4_f32, 0.7_f32);
        let error = (0..=20).map(|k| {
            let alpha = k as f32 / 20.0;
            let ours = run(None, rgb([b; 3]), [colour * alpha, 0.0, 0.0, alpha], [0.5; 3])[0];
            f64::from((ours - (b * 0.5 * (1.0 - alpha) + colour * alpha)).abs())
        });
        row(58, "difference of premultiplied and straight", error.fold(0.0, f64::max), 1e-6);
    }

    /// Holes show the backdrop or stay transparent, and the alpha of the result is given by the "over" operator.
    #[test]
    fn holes_show_the_backdrop_or_stay_open() {
        let half: Picture = Image::<Linear>::from_samples(1, 1, 4, vec![0.2, 0.2, 0.2, 0.5]).into();
        let over = run(Some([1.0, 0.0, 0.0]), half.clone(), [0.0; 4], [0.5; 3]);
        assert_eq!(over, [0.6, 0.1, 0.1]);
        let open = run(None, half, [0.1, 0.1, 0.1, 0.5], [1.0; 3]);
        assert_eq!(open, [0.2, 0.2, 0.2, 0.75]);
    }

    // Half-covered display-encoded pixels are decoded at their own colour, not at the colour darkened by alpha.
    #[test]
    fn encoded_colour_is_unpremultiplied_before_decoding() {
        let b: Picture = Image::<Srgb>::from_samples(1, 1, 4, vec![0.25, 0.25, 0.25, 0.5]).into();
        let out = run(Some([0.0; 3]), b, [0.0; 4], [1.0; 3]);
        assert!((out[0] - 0.5 * scene::math::color::linear_from_srgb(0.5)).abs() < 1e-7);
    }

    // Added light falls behind the object, and the result never goes below 0.
    #[test]
    fn light_is_added_under_the_object() {
        let data = |v: [f32; 3]| Some(one(Image::<Data>::from_samples(1, 1, 3, v.to_vec())));
        let inputs = In {
            background: one(rgb([0.5; 3])),
            object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.1, 0.1, 0.1, 0.5])),
            shadow: data([0.5; 3]),
            added: data([0.25, 0.0, -9.0]),
            front: None,
            variance: None,
        };
        let (out, _) =
            Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
                .expect("runs");
        let expected = [0.5 * 0.5 + 0.1, 0.25 * 0.5 + 0.1, 0.1];
        assert_eq!(out.image.0[0].picture.samples(), expected);
    }

    // The front layer covers the object by its alpha; elsewhere the background already contains it.
    #[test]
    fn the_front_is_laid_over_the_object_only() {
        let over = |alpha: f32, f: f32| {
            let inputs = In {
                background: one(rgb([0.5; 3])),
                object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.8 * alpha, 0.0, 0.0, alpha])),
                shadow: None,
                added: None,
                front: Some(one(Image::<Linear>::from_samples(1, 1, 4, vec![0.0, 0.3 * f, 0.0, f]))),
                variance: None,
            };
            let (out, _) =
                Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
                    .expect("runs");
            out.image.0[0].picture.samples().to_vec()
        };
        assert_eq!(over(1.0, 0.0), [0.8, 0.0, 0.0]);
        assert_eq!(over(1.0, 1.0), [0.0, 0.3, 0.0]);
        assert_eq!(over(0.0, 1.0), [0.5; 3]);
        assert_eq!(over(1.0, 0.5), [0.4, 0.15, 0.0]);
        assert_eq!(over(0.5, 1.0), [0.25, 0.25 + 0.15, 0.25]);
    }

    // The shadow and the light of objects fall on the background behind a railing, not on the railing, and the
    // front layer is limited to what the background contains.
    #[test]
    fn what_is_in_front_stands_in_no_shadow() {
        let data = |v: f32| Some(one(Image::<Data>::from_samples(1, 1, 3, vec![v; 3])));
        let railing = |f: [f32; 4], shadow: f32, added: f32| {
            let inputs = In {
                background: one(rgb([0.5; 3])),
                object: one(Image::<Linear>::new(1, 1, 4)),
                shadow: data(shadow),
                added: data(added),
                front: Some(one(Image::<Linear>::from_samples(1, 1, 4, f.to_vec()))),
                variance: None,
            };
            let (out, _) =
                Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
                    .expect("runs");
            out.image.0[0].picture.samples()[0]
        };
        assert_eq!(railing([0.125, 0.125, 0.125, 0.5], 0.5, 0.0), 0.375 * 0.5 + 0.125);
        assert_eq!(railing([0.5, 0.5, 0.5, 1.0], 0.0, 9.0), 0.5);
        assert_eq!(railing([0.7, 0.7, 0.7, 0.9], 0.1, 0.0), 0.5);
        assert_eq!(railing([0.1, 0.1, 0.1, 0.3], 1.0, 0.0), 0.5);
        assert_eq!(railing([0.25, 0.25, 0.25, 0.5], 1.0, -9.0), 0.25);
    }

    // The object covers half of the pixel, so half of the error of the background's ratio remains. The error of the
    // object is added, reduced by a quarter because of the front layer.
    #[test]
    fn the_error_is_that_of_the_ratio_and_of_the_object() {
        let data = |v: Vec<f32>| one(Image::<Data>::from_samples(1, 1, v.len(), v));
        let inputs = |variance| In {
            background: one(rgb([0.8; 3])),
            object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.1, 0.1, 0.1, 0.5])),
            shadow: Some(data(vec![0.5; 3])),
            added: None,
            front: Some(one(Image::<Linear>::from_samples(1, 1, 4, vec![0.0, 0.0, 0.0, 0.25]))),
            variance,
        };
        let run = |variance| {
            Composite::run(
                &Composite { backdrop: None, ..Composite::default() },
                inputs(variance),
                &context(),
            )
        };
        let error = |variance| run(variance).expect("runs").0.error.0[0].picture.samples()[0];
        let reported = data(vec![9.0, 9.0, 0.04, 0.09]);
        let expected = (0.12_f32 * 0.12 + 0.15 * 0.15).sqrt();
        assert!((error(Some(reported)) - expected).abs() < 1e-6);
        assert_eq!(error(None), 0.0);
        let wrong = run(Some(data(vec![0.0; 3]))).err().expect("channels");
        assert!(wrong.message().contains("but has 3"), "{wrong}");
    }

    #[test]
    fn views_of_another_size_are_refused() {
        let inputs = In {
            background: one(Image::<Linear>::new(2, 1, 3)),
            object: one(Image::<Linear>::new(1, 1, 4)),
            shadow: None,
            added: None,
            front: None,
            variance: None,
        };
        let error = Composite::run(&Composite { backdrop: None, ..Composite::default() }, inputs, &context())
            .err()
            .expect("sizes");
        assert!(error.message().contains("1x1"), "{error}");
    }
}

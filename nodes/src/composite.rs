//! `composite`: the background, darkened by the shadow, under the inserted objects.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes};

use crate::layers::{linear, matching};
use crate::types::{Image, Images, Linear, NamedImage};

engine::params! {
    /// Puts the rendered objects over the background, which the shadow darkens first.
    ///
    /// In linear light and per pixel `(B * S + A) * (1 - M) + O`, where `B` is the background, `S` the shadow,
    /// `A` added light, `O` the object premultiplied by its alpha `M`. A splat render is un-premultiplied before it is decoded.
    /// Holes of the background show `backdrop`; with `backdrop: None` they stay transparent.
    pub struct Composite {
        /// Linear colour behind the holes of the background; `None` keeps the alpha channel.
        backdrop: Option<[f64; 3]> = Some([0.0; 3]), range(0.0, 1e6), other("(0.5, 0.25, 1.0)");
    }
}

engine::inputs! {
    /// Inputs of [`Composite`].
    pub struct In {
        /// What the camera sees without the objects; a splat render or a photograph.
        background: Arc<Images>,
        /// The objects, linear, premultiplied, with alpha.
        object: Arc<Images>,
        /// Factor of the background for each channel; without it there is no shadow.
        shadow: Option<Arc<Images>>,
        /// Light that the objects give to the background, or take where it is negative; by `shadow-ratio`.
        added: Option<Arc<Images>>,
    }
}

engine::outputs! {
    /// Outputs of [`Composite`].
    pub struct Out {
        /// The picture, linear; RGB over the backdrop, or premultiplied RGBA without one.
        image: Arc<Images>,
    }
}

impl Composite {
    fn view(
        &self,
        background: &Image<Linear>,
        object: &Image<Linear>,
        shadow: Option<&Image<Linear>>,
        added: Option<&Image<Linear>>,
        broken: &mut u64,
    ) -> Image<Linear> {
        let (width, height) = (background.width, background.height);
        let keep_alpha = self.backdrop.is_none() && background.channels == 4;
        let mut out = Image::new(width, height, if keep_alpha { 4 } else { 3 });
        for y in 0..height {
            for x in 0..width {
                let b = background.pixel(x, y);
                let o = object.pixel(x, y);
                let behind = if background.channels == 4 { b[3] } else { 1.0 };
                let cover = if object.channels == 4 { o[3] } else { 1.0 };
                let pixel = out.pixel_mut(x, y);
                for c in 0..3 {
                    let factor = shadow.map_or(1.0, |s| s.pixel(x, y)[c]);
                    let mut under = b[c] * factor;
                    if let Some(added) = added {
                        under = (under + added.pixel(x, y)[c] * behind).max(0.0);
                    }
                    if let (Some(backdrop), true) = (self.backdrop, behind < 1.0) {
                        under += (1.0 - behind) * backdrop[c] as f32;
                    }
                    let value = under * (1.0 - cover) + o[c];
                    *broken += u64::from(!value.is_finite());
                    pixel[c] = if value.is_finite() { value } else { 0.0 };
                }
                if keep_alpha {
                    let alpha = behind * (1.0 - cover) + cover;
                    pixel[3] = if alpha.is_finite() { alpha } else { 0.0 };
                }
            }
        }
        out
    }
}

impl Kind for Composite {
    const NAME: &'static str = "composite";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut broken = 0;
        let mut views = Vec::with_capacity(inputs.background.0.len());
        for view in &inputs.background.0 {
            cx.check()?;
            let background = linear(&view.picture, "background")?;
            let size = (background.width, background.height);
            let object = linear(matching(&inputs.object, "object", &view.name, size)?, "object")?;
            let shadow = match &inputs.shadow {
                Some(images) => Some(factors(matching(images, "shadow", &view.name, size)?)?),
                None => None,
            };
            let added = match &inputs.added {
                Some(images) => Some(factors(matching(images, "added", &view.name, size)?)?),
                None => None,
            };
            let image = params.view(&background, &object, shadow.as_ref(), added.as_ref(), &mut broken);
            views.push(NamedImage { name: view.name.clone(), picture: image.into() });
        }
        let mut notes = Notes::none();
        if broken > 0 {
            notes.warning("not-finite", format!("{broken} samples were not finite and are black"));
        }
        Ok((Out { image: Arc::new(Images(views)) }, notes))
    }
}

/// The shadow as plain factors, whatever encoding it is tagged with: it is no colour.
fn factors(picture: &crate::types::Picture) -> Result<Image<Linear>, NodeError> {
    let (width, height, channels) = picture.size();
    match channels {
        3.. => Ok(Image::from_samples(width, height, channels, picture.samples().to_vec())),
        1 => {
            let samples = picture.samples().iter().flat_map(|&v| [v; 3]).collect();
            Ok(Image::from_samples(width, height, 3, samples))
        }
        _ => Err(NodeError::new(format!("a shadow has 1 or 3 channels, not {channels}")).at("shadow")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;
    use crate::types::{Data, Picture, Srgb};

    fn one(picture: impl Into<Picture>) -> Arc<Images> {
        Arc::new(Images::single("v", picture))
    }

    fn run(backdrop: Option<[f64; 3]>, b: Picture, o: [f32; 4], s: [f32; 3]) -> Vec<f32> {
        let inputs = In {
            background: one(b),
            object: one(Image::<Linear>::from_samples(1, 1, 4, o.to_vec())),
            shadow: Some(one(Image::<Data>::from_samples(1, 1, 3, s.to_vec()))),
            added: None,
        };
        let (out, _) = Composite::run(&Composite { backdrop }, inputs, &context()).expect("runs");
        out.image.0[0].picture.samples().to_vec()
    }

    fn rgb(c: [f32; 3]) -> Picture {
        Image::<Linear>::from_samples(1, 1, 3, c.to_vec()).into()
    }

    // Row 56, and no shadow leaves the background bit for bit.
    #[test]
    fn full_and_empty_masks_are_exact() {
        let (b, s) = ([0.1, 0.7, 3.3], [0.25, 0.5, 1.0]);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], s), [0.1 * 0.25, 0.7 * 0.5, 3.3]);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.0; 4], [1.0; 3]), b);
        assert_eq!(run(Some([0.0; 3]), rgb(b), [0.2, 0.3, 9.0, 1.0], s), [0.2, 0.3, 9.0]);
    }

    // Row 57: light with no coverage (a glow) is added.
    #[test]
    fn glow_is_added() {
        assert_eq!(run(None, rgb([0.5; 3]), [0.25, 0.0, 0.0, 0.0], [1.0; 3]), [0.75, 0.5, 0.5]);
    }

    // Row 59: holes show the backdrop or stay open, and the alpha that leaves is that of "over".
    #[test]
    fn holes_show_the_backdrop_or_stay_open() {
        let half: Picture = Image::<Linear>::from_samples(1, 1, 4, vec![0.2, 0.2, 0.2, 0.5]).into();
        let over = run(Some([1.0, 0.0, 0.0]), half.clone(), [0.0; 4], [0.5; 3]);
        assert_eq!(over, [0.6, 0.1, 0.1]);
        let open = run(None, half, [0.1, 0.1, 0.1, 0.5], [1.0; 3]);
        assert_eq!(open, [0.2, 0.2, 0.2, 0.75]);
    }

    // Half-covered display-encoded pixels are decoded at their own colour, not at the darkened one.
    #[test]
    fn encoded_colour_is_unpremultiplied_before_decoding() {
        let b: Picture = Image::<Srgb>::from_samples(1, 1, 4, vec![0.25, 0.25, 0.25, 0.5]).into();
        let out = run(Some([0.0; 3]), b, [0.0; 4], [1.0; 3]);
        assert!((out[0] - 0.5 * crate::color::linear_from_srgb(0.5)).abs() < 1e-7);
    }

    // Added light falls on what is behind the object, and no more is taken than there is.
    #[test]
    fn light_is_added_under_the_object() {
        let data = |v: [f32; 3]| Some(one(Image::<Data>::from_samples(1, 1, 3, v.to_vec())));
        let inputs = In {
            background: one(rgb([0.5; 3])),
            object: one(Image::<Linear>::from_samples(1, 1, 4, vec![0.1, 0.1, 0.1, 0.5])),
            shadow: data([0.5; 3]),
            added: data([0.25, 0.0, -9.0]),
        };
        let (out, _) = Composite::run(&Composite { backdrop: None }, inputs, &context()).expect("runs");
        let expected = [0.5 * 0.5 + 0.1, 0.25 * 0.5 + 0.1, 0.1];
        assert_eq!(out.image.0[0].picture.samples(), expected);
    }

    #[test]
    fn views_of_another_size_are_refused() {
        let inputs = In {
            background: one(Image::<Linear>::new(2, 1, 3)),
            object: one(Image::<Linear>::new(1, 1, 4)),
            shadow: None,
            added: None,
        };
        let error = Composite::run(&Composite { backdrop: None }, inputs, &context()).err().expect("sizes");
        assert!(error.message().contains("1x1"), "{error}");
    }
}

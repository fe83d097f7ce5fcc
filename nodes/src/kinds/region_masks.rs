//! `region-masks`: masks of the object, its shadow and the rest.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, ViewCount, Wired};
use scene::math::color::srgb_from_linear;
use scene::types::layers::{linear, matching};
use scene::types::{Data, Image, Images, NamedImage, Picture};

engine::params! {
    /// Divides a picture into the object, its shadow and the rest, for `compare`.
    ///
    /// The shadow region consists of the pixels outside the object where the `shadow` factor differs from 1, or
    /// where `with` and `without` differ in display values. Light that the object reflects onto the background
    /// counts as shadow too. The contact band lies just below the lower edge of the object.
    pub struct RegionMasks {
        /// Alpha above which a pixel belongs to the object.
        object_threshold: f64 = 0.5, range(0, 1), other("0.1");
        /// Largest alpha at which a pixel can belong to the shadow or the rest. Pixels of soft edges, whose alpha
        /// is between this value and `object_threshold`, belong to no region.
        edge_threshold: f64 = 0.0, range(0, 1), other("0.5");
        /// Minimum change of a channel for a pixel to belong to the shadow: between `with` and `without`, the
        /// difference in display values; in `shadow`, the difference between the ratio and 1.
        shadow_threshold: f64 = 0.02, range(0, 1), other("0.3");
        /// Height of the contact band, as a fraction of the object's height in the picture.
        contact: f64 = 0.05, range(0, 1), other("0.5");
    }
}
engine::inputs! {
    /// Pictures to divide.
    pub struct In {
        /// The object: the last channel is alpha, or the only channel is a mask.
        object: Arc<Images>,
        /// Shadow factor of the background, from `shadow-ratio`.
        shadow: Option<Arc<Images>>,
        /// Picture of the scene without the object.
        without: Option<Arc<Images>>,
        /// Picture of the scene with the object.
        with: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Masks of one channel: 1 inside the region, 0 outside.
    pub struct Out {
        /// Pixels of the object.
        object: Arc<Images>,
        /// Pixels of the object's shadow.
        shadow: Arc<Images>,
        /// Pixels that are neither object, soft edge nor shadow.
        rest: Arc<Images>,
        /// Pixels of the contact band.
        contact: Arc<Images>,
    }
}

impl Kind for RegionMasks {
    const NAME: &'static str = "region-masks";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.edge_threshold > p.object_threshold {
            return Err(NodeError::new("`edge_threshold` cannot exceed `object_threshold`")
                .at("edge_threshold")
                .hint("lower `edge_threshold` or raise `object_threshold`"));
        }
        Ok(())
    }

    fn check_wires(_: &Self, wired: &Wired) -> Result<(), NodeError> {
        check_shadow(["shadow", "with", "without"].map(|input| !wired.of(input).is_empty()))
    }

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["object"])
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let given = [inputs.shadow.is_some(), inputs.with.is_some(), inputs.without.is_some()];
        check_shadow(given)?;
        if inputs.shadow.is_none() && inputs.with.is_none() {
            notes.decision(
                "no-shadow-known",
                "the shadow region is empty, since neither `shadow` nor `with` and `without` are wired",
            );
        }
        let mut masks: [Vec<NamedImage>; 4] = Default::default();
        for view in &inputs.object.0 {
            cx.check()?;
            let (width, height, channels) = view.picture.size();
            if !matches!(channels, 1 | 2 | 4) || width == 0 || height == 0 {
                let what = format!("`{}` has no alpha channel (channels: {channels})", view.name);
                return Err(NodeError::new(what).at("object").hint("give a picture with alpha, or a mask"));
            }
            let alpha: Vec<f64> = view
                .picture
                .samples()
                .chunks_exact(channels)
                .map(|pixel| f64::from(pixel[channels - 1]))
                .collect();
            let change = match (&inputs.shadow, &inputs.without, &inputs.with) {
                (Some(shadow), _, _) => from_factor(matching(shadow, "shadow", &view.name, (width, height))?),
                (None, Some(without), Some(with)) => from_pair(
                    matching(without, "without", &view.name, (width, height))?,
                    matching(with, "with", &view.name, (width, height))?,
                )?,
                _ => vec![0.0; width * height],
            };
            let object: Vec<bool> = alpha.iter().map(|a| *a > p.object_threshold).collect();
            let clear = |i: usize| alpha[i] <= p.edge_threshold;
            let shadow: Vec<bool> =
                (0..alpha.len()).map(|i| clear(i) && change[i] > p.shadow_threshold).collect();
            let rest: Vec<bool> = (0..alpha.len()).map(|i| clear(i) && !shadow[i]).collect();
            let contact = contact_band(&object, width, height, p.contact);
            for (list, mask) in masks.iter_mut().zip([&object, &shadow, &rest, &contact]) {
                let samples = mask.iter().map(|inside| f32::from(u8::from(*inside))).collect();
                let image = Image::<Data>::from_samples(width, height, 1, samples);
                list.push(NamedImage { name: view.name.clone(), picture: image.into() });
            }
        }
        let [object, shadow, rest, contact] = masks.map(|list| Arc::new(Images(list)));
        Ok((Out { object, shadow, rest, contact }, notes))
    }
}

/// Checks that at most one source of the shadow is wired, and that `with` and `without` are either both wired or
/// both unwired.
fn check_shadow([shadow, with, without]: [bool; 3]) -> Result<(), NodeError> {
    if with != without {
        return Err(NodeError::new("`with` and `without` must both be wired, or neither").at(if with {
            "with"
        } else {
            "without"
        }));
    }
    if shadow && with {
        let what = "the shadow comes either from `shadow` or from `with` and `without`, not from both";
        return Err(NodeError::new(what).at("shadow"));
    }
    Ok(())
}

/// For each pixel, the largest difference of a channel of the factor from 1.
fn from_factor(factor: &Picture) -> Vec<f64> {
    let colours = if factor.size().2 == 4 { 3 } else { factor.size().2.max(1) };
    let largest =
        |pixel: &[f32]| pixel[..colours].iter().map(|f| (1.0 - f64::from(*f)).abs()).fold(0.0, f64::max);
    factor.samples().chunks_exact(factor.size().2.max(1)).map(largest).collect()
}

/// For each pixel, the largest change of a channel, in display values that are clamped to 0 to 1.
fn from_pair(without: &Picture, with: &Picture) -> Result<Vec<f64>, NodeError> {
    let (a, b) = (shown(without, "without")?, shown(with, "with")?);
    let largest =
        |(a, b): (&[f64; 3], &[f64; 3])| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    Ok(a.iter().zip(&b).map(largest).collect())
}

fn shown(picture: &Picture, port: &'static str) -> Result<Vec<[f64; 3]>, NodeError> {
    if let Picture::Srgb(image) = picture
        && image.channels == 3
    {
        return Ok(image
            .samples
            .as_chunks::<3>()
            .0
            .iter()
            .map(|p| p.map(|v| f64::from(v).clamp(0.0, 1.0)))
            .collect());
    }
    let image = linear(picture, port)?;
    let display = |v: f32| f64::from(srgb_from_linear(v)).clamp(0.0, 1.0);
    Ok(image
        .samples
        .chunks_exact(image.channels)
        .map(|p| [display(p[0]), display(p[1]), display(p[2])])
        .collect())
}

/// Pixels of the contact band: in each column, the pixels directly below the lowest pixel of the object.
fn contact_band(object: &[bool], width: usize, height: usize, share: f64) -> Vec<bool> {
    let mut band = vec![false; object.len()];
    let filled = |y: &usize| object[y * width..(y + 1) * width].contains(&true);
    let (Some(top), Some(bottom)) = ((0..height).find(filled), (0..height).rev().find(filled)) else {
        return band;
    };
    let deep = (share * (bottom - top + 1) as f64).round() as usize;
    for x in 0..width {
        if let Some(lowest) = (0..height).rev().find(|y| object[y * width + x]) {
            for y in lowest + 1..(lowest + 1 + deep).min(height) {
                band[y * width + x] = true;
            }
        }
    }
    band
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Srgb;
    use testing::context;

    fn one(picture: impl Into<Picture>) -> Arc<Images> {
        Arc::new(Images::single("v", picture))
    }
    fn node() -> RegionMasks {
        RegionMasks { object_threshold: 0.5, edge_threshold: 0.0, shadow_threshold: 0.02, contact: 0.5 }
    }
    fn object() -> Arc<Images> {
        // A column of object, a soft edge, and two clear columns; the lowest two rows are clear.
        let alpha = [[1.0, 0.3, 0.0, 0.0], [1.0, 0.3, 0.0, 0.0], [0.0; 4], [0.0; 4]];
        one(Image::<Data>::from_samples(4, 4, 1, alpha.as_flattened().to_vec()))
    }
    fn mask(images: &Images) -> Vec<usize> {
        let samples = images.0[0].picture.samples();
        samples.iter().enumerate().filter(|(_, v)| **v == 1.0).map(|(i, _)| i).collect()
    }

    #[test]
    fn regions_do_not_overlap_and_edges_belong_to_none() {
        let mut factor = vec![1.0; 48];
        factor[0] = 0.2; // below the object: no shadow
        factor[3] = 0.2; // in the soft edge: no shadow
        factor[7] = 0.9; // column 2: shadow
        factor[11] = 1.1; // column 3: light thrown back
        let shadow = one(Image::<Data>::from_samples(4, 4, 3, factor));
        let inputs = In { object: object(), shadow: Some(shadow), without: None, with: None };
        let (out, _) = RegionMasks::run(&node(), inputs, &context()).expect("runs");
        assert_eq!((mask(&out.object), mask(&out.shadow)), (vec![0, 4], vec![2, 3]));
        assert_eq!(mask(&out.rest), (6..16).collect::<Vec<_>>());
        assert_eq!(mask(&out.contact), vec![8], "half of two rows, below the lowest");
    }

    #[test]
    fn a_pair_differs_on_the_display() {
        let without = one(Image::<Srgb>::from_samples(4, 4, 3, vec![0.5; 48]));
        let mut samples = vec![0.5; 48];
        samples[3 * 10 + 1] = 0.47;
        samples[3 * 15] = 0.485;
        let with = one(Image::<Srgb>::from_samples(4, 4, 3, samples));
        let inputs = In { object: object(), shadow: None, without: Some(without.clone()), with: Some(with) };
        let (out, _) = RegionMasks::run(&node(), inputs, &context()).expect("runs");
        assert_eq!(mask(&out.shadow), vec![10]);
        let half = In { object: object(), shadow: None, without: Some(without), with: None };
        assert!(RegionMasks::run(&node(), half, &context()).is_err());
    }

    #[test]
    fn no_object_and_no_shadow_is_all_rest() {
        let empty = one(Image::<Data>::new(3, 2, 1));
        let inputs = In { object: empty, shadow: None, without: None, with: None };
        let (out, notes) = RegionMasks::run(&node(), inputs, &context()).expect("runs");
        assert_eq!(mask(&out.rest).len(), 6);
        assert!(notes.iter().any(|n| n.id == "no-shadow-known"));
    }
}

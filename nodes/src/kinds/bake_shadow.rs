//! `bake-shadow`: splats that carry the shadow of the inserted objects in their colours.

use std::sync::Arc;

use engine::{Artifact, Context, Cost, Kind, NodeError, Notes};
use render::transport::picture::splat_rays::SplatPixels;
use scene::io::splats::SH_C0;
use scene::math::color::{linear_from_srgb, srgb_from_linear};
use scene::types::{Data, Image, Images, Picture, SplatEncoding, Splats};

engine::params! {
    /// Multiplies the colours of splats by the shadow of the inserted objects, so that viewers of splats show the
    /// shadow from every direction.
    ///
    /// The shadow is traced at each splat: give `path-trace` the splats as `points`, and its outputs `without` and
    /// `with` to `shadow-ratio`. The ratio belongs to linear light: the mean colour of a splat is decoded, multiplied,
    /// and encoded again, and the part of its colour that depends on the direction is scaled by the same factor. Splats
    /// that do not lie on the receiver keep their colours. `write-splats` writes the result.
    pub struct BakeShadow {
        /// Strength of the shadow; 0 leaves the splats unchanged.
        strength: f64 = 1.0, range(0.0, 1.0), other("0.5");
    }
}
engine::inputs! {
    /// Inputs of [`BakeShadow`].
    pub struct In {
        /// The splats, the same as `points` of `path-trace`.
        splats: Arc<Splats>,
        /// The ratio at each splat, from `shadow-ratio`.
        shadow: Arc<Images>,
    }
}
engine::outputs! {
    /// Outputs of [`BakeShadow`].
    pub struct Out {
        /// The splats with the shadow.
        splats: Arc<Splats>,
    }
}

impl Kind for BakeShadow {
    const NAME: &'static str = "bake-shadow";
    const VERSION: u32 = 2;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_: &Self, In { splats, .. }: &In) -> Cost {
        Cost { bytes: (splats.bytes() + 24 * splats.len()) as u64 }
    }

    fn run(p: &Self, In { splats, shadow }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let pixels = SplatPixels::of(&splats);
        let ratio = of_splats(&shadow, &pixels, splats.len())?;
        let mut baked = (*splats).clone();
        let width = splats.sh_len();
        let mut changed = 0_u64;
        for (splat, (x, y)) in pixels.iter() {
            if splat % 65_536 == 0 {
                cx.check()?;
            }
            let channels = ratio.channels;
            let at = (y as usize * ratio.width + x as usize) * channels;
            let ratio: [f32; 3] = std::array::from_fn(|c| ratio.samples[at + c.min(channels - 1)]);
            let factor = ratio.map(|ratio| 1.0 + p.strength as f32 * (ratio - 1.0));
            if factor == [1.0; 3] {
                continue;
            }
            changed += 1;
            let sh = &mut baked.sh[splat * width..(splat + 1) * width];
            for (channel, factor) in factor.into_iter().enumerate() {
                shade(sh, channel, factor, splats.encoding);
            }
        }
        cx.count("splats_changed", changed);
        let mut notes = Notes::none();
        if changed == 0 {
            let text =
                "the shadow changes no splat; is the object on the receiver, and do the splats lie on it?";
            notes.warning("no-shadow", text);
        }
        Ok((Out { splats: Arc::new(baked) }, notes))
    }
}

/// The only picture of the ratio, if its pixels are those of the splats.
fn of_splats<'s>(
    shadow: &'s Images,
    pixels: &SplatPixels,
    count: usize,
) -> Result<&'s Image<Data>, NodeError> {
    let picture = match &shadow.0[..] {
        [only] if only.name == pixels.name() => match &only.picture {
            Picture::Data(image) => Some(image),
            _ => None,
        },
        _ => None,
    };
    let (width, height) = (pixels.size.0 as usize, pixels.size.1 as usize);
    let fits = |image: &&Image<Data>| (image.width, image.height) == (width, height);
    picture.filter(fits).ok_or_else(|| {
        let text = format!("`shadow` must be one ratio, traced at these {count} splats");
        let hint = "give the same splats to `points` of `path-trace`, and its `without` and `with` to `shadow-ratio`";
        NodeError::new(text).at("shadow").hint(hint)
    })
}

/// Multiplies one channel of the light of a splat by a factor. Its mean colour is multiplied as linear light.
fn shade(sh: &mut [[f32; 3]], channel: usize, factor: f32, encoding: SplatEncoding) {
    let base = SH_C0 as f32;
    let Some((mean, others)) = sh.split_first_mut() else { return };
    let colour = 0.5 + base * mean[channel];
    let scale = if colour <= 0.0 || encoding == SplatEncoding::Linear {
        factor
    } else {
        srgb_from_linear(factor * linear_from_srgb(colour)) / colour
    };
    mean[channel] = (scale * colour - 0.5) / base;
    others.iter_mut().for_each(|coefficient| coefficient[channel] *= scale);
}

#[cfg(test)]
mod tests {
    use scene::types::NamedImage;
    use testing::context;

    use super::*;

    fn scene(encoding: SplatEncoding) -> Splats {
        let mut scene = Splats::empty();
        (scene.sh_degree, scene.encoding) = (1, encoding);
        for i in 0..100 {
            scene.means.push([(i % 10) as f32, (i / 10) as f32, 0.0]);
            scene.scales.push([0.1; 3]);
            scene.quats.push([1.0, 0.0, 0.0, 0.0]);
            scene.opacities.push(0.5);
            scene.sh.extend([[0.5, -0.2, 0.9], [0.1; 3], [0.2; 3], [-0.1; 3]]);
        }
        scene
    }

    /// A ratio that differs from 1 at the splats with the given indices.
    fn ratio(scene: &Splats, dark: &[usize], value: [f32; 3]) -> Arc<Images> {
        let pixels = SplatPixels::of(scene);
        let (width, height) = (pixels.size.0 as usize, pixels.size.1 as usize);
        let mut image = Image::<Data>::from_samples(width, height, 3, vec![1.0; 3 * width * height]);
        for (splat, (x, y)) in pixels.iter().filter(|(splat, _)| dark.contains(splat)) {
            assert!(splat < scene.len());
            let at = 3 * (y as usize * width + x as usize);
            image.samples[at..at + 3].copy_from_slice(&value);
        }
        Arc::new(Images(vec![NamedImage { name: pixels.name(), picture: image.into() }]))
    }

    fn bake(scene: &Splats, shadow: Arc<Images>, strength: f64) -> Result<Arc<Splats>, NodeError> {
        let inputs = In { splats: Arc::new(scene.clone()), shadow };
        BakeShadow::run(&BakeShadow { strength }, inputs, &context()).map(|(out, _)| out.splats)
    }

    /// Exactly the splats in shadow change, and their linear light by the ratio. This test fails if the ratio is applied
    /// to the encoded colours.
    #[test]
    fn light_is_multiplied_where_the_shadow_is() {
        for encoding in [SplatEncoding::Srgb, SplatEncoding::Linear] {
            let scene = scene(encoding);
            let factor = [0.25, 0.5, 1.0];
            let baked = bake(&scene, ratio(&scene, &[3, 77], factor), 1.0).expect("runs");
            let light = |splats: &Splats, i: usize, c: usize| {
                let colour = 0.5 + SH_C0 as f32 * splats.sh[4 * i][c];
                if encoding == SplatEncoding::Srgb { linear_from_srgb(colour) } else { colour }
            };
            for i in 0..scene.len() {
                for (c, factor) in factor.into_iter().enumerate() {
                    let wanted = if [3, 77].contains(&i) { factor } else { 1.0 } * light(&scene, i, c);
                    assert!((light(&baked, i, c) - wanted).abs() < 1e-6, "{i} {c}");
                }
            }
            assert_eq!(baked.sh[..12], scene.sh[..12], "splats in the light keep their bits");
            assert!(baked.sh[13][0] < scene.sh[13][0] && baked.sh[13][2] == scene.sh[13][2]);
            let half = bake(&scene, ratio(&scene, &[3], [0.5; 3]), 0.5).expect("runs");
            assert!((light(&half, 3, 0) / light(&scene, 3, 0) - 0.75).abs() < 1e-5);
        }
    }

    #[test]
    fn a_ratio_of_other_splats_is_refused() {
        let scene = scene(SplatEncoding::Srgb);
        let (mut fewer, mut moved) = (scene.clone(), scene.clone());
        fewer.means.truncate(60);
        moved.means.reverse();
        for other in [fewer, moved] {
            let error = bake(&scene, ratio(&other, &[], [1.0; 3]), 1.0).expect_err("is refused");
            assert!(error.message().contains("these 100 splats"), "{error}");
        }
    }
}

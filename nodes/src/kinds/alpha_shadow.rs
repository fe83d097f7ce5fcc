//! `alpha-shadow`: the shadow as a grey mask over the picture, for comparison.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, ViewCount};
use scene::math::color::{linear_from_srgb, luminance};
use scene::types::layers::{linear, matching};
use scene::types::{Data, Image, Images, NamedImage};

engine::params! {
    /// Makes the shadow in the way that alpha compositing of a grey mask would, instead of from a ratio of light.
    /// The paper evaluates this variant in an ablation.
    ///
    /// The mask is the fraction of luminance that the objects take away. An image editor composites it as black
    /// over the displayed picture, without converting to linear light. This node outputs a factor in linear light
    /// instead, chosen so that a white pixel gets the same value as in the editor. Darker pixels become darker than
    /// in the editor: under a mask of 0.5, code 128 becomes 61 instead of 64, and code 26 becomes 7 instead of 13.
    /// The shadows are too dark and have no colour. For real work use `shadow-ratio`, which can replace this node
    /// in a graph.
    pub struct AlphaShadow {
        /// Opacity of the mask.
        strength: f64 = 1.0, range(0.0, 1.0), other("0.5");
    }
}

engine::inputs! {
    /// Inputs of [`AlphaShadow`].
    pub struct In {
        /// Render of the receiver without the objects (R0).
        without: Arc<Images>,
        /// Render of the receiver with the objects, which are invisible to the camera (R1).
        with: Arc<Images>,
    }
}

engine::outputs! {
    /// Outputs of [`AlphaShadow`].
    pub struct Out {
        /// Factor by which the linear light of the background is multiplied. It is the same in each channel.
        shadow: Arc<Images>,
    }
}

impl Kind for AlphaShadow {
    const NAME: &'static str = "alpha-shadow";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["without"])
    }

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut views = Vec::with_capacity(inputs.without.0.len());
        for view in &inputs.without.0 {
            cx.check()?;
            let without = linear(&view.picture, "without")?;
            let (width, height) = (without.width, without.height);
            let with = linear(matching(&inputs.with, "with", &view.name, (width, height))?, "with")?;
            let mut shadow = Image::<Data>::new(width, height, 3);
            for y in 0..height {
                for x in 0..width {
                    let (a, b) = (luminance(without.rgb(x, y)), luminance(with.rgb(x, y)));
                    let left = if a > 0.0 && (b / a).is_finite() { (b / a).clamp(0.0, 1.0) } else { 1.0 };
                    // Black over an encoded value v leaves v * (1 - alpha); for white that is this factor.
                    let factor = linear_from_srgb(1.0 - params.strength as f32 * (1.0 - left));
                    shadow.pixel_mut(x, y).fill(factor);
                }
            }
            views.push(NamedImage { name: view.name.clone(), picture: shadow.into() });
        }
        Ok((Out { shadow: Arc::new(Images(views)) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Linear;
    use testing::context;

    #[test]
    fn mask_is_grey_and_deeper_than_the_light_lost() {
        let image =
            |v: [f32; 6]| Arc::new(Images::single("v", Image::<Linear>::from_samples(2, 1, 3, v.to_vec())));
        let inputs = In { without: image([0.5; 6]), with: image([0.5, 0.5, 0.5, 0.1, 0.25, 0.4]) };
        let (out, _) = AlphaShadow::run(&AlphaShadow { strength: 1.0 }, inputs, &context()).expect("runs");
        let s = out.shadow.0[0].picture.samples();
        assert_eq!(s[..3], [1.0; 3]);
        assert!(s[3] == s[4] && s[4] == s[5] && s[4] < 0.4, "{s:?}");
    }
}

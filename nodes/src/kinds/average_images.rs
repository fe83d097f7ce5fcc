//! `average-images`: one picture from several of the same view, such as the moments of a shutter.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes, ViewCount};
use scene::types::layers::{coloured, linear_on, matching};
use scene::types::{Data, Image, Images, Linear, NamedImage, Picture};

engine::choices! {
    /// How pictures are combined.
    pub enum Combination {
        /// The mean of each sample, in linear light. With alpha it is the mean of premultiplied colours.
        Mean,
        /// The variance of the mean, from the variances of independent pictures: their sum divided by the square of their
        /// number.
        Variance,
        /// The least value of each sample, such as the nearest depth.
        Least,
    }
}
engine::params! {
    /// Combines several pictures of each view, such as the moments of an open shutter, into one.
    ///
    /// For motion blur, trace the scene at several moments along an axis, gather `without`, `with` and `object` of
    /// `path-trace`, and average each of them; the ratio of the averages is the shadow of the moving objects. See
    /// `docs/motion.md`.
    pub struct AverageImages {
        /// How the pictures are combined.
        how: Combination = Combination::Mean, other("Least");
    }
}
engine::inputs! {
    /// Inputs of [`AverageImages`].
    pub struct In {
        /// The pictures, which must have the same views and sizes.
        images: Vec<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`AverageImages`].
    pub struct Out {
        /// One picture per view: linear light, or data if the pictures are data.
        image: Arc<Images>,
    }
}

impl Kind for AverageImages {
    const NAME: &'static str = "average-images";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["images"])
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        // Sums in f64, the result, and one picture in linear light.
        let first = inputs.images.iter().take(1).flat_map(|images| &images.0);
        Cost::of(first.map(|view| (view.picture.samples().len() as u64, 16)))
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let Some(first) = inputs.images.first() else {
            return Err(NodeError::new("there is no picture to average").at("images").hint("wire pictures"));
        };
        let mut views = Vec::with_capacity(first.0.len());
        for view in &first.0 {
            let (width, height, channels) = coloured(&view.picture).size();
            let is_data = matches!(view.picture, Picture::Data(_));
            let mut sums = vec![p.start(); width * height * channels];
            for images in &inputs.images {
                cx.check()?;
                let picture = matching(images, "images", &view.name, (width, height))?;
                p.add(&mut sums, picture, (channels, is_data), cx)?;
            }
            let count = inputs.images.len() as f64;
            let samples = sums.into_iter().map(|sum| p.finish(sum, count) as f32).collect();
            let picture = match is_data {
                true => Image::<Data>::from_samples(width, height, channels, samples).into(),
                false => Image::<Linear>::from_samples(width, height, channels, samples).into(),
            };
            views.push(NamedImage { name: view.name.clone(), picture });
        }
        Ok((Out { image: Arc::new(Images(views)) }, Notes::none()))
    }
}

impl AverageImages {
    fn start(&self) -> f64 {
        if self.how == Combination::Least { f64::INFINITY } else { 0.0 }
    }

    /// Adds a picture to the sums. `channels` and `is_data` are those of the first picture.
    fn add(
        &self,
        sums: &mut [f64],
        picture: &Picture,
        (channels, is_data): (usize, bool),
        cx: &Context,
    ) -> Result<(), NodeError> {
        let light;
        let samples = if let Picture::Data(data) = picture {
            &data.samples
        } else {
            light = linear_on(picture, "images", cx)?;
            &light.samples
        };
        if samples.len() != sums.len() || matches!(picture, Picture::Data(_)) != is_data {
            let what =
                format!("the pictures must all be colours, or all data, with {channels} channels each");
            return Err(NodeError::new(what).at("images").hint("gather one output of one node"));
        }
        for (sum, value) in sums.iter_mut().zip(samples) {
            *sum = match self.how {
                Combination::Mean | Combination::Variance => *sum + f64::from(*value),
                Combination::Least => sum.min(f64::from(*value)),
            };
        }
        Ok(())
    }

    fn finish(&self, sum: f64, count: f64) -> f64 {
        match self.how {
            Combination::Mean => sum / count,
            Combination::Variance => sum / (count * count),
            Combination::Least => sum,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::Srgb;

    fn run(how: Combination, pictures: Vec<Picture>) -> Result<Vec<f32>, String> {
        let images = pictures.into_iter().map(|picture| Arc::new(Images::single("v", picture))).collect();
        let found = AverageImages::run(&AverageImages { how }, In { images }, &testing::context());
        let (out, _) = found.map_err(|e| e.to_string())?;
        Ok(out.image.0[0].picture.samples().to_vec())
    }

    fn data(samples: &[f32]) -> Picture {
        Image::<Data>::from_samples(samples.len(), 1, 1, samples.to_vec()).into()
    }

    /// This test fails if the sum is divided by the number of samples, or not at all.
    #[test]
    fn means_variances_and_least_values() {
        let pictures = || vec![data(&[1.0, f32::INFINITY]), data(&[2.0, 4.0]), data(&[6.0, 1.0])];
        assert_eq!(run(Combination::Mean, pictures()), Ok(vec![3.0, f32::INFINITY]));
        assert_eq!(run(Combination::Variance, pictures()).map(|all| all[0]), Ok(1.0));
        assert_eq!(run(Combination::Least, pictures()), Ok(vec![1.0, 1.0]));
    }

    /// This test fails if display codes are averaged as they are.
    #[test]
    fn display_codes_are_averaged_as_light() {
        let grey = |code| Picture::from(Image::<Srgb>::from_samples(1, 1, 3, vec![code; 3]));
        let mean = run(Combination::Mean, vec![grey(0.5), grey(1.0)]).expect("fits");
        assert!((mean[0] - 0.5 * (0.214_041 + 1.0)).abs() < 1e-5, "{mean:?}");
    }

    #[test]
    fn pictures_that_differ_are_refused() {
        let colour = Picture::from(Image::<Linear>::new(2, 1, 3));
        for (pictures, message) in [
            (vec![], "there is no picture to average"),
            (vec![data(&[1.0, 1.0]), colour.clone()], "or all data, with 1 channels"),
            (vec![colour.clone(), data(&[1.0, 1.0])], "or all data, with 3 channels"),
            (vec![colour.clone(), Image::<Linear>::new(2, 1, 4).into()], "with 3 channels"),
            (vec![colour, Image::<Linear>::new(1, 1, 3).into()], "is 1x1 pixels"),
        ] {
            let error = run(Combination::Mean, pictures).expect_err(message);
            assert!(error.contains(message), "{error}");
        }
    }
}

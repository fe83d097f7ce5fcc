//! Differences between two pictures, as the kind `compare` computes them.

use std::sync::Arc;

use engine::{Context, Kind, Scene, Up};
use nodes::kinds::compare::{Compare, In};
use scene::types::{Images, NamedImage, Picture, Report};

use crate::values::Weight;

/// A picture of a value: the digest of the value in hexadecimal digits, and the index of the picture in it.
pub type Place = (String, usize);

/// The difference between two pictures.
pub struct Difference {
    /// The table `compare` for colours or `ratio` for data.
    pub report: Report,
    /// FLIP of each pixel, from 0 to 1, as data; `None` for pictures of data.
    pub flip: Option<Picture>,
    /// Texts of the notes about measures that could not be computed.
    pub notes: Vec<String>,
}

impl Weight for Difference {
    fn bytes(&self) -> usize {
        self.flip.as_ref().map_or(0, |flip| flip.samples().len() * 4)
    }
}

impl Difference {
    /// Compares a picture with a reference of the same size. Colours are compared as an 8-bit display shows them.
    ///
    /// # Errors
    /// A text for the user if the pictures cannot be compared, for instance because their sizes differ.
    pub fn of(picture: &Picture, reference: &Picture) -> Result<Self, String> {
        let (a, b) = (picture.size(), reference.size());
        if (a.0, a.1) != (b.0, b.1) {
            return Err(format!("A is {} by {} pixels, and B is {} by {} pixels", a.0, a.1, b.0, b.1));
        }
        let images = |picture: &Picture| {
            Arc::new(Images(vec![NamedImage { name: "picture".to_owned(), picture: picture.clone() }]))
        };
        let inputs = In {
            image: images(picture),
            reference: images(reference),
            mask: None,
            regions: Vec::new(),
            background: None,
            no_shadow: None,
        };
        // The comparison does not depend on the scene.
        let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
        let (out, notes) = Compare::run(&Compare::default(), inputs, &Context::detached(scene, ""))
            .map_err(|error| error.to_string())?;
        let flip = out.flip.0.first().map(|image| image.picture.clone());
        let notes = notes.iter().map(|note| note.text.clone()).collect();
        Ok(Self { report: Arc::unwrap_or_clone(out.report), flip, notes })
    }
}

#[cfg(test)]
mod tests {
    use scene::types::{Data, Image, Linear, Srgb};

    use super::*;

    fn grey(v: f32) -> Picture {
        Image::<Srgb>::from_samples(16, 16, 3, vec![v; 768]).into()
    }

    #[test]
    fn equal_pictures_have_no_flip_and_black_to_white_has_the_most() {
        let flip = |a: f32, b: f32| {
            let found = Difference::of(&grey(a), &grey(b)).map(|found| found.flip);
            found.ok().flatten().map(|flip| flip.samples()[0])
        };
        assert_eq!(flip(0.5, 0.5), Some(0.0));
        assert!(flip(0.0, 1.0).is_some_and(|most| most > 0.9));
        // Light is compared as a display shows it.
        let light: Picture = Image::<Linear>::from_samples(16, 16, 3, vec![1.0; 768]).into();
        let found = Difference::of(&light, &grey(1.0)).ok().and_then(|found| found.flip);
        assert_eq!(found.map(|flip| flip.samples()[0]), Some(0.0));
    }

    #[test]
    fn what_cannot_be_compared_is_named() {
        let small: Picture = Image::<Srgb>::from_samples(8, 16, 3, vec![0.0; 384]).into();
        let refused = Difference::of(&grey(0.0), &small).err();
        assert_eq!(refused.as_deref(), Some("A is 16 by 16 pixels, and B is 8 by 16 pixels"));
        let depth: Picture = Image::<Data>::from_samples(16, 16, 1, vec![1.0; 256]).into();
        assert!(Difference::of(&grey(0.0), &depth).is_err());
        let data = Difference::of(&depth, &depth);
        assert!(data.is_ok_and(|found| found.flip.is_none() && found.report.tables[0].name == "ratio"));
    }
}

//! Mattes: for each pixel, the objects that it shows, and the share of the pixel that each covers.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

use super::image::samples_difference;

/// Mattes of the views of a rig, for one layer of a Cryptomatte. Port type `mattes`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mattes {
    /// Name of the layer, such as `CryptoObject`.
    pub layer: String,
    /// Names of what can be selected, such as objects. No two are equal.
    pub names: Vec<String>,
    /// The mattes of each view.
    pub views: Vec<MatteView>,
}

/// Mattes of one view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MatteView {
    /// Name of the view, as in the rig.
    pub name: String,
    /// Width, in pixels.
    pub width: usize,
    /// Height, in pixels.
    pub height: usize,
    /// Number of pairs per pixel.
    pub ranks: usize,
    /// `width * height * ranks` indices into [`Mattes::names`], row by row. The pairs of a pixel are sorted by falling
    /// coverage.
    pub indices: Vec<u32>,
    /// Coverage of each pair, from 0 to 1. 0 marks a pair that is not used; its index is 0.
    pub coverages: Vec<f32>,
}

impl MatteView {
    /// Pairs of the pixel with index `y * width + x` that are used.
    pub fn pairs(&self, pixel: usize) -> impl Iterator<Item = (u32, f32)> {
        let range = pixel * self.ranks..(pixel + 1) * self.ranks;
        let pairs = self.indices[range.clone()].iter().zip(&self.coverages[range]);
        pairs.map(|(index, coverage)| (*index, *coverage)).filter(|(_, coverage)| *coverage > 0.0)
    }

    fn encode(&self, to: &mut Encoder) {
        to.str(&self.name);
        for n in [self.width, self.height, self.ranks] {
            to.u32(n as u32);
        }
        to.u32s(&self.indices);
        to.f32s(&self.coverages);
    }

    fn decode(from: &mut Decoder<'_>, names: usize) -> Result<Self, Corrupt> {
        let name = from.str()?;
        let (width, height, ranks) = (from.u32()? as usize, from.u32()? as usize, from.u32()? as usize);
        let (indices, coverages) = (from.u32s()?, from.f32s()?);
        let pairs = width.checked_mul(height).and_then(|n| n.checked_mul(ranks));
        if pairs != Some(indices.len()) || pairs != Some(coverages.len()) {
            return Err(Corrupt(format!("mattes of {width}x{height} pixels have a wrong number of pairs")));
        }
        let is_known = |(index, coverage): (&u32, &f32)| *coverage == 0.0 || (*index as usize) < names;
        if !indices.iter().zip(&coverages).all(is_known) {
            return Err(Corrupt("a matte refers to a name that does not exist".to_owned()));
        }
        Ok(Self { name, width, height, ranks, indices, coverages })
    }
}

impl Mattes {
    /// The mattes of the view `name`. If there is only one view, it belongs to every name. `None` if there is no such
    /// view.
    pub fn view(&self, name: &str) -> Option<&MatteView> {
        let named = self.views.iter().find(|view| view.name == name);
        named.or(if self.views.len() == 1 { self.views.first() } else { None })
    }
}

impl Artifact for Mattes {
    const TYPE: &'static str = "mattes";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.str(&self.layer);
        to.u64(self.names.len() as u64);
        self.names.iter().for_each(|name| to.str(name));
        to.u64(self.views.len() as u64);
        self.views.iter().for_each(|view| view.encode(to));
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let layer = from.str()?;
        let names = (0..from.length(8)?).map(|_| from.str()).collect::<Result<Vec<_>, _>>()?;
        let views = (0..from.length(36)?).map(|_| MatteView::decode(from, names.len()));
        let views = views.collect::<Result<_, _>>()?;
        Ok(Self { layer, names, views })
    }

    fn bytes(&self) -> usize {
        let names: usize = self.names.iter().map(|name| name.len() + 24).sum();
        names + self.views.iter().map(|view| view.indices.len() * 8 + view.name.len() + 100).sum::<usize>()
    }

    fn difference(&self, other: &Self) -> Difference {
        if (&self.layer, &self.names) != (&other.layer, &other.names) {
            return Difference::of("other names");
        }
        if self.views.len() != other.views.len() {
            let counts = format!("{} and {}", self.views.len(), other.views.len());
            return Difference::of(format!("the numbers of views differ: {counts}"));
        }
        for (a, b) in self.views.iter().zip(&other.views) {
            let size = |view: &MatteView| (view.width, view.height, view.ranks);
            let found = samples_difference(&a.name, size(a), &a.coverages, size(b), &b.coverages);
            if !found.equal {
                return found;
            }
        }
        if self == other { Difference::none() } else { Difference::of("the same coverages of other objects") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mattes() -> Mattes {
        let view = MatteView {
            name: "v".to_owned(),
            width: 2,
            height: 1,
            ranks: 2,
            indices: vec![1, 0, 0, 0],
            coverages: vec![0.75, 0.25, 0.0, 0.0],
        };
        let names = vec!["vase".to_owned(), "table".to_owned()];
        Mattes { layer: "CryptoObject".to_owned(), names, views: vec![view] }
    }

    fn encoded(mattes: &Mattes) -> Vec<u8> {
        engine::encode_to_vec(mattes)
    }

    /// This test fails if `decode` does not check the indices.
    #[test]
    fn survives_the_cache_and_is_checked() {
        let first = mattes();
        let back = engine::decode_all::<Mattes>(&encoded(&first)).expect("decodes");
        assert_eq!(back, first);
        assert_eq!(back.views[0].pairs(0).collect::<Vec<_>>(), [(1, 0.75), (0, 0.25)]);
        assert_eq!(back.views[0].pairs(1).count(), 0);
        let mut broken = mattes();
        broken.views[0].indices[0] = 7;
        assert!(engine::decode_all::<Mattes>(&encoded(&broken)).is_err());
        broken = mattes();
        broken.views[0].coverages.pop();
        assert!(engine::decode_all::<Mattes>(&encoded(&broken)).is_err());
    }

    #[test]
    fn differences_are_named() {
        let mut other = mattes();
        assert!(mattes().difference(&other).equal);
        other.views[0].indices[0] = 0;
        assert!(!mattes().difference(&other).equal);
        other.names.pop();
        assert!(!mattes().difference(&other).equal);
    }
}

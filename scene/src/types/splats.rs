//! Gaussian splats, and views of them.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

use super::image::{Data, Image, Images, Linear, NamedImage, Picture, Srgb, samples_difference};
use super::mesh::grouped;
use super::rig::{Camera, Rig};

/// Encoding in which the colours of splats were trained and are blended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplatEncoding {
    /// Display values, similar to sRGB. Nearly all captures use this encoding.
    Srgb,
    /// Linear light. Used only if the file specifies it.
    Linear,
}

/// A scene of 3D Gaussians with activated parameters: scales, opacities and rotations are the values used for
/// rendering, not those stored by the optimiser. All vectors have one entry per splat, in file order.
#[derive(Debug, Clone, PartialEq)]
pub struct Splats {
    /// Centres, in world units.
    pub means: Vec<[f32; 3]>,
    /// Remainder of each centre that f32 cannot hold, to be added in f64; empty if the file stores f32. Needed for
    /// files with centres in f64 (survey coordinates) or with fine quantisation (SOG): a render of 16-bit SOG
    /// deviates from the file by -105 dB without this remainder, and by less than -120 dB with it.
    pub means_low: Vec<[f32; 3]>,
    /// Unit quaternions (w, x, y, z): rotation from the axes of the Gaussian to the world.
    pub quats: Vec<[f32; 4]>,
    /// Standard deviations along the axes of the Gaussian, in world units; at least 0, finite.
    pub scales: Vec<[f32; 3]>,
    /// Opacities, 0 to 1.
    pub opacities: Vec<f32>,
    /// Degree of the spherical harmonics, 0 to 4.
    pub sh_degree: u32,
    /// Spherical harmonics coefficients: `(sh_degree + 1)^2` RGB triples per splat, degree 0 first, in the basis
    /// and sign convention of the INRIA rasterizer.
    pub sh: Vec<[f32; 3]>,
    /// Encoding of the colours.
    pub encoding: SplatEncoding,
    /// True if the file specifies training with a screen-space antialiasing filter.
    pub antialiased: bool,
}

impl Splats {
    /// A scene of degree 0 without splats, with colours in sRGB.
    pub fn empty() -> Self {
        Self {
            means: Vec::new(),
            means_low: Vec::new(),
            quats: Vec::new(),
            scales: Vec::new(),
            opacities: Vec::new(),
            sh_degree: 0,
            sh: Vec::new(),
            encoding: SplatEncoding::Srgb,
            antialiased: false,
        }
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// True for an empty scene.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The centre of a splat, which must exist.
    #[inline]
    pub fn mean(&self, index: usize) -> glam::DVec3 {
        let mean = glam::DVec3::from(self.means[index].map(f64::from));
        match self.means_low.get(index) {
            Some(low) => mean + glam::DVec3::from(low.map(f64::from)),
            None => mean,
        }
    }

    /// Number of RGB triples of spherical harmonics per splat.
    pub fn sh_len(&self) -> usize {
        ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }
}

impl Artifact for Splats {
    const TYPE: &'static str = "splats";
    const FORMAT: u32 = 2;

    fn encode(&self, to: &mut Encoder) {
        to.f32s(self.means.as_flattened());
        to.f32s(self.means_low.as_flattened());
        to.f32s(self.quats.as_flattened());
        to.f32s(self.scales.as_flattened());
        to.f32s(&self.opacities);
        to.u32(self.sh_degree);
        to.f32s(self.sh.as_flattened());
        to.bool(self.encoding == SplatEncoding::Linear);
        to.bool(self.antialiased);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let means = grouped(from.f32s()?)?;
        let means_low = grouped(from.f32s()?)?;
        let splats = Self {
            means,
            means_low,
            quats: grouped(from.f32s()?)?,
            scales: grouped(from.f32s()?)?,
            opacities: from.f32s()?,
            sh_degree: from.u32()?,
            sh: grouped(from.f32s()?)?,
            encoding: if from.bool()? { SplatEncoding::Linear } else { SplatEncoding::Srgb },
            antialiased: from.bool()?,
        };
        let n = splats.len();
        let fits = splats.sh_degree <= 4
            && (splats.means_low.is_empty() || splats.means_low.len() == n)
            && splats.quats.len() == n
            && splats.scales.len() == n
            && splats.opacities.len() == n
            && splats.sh.len() == n * splats.sh_len();
        if fits {
            Ok(splats)
        } else {
            Err(Corrupt("the arrays of the splats have unequal lengths".to_owned()))
        }
    }

    fn bytes(&self) -> usize {
        (self.len() * (44 + 12 * self.sh_len())) + self.means_low.len() * 12
    }

    fn size(&self) -> u64 {
        self.len() as u64
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        let (count, others) = (self.len(), other.len());
        Difference::of(if count == others {
            format!("the numbers of splats are equal ({count}), but their values differ")
        } else {
            format!("the numbers of splats differ: {count} and {others}")
        })
    }
}

/// View of a splat scene from one camera.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// RGB premultiplied by alpha over black, and alpha: 4 channels, f32, unclipped; tagged with the
    /// encoding the splats were trained in.
    pub colour: Picture,
    /// Planar z in world units, one channel; +inf where no splat is visible.
    pub depth: Image<Data>,
}

/// Views of a splat scene, one per camera of a rig. Port type `views`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Views(pub Vec<View>);

impl Artifact for Views {
    const TYPE: &'static str = "views";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        Rig { cameras: self.0.iter().map(|view| view.camera.clone()).collect() }.encode(to);
        for view in &self.0 {
            let depth = NamedImage { name: "depth".to_owned(), picture: view.depth.clone().into() };
            Images(vec![NamedImage { name: "colour".to_owned(), picture: view.colour.clone() }, depth])
                .encode(to);
        }
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let rig = Rig::decode(from)?;
        let mut views = Vec::with_capacity(rig.cameras.len());
        for camera in rig.cameras {
            let [colour, depth]: [NamedImage; 2] = Images::decode(from)?
                .0
                .try_into()
                .map_err(|_| Corrupt("a view must consist of two pictures, colour and depth".to_owned()))?;
            let Picture::Data(depth) = depth.picture else {
                return Err(Corrupt(
                    "the depth of a view is stored as colours instead of as plain numbers".to_owned(),
                ));
            };
            views.push(View { camera, colour: colour.picture, depth });
        }
        Ok(Self(views))
    }

    fn bytes(&self) -> usize {
        self.0.iter().map(|view| (view.colour.samples().len() + view.depth.samples.len()) * 4 + 512).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self.0.len() != other.0.len() {
            return Difference::of(format!(
                "the numbers of views differ: {} and {}",
                self.0.len(),
                other.0.len()
            ));
        }
        for (a, b) in self.0.iter().zip(&other.0) {
            if a.camera != b.camera {
                return Difference::of(format!("the cameras `{}` differ", a.camera.name));
            }
            let (size, other_size) = (a.colour.size(), b.colour.size());
            let difference =
                samples_difference(&a.camera.name, size, a.colour.samples(), other_size, b.colour.samples());
            if !difference.equal {
                return difference;
            }
        }
        if self == other { Difference::none() } else { Difference::of("depth differs") }
    }
}

/// A colour picture made of these samples, marked with the encoding of the splats.
pub fn tagged(
    encoding: SplatEncoding,
    width: usize,
    height: usize,
    channels: usize,
    samples: Vec<f32>,
) -> Picture {
    match encoding {
        SplatEncoding::Srgb => Image::<Srgb>::from_samples(width, height, channels, samples).into(),
        SplatEncoding::Linear => Image::<Linear>::from_samples(width, height, channels, samples).into(),
    }
}

//! Posed photographs of a place.

use engine::{Artifact, Corrupt, Decoder, Difference, Encoder};

use super::mesh::grouped;
use super::rig::{Camera, Rig};

/// A photograph with its camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Photo {
    /// The camera. Its picture has the size of the photograph.
    pub camera: Camera,
    /// Display codes of red, green and blue, row by row, and 255 if the pixel belongs to the place or 0 if a mask
    /// excludes it.
    pub pixels: Vec<[u8; 4]>,
}

/// A point on a surface, found when the poses of the photographs were computed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Position, in world units.
    pub position: [f32; 3],
    /// Display colour, 0 to 1.
    pub rgb: [f32; 3],
}

/// Posed photographs of a place, and points on its surfaces if they are known. Port type `photos`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Photos {
    /// The photographs, at least one, with unique names of cameras.
    pub photos: Vec<Photo>,
    /// The points; may be empty.
    pub points: Vec<Point>,
}

impl Artifact for Photos {
    const TYPE: &'static str = "photos";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        Rig { cameras: self.photos.iter().map(|photo| photo.camera.clone()).collect() }.encode(to);
        for photo in &self.photos {
            to.u8s(photo.pixels.as_flattened());
        }
        let points: Vec<[f32; 6]> = self
            .points
            .iter()
            .map(|Point { position: [x, y, z], rgb: [r, g, b] }| [*x, *y, *z, *r, *g, *b])
            .collect();
        to.f32s(points.as_flattened());
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mut photos = Vec::new();
        for camera in Rig::decode(from)?.cameras {
            let codes = from.u8s()?;
            let (pixels, rest) = codes.as_chunks::<4>();
            let size = u64::from(camera.width_px) * u64::from(camera.height_px);
            if !rest.is_empty() || pixels.len() as u64 != size {
                return Err(Corrupt(format!(
                    "the photograph `{}` has not the size of its camera",
                    camera.name
                )));
            }
            photos.push(Photo { pixels: pixels.to_vec(), camera });
        }
        let points = grouped::<f32, 6>(from.f32s()?)?;
        let points =
            points.into_iter().map(|[x, y, z, r, g, b]| Point { position: [x, y, z], rgb: [r, g, b] });
        Ok(Self { photos, points: points.collect() })
    }

    fn bytes(&self) -> usize {
        let pixels: usize = self.photos.iter().map(|photo| photo.pixels.len() * 4 + 512).sum();
        pixels + self.points.len() * size_of::<Point>()
    }

    fn size(&self) -> u64 {
        self.photos.iter().map(|photo| photo.pixels.len() as u64).sum()
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            return Difference::none();
        }
        if self.photos.len() != other.photos.len() {
            let (a, b) = (self.photos.len(), other.photos.len());
            return Difference::of(format!("the numbers of photographs differ: {a} and {b}"));
        }
        let differs = self.photos.iter().zip(&other.photos).find(|(a, b)| a != b);
        Difference::of(match differs {
            Some((a, _)) => format!("the photographs or cameras `{}` differ", a.camera.name),
            None => "the points differ".to_owned(),
        })
    }
}

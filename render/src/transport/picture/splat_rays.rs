//! Rays that hit the receiver where splats lie on it, arranged like the pixels of an image: one pixel per splat.

use engine::{Context, Digest, NodeError};
use glam::{DVec3, Quat, Vec3};
use scene::types::Splats;

use super::film::TILE;
use crate::geometry::bvh::Ray;
use crate::transport::scene::frame::in_scene_frame;
use crate::transport::scene::receiver::Receiver;

/// Number of splats per job.
const CHUNK: usize = 4096;
/// Start of the names of images that have one pixel for each splat.
const NAMED: &str = "splats-";
/// Bits of each coordinate in the order of splats.
const BITS: u32 = 21;

/// The pixels of an image that has one pixel for each splat. Splats that are near each other have pixels in the same
/// tile, so that tiles have one set of light samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SplatPixels {
    /// Size of the image in pixels.
    pub size: (u32, u32),
    /// Indices of the splats, tile by tile.
    order: Vec<u32>,
}

impl SplatPixels {
    /// Arranges splats along a [`curve`].
    pub fn of(splats: &Splats) -> Self {
        let order = curve(splats, 0.0);
        let tiles = order.len().div_ceil((TILE * TILE) as usize).max(1) as u32;
        let columns = (1..=tiles).find(|columns| columns * columns >= tiles).unwrap_or(1);
        let size = (columns * TILE, tiles.div_ceil(columns) * TILE);
        Self { size, order }
    }

    /// Name of images with these pixels: `splats-` and 8 hexadecimal digits of the digest of the arrangement. Images of
    /// splats with another arrangement have another name, even if they have the same size.
    pub fn name(&self) -> String {
        let bytes: Vec<u8> = self.order.iter().flat_map(|splat| splat.to_le_bytes()).collect();
        let digest = Digest::of(&bytes).to_string();
        format!("{NAMED}{}", &digest[..8])
    }

    /// Returns whether an image with this name has one pixel for each splat.
    pub fn are_named(name: &str) -> bool {
        name.strip_prefix(NAMED)
            .is_some_and(|digest| digest.len() == 8 && digest.bytes().all(|b| b.is_ascii_hexdigit()))
    }

    /// Each splat with its pixel.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (usize, (u32, u32))> + '_ {
        let columns = self.size.0 / TILE;
        self.order.iter().enumerate().map(move |(at, &splat)| {
            let (tile, within) = (at as u32 / (TILE * TILE), at as u32 % (TILE * TILE));
            let (left, top) = (tile % columns * TILE, tile / columns * TILE);
            (splat as usize, (left + within % TILE, top + within / TILE))
        })
    }
}

/// Indices of splats along a curve through space that visits the octants of the bounding box one after the other, and
/// in the same way the octants of each (Morton 1966). `shift`, from 0 to 1, moves the boundaries of the octants by this
/// share of the box, so that neighbours which one curve separates are near each other on another.
pub fn curve(splats: &Splats, shift: f64) -> Vec<u32> {
    let all = 0..splats.len();
    let bounds = all.clone().map(|i| splats.mean(i)).map(|mean| (mean, mean));
    let bounds = bounds.reduce(|(low, high), (mean, _)| (low.min(mean), high.max(mean)));
    let (low, high) = bounds.unwrap_or_default();
    let extent = (high - low).max(DVec3::splat(f64::MIN_POSITIVE));
    let most = f64::from((1_u32 << BITS) - 1) / (1.0 + shift);
    let code = |index: usize| {
        let cell = (((splats.mean(index) - low) / extent + shift) * most).to_array();
        cell.iter().enumerate().fold(0, |code, (axis, at)| code | spread(*at as u64) << axis)
    };
    let mut order: Vec<(u64, u32)> = all.map(|index| (code(index), index as u32)).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, index)| index).collect()
}

/// Moves bit i of a number to bit 3 i.
fn spread(bits: u64) -> u64 {
    [(32, 0x1f_0000_0000_ffff), (16, 0x1f_0000_ff00_00ff), (8, 0x100f_00f0_0f00_f00f)]
        .into_iter()
        .chain([(4, 0x10c3_0c30_c30c_30c3), (2, 0x1249_2492_4924_9249)])
        .fold(bits, |bits, (by, mask)| (bits | bits << by) & mask)
}

/// Rays to the receiver, one per pixel.
pub struct SplatRays {
    /// Size of the image in pixels.
    pub size: (u32, u32),
    /// [`SplatPixels::name`].
    pub name: String,
    /// Row by row. The rays of splats that do not lie on the receiver end where they start.
    rays: Vec<Ray>,
    /// Number of splats that lie on the receiver.
    pub on_receiver: u64,
    /// Maximum distance between a splat and the receiver on which it lies, in world units.
    pub(crate) reach: f32,
}

impl SplatRays {
    /// Finds the surface of the receiver at each splat: the nearest one along the axes of the splat, at most `reach`
    /// world units from its centre. Rays come from the side of `eye`, in the frame of the scene.
    ///
    /// # Errors
    /// If the run was cancelled.
    pub fn new(
        splats: &Splats,
        receiver: &Receiver,
        (origin, eye): (DVec3, Vec3),
        reach: f32,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let pixels = SplatPixels::of(splats);
        let found = cx.for_each_tile(splats.len().div_ceil(CHUNK), |chunk| {
            let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(splats.len());
            range.map(|index| ray_to(splats, index, receiver, (origin, eye), reach)).collect::<Vec<_>>()
        })?;
        let found = found.concat();
        let none = Ray { t_max: 0.0, ..Ray::new(eye, Vec3::X) };
        let mut rays = vec![none; (pixels.size.0 * pixels.size.1) as usize];
        for (splat, (x, y)) in pixels.iter() {
            rays[(y * pixels.size.0 + x) as usize] = found[splat].unwrap_or(none);
        }
        Ok(Self {
            size: pixels.size,
            name: pixels.name(),
            rays,
            on_receiver: found.iter().flatten().count() as u64,
            reach,
        })
    }

    /// The ray of a pixel.
    pub(crate) fn of(&self, (x, y): (u32, u32)) -> Ray {
        self.rays[(y.min(self.size.1 - 1) * self.size.0 + x.min(self.size.0 - 1)) as usize]
    }
}

/// The ray to the surface of the receiver at a splat. `None` if the splat does not lie on the receiver.
fn ray_to(
    splats: &Splats,
    index: usize,
    receiver: &Receiver,
    (origin, eye): (DVec3, Vec3),
    reach: f32,
) -> Option<Ray> {
    let centre = in_scene_frame(splats.mean(index), origin);
    let [w, x, y, z] = splats.quats[index];
    let turn = Quat::from_xyzw(x, y, z, w).normalize();
    let axes = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| turn * axis);
    let each = axes.into_iter().flat_map(|axis| [axis, -axis]);
    let hits = each.filter_map(|direction| {
        // A start a little behind the centre also finds a surface through the centre.
        let ray = Ray { t_max: 1.01 * reach, ..Ray::new(centre - direction * (0.01 * reach), direction) };
        receiver.bvh.closest(ray, |_| true).map(|hit| (ray.origin + direction * hit.t, hit))
    });
    let squared = |at: &Vec3| at.distance_squared(centre);
    let (at, hit) = hits.min_by(|(a, _), (b, _)| squared(a).total_cmp(&squared(b)))?;
    let normal = receiver.normal(hit.triangle);
    let normal = if normal.dot(eye - at) < 0.0 { -normal } else { normal };
    let start = at + normal * (0.1 * reach);
    Some(Ray { t_max: 0.2 * reach, ..Ray::new(start, -normal) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every splat has a pixel of its own, and neighbours in space are neighbours in the image. This test fails if the
    /// order is that of the file.
    #[test]
    fn each_splat_has_a_pixel_near_those_of_its_neighbours() {
        let mut splats = Splats::empty();
        for i in 0..40_u32 {
            for j in 0..40_u32 {
                // Far neighbours in the file.
                splats.means.push([(7 * i % 40) as f32, (11 * j % 40) as f32, 0.0]);
            }
        }
        let pixels = SplatPixels::of(&splats);
        let mut taken = vec![false; (pixels.size.0 * pixels.size.1) as usize];
        let mut tiles: Vec<Vec<DVec3>> = vec![Vec::new(); taken.len()];
        for (splat, (x, y)) in pixels.iter() {
            let seen = &mut taken[(y * pixels.size.0 + x) as usize];
            assert!(!*seen);
            *seen = true;
            tiles[(y / TILE * pixels.size.0 + x / TILE) as usize].push(splats.mean(splat));
        }
        assert_eq!(taken.iter().filter(|taken| **taken).count(), splats.len());
        // A tile of 64 neighbours is 8 wide; of 64 random splats, it is as wide as the place.
        let far = tiles.iter().flat_map(|tile| tile.iter().map(|mean| mean.distance(tile[0])));
        let mean = far.sum::<f64>() / splats.len() as f64;
        assert!(mean < 10.0, "{mean}");
        let empty = SplatPixels::of(&Splats::empty());
        assert_eq!((empty.size, empty.iter().count()), ((TILE, TILE), 0));
    }

    #[test]
    fn bits_are_spread() {
        assert_eq!([0, 1, 2, 3, 0x1f_ffff].map(spread), [0, 1, 8, 9, 0x1249_2492_4924_9249]);
    }
}

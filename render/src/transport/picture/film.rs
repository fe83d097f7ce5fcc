//! Sums over samples, which are the stored result of a part.

use engine::{Artifact, Context, Corrupt, Decoder, Difference, Encoder, NodeError};

use scene::types::{Camera, grouped};
use serde::Serialize;

use super::tile_bounds::TileBounds;
use crate::geometry::bvh::Steps;
use crate::transport::path::rays::{LANES, Rays};

/// Side of the square tiles that are traced at once, in pixels.
pub const TILE: u32 = 8;
/// Rectangle of pixels whose upper left corner is on the grid of tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Area {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

/// Number of sums per pixel of the part `r0`: RGB, and the root of the sum of squared luminance. The root is
/// stored because the square of a luminance that fits into an f32 may not fit.
pub const R0: usize = 4;
/// Number of sums per pixel of the part `pair`: RGB of R1, and the root of the sum of squared luminance of `R1 -
/// R0`; RGB and alpha of O, and the root of the sum of its squared luminance.
pub const PAIR: usize = 9;
/// Number of values per pixel of the part `front`: depth, depth of the nearest object, normal.
pub const FIRST_HIT: usize = 5;

/// Checks the number of stored bytes per pixel and chunk. It is 53 and must not exceed 64.
const _: () = assert!((R0 + PAIR) * 4 + (TileBounds::VALUES * 4).div_ceil((TILE * TILE) as usize) <= 64);

/// Number of sums per pixel for the variance between chunks.
pub const CROSS: usize = 4;

impl Area {
    /// Area of the whole image of a camera.
    pub fn whole(camera: &Camera) -> Self {
        Self { left: 0, top: 0, width: camera.width_px, height: camera.height_px }
    }

    /// The same area with its size in blocks of `side` by `side` pixels instead of pixels.
    pub fn in_blocks(self, side: u32) -> Self {
        Self { width: self.width.div_ceil(side), height: self.height.div_ceil(side), ..self }
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Index within the area, row by row, of the pixel at the given image coordinates.
    pub fn index(&self, (x, y): (u32, u32)) -> usize {
        (y - self.top) as usize * self.width as usize + (x - self.left) as usize
    }

    /// Pieces of the area on a square grid, row by row. The last piece of a row or column may be smaller.
    pub fn pieces(&self, side: u32) -> Vec<Self> {
        let steps = |length: u32| (0..length).step_by(side as usize);
        let piece = |x: u32, y: u32| Self {
            left: self.left + x,
            top: self.top + y,
            width: side.min(self.width - x),
            height: side.min(self.height - y),
        };
        steps(self.height).flat_map(|y| steps(self.width).map(move |x| piece(x, y))).collect()
    }

    /// True if BVH steps are counted for this tile. This is the case for one tile in 16, along each row and along
    /// each column of tiles.
    fn is_followed(&self) -> bool {
        (self.left / TILE + 5 * (self.top / TILE)).is_multiple_of(16)
    }

    /// Image coordinates of the pixels of the area, row by row.
    pub fn each(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let Self { left, top, width, height } = *self;
        (top..top + height).flat_map(move |y| (left..left + width).map(move |x| (x, y)))
    }
}

/// Sums of some channels per pixel over a range of samples. They are computed in f64 and stored in f32, and
/// chunks are added in f64 in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sums {
    /// Number of sums per pixel.
    pub channels: u32,
    /// `channels` sums per pixel, row by row.
    pub sums: Vec<f32>,
    /// Numbers of rays cast.
    pub rays: Rays,
    /// Number of samples that were not finite and were ignored.
    pub broken: u64,
    /// Number of samples that show an object and in which the limit on bounces ended a path that still carried most
    /// of its light.
    pub cut: u64,
    /// Number of samples that show an object behind the back of a single-sided face and that either are black or were
    /// ended by the limit on bounces.
    pub behind: u64,
    /// Number of pixels whose sums equal the sums without objects, bit for bit.
    pub untouched: u64,
    /// Number of cropped pixels, and an upper bound of the relative change of their light.
    pub cropped: (u64, f32),
    /// Bounds of each tile of [`Area::pieces`], if computed.
    pub tile_bounds: Vec<TileBounds>,
}

/// Result of a tile.
#[derive(Debug, Clone, Default)]
pub struct TileSums {
    /// Sums of the tile's pixels, in order.
    pub sums: Vec<f32>,
    /// Numbers of rays cast in the tile.
    pub rays: Rays,
    /// Number of samples that were not finite and were ignored.
    pub broken: u64,
    /// Number of samples that show an object and in which the limit on bounces ended a path that still carried most
    /// of its light.
    pub cut: u64,
    /// Number of samples that show an object behind the back of a single-sided face and that either are black or were
    /// ended by the limit on bounces.
    pub behind: u64,
    /// Number of pixels whose sums equal the sums without objects, bit for bit.
    pub untouched: u64,
    /// Upper bound of the relative change of light, if the tile was cropped.
    pub cropped: Option<f64>,
    /// Bounds of the points of the tile.
    pub bounds: Option<TileBounds>,
}

impl TileSums {
    /// Result of `trace`. If `followed` is true, BVH steps are counted.
    pub fn followed(followed: bool, trace: impl FnOnce() -> Self) -> Self {
        if !followed {
            return trace();
        }
        let (mut done, steps) = Steps::of(trace);
        (done.rays.followed, done.rays.steps) = (done.rays.all(), steps);
        done
    }

    /// Creates an empty result with capacity for `sums` values.
    pub fn with_room(sums: usize) -> Self {
        Self { sums: Vec::with_capacity(sums), ..Self::default() }
    }

    /// Appends the sums of a pixel, clamped to the range of single precision. Infinite values, such as the depth of
    /// a pixel without a surface, are kept.
    pub fn push(&mut self, sums: &[f64]) {
        let single = |v: f64| if v.is_finite() { (v as f32).clamp(-f32::MAX, f32::MAX) } else { v as f32 };
        self.sums.extend(sums.iter().map(|&v| single(v)));
    }
}

impl Sums {
    /// Runs `tile` for every tile of an area, with the index and the pixels of the tile, and combines the results.
    /// Counts rays, and BVH steps for one tile in 16.
    pub fn trace(
        cx: &Context,
        area: Area,
        channels: usize,
        progress: impl Fn() + Send + Sync,
        tile: impl Fn(usize, &[(u32, u32)]) -> TileSums + Send + Sync,
    ) -> Result<Self, NodeError> {
        let one = |number: usize, pixels: &[(u32, u32)], followed| {
            let done = TileSums::followed(followed, || tile(number, pixels));
            progress();
            [done]
        };
        let [all] = Self::trace_each(cx, &[area], [channels], one)?.remove(0);
        all.count(cx);
        Ok(all)
    }

    /// Runs `tile` for every tile of some areas, and combines each of its results for each area. `tile` gets the index
    /// of the tile in its area, the pixels of the tile, and whether BVH steps are to be counted. Counts nothing in the
    /// context.
    pub(crate) fn trace_each<const N: usize>(
        cx: &Context,
        areas: &[Area],
        channels: [usize; N],
        tile: impl Fn(usize, &[(u32, u32)], bool) -> [TileSums; N] + Send + Sync,
    ) -> Result<Vec<[Self; N]>, NodeError> {
        let of_area = |(number, area): (usize, &Area)| {
            area.pieces(TILE).into_iter().enumerate().map(move |(index, piece)| (number, index, piece))
        };
        let pieces: Vec<(usize, usize, Area)> = areas.iter().enumerate().flat_map(of_area).collect();
        let tiles = cx.for_each_tile(pieces.len(), |at| {
            let (_, index, piece) = &pieces[at];
            tile(*index, &piece.each().collect::<Vec<_>>(), piece.is_followed())
        })?;
        let empty = |area: &Area| {
            channels.map(|channels| {
                let sums = vec![0.0; area.pixels() * channels];
                Self { channels: channels as u32, sums, ..Self::default() }
            })
        };
        let mut all: Vec<[Self; N]> = areas.iter().map(empty).collect();
        for ((number, _, piece), tiles) in pieces.iter().zip(tiles) {
            for (all, tile) in all[*number].iter_mut().zip(tiles) {
                all.add(areas[*number], piece, tile);
            }
        }
        Ok(all)
    }

    /// Adds the result of the tile `piece` of `area`.
    fn add(&mut self, area: Area, piece: &Area, tile: TileSums) {
        self.rays += tile.rays;
        self.broken += tile.broken;
        self.cut += tile.cut;
        self.behind += tile.behind;
        self.untouched += tile.untouched;
        if let Some(bound) = tile.cropped {
            let (pixels, most) = self.cropped;
            self.cropped = (pixels + piece.pixels() as u64, most.max(bound as f32));
        }
        self.tile_bounds.extend(tile.bounds);
        let channels = self.channels as usize;
        for (pixel, sums) in piece.each().zip(tile.sums.chunks_exact(channels)) {
            let at = area.index(pixel) * channels;
            self.sums[at..at + channels].copy_from_slice(sums);
        }
    }

    /// Sums of some pixels of `area`, pixel by pixel.
    pub(crate) fn of_pixels(&self, area: Area, pixels: &[(u32, u32)]) -> Vec<f32> {
        let channels = self.channels as usize;
        let of = |pixel: &(u32, u32)| &self.sums[area.index(*pixel) * channels..][..channels];
        pixels.iter().flat_map(of).copied().collect()
    }

    /// Counts the rays in the context.
    pub(crate) fn count(&self, cx: &Context) {
        let Rays { camera, shadow, scattered, followed, steps } = self.rays;
        cx.count("rays", self.rays.all());
        cx.count("camera_rays", camera);
        cx.count("shadow_rays", shadow);
        cx.count("scattered_rays", scattered);
        cx.count("followed_rays", followed);
        cx.count("bvh_nodes", steps.nodes);
        cx.count("triangle_tests", LANES * steps.packets);
    }
}

impl Artifact for Sums {
    const TYPE: &'static str = "path-sums";
    const FORMAT: u32 = 5;

    fn encode(&self, to: &mut Encoder) {
        to.u32(self.channels);
        to.f32s(&self.sums);
        let Rays { camera, shadow, scattered, followed, steps: Steps { nodes, packets } } = self.rays;
        for n in [camera, shadow, scattered, followed, nodes, packets] {
            to.u64(n);
        }
        to.u64(self.broken);
        to.u64(self.cut);
        to.u64(self.behind);
        to.u64(self.untouched);
        to.u64(self.cropped.0);
        to.f32s(&[self.cropped.1]);
        to.f32s(self.tile_bounds.iter().flat_map(TileBounds::values).collect::<Vec<_>>().as_slice());
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        let mut all = Self {
            channels: from.u32()?,
            sums: from.f32s()?,
            rays: Rays {
                camera: from.u64()?,
                shadow: from.u64()?,
                scattered: from.u64()?,
                followed: from.u64()?,
                steps: Steps { nodes: from.u64()?, packets: from.u64()? },
            },
            broken: from.u64()?,
            cut: from.u64()?,
            behind: from.u64()?,
            untouched: from.u64()?,
            ..Self::default()
        };
        let cropped = from.u64()?;
        let [largest] = from.f32s()?[..] else {
            return Err(Corrupt("expected exactly one bound on the change of cropped pixels".to_owned()));
        };
        all.cropped = (cropped, largest);
        all.tile_bounds = grouped(from.f32s()?)?.iter().map(TileBounds::from_values).collect();
        Ok(all)
    }

    fn bytes(&self) -> usize {
        self.sums.len() * 4 + self.tile_bounds.len() * size_of::<TileBounds>() + 120
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other { Difference::none() } else { Difference::of("other sums") }
    }
}

/// Number of samples of the first chunk.
pub const FIRST: u32 = 4;

/// Half-open ranges of samples, one per chunk. They begin at 0, 4, 16 and every multiple of 64, regardless of
/// `samples`, so a larger number of samples only adds parts.
pub fn chunks(samples: u32) -> Vec<(u32, u32)> {
    let mut out = Vec::new();
    let mut start = 0;
    while start < samples {
        let end = match start {
            0 => FIRST,
            FIRST => 16,
            16 => 64,
            _ => start.saturating_add(64),
        };
        out.push((start, end.min(samples)));
        start = end;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_cover_an_area_once() {
        let area = Area { left: 16, top: 8, width: 37, height: 20 };
        let mut seen = vec![0; area.pixels()];
        for piece in area.pieces(TILE) {
            assert!(piece.left % TILE == 0 && piece.top % TILE == 0);
            piece.each().for_each(|pixel| seen[area.index(pixel)] += 1);
        }
        assert!(seen.iter().all(|&n| n == 1));
        assert_eq!(area.pieces(32).len(), 2);
    }

    #[test]
    fn boundaries_do_not_depend_on_the_number_of_samples() {
        assert_eq!(chunks(3), [(0, 3)]);
        assert_eq!(chunks(64), [(0, 4), (4, 16), (16, 64)]);
        assert_eq!(chunks(200), [(0, 4), (4, 16), (16, 64), (64, 128), (128, 192), (192, 200)]);
        assert!(chunks(256).starts_with(&chunks(64)));
    }
}

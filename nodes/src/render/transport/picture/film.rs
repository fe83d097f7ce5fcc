//! Sums over samples: what a part of the work leaves behind.

use engine::{Artifact, Context, Corrupt, Decoder, Difference, Encoder, NodeError};

use serde::Serialize;

use super::tile_bounds::TileBounds;
use crate::geometry::bvh::Steps;
use crate::render::transport::path::rays::{LANES, Rays};
use crate::types::{Camera, grouped};

/// Side of the square tiles that are traced at once, in pixels.
pub const TILE: u32 = 8;
/// A rectangle of pixels that begins where a tile of the picture does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Area {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Sums a pixel of the part `r0`: RGB, and the root of that of squared luminance, since squares leave the range of
/// single precision where light does not.
pub(crate) const R0: usize = 4;
/// Sums a pixel of the part `pair`: RGB of R1 and the root of that of the squared luminance of R1 - R0; RGB, alpha and
/// the root of that of the squared luminance of O.
pub(crate) const PAIR: usize = 9;
/// Values a pixel of the part `front`: depth, that of the nearest object, normal.
pub(crate) const FIRST_HIT: usize = 5;

/// Bytes that parts store of a pixel and chunk: 53.
const _: () = assert!((R0 + PAIR) * 4 + (TileBounds::VALUES * 4).div_ceil((TILE * TILE) as usize) <= 64);

/// Sums a pixel over chunks, for how far these lie apart.
pub(crate) const CROSS: usize = 4;

impl Area {
    /// The whole picture of a camera.
    pub fn whole(camera: &Camera) -> Self {
        Self { left: 0, top: 0, width: camera.width_px, height: camera.height_px }
    }

    /// With a block of so many by so many pixels for each of its pixels.
    pub fn in_blocks(self, side: u32) -> Self {
        Self { width: self.width.div_ceil(side), height: self.height.div_ceil(side), ..self }
    }

    /// How many pixels it has.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The place of a pixel of the picture in it, row by row.
    pub fn index(&self, (x, y): (u32, u32)) -> usize {
        (y - self.top) as usize * self.width as usize + (x - self.left) as usize
    }

    /// The pieces of a square grid that make it up, row by row; those at the end may be smaller.
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

    /// Whether the rays of it as a tile are followed: one tile in 16, in each row and in each column.
    fn is_followed(&self) -> bool {
        (self.left / TILE + 5 * (self.top / TILE)).is_multiple_of(16)
    }

    /// Its pixels in the picture, row by row.
    pub fn each(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let Self { left, top, width, height } = *self;
        (top..top + height).flat_map(move |y| (left..left + width).map(move |x| (x, y)))
    }
}

/// For each pixel the sums of some channels over a range of samples. Sums are taken in f64 and kept in
/// f32; chunks are added in f64 in their order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sums {
    /// Sums a pixel.
    pub channels: u32,
    /// `channels` sums a pixel, row by row.
    pub sums: Vec<f32>,
    /// Rays that it took.
    pub rays: Rays,
    /// Samples that were not finite and were left out.
    pub broken: u64,
    /// Samples of objects that ended with most of their light to come.
    pub cut: u64,
    /// Pixels whose sums are those of the objects' absence, bit for bit.
    pub untouched: u64,
    /// Those of them that were not asked, and the largest share of their light that the objects may change.
    pub cropped: (u64, f32),
    /// Of each tile of [`Area::pieces`] where its points are, if its sums tell.
    pub tile_bounds: Vec<TileBounds>,
}

/// What a tile gives.
#[derive(Debug, Clone, Default)]
pub struct TileSums {
    /// Sums of the tile's pixels, in order.
    pub sums: Vec<f32>,
    /// As in [`Sums`].
    pub rays: Rays,
    /// As in [`Sums`].
    pub broken: u64,
    /// As in [`Sums`].
    pub cut: u64,
    /// As in [`Sums`].
    pub untouched: u64,
    /// The share of its light that the objects may change at most, where that is so little that they were not asked.
    pub cropped: Option<f64>,
    /// Where its points are.
    pub bounds: Option<TileBounds>,
}

impl TileSums {
    /// What `trace` gives, its rays followed.
    fn followed(trace: impl FnOnce() -> Self) -> Self {
        let (mut done, steps) = Steps::of(trace);
        (done.rays.followed, done.rays.steps) = (done.rays.all(), steps);
        done
    }

    /// With room for so many sums.
    pub fn with_room(sums: usize) -> Self {
        Self { sums: Vec::with_capacity(sums), ..Self::default() }
    }

    /// Appends the sums of a pixel, those beyond single precision as its largest number. What is infinite, as depth
    /// beyond all surfaces, stays so.
    pub fn push(&mut self, sums: &[f64]) {
        let single = |v: f64| if v.is_finite() { (v as f32).clamp(-f32::MAX, f32::MAX) } else { v as f32 };
        self.sums.extend(sums.iter().map(|&v| single(v)));
    }
}

impl Sums {
    /// Runs `tile` for every tile of an area, given its number and its pixels, and puts the tiles together. Counts rays, and
    /// for one tile in 16 the steps of their walks.
    pub fn trace(
        cx: &Context,
        area: Area,
        channels: usize,
        progress: impl Fn() + Send + Sync,
        tile: impl Fn(usize, &[(u32, u32)]) -> TileSums + Send + Sync,
    ) -> Result<Self, NodeError> {
        let pieces = area.pieces(TILE);
        let tiles = cx.for_each_tile(pieces.len(), |index| {
            let piece = &pieces[index];
            let trace = || tile(index, &piece.each().collect::<Vec<_>>());
            let done = if piece.is_followed() { TileSums::followed(trace) } else { trace() };
            progress();
            done
        })?;
        let mut all = Self { channels: channels as u32, ..Self::default() };
        all.sums.resize(area.pixels() * channels, 0.0);
        for (piece, tile) in pieces.iter().zip(tiles) {
            all.rays += tile.rays;
            all.broken += tile.broken;
            all.cut += tile.cut;
            all.untouched += tile.untouched;
            if let Some(bound) = tile.cropped {
                let (pixels, most) = all.cropped;
                all.cropped = (pixels + piece.pixels() as u64, most.max(bound as f32));
            }
            all.tile_bounds.extend(tile.bounds);
            for (pixel, sums) in piece.each().zip(tile.sums.chunks_exact(channels)) {
                let at = area.index(pixel) * channels;
                all.sums[at..at + channels].copy_from_slice(sums);
            }
        }
        let Rays { camera, shadow, scattered, followed, steps } = all.rays;
        cx.count("rays", all.rays.all());
        cx.count("camera_rays", camera);
        cx.count("shadow_rays", shadow);
        cx.count("scattered_rays", scattered);
        cx.count("followed_rays", followed);
        cx.count("bvh_nodes", steps.nodes);
        cx.count("triangle_tests", LANES * steps.packets);
        Ok(all)
    }
}

impl Artifact for Sums {
    const TYPE: &'static str = "path-sums";
    const FORMAT: u32 = 4;

    fn encode(&self, to: &mut Encoder) {
        to.u32(self.channels);
        to.f32s(&self.sums);
        let Rays { camera, shadow, scattered, followed, steps: Steps { nodes, packets } } = self.rays;
        for n in [camera, shadow, scattered, followed, nodes, packets] {
            to.u64(n);
        }
        to.u64(self.broken);
        to.u64(self.cut);
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
            untouched: from.u64()?,
            ..Self::default()
        };
        let cropped = from.u64()?;
        let [largest] = from.f32s()?[..] else {
            return Err(Corrupt("not one bound of what was cropped".to_owned()));
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

/// Samples of the first chunk.
pub const FIRST: u32 = 4;

/// The ranges of samples that parts are made of: they begin at 0, 4, 16, 64 and every further 64, whatever
/// the number of samples is, so that more samples only add parts.
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

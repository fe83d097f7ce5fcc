//! Sums over samples: what a part of the work leaves behind.

use engine::{Artifact, Context, Corrupt, Decoder, Difference, Encoder, NodeError};

use crate::types::Camera;

/// Side of the square tiles that are traced at once, in pixels.
pub const TILE: usize = 8;

/// For each pixel the sums of some channels over a range of samples. Sums are taken in f64 and kept in
/// f32; chunks are added in f64 in their order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sums {
    /// Sums a pixel.
    pub channels: u32,
    /// `channels` sums a pixel, row by row.
    pub sums: Vec<f32>,
    /// Rays that it took.
    pub rays: u64,
    /// Samples that were not finite and were left out.
    pub broken: u64,
    /// Pixels whose sums are those of the objects' absence, bit for bit.
    pub untouched: u64,
}

/// What a tile gives.
#[derive(Debug, Clone, Default)]
pub struct TileSums {
    /// Sums of the tile's pixels, in order.
    pub sums: Vec<f32>,
    /// As in [`Sums`].
    pub rays: u64,
    /// As in [`Sums`].
    pub broken: u64,
    /// As in [`Sums`].
    pub untouched: u64,
}

impl TileSums {
    /// Appends the sums of a pixel.
    pub fn push(&mut self, sums: &[f64]) {
        self.sums.extend(sums.iter().map(|&v| v as f32));
    }
}

impl Sums {
    /// Runs `tile` for every tile of a picture, given its pixels, and puts the tiles together.
    pub fn trace(
        cx: &Context,
        camera: &Camera,
        channels: usize,
        progress: impl Fn() + Send + Sync,
        tile: impl Fn(&[(u32, u32)]) -> TileSums + Send + Sync,
    ) -> Result<Self, NodeError> {
        let (width, height) = (camera.width_px as usize, camera.height_px as usize);
        let across = width.div_ceil(TILE);
        let pixels = |index: usize| -> Vec<(u32, u32)> {
            let (left, top) = (index % across * TILE, index / across * TILE);
            let rows = top..(top + TILE).min(height);
            rows.flat_map(|y| (left..(left + TILE).min(width)).map(move |x| (x as u32, y as u32))).collect()
        };
        let tiles = cx.for_each_tile(across * height.div_ceil(TILE), |index| {
            let done = tile(&pixels(index));
            progress();
            done
        })?;
        let mut all = Self { channels: channels as u32, ..Self::default() };
        all.sums.resize(width * height * channels, 0.0);
        for (index, tile) in tiles.into_iter().enumerate() {
            all.rays += tile.rays;
            all.broken += tile.broken;
            all.untouched += tile.untouched;
            for ((x, y), sums) in pixels(index).into_iter().zip(tile.sums.chunks_exact(channels)) {
                let at = (y as usize * width + x as usize) * channels;
                all.sums[at..at + channels].copy_from_slice(sums);
            }
        }
        Ok(all)
    }
}

impl Artifact for Sums {
    const TYPE: &'static str = "path-sums";
    const FORMAT: u32 = 1;

    fn encode(&self, to: &mut Encoder) {
        to.u32(self.channels);
        to.f32s(&self.sums);
        to.u64(self.rays);
        to.u64(self.broken);
        to.u64(self.untouched);
    }

    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        Ok(Self {
            channels: from.u32()?,
            sums: from.f32s()?,
            rays: from.u64()?,
            broken: from.u64()?,
            untouched: from.u64()?,
        })
    }

    fn bytes(&self) -> usize {
        self.sums.len() * 4 + 64
    }

    fn difference(&self, other: &Self) -> Difference {
        if self == other { Difference::none() } else { Difference::of("other sums") }
    }
}

/// The ranges of samples that parts are made of: they begin at 0, 4, 16, 64 and every further 64, whatever
/// the number of samples is, so that more samples only add parts.
pub fn chunks(samples: u32) -> Vec<(u32, u32)> {
    let mut out = Vec::new();
    let mut start = 0;
    while start < samples {
        let end = match start {
            0 => 4,
            4 => 16,
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
    fn boundaries_do_not_depend_on_the_number_of_samples() {
        assert_eq!(chunks(3), [(0, 3)]);
        assert_eq!(chunks(64), [(0, 4), (4, 16), (16, 64)]);
        assert_eq!(chunks(200), [(0, 4), (4, 16), (16, 64), (64, 128), (128, 192), (192, 200)]);
        assert!(chunks(256).starts_with(&chunks(64)));
    }
}

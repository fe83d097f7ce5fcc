//! Non-local means: every pixel becomes the mean of those near it whose surroundings look the same, to the
//! noise that they are known to have.
//!
//! The distance of two pixels is that of the patches around them, per sample and in units of its variance,
//! less what noise alone would give (Rousselle, Knaus and Zwicker 2012, Adaptive rendering with non-local
//! means filtering, section 4). So an edge stays that is stronger than the noise, and the filter fades as
//! more samples leave less of it.

use std::ops::Range;

use engine::{Context, NodeError};
use fearless_simd::{Level, dispatch};
use glam::Vec3;

/// Side of the square tiles that are filtered at once, in pixels.
const TILE: usize = 32;
/// Patches reach so many pixels from their centre.
const PATCH: usize = 2;
/// Rows, and columns, of a patch.
const PATCHES: usize = 2 * PATCH + 1;
/// Side of the region whose pixels are compared for the patches of a tile.
const SIDE: usize = TILE + 2 * PATCH;
/// Variance below this is nothing, for signals near 1.
const FLOOR: f32 = 1e-8;
/// Off the plane of a pixel by this share of the depth is another surface.
const OFF: f32 = 0.05;
/// A pixel so many times less sure than another and what is around that one is not averaged with it in full.
const LESS_SURE: f32 = 16.0;
/// Sums of values above this could overflow: their weights add up to less than 2^12.
const ROOM: f32 = f32::MAX / 65536.0;
/// Values that are averaged together.
pub const VALUES: usize = 6;

/// What is known of a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pixel {
    /// What is compared.
    pub signal: [f32; 3],
    /// Variance of a channel of the signal, for each alike; 0 leaves the pixel as it is.
    pub variance: f32,
    /// One over its own variance, and the variance up to which it is averaged with others in full; what
    /// [`Field::find_doubts`] fills in.
    pub doubt: [f32; 2],
    /// What is averaged.
    pub values: [f32; VALUES],
    /// Whether it is to be averaged at all.
    pub there: bool,
    /// Normal of the surface, 0 where it does not matter which surface it is.
    pub normal: Vec3,
    /// One over the depth, which is linear over the pixels of a plane, and its change from column to column
    /// and from row to row.
    pub nearness: [f32; 3],
}

/// How alike is alike enough.
#[derive(Debug, Clone, Copy)]
pub struct Reach {
    /// Pixels on each side, at most.
    pub radius: usize,
    /// In standard deviations of the noise: how far patches may differ.
    pub strength: f32,
    /// Normals may differ by this much of a cosine.
    pub bend: f32,
}

/// A grid of pixels.
#[derive(Debug)]
pub struct Field {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row by row.
    pub pixels: Vec<Pixel>,
    /// Whether pixels that are much less sure than others are kept apart from them.
    pub doubts: bool,
}

impl Pixel {
    /// Whether it takes an average.
    pub fn is_noisy(&self) -> bool {
        self.there && self.variance > 0.0
    }
}

impl Field {
    /// Replaces each variance by the mean over the pixels up to `radius` away that are there, since the variance
    /// of a few samples is itself noise; but no less than a tenth of its own, or a single pixel of very
    /// uneven samples would count as an edge.
    pub fn smooth_variance(&mut self, radius: usize) {
        let mean = |x: usize, y: usize| {
            let (mut sum, mut count) = (0.0, 0.0);
            for j in y.saturating_sub(radius)..=(y + radius).min(self.height - 1) {
                for pixel in &self.pixels[j * self.width..]
                    [x.saturating_sub(radius)..=(x + radius).min(self.width - 1)]
                {
                    if pixel.there {
                        sum += pixel.variance;
                        count += 1.0;
                    }
                }
            }
            sum / f32::max(count, 1.0)
        };
        let smooth: Vec<f32> = (0..self.pixels.len()).map(|i| mean(i % self.width, i / self.width)).collect();
        for (pixel, variance) in self.pixels.iter_mut().zip(smooth) {
            pixel.variance = variance.max(0.1 * pixel.variance);
        }
    }

    /// Learns how sure a pixel is against its eight neighbours, before variances are smoothed. The light of a lucky
    /// path looks like that of all around it, to its own great variance. A mean would splash it over pixels that
    /// are known well, and take it from where it belongs. So such pairs are averaged less, both ways, by the
    /// ratio of one's variance to the mean around the other. The largest is left out of that mean, so that a lone
    /// bright pixel does not vouch for itself.
    pub fn find_doubts(&mut self) {
        let around = |x: usize, y: usize| {
            let (mut sum, mut largest, mut count) = (0.0, 0.0_f32, 0.0);
            for j in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
                for i in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                    let pixel = &self.pixels[j * self.width + i];
                    if pixel.there {
                        sum += pixel.variance.min(largest);
                        largest = largest.max(pixel.variance);
                        count += 1.0;
                    }
                }
            }
            sum / f32::max(count - 1.0, 1.0)
        };
        let around: Vec<f32> =
            (0..self.pixels.len()).map(|i| around(i % self.width, i / self.width)).collect();
        for (pixel, around) in self.pixels.iter_mut().zip(around) {
            pixel.doubt = [1.0 / pixel.variance.max(1e-30), LESS_SURE * around];
        }
        self.doubts = true;
    }

    /// Takes the slopes of nearness from the pixels on both sides: the smaller step of the two, none where
    /// they disagree, so that edges do not count as slopes.
    pub fn find_slopes(&mut self) {
        let step = |at: usize, back: Option<usize>, on: Option<usize>| {
            let near = |i: usize| self.pixels[i].nearness[0];
            let (Some(back), Some(on)) = (back, on) else { return 0.0 };
            let (a, b) = (near(at) - near(back), near(on) - near(at));
            if a * b <= 0.0 {
                0.0
            } else if a.abs() < b.abs() {
                a
            } else {
                b
            }
        };
        let (w, h) = (self.width, self.height);
        let slopes: Vec<[f32; 2]> = (0..self.pixels.len())
            .map(|i| {
                let (x, y) = (i % w, i / w);
                let columns = step(i, (x > 0).then(|| i - 1), (x + 1 < w).then_some(i + 1));
                [columns, step(i, (y > 0).then(|| i - w), (y + 1 < h).then_some(i + w))]
            })
            .collect();
        for (pixel, [columns, rows]) in self.pixels.iter_mut().zip(slopes) {
            pixel.nearness[1..].copy_from_slice(&[columns, rows]);
        }
    }

    /// The averages of each pixel's values.
    pub fn average(&self, reach: Reach, cx: &Context) -> Result<Vec<[f32; VALUES]>, NodeError> {
        self.average_at(Level::new(), reach, cx)
    }

    /// The same by a set of vector instructions, each of which gives the same bits.
    pub(super) fn average_at(
        &self,
        level: Level,
        reach: Reach,
        cx: &Context,
    ) -> Result<Vec<[f32; VALUES]>, NodeError> {
        let (across, down) = (self.width.div_ceil(TILE), self.height.div_ceil(TILE));
        // A power of two, so it changes no bit but where sums would overflow.
        let scale = if self.brightest() > ROOM { 1.0 / 65536.0 } else { 1.0 };
        let tiles = cx.for_each_tile(across * down, |index| {
            let corner = [index % across * TILE, index / across * TILE];
            let tile = Tile::cut(self, corner, reach.radius + PATCH, scale);
            let rows = tile.noisy_rows();
            let radius = if rows.is_empty() { 0 } else { reach.radius };
            cx.count("taps", ((2 * radius + 1) * (2 * radius + 1) * rows.len() * TILE) as u64);
            let reach = Reach { radius, ..reach };
            dispatch!(level, _simd => tile.average(reach, rows))
        })?;
        let mut out: Vec<_> = self.pixels.iter().map(|pixel| pixel.values).collect();
        for (index, tile) in tiles.iter().enumerate() {
            let (left, top) = (index % across * TILE, index / across * TILE);
            for (row, values) in tile.chunks_exact(TILE).enumerate().take(self.height - top) {
                let wide = TILE.min(self.width - left);
                let out = &mut out[(top + row) * self.width + left..][..wide];
                out.iter_mut()
                    .zip(values)
                    .for_each(|(out, values)| *out = values.map(|v| (v / scale).min(f32::MAX)));
            }
        }
        Ok(out)
    }

    fn brightest(&self) -> f32 {
        self.pixels.iter().filter(|pixel| pixel.there).flat_map(|pixel| pixel.values).fold(0.0, f32::max)
    }
}

/// A tile and what surrounds it, one plane for each number, so that rows run through vector registers. No lane
/// depends on another, so vectors of any width give the same bits.
struct Tile {
    /// Pixels around the tile.
    rim: usize,
    /// Length of a row.
    stride: usize,
    signal: [Vec<f32>; 3],
    variance: Vec<f32>,
    values: [Vec<f32>; VALUES],
    there: Vec<f32>,
    normal: [Vec<f32>; 3],
    nearness: [Vec<f32>; 3],
    /// One over the difference of nearness that makes another surface.
    level: Vec<f32>,
    doubt: Option<[Vec<f32>; 2]>,
}

/// The sums of one row of a tile.
struct Sums {
    values: [[f32; TILE]; VALUES],
    weight: [f32; TILE],
}

/// A piece of a plane.
#[inline(always)]
fn cut<const N: usize>(plane: &[f32], start: usize) -> &[f32; N] {
    plane[start..].first_chunk().expect("a tile lies within its planes")
}

impl Tile {
    fn cut(field: &Field, [left, top]: [usize; 2], rim: usize, scale: f32) -> Self {
        let stride = TILE + 2 * rim;
        let plane = || vec![0.0; stride * stride];
        let mut tile = Self {
            rim,
            stride,
            signal: [plane(), plane(), plane()],
            variance: plane(),
            values: std::array::from_fn(|_| plane()),
            there: plane(),
            normal: [plane(), plane(), plane()],
            nearness: [plane(), plane(), plane()],
            level: plane(),
            doubt: field.doubts.then(|| [plane(), plane()]),
        };
        for i in 0..stride * stride {
            let (x, y) = (left + i % stride, top + i / stride);
            if x < rim || y < rim || x - rim >= field.width || y - rim >= field.height {
                continue;
            }
            let pixel = &field.pixels[(y - rim) * field.width + x - rim];
            // What is left out may be infinite, which no weight of 0 takes away.
            if !pixel.there {
                continue;
            }
            tile.there[i] = 1.0;
            tile.variance[i] = pixel.variance;
            tile.level[i] = 1.0 / (OFF * pixel.nearness[0]).max(1e-30);
            for k in 0..3 {
                tile.signal[k][i] = pixel.signal[k];
                tile.normal[k][i] = pixel.normal[k];
                tile.nearness[k][i] = pixel.nearness[k];
            }
            for (plane, value) in tile.values.iter_mut().zip(pixel.values) {
                plane[i] = value * scale;
            }
            if let Some(planes) = &mut tile.doubt {
                planes.iter_mut().zip(pixel.doubt).for_each(|(plane, doubt)| plane[i] = doubt);
            }
        }
        tile
    }

    /// Whether the pixel at an index of the planes takes an average.
    fn noisy(&self, i: usize) -> bool {
        self.there[i] > 0.0 && self.variance[i] > 0.0
    }

    /// The rows of the tile from the first to the last in which any pixel does.
    fn noisy_rows(&self) -> Range<usize> {
        let noisy = |y: &usize| (0..TILE).any(|x| self.noisy((y + self.rim) * self.stride + x + self.rim));
        let first = (0..TILE).find(noisy).unwrap_or(TILE);
        first..(first..TILE).rfind(noisy).map_or(first, |last| last + 1)
    }

    /// Averages of the tile's pixels, row by row.
    #[inline(always)]
    fn average(&self, reach: Reach, noisy: Range<usize>) -> Vec<[f32; VALUES]> {
        let at = |x: usize, y: usize| (y + self.rim) * self.stride + x + self.rim;
        // The pixel itself counts once.
        let own = |y: usize| Sums {
            values: self.values.each_ref().map(|plane| *cut(plane, at(0, y))),
            weight: [1.0; TILE],
        };
        let mut sums: Vec<Sums> = (0..TILE).map(own).collect();
        let radius = reach.radius as isize;
        // Row by row, so that all that a row needs stays near: for each offset along it the distances of the last
        // rows that patches reach over, summed along the row.
        let mut along = vec![[[0.0_f32; TILE]; PATCHES]; 2 * reach.radius + 1];
        for dy in -radius..=radius {
            for y in noisy.start..noisy.end + 2 * PATCH {
                let p = (y + self.rim - PATCH) * self.stride + self.rim - PATCH;
                for (dx, rows) in (-radius..=radius).zip(&mut along).filter(|(dx, _)| (*dx, dy) != (0, 0)) {
                    let q = (p as isize + dy * self.stride as isize + dx) as usize;
                    self.compare([p, q], reach.strength, &mut rows[y % PATCHES]);
                    if let Some(y) = y.checked_sub(2 * PATCH).filter(|y| noisy.contains(y)) {
                        let q = (at(0, y) as isize + dy * self.stride as isize + dx) as usize;
                        let pair = [at(0, y), q];
                        let mut weights = self.weigh(pair, [dx as f32, dy as f32], reach.bend, rows, y);
                        if let Some(doubt) = &self.doubt {
                            keep_apart(doubt, pair, &mut weights);
                        }
                        sums[y].add(&self.values, q, &weights);
                    }
                }
            }
        }
        let mean = |i: usize| {
            let (x, y) = (i % TILE, i / TILE);
            match self.noisy(at(x, y)) {
                true => sums[y].values.map(|row| row[x] / sums[y].weight[x]),
                false => self.values.each_ref().map(|plane| plane[at(x, y)]),
            }
        };
        (0..TILE * TILE).map(mean).collect()
    }

    /// Distances of a row of pairs of single pixels that starts at the pixels p and q, summed over the columns of
    /// patches.
    #[inline(always)]
    fn compare(&self, [p, q]: [usize; 2], strength: f32, out: &mut [f32; TILE]) {
        let k = strength * strength;
        let [a, b, c] = self.signal.each_ref().map(|plane| cut::<SIDE>(plane, p));
        let [d, e, f] = self.signal.each_ref().map(|plane| cut::<SIDE>(plane, q));
        let (v, w) = (cut::<SIDE>(&self.variance, p), cut::<SIDE>(&self.variance, q));
        let (t, u) = (cut::<SIDE>(&self.there, p), cut::<SIDE>(&self.there, q));
        let mut single = [0.0; SIDE];
        for x in 0..SIDE {
            let [a, b, c] = [a[x] - d[x], b[x] - e[x], c[x] - f[x]];
            let squared = (a * a + b * b + c * c) * (1.0 / 3.0);
            let noise = v[x] + if v[x] < w[x] { v[x] } else { w[x] };
            single[x] = t[x] * u[x] * (squared - noise) / (FLOOR + k * (v[x] + w[x]));
        }
        for x in 0..TILE {
            out[x] = single[x] + single[x + 1] + single[x + 2] + single[x + 3] + single[x + 4];
        }
    }

    /// Weights of a row of pairs that starts at the pixels p and q, from the rows of distances around it.
    #[inline(always)]
    fn weigh(
        &self,
        [p, q]: [usize; 2],
        [dx, dy]: [f32; 2],
        bend: f32,
        rows: &[[f32; TILE]; PATCHES],
        first: usize,
    ) -> [f32; TILE] {
        let straight = 1.0 / bend;
        let there = cut::<TILE>(&self.there, q);
        let [near, columns, lines] = self.nearness.each_ref().map(|plane| cut::<TILE>(plane, p));
        let other = cut::<TILE>(&self.nearness[0], q);
        let (own, its) = (cut::<TILE>(&self.level, p), cut::<TILE>(&self.level, q));
        let n = self.normal.each_ref().map(|plane| cut::<TILE>(plane, p));
        let m = self.normal.each_ref().map(|plane| cut::<TILE>(plane, q));
        let [r0, r1, r2, r3, r4] = std::array::from_fn(|k| &rows[(first + k) % PATCHES]);
        let mut out = [0.0; TILE];
        for x in 0..TILE {
            let far = r0[x] + r1[x] + r2[x] + r3[x] + r4[x];
            // (1 - d/4)^4 falls like exp(-d), and to nothing at 4.
            let alike = (1.0 - far * (0.25 / (PATCHES * PATCHES) as f32)).clamp(0.0, 1.0);
            let alike = alike * alike;
            let cosine = n[0][x] * m[0][x] + n[1][x] * m[1][x] + n[2][x] * m[2][x];
            let lengths = (n[0][x].abs() + n[1][x].abs() + n[2][x].abs())
                * (m[0][x].abs() + m[1][x].abs() + m[2][x].abs());
            let turned = (1.0 - (1.0 - cosine) * straight).clamp(0.0, 1.0);
            let off = (other[x] - near[x] - columns[x] * dx - lines[x] * dy).abs();
            let level = (1.0 - off * if own[x] < its[x] { own[x] } else { its[x] }).clamp(0.0, 1.0);
            let same = if lengths > 0.0 { turned * level } else { 1.0 };
            out[x] = there[x] * alike * alike * same;
        }
        out
    }
}

/// Takes weight from a row of pairs that starts at the pixels p and q where one is much less sure than the other.
#[inline(always)]
fn keep_apart([sureness, trust]: &[Vec<f32>; 2], [p, q]: [usize; 2], weights: &mut [f32; TILE]) {
    let (s, t) = (cut::<TILE>(sureness, p), cut::<TILE>(trust, p));
    let (u, v) = (cut::<TILE>(sureness, q), cut::<TILE>(trust, q));
    for x in 0..TILE {
        let (one, other) = (t[x] * u[x], v[x] * s[x]);
        let least = if one < other { one } else { other };
        weights[x] *= if least < 1.0 { least } else { 1.0 };
    }
}

impl Sums {
    /// Adds a row of pixels that starts at q by their weights.
    #[inline(always)]
    fn add(&mut self, values: &[Vec<f32>; VALUES], q: usize, weights: &[f32; TILE]) {
        for (sum, weight) in self.weight.iter_mut().zip(weights) {
            *sum += weight;
        }
        for (sums, plane) in self.values.iter_mut().zip(values) {
            for ((sum, value), weight) in sums.iter_mut().zip(cut::<TILE>(plane, q)).zip(weights) {
                *sum += weight * value;
            }
        }
    }
}

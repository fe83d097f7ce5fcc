//! Non-local means: every pixel becomes the mean of nearby pixels whose surroundings look the same within their
//! known noise.
//!
//! The distance between two pixels is the mean squared difference of the patches around them, in units of the
//! variance of each sample, minus the difference expected from noise alone (Rousselle, Knaus and Zwicker 2012,
//! Adaptive rendering with non-local means filtering, section 4). So an edge stronger than the noise is kept, and
//! the filter has less effect as more samples reduce the noise.

use std::ops::Range;

use engine::{Context, NodeError};
use fearless_simd::{Level, dispatch, f32x8, prelude::*};
use glam::Vec3;

/// Side of the square tiles that are filtered at once, in pixels.
const TILE: usize = 32;
/// Radius of a patch, in pixels.
const PATCH: usize = 2;
/// Number of rows and columns of a patch.
const PATCHES: usize = 2 * PATCH + 1;
/// Number of pixels per vector register.
const LANES: usize = 8;
/// Number of pixels per row that are compared for the patches of a tile, rounded up to whole vectors.
const SIDE: usize = (TILE + 2 * PATCH).next_multiple_of(LANES);
/// Number that is added to variances before they are used as divisors, so that no divisor is 0. It is negligible
/// for signals near 1.
const FLOOR: f32 = 1e-8;
/// Maximum relative difference in depth between a pixel and the plane of another pixel for both to belong to the
/// same surface.
const OFF: f32 = 0.05;
/// Maximum ratio of the variance of a pixel to the mean variance around another pixel. Above this ratio, the weight
/// of the pair is reduced.
const LESS_SURE: f32 = 16.0;
/// Largest value that is summed without being scaled down, so that sums do not overflow. The weights add up to less
/// than 2^12.
const ROOM: f32 = f32::MAX / 65536.0;
/// Number of values that are averaged together.
pub const VALUES: usize = 6;

/// Data of a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pixel {
    /// Signal that is compared.
    pub signal: [f32; 3],
    /// Variance of each channel of the signal, the same for all three. A pixel with variance 0 stays
    /// unchanged.
    pub variance: f32,
    /// Reciprocal of the variance, and the largest variance that another pixel can have to be averaged with this
    /// pixel at full weight. Set by [`Field::find_doubts`].
    pub doubt: [f32; 2],
    /// Values that are averaged.
    pub values: [f32; VALUES],
    /// True if the pixel takes part in averages.
    pub there: bool,
    /// Normal of the surface; 0 if normals are not compared at the pixel.
    pub normal: Vec3,
    /// Reciprocal of the depth, its change per column, and its change per row. On a plane, the reciprocal is linear
    /// over the pixels.
    pub nearness: [f32; 3],
}

/// Parameters of the filter: the search window, and how much patches and normals may differ.
#[derive(Debug, Clone, Copy)]
pub struct Reach {
    /// Radius of the search window, in pixels.
    pub radius: usize,
    /// Allowed difference of patches, in standard deviations of the noise.
    pub strength: f32,
    /// Allowed difference of normals, as 1 - cosine.
    pub bend: f32,
}

/// A grid of pixels.
#[derive(Debug)]
pub struct Field {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixels, row by row.
    pub pixels: Vec<Pixel>,
    /// True if pixels with much larger variance than others get a reduced weight.
    pub doubts: bool,
}

impl Pixel {
    /// True if the pixel is to be averaged.
    pub fn is_noisy(&self) -> bool {
        self.there && self.variance > 0.0
    }
}

impl Field {
    /// Replaces each variance with the mean variance of the pixels within `radius` that take part, since the
    /// variance of a few samples is itself noisy. The result is at least a tenth of the pixel's own variance;
    /// otherwise a single pixel of very uneven samples would count as an edge.
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

    /// Compares the variance of each pixel with the variances of its eight neighbours, before variances are
    /// smoothed. The variance of a firefly is so large that its light seems equal to the light of every pixel
    /// around it. A mean would spread this light over pixels whose light is well known, and remove it from its
    /// place. So the weight of such a pair of pixels is reduced in both directions, by the ratio of the variance of
    /// one pixel to the mean variance around the other. The largest variance is left out of that mean, since it may
    /// belong to the firefly itself.
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

    /// Computes the slopes of nearness from the pixels on both sides: the smaller of the two steps, or zero where
    /// their signs differ, so that edges do not count as slopes.
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

    /// Computes the averaged values of each pixel.
    pub fn average(&self, reach: Reach, cx: &Context) -> Result<Vec<[f32; VALUES]>, NodeError> {
        self.average_at(Level::new(), reach, cx)
    }

    /// Same as [`average`](Self::average), with a given set of vector instructions. All sets give the same
    /// bits.
    pub(super) fn average_at(
        &self,
        level: Level,
        reach: Reach,
        cx: &Context,
    ) -> Result<Vec<[f32; VALUES]>, NodeError> {
        let (across, down) = (self.width.div_ceil(TILE), self.height.div_ceil(TILE));
        // A power of two, which changes no bit unless sums would overflow.
        let scale = if self.brightest() > ROOM { 1.0 / 65536.0 } else { 1.0 };
        let tiles = cx.for_each_tile(across * down, |index| {
            let corner = [index % across * TILE, index / across * TILE];
            let tile = Tile::cut(self, corner, reach.radius + PATCH, scale);
            let rows = tile.noisy_rows();
            let radius = if rows.is_empty() { 0 } else { reach.radius };
            cx.count("taps", ((2 * radius + 1) * (2 * radius + 1) * rows.len() * TILE) as u64);
            let reach = Reach { radius, ..reach };
            dispatch!(level, simd => tile.average(simd, reach, rows))
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

/// Index of the first of the three planes of the signal in a tile, one plane per channel.
const SIGNAL: usize = 0;
/// Index of the plane of the variance of the signal.
const VARIANCE: usize = 3;
/// Index of the plane that is 1 where a pixel takes part in averages, and 0 elsewhere.
const THERE: usize = 4;
/// Index of the first of the three planes of the normal.
const NORMAL: usize = 5;
/// Index of the plane of the sum of the absolute components of the normal.
const FACED: usize = 8;
/// Index of the first of the three planes of nearness and its two slopes.
const NEARNESS: usize = 9;
/// Index of the plane that holds the reciprocal of each pixel's threshold for nearness. Two pixels whose nearness
/// differs by more than the threshold belong to different surfaces.
const LEVEL: usize = 12;
/// Index of the first of the planes of the values to average.
const AVERAGED: usize = 13;
/// Index of the last two planes: the reciprocal of the variance, and the largest variance that another pixel can
/// have to be averaged at full weight. They exist only if weights are reduced by variance.
const DOUBT: usize = AVERAGED + VALUES;

/// A tile and its surroundings. Each number of a pixel has its own plane, so that rows can be processed in vector
/// registers. No lane depends on another, so vectors of any width give the same bits.
struct Tile {
    /// Width of the border around the tile, in pixels.
    rim: usize,
    /// Length of a row of a plane, in values.
    stride: usize,
    /// Length of a plane, in values.
    size: usize,
    planes: Vec<f32>,
    doubts: bool,
}

/// The sums of one row of a tile.
struct Sums {
    values: [[f32; TILE]; VALUES],
    weight: [f32; TILE],
}

/// Eight consecutive numbers of a row.
#[inline(always)]
fn lanes<S: Simd, const N: usize>(simd: S, row: &[f32; N], vector: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &row[vector * LANES..(vector + 1) * LANES])
}

/// Clamps each lane to the range from 0 to 1.
#[inline(always)]
fn share<S: Simd>(simd: S, v: f32x8<S>) -> f32x8<S> {
    v.max(f32x8::splat(simd, 0.0)).min(f32x8::splat(simd, 1.0))
}

impl Tile {
    fn cut(field: &Field, [left, top]: [usize; 2], rim: usize, scale: f32) -> Self {
        let stride = TILE + 2 * rim;
        // Reads of the last row may extend beyond its end.
        let size = stride * stride + LANES;
        let mut planes = vec![0.0; size * if field.doubts { DOUBT + 2 } else { DOUBT }];
        let (columns, rows) =
            (rim.saturating_sub(left)..stride.min(field.width + rim - left), rim.saturating_sub(top)..stride);
        for y in rows.take_while(|y| top + y - rim < field.height) {
            for x in columns.clone() {
                let pixel = &field.pixels[(top + y - rim) * field.width + left + x - rim];
                // A pixel that is left out may be infinite, which a weight of 0 does not remove.
                if !pixel.there {
                    continue;
                }
                let mut set = |plane: usize, value: f32| planes[plane * size + y * stride + x] = value;
                set(VARIANCE, pixel.variance);
                set(THERE, 1.0);
                set(LEVEL, 1.0 / (OFF * pixel.nearness[0]).max(1e-30));
                let normal = pixel.normal.to_array();
                set(FACED, normal[0].abs() + normal[1].abs() + normal[2].abs());
                for (first, values) in [(SIGNAL, pixel.signal), (NORMAL, normal), (NEARNESS, pixel.nearness)]
                {
                    (0..3).for_each(|k| set(first + k, values[k]));
                }
                (0..VALUES).for_each(|k| set(AVERAGED + k, pixel.values[k] * scale));
                if field.doubts {
                    (0..2).for_each(|k| set(DOUBT + k, pixel.doubt[k]));
                }
            }
        }
        Self { rim, stride, size, planes, doubts: field.doubts }
    }

    /// The `N` values of a plane that begin at `start`.
    #[inline(always)]
    fn row<const N: usize>(&self, plane: usize, start: usize) -> &[f32; N] {
        self.planes[plane * self.size + start..].first_chunk().expect("a tile lies within its planes")
    }

    /// Index of a pixel of the tile in the planes.
    fn at(&self, x: usize, y: usize) -> usize {
        (y + self.rim) * self.stride + x + self.rim
    }

    /// True if a pixel of the tile is averaged.
    fn noisy(&self, x: usize, y: usize) -> bool {
        let at = self.at(x, y);
        self.row::<1>(THERE, at)[0] > 0.0 && self.row::<1>(VARIANCE, at)[0] > 0.0
    }

    /// Range of the rows of the tile from the first to the last row that has a pixel to average.
    fn noisy_rows(&self) -> Range<usize> {
        let noisy = |y: &usize| (0..TILE).any(|x| self.noisy(x, *y));
        let first = (0..TILE).find(noisy).unwrap_or(TILE);
        first..(first..TILE).rfind(noisy).map_or(first, |last| last + 1)
    }

    /// Averages of the pixels of the tile, row by row.
    #[inline(always)]
    fn average<S: Simd>(&self, simd: S, reach: Reach, noisy: Range<usize>) -> Vec<[f32; VALUES]> {
        // The pixel itself counts once.
        let own = |y: usize| Sums {
            values: std::array::from_fn(|k| *self.row(AVERAGED + k, self.at(0, y))),
            weight: [1.0; TILE],
        };
        let mut sums: Vec<Sums> = (0..TILE).map(own).collect();
        let radius = reach.radius as isize;
        // Row by row, to keep the working set small: for each offset along the row, the distances of the last rows
        // that patches cover, summed along the row.
        let mut along = vec![[[0.0_f32; TILE]; PATCHES]; 2 * reach.radius + 1];
        for dy in -radius..=radius {
            for y in noisy.start..noisy.end + 2 * PATCH {
                let p = (y + self.rim - PATCH) * self.stride + self.rim - PATCH;
                for (dx, rows) in (-radius..=radius).zip(&mut along) {
                    if (dx, dy) == (0, 0) {
                        continue;
                    }
                    let offset = dy * self.stride as isize + dx;
                    let q = (p as isize + offset) as usize;
                    self.compare(simd, [p, q], reach.strength, &mut rows[y % PATCHES]);
                    let Some(y) = y.checked_sub(2 * PATCH) else { continue };
                    if y >= noisy.start {
                        let p = self.at(0, y);
                        let q = (p as isize + offset) as usize;
                        let row = |k: usize| &rows[(y + k) % PATCHES];
                        let rows = [row(0), row(1), row(2), row(3), row(4)];
                        self.add(simd, [p, q], [dx as f32, dy as f32], reach.bend, rows, &mut sums[y]);
                    }
                }
            }
        }
        let mean = |i: usize| {
            let (x, y) = (i % TILE, i / TILE);
            let Sums { values, weight } = &sums[y];
            match self.noisy(x, y) {
                true => values.map(|row| row[x] / weight[x]),
                false => std::array::from_fn(|k| self.row::<1>(AVERAGED + k, self.at(x, y))[0]),
            }
        };
        (0..TILE * TILE).map(mean).collect()
    }

    /// Compares the pixels of the row that starts at `p` with the pixels of the row that starts at `q`, pair by
    /// pair. Writes the distance of each pair to `out`, summed over the columns of a patch.
    #[inline(always)]
    fn compare<S: Simd>(&self, simd: S, [p, q]: [usize; 2], strength: f32, out: &mut [f32; TILE]) {
        let k = strength * strength;
        let [a, b, c] = [self.row::<SIDE>(SIGNAL, p), self.row(SIGNAL + 1, p), self.row(SIGNAL + 2, p)];
        let [d, e, f] = [self.row::<SIDE>(SIGNAL, q), self.row(SIGNAL + 1, q), self.row(SIGNAL + 2, q)];
        let [v, w] = [self.row::<SIDE>(VARIANCE, p), self.row(VARIANCE, q)];
        let [t, u] = [self.row::<SIDE>(THERE, p), self.row(THERE, q)];
        let mut single = [f32x8::splat(simd, 0.0); SIDE / LANES];
        for (i, single) in single.iter_mut().enumerate() {
            let a = lanes(simd, a, i) - lanes(simd, d, i);
            let b = lanes(simd, b, i) - lanes(simd, e, i);
            let c = lanes(simd, c, i) - lanes(simd, f, i);
            let squared = (a * a + b * b + c * c) * (1.0 / 3.0);
            let (v, w) = (lanes(simd, v, i), lanes(simd, w, i));
            let there = lanes(simd, t, i) * lanes(simd, u, i);
            *single = there * (squared - (v + v.min(w))) / ((v + w) * k + FLOOR);
        }
        for i in 0..TILE / LANES {
            let (here, next) = (single[i], single[i + 1]);
            let sum = here + here.slide::<1>(next) + here.slide::<2>(next);
            let sum = sum + here.slide::<3>(next) + here.slide::<4>(next);
            sum.store_slice(&mut out[i * LANES..(i + 1) * LANES]);
        }
    }

    /// Adds the pixels of a row that starts at q to the sums of a row that starts at p. The weights are computed
    /// from `rows`: for each row of the two patches, the sum of the distances between their pixels.
    #[inline(always)]
    fn add<S: Simd>(
        &self,
        simd: S,
        [p, q]: [usize; 2],
        [dx, dy]: [f32; 2],
        bend: f32,
        rows: [&[f32; TILE]; PATCHES],
        sums: &mut Sums,
    ) {
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let straight = 1.0 / bend;
        let there = self.row::<TILE>(THERE, q);
        let [near, other] = [self.row::<TILE>(NEARNESS, p), self.row(NEARNESS, q)];
        let [columns, lines] = [self.row::<TILE>(NEARNESS + 1, p), self.row(NEARNESS + 2, p)];
        let [own, its] = [self.row::<TILE>(LEVEL, p), self.row(LEVEL, q)];
        let [faced, facing] = [self.row::<TILE>(FACED, p), self.row(FACED, q)];
        let [a, b, c] = [self.row::<TILE>(NORMAL, p), self.row(NORMAL + 1, p), self.row(NORMAL + 2, p)];
        let [d, e, f] = [self.row::<TILE>(NORMAL, q), self.row(NORMAL + 1, q), self.row(NORMAL + 2, q)];
        for i in 0..TILE / LANES {
            let at = |row: &[f32; TILE]| lanes(simd, row, i);
            let far = at(rows[0]) + at(rows[1]) + at(rows[2]) + at(rows[3]) + at(rows[4]);
            // (1 - d/4)^4 falls like exp(-d), and reaches 0 at 4.
            let alike = share(simd, one - far * (0.25 / (PATCHES * PATCHES) as f32));
            let alike = alike * alike;
            let cosine = at(a) * at(d) + at(b) * at(e) + at(c) * at(f);
            let turned = share(simd, one - (one - cosine) * straight);
            let off = (at(other) - at(near) - at(columns) * dx - at(lines) * dy).abs();
            let level = share(simd, one - off * at(own).min(at(its)));
            let faced = (at(faced) * at(facing)).simd_gt(zero);
            let mut weight = at(there) * alike * alike * faced.select(turned * level, one);
            if self.doubts {
                let of = |k: usize, start: usize| at(self.row(DOUBT + k, start));
                // Reduced if one of the two has a much larger variance.
                weight *= (of(1, p) * of(0, q)).min(of(1, q) * of(0, p)).min(one);
            }
            let more = |sum: &mut [f32; TILE], value: f32x8<S>| {
                (lanes(simd, sum, i) + value).store_slice(&mut sum[i * LANES..(i + 1) * LANES]);
            };
            more(&mut sums.weight, weight);
            for (k, sum) in sums.values.iter_mut().enumerate() {
                more(sum, weight * at(self.row(AVERAGED + k, q)));
            }
        }
    }
}

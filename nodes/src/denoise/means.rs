//! Non-local means: every pixel becomes the mean of those near it whose surroundings look the same, to the
//! noise that they are known to have.
//!
//! The distance of two pixels is that of the patches around them, per sample and in units of its variance,
//! less what noise alone would give (Rousselle, Knaus and Zwicker 2012, Adaptive rendering with non-local
//! means filtering, section 4). So an edge stays that is stronger than the noise, and the filter fades as
//! more samples leave less of it.

use engine::{Context, NodeError};
use glam::Vec3;

/// Side of the square tiles that are filtered at once, in pixels.
const TILE: usize = 32;
/// Patches reach so many pixels from their centre.
const PATCH: usize = 2;
/// Side of the region whose pixels are compared for the patches of a tile.
const SIDE: usize = TILE + 2 * PATCH;
/// Variance below this is nothing.
const FLOOR: f32 = 1e-8;
/// Values that are averaged together.
pub const VALUES: usize = 6;

/// What is known of a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pixel {
    /// What is compared.
    pub signal: [f32; 3],
    /// Variance of a channel of the signal, for each alike; 0 leaves the pixel as it is.
    pub variance: f32,
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
        let (across, down) = (self.width.div_ceil(TILE), self.height.div_ceil(TILE));
        let tiles = cx.for_each_tile(across * down, |index| {
            let tile = Tile::cut(self, index % across * TILE, index / across * TILE, reach.radius + PATCH);
            let radius = if tile.busy() { reach.radius } else { 0 };
            cx.count("taps", ((2 * radius + 1) * (2 * radius + 1) * TILE * TILE) as u64);
            tile.average(Reach { radius, ..reach })
        })?;
        let mut out: Vec<_> = self.pixels.iter().map(|pixel| pixel.values).collect();
        for (index, tile) in tiles.iter().enumerate() {
            let (left, top) = (index % across * TILE, index / across * TILE);
            for (row, values) in tile.chunks_exact(TILE).enumerate().take(self.height - top) {
                let wide = TILE.min(self.width - left);
                out[(top + row) * self.width + left..][..wide].copy_from_slice(&values[..wide]);
            }
        }
        Ok(out)
    }
}

/// A tile and what surrounds it, one plane for each number, so that rows run through vector registers.
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
}

impl Tile {
    fn cut(field: &Field, left: usize, top: usize, rim: usize) -> Self {
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
            for k in 0..3 {
                tile.signal[k][i] = pixel.signal[k];
                tile.normal[k][i] = pixel.normal[k];
                tile.nearness[k][i] = pixel.nearness[k];
            }
            for (plane, value) in tile.values.iter_mut().zip(pixel.values) {
                plane[i] = value;
            }
        }
        tile
    }

    /// Whether the pixel at an index of the planes takes an average.
    fn noisy(&self, i: usize) -> bool {
        self.there[i] > 0.0 && self.variance[i] > 0.0
    }

    /// Whether any pixel does.
    fn busy(&self) -> bool {
        let at = |i: usize| (i / TILE + self.rim) * self.stride + i % TILE + self.rim;
        (0..TILE * TILE).any(|i| self.noisy(at(i)))
    }

    /// Averages of the tile's pixels, row by row.
    fn average(&self, reach: Reach) -> Vec<[f32; VALUES]> {
        let at = |x: usize, y: usize| (y + self.rim) * self.stride + x + self.rim;
        let own = |y: usize| self.values.each_ref().map(|plane| cut::<TILE>(plane, at(0, y)));
        let mut sums: Vec<[[f32; TILE]; VALUES]> = (0..TILE).map(own).collect();
        // The pixel itself counts once.
        let mut total = [[1.0_f32; TILE]; TILE];
        let radius = reach.radius as isize;
        let mut patches = Patches::default();
        for dy in -radius..=radius {
            for dx in (-radius..=radius).filter(|&dx| (dx, dy) != (0, 0)) {
                patches.compare(self, (dx, dy), reach.strength);
                for y in 0..TILE {
                    let p = at(0, y);
                    let q = (p as isize + dy * self.stride as isize + dx) as usize;
                    let weights = self.weigh(p, q, (dx as f32, dy as f32), reach.bend, &patches.row(y));
                    for (sum, weight) in total[y].iter_mut().zip(&weights) {
                        *sum += weight;
                    }
                    for (sums, plane) in sums[y].iter_mut().zip(&self.values) {
                        for ((sum, value), weight) in sums.iter_mut().zip(&plane[q..q + TILE]).zip(&weights) {
                            *sum += weight * value;
                        }
                    }
                }
            }
        }
        let mean = |i: usize| {
            let (x, y) = (i % TILE, i / TILE);
            if self.noisy(at(x, y)) {
                sums[y].map(|row| row[x] / total[y][x])
            } else {
                own(y).map(|row| row[x])
            }
        };
        (0..TILE * TILE).map(mean).collect()
    }

    /// Weights of a row of pairs that starts at the pixels p and q.
    fn weigh(&self, p: usize, q: usize, (dx, dy): (f32, f32), bend: f32, far: &[f32; TILE]) -> [f32; TILE] {
        let there = cut::<TILE>(&self.there, q);
        let [near, columns, rows] = [0, 1, 2].map(|k| cut::<TILE>(&self.nearness[k], p));
        let other = cut::<TILE>(&self.nearness[0], q);
        let n = [0, 1, 2].map(|k| cut::<TILE>(&self.normal[k], p));
        let m = [0, 1, 2].map(|k| cut::<TILE>(&self.normal[k], q));
        std::array::from_fn(|x| {
            // (1 - d/4)^4 falls like exp(-d), and to nothing at 4.
            let alike = (1.0 - far[x] * 0.25).max(0.0);
            let alike = alike * alike;
            let cosine = n[0][x] * m[0][x] + n[1][x] * m[1][x] + n[2][x] * m[2][x];
            let lengths = (n[0][x].abs() + n[1][x].abs() + n[2][x].abs())
                * (m[0][x].abs() + m[1][x].abs() + m[2][x].abs());
            let turned = (1.0 - (1.0 - cosine) / bend).clamp(0.0, 1.0);
            // Off the plane by a twentieth of the depth is another surface.
            let off = (other[x] - near[x] - columns[x] * dx - rows[x] * dy).abs();
            let level = (1.0 - off / (0.05 * near[x].max(other[x]) + f32::MIN_POSITIVE)).clamp(0.0, 1.0);
            let same = if lengths > 0.0 { turned * level } else { 1.0 };
            there[x] * alike * alike * same
        })
    }
}

/// A piece of a plane.
fn cut<const N: usize>(plane: &[f32], start: usize) -> [f32; N] {
    std::array::from_fn(|x| plane[start + x])
}

/// Distances of patches for one offset.
#[derive(Default)]
struct Patches {
    single: Vec<f32>,
    rows: Vec<f32>,
}

impl Patches {
    fn compare(&mut self, tile: &Tile, (dx, dy): (isize, isize), strength: f32) {
        let k = strength * strength;
        self.single.clear();
        for y in 0..SIDE {
            let p = (y + tile.rim - PATCH) * tile.stride + tile.rim - PATCH;
            let q = (p as isize + dy * tile.stride as isize + dx) as usize;
            let s = [0, 1, 2].map(|c| (cut::<SIDE>(&tile.signal[c], p), cut::<SIDE>(&tile.signal[c], q)));
            let (v, w) = (cut::<SIDE>(&tile.variance, p), cut::<SIDE>(&tile.variance, q));
            let (t, u) = (cut::<SIDE>(&tile.there, p), cut::<SIDE>(&tile.there, q));
            let row: [f32; SIDE] = std::array::from_fn(|x| {
                let [a, b, c] = [0, 1, 2].map(|c| s[c].0[x] - s[c].1[x]);
                let squared = (a * a + b * b + c * c) * (1.0 / 3.0);
                let noise = v[x] + if v[x] < w[x] { v[x] } else { w[x] };
                t[x] * u[x] * (squared - noise) / (FLOOR + k * (v[x] + w[x]))
            });
            self.single.extend(row);
        }
        // Sums over patches, first along rows.
        self.rows.clear();
        for row in self.single.chunks_exact(SIDE) {
            let sum: [f32; TILE] =
                std::array::from_fn(|x| row[x] + row[x + 1] + row[x + 2] + row[x + 3] + row[x + 4]);
            self.rows.extend(sum);
        }
    }

    /// Distances for a row of the tile, at least 0.
    fn row(&self, y: usize) -> [f32; TILE] {
        const AREA: f32 = ((2 * PATCH + 1) * (2 * PATCH + 1)) as f32;
        std::array::from_fn(|x| {
            let sum: f32 = (0..2 * PATCH + 1).map(|k| self.rows[(y + k) * TILE + x]).sum();
            (sum / AREA).max(0.0)
        })
    }
}

//! Projection of splats to footprints on the image plane: EWA splatting (Zwicker et al. 2001, "EWA Splatting", eq.
//! 24 to 26) with the constants of the INRIA rasterizer, in f64.

use std::ops::Range;

use engine::{Context, NodeError};
use fearless_simd::{Level, Simd, dispatch};
use glam::DVec3;
use scene::math::num;
use scene::types::Splats;

use super::block::{BLOCK, Blocks};
use super::camera_model::{CameraModel, SLACK_PX, TileRange};
use super::listed::{Listed, clip};
use super::peak::Peak;
use super::settings::{Bounds, DepthMode, Precision, Settings, Sort, TILE};
use super::sh;
use super::shape::{BATCH, Batch, Shape};
use super::work::Work;

/// Base-2 logarithm of the number of splats per job. It is fixed, so that the order of footprints does not depend
/// on the number of threads.
const CHUNK_BITS: u32 = 13;
pub(crate) const CHUNK: usize = 1 << CHUNK_BITS;

/// A splat projected to the image plane. Its alpha at the pixel centre (x, y) is `opacity * 2^-(t^2 + s^2)`
/// with `t = l11 (x - u) + l21 (y - v)` and `s = l22 (y - v)`. These are the elements of the Cholesky factor of the
/// inverse covariance, which is exact for needles, where `a dx^2 + 2 b dx dy + c dy^2` cancels. A footprint fits
/// one cache line, since tiles access footprints in random order.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Footprint {
    pub u: f64,
    pub v: f64,
    pub l11: f64,
    pub l21: f64,
    pub l22: f64,
    pub opacity: f32,
    pub log2_opacity: f32,
    pub rgb: [f32; 3],
    pub z: f32,
}

/// A footprint in a row of tiles.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Entry {
    /// Sort key, which increases from front to back.
    pub key: u64,
    pub index: u32,
    /// First column of tiles.
    pub x0: u16,
    /// End of the range of columns of tiles (exclusive), as in [`TileRange`].
    pub x1: u16,
}

/// Footprints of one job in file order, with their keys and the tiles that they touch.
#[derive(Default)]
struct Chunk {
    footprints: Vec<Footprint>,
    /// For each footprint, the distance by which the peak of its splat must lie in front of the limiting surface
    /// (see [`Limit`](super::draw::Limit)) for the splat to be drawn, in world units. Empty if there is no such
    /// surface or all of these distances are 0.
    margins: Vec<f32>,
    /// Peak of each footprint, for `RayMedian` and where there are margins.
    peaks: Vec<Peak>,
    /// Index in the scene of the splat of each footprint; empty unless indices are kept.
    indices: Vec<u32>,
    reaches: Vec<(u64, TileRange)>,
    skipped: u64,
    directed: u64,
    degenerate: u64,
    held: u64,
}

/// Footprints of a view in file order. They stay in separate chunks, one per job, because joining the chunks would
/// take longer than all lookups in them.
pub(crate) struct Projected {
    chunks: Vec<Chunk>,
    /// Number of splats of the scene.
    splats: u64,
    /// Same as `faint` of [`Work`].
    faint: u64,
    /// Same as `behind` of [`Work`].
    behind: u64,
    /// Base-2 logarithm of the smallest alpha that is blended.
    pub log2_cut: f64,
    /// Number of columns after which the picture repeats, for a panorama.
    pub period: Option<u32>,
}

impl Projected {
    /// Creates a view with a single chunk, for calibration.
    pub(super) fn of(footprints: Vec<Footprint>) -> Self {
        let chunks = vec![Chunk { footprints, ..Chunk::default() }];
        Self { chunks, splats: 0, faint: 0, behind: 0, log2_cut: 0.0, period: None }
    }

    /// For each chunk and each row of tiles in `rows`, lists the footprints that touch that row, in file order.
    pub(super) fn listed(&self, rows: &Range<usize>, cx: &Context) -> Result<Vec<Listed<Entry>>, NodeError> {
        cx.for_each_tile(self.chunks.len(), |chunk| {
            let number = (chunk << CHUNK_BITS) as u32;
            Listed::by(rows.len(), &self.chunks[chunk].reaches, |at, &(key, TileRange { x0, x1, y0, y1 })| {
                (Entry { key, index: number + at as u32, x0, x1 }, [clip(y0..y1, rows), 0..0])
            })
        })
    }

    /// Returns two numbers for each of the first `rows` rows of tiles: the number of footprints that touch the row,
    /// and an upper bound of the number of pairs of a footprint and a tile of the row that it touches.
    pub(super) fn in_rows(&self, rows: usize) -> Vec<[u64; 2]> {
        // Differences between consecutive rows; negative differences wrap around.
        let mut sums = vec![[0_u64; 2]; rows + 1];
        for (_, reach) in self.chunks.iter().flat_map(|chunk| &chunk.reaches) {
            let both = [1, u64::from(reach.x1 - reach.x0)];
            for (i, count) in both.into_iter().enumerate() {
                let (first, end) = (usize::from(reach.y0), usize::from(reach.y1));
                sums[first][i] = sums[first][i].wrapping_add(count);
                sums[end][i] = sums[end][i].wrapping_sub(count);
            }
        }
        for row in 1..sums.len() {
            sums[row] = [0, 1].map(|i| sums[row][i].wrapping_add(sums[row - 1][i]));
        }
        sums.truncate(rows);
        sums
    }

    #[inline(always)]
    pub(super) fn footprint(&self, index: u32) -> &Footprint {
        &self.chunks[(index >> CHUNK_BITS) as usize].footprints[index as usize % CHUNK]
    }

    /// Distance by which the peak of a splat must lie in front of the limiting surface for the splat to be drawn,
    /// in world units. `index` is the index of the footprint of the splat. `None` if only its centre must lie in
    /// front.
    #[inline(always)]
    pub(super) fn margin(&self, index: u32) -> Option<f32> {
        let margins = &self.chunks[(index >> CHUNK_BITS) as usize].margins;
        margins.get(index as usize % CHUNK).copied()
    }

    /// Peak of the footprint with this index, for `RayMedian` and where there are margins.
    #[inline(always)]
    pub(super) fn peak(&self, index: u32) -> &Peak {
        let peaks = &self.chunks[(index >> CHUNK_BITS) as usize].peaks;
        peaks.get(index as usize % CHUNK).unwrap_or(&Peak::NONE)
    }

    /// Number of chunks. Chunk `i` holds the footprints of splats `i * CHUNK..(i + 1) * CHUNK`.
    pub(super) fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Footprints of a chunk, in file order, and the index in the scene of the splat of each. The indices are empty
    /// unless they were kept.
    pub(super) fn chunk(&self, chunk: usize) -> (&[Footprint], &[u32]) {
        let Chunk { footprints, indices, .. } = &self.chunks[chunk];
        (footprints, indices)
    }

    /// Chunk of the footprint with this index, and the position of the footprint in the chunk.
    #[inline(always)]
    pub(super) fn place(index: u32) -> (usize, usize) {
        ((index >> CHUNK_BITS) as usize, index as usize % CHUNK)
    }

    /// Work counts of the projection.
    pub(super) fn work(&self) -> Work {
        let mut work = Work { faint: self.faint, behind: self.behind, ..Work::default() };
        for chunk in &self.chunks {
            work.projected += chunk.footprints.len() as u64;
            work.skipped += chunk.skipped;
            work.directed += chunk.directed;
            work.degenerate += chunk.degenerate;
            work.held += chunk.held;
        }
        Work { visited: self.splats - work.skipped, ..work }
    }
}

impl Footprint {
    /// Placeholder for buffers that are filled later.
    pub(super) const NONE: Self = Self {
        u: 0.0,
        v: 0.0,
        l11: 0.0,
        l21: 0.0,
        l22: 0.0,
        opacity: 0.0,
        log2_opacity: 0.0,
        rgb: [0.0; 3],
        z: 0.0,
    };

    /// Horizontal extent, in pixels, of the region where alpha reaches the cutoff, in the row of tiles whose first
    /// pixel row is `y`. Includes a margin.
    pub(super) fn extent_in(&self, y: usize, log2_cut: f64) -> (f64, f64) {
        let reach = f64::from(self.log2_opacity) - log2_cut;
        let (low, high) = (y as f64 + 0.5 - self.v - SLACK_PX, (y + TILE) as f64 - 0.5 - self.v + SLACK_PX);
        // The ellipse is widest, seen from the centre, at dy = widest (its rightmost point).
        let widest = -self.l21 * reach.max(0.0).sqrt()
            / (self.l22 * (self.l21 * self.l21 + self.l22 * self.l22).sqrt());
        let edge = |dy: f64, side: f64| {
            let s = self.l22 * dy;
            (side * (reach - s * s).max(0.0).sqrt() - self.l21 * dy) / self.l11
        };
        let right = self.u + edge(widest.clamp(low, high), 1.0) + SLACK_PX;
        let left = self.u + edge((-widest).clamp(low, high), -1.0) - SLACK_PX;
        (left, right)
    }
}

/// Projects a chunk. The code is scalar and compiled once per instruction set; the compiler vectorises its loops
/// where it can.
#[inline(always)]
fn chunk<S: Simd, L: CameraModel>(_simd: S, projection: &Projection<'_, L>, range: Range<usize>) -> Chunk {
    projection.chunk(range)
}

/// Projects every splat that can change a pixel. Blocks without such splats are skipped.
pub(super) fn project<L: CameraModel>(
    splats: &Splats,
    blocks: Option<&Blocks>,
    camera_model: &L,
    how: (&Settings, Option<f64>),
    cx: &Context,
    level: Level,
) -> Result<Projected, NodeError> {
    project_with(splats, blocks, camera_model, (how.0, how.1, false), cx, level)
}

/// Same as [`project`], and keeps the index of the splat of each footprint.
pub(super) fn project_indexed<L: CameraModel>(
    splats: &Splats,
    camera_model: &L,
    settings: &Settings,
    cx: &Context,
    level: Level,
) -> Result<Projected, NodeError> {
    project_with(splats, None, camera_model, (settings, None, true), cx, level)
}

fn project_with<L: CameraModel>(
    splats: &Splats,
    blocks: Option<&Blocks>,
    camera_model: &L,
    (settings, limit_sigmas, indexed): (&Settings, Option<f64>, bool),
    cx: &Context,
    level: Level,
) -> Result<Projected, NodeError> {
    let log2_cut = num::f64::log2(settings.alpha_cut);
    let projection = Projection {
        indexed,
        ..Projection::new(splats, blocks, camera_model, (settings, limit_sigmas), log2_cut)
    };
    let chunks = cx.for_each_tile(splats.len().div_ceil(CHUNK), |job| {
        let range = job * CHUNK..((job + 1) * CHUNK).min(splats.len());
        dispatch!(level, simd => chunk(simd, &projection, range))
    })?;
    let mut projected = Projected {
        chunks,
        splats: splats.len() as u64,
        faint: 0,
        behind: 0,
        log2_cut,
        period: camera_model.period(),
    };
    // The reasons are counted only if almost nothing is visible.
    if projected.work().projected * 100 < projected.splats {
        let causes = cx.for_each_tile(splats.len().div_ceil(CHUNK), |job| {
            let range = job * CHUNK..((job + 1) * CHUNK).min(splats.len());
            let length = range.len() as u64;
            let drawn = range.filter(|index| is_drawn(splats.opacities[*index], settings));
            let behind = drawn
                .map(|index| camera_model.is_behind(splats.mean(index) - camera_model.eye(), settings.near));
            behind.fold([length, 0], |[faint, behind], one| [faint - 1, behind + u64::from(one)])
        })?;
        for [faint, behind] in causes {
            projected.faint += faint;
            projected.behind += behind;
        }
    }
    Ok(projected)
}

/// True if the opacity is above 0 and reaches `alpha_cut`.
#[inline(always)]
fn is_drawn(opacity: f32, settings: &Settings) -> bool {
    (f64::from(opacity) >= settings.alpha_cut) & (opacity > 0.0)
}

/// Parameters of the projection, common to all splats.
struct Projection<'a, L> {
    splats: &'a Splats,
    blocks: Option<&'a Blocks>,
    camera_model: &'a L,
    settings: &'a Settings,
    log2_cut: f64,
    eye: DVec3,
    /// Degree of the harmonics that are used.
    degree: u32,
    /// Same as `sigmas` of [`Limit`](super::draw::Limit); 0 if there is no limit.
    limit_sigmas: f64,
    /// True if each splat is evaluated only within its bounds, false if at every pixel.
    bounded: bool,
    /// Maximum extent of a splat, in standard deviations along its longest axis, without the part in `beyond`.
    sigmas: f64,
    /// Additional extent of a splat for the low-pass filter and rounding, in pixels.
    beyond: f64,
    /// True to keep the index of the splat of each footprint.
    indexed: bool,
}

impl<'a, L: CameraModel> Projection<'a, L> {
    #[inline(always)]
    fn new(
        splats: &'a Splats,
        blocks: Option<&'a Blocks>,
        camera_model: &'a L,
        (settings, limit_sigmas): (&'a Settings, Option<f64>),
        log2_cut: f64,
    ) -> Self {
        let limit_sigmas = limit_sigmas.unwrap_or(0.0);
        let bounded = settings.is_bounded();
        // 2 ln(255) is 11.1 and INRIA's 3 sigma, squared, 9; 12 covers both.
        let sigmas = (2.0 * std::f64::consts::LN_2 * -log2_cut).max(12.0).sqrt();
        // One pixel covers rounding, two tiles the bounds of the INRIA rasterizer.
        let rounding = if settings.bounds == Bounds::Exact { 1.0 } else { 2.0 * TILE as f64 };
        let beyond = sigmas * settings.low_pass_px2.sqrt() + rounding;
        let (sigmas, beyond) = if bounded { (sigmas, beyond) } else { (f64::INFINITY, 0.0) };
        let (eye, degree) = (camera_model.eye(), settings.sh_degree.min(splats.sh_degree));
        Self {
            splats,
            blocks,
            camera_model,
            settings,
            log2_cut,
            eye,
            degree,
            limit_sigmas,
            bounded,
            sigmas,
            beyond,
            indexed: false,
        }
    }

    /// True if no splat of the block that starts at `first` can be in the picture.
    #[inline(always)]
    fn is_unseen(&self, first: usize) -> bool {
        self.blocks.is_some_and(|blocks| {
            let block = blocks.around(first, self.eye);
            self.camera_model.misses(&block, self.settings.near, self.sigmas, self.beyond)
        })
    }

    /// Vectors from the eye to the centres of the splats in `range`, as one array per coordinate.
    #[inline(always)]
    fn offsets(&self, range: Range<usize>) -> [[f64; BLOCK]; 3] {
        let mut offsets = [[0.0; BLOCK]; 3];
        let means = &self.splats.means[range.clone()];
        let low = self.splats.means_low.get(range).unwrap_or_default();
        for (axis, (offsets, eye)) in offsets.iter_mut().zip(self.eye.to_array()).enumerate() {
            for (offset, mean) in offsets.iter_mut().zip(means) {
                *offset = f64::from(mean[axis]);
            }
            for (offset, low) in offsets.iter_mut().zip(low) {
                *offset += f64::from(low[axis]);
            }
            for offset in offsets {
                *offset -= eye;
            }
        }
        offsets
    }

    /// Adds to `places` the positions in the chunk of those splats that reach `alpha_cut` and for which `is_behind`
    /// and `is_aside` are false. `first` is the position of the first splat of the range. There are no branches, so
    /// the compiler can vectorise the test over several splats.
    #[inline(always)]
    fn find(&self, range: Range<usize>, first: usize, places: &mut Vec<u16>) {
        let Self { splats, camera_model, settings, .. } = *self;
        let [x, y, z] = self.offsets(range.clone());
        let mut world = [f64::INFINITY; BLOCK];
        if self.bounded {
            for (world, [a, b, c]) in world.iter_mut().zip(&splats.scales[range.clone()]) {
                *world = self.sigmas * f64::from(a.max(*b).max(*c));
            }
        }
        let mut found = [false; BLOCK];
        for (found, opacity) in found.iter_mut().zip(&splats.opacities[range]) {
            *found = is_drawn(*opacity, settings);
        }
        for i in 0..BLOCK {
            let offset = DVec3::new(x[i], y[i], z[i]);
            found[i] &= !camera_model.is_behind(offset, settings.near)
                & !camera_model.is_aside(offset, world[i], self.beyond);
        }
        let (mut here, mut count) = ([0; BLOCK], 0);
        for (place, found) in (first..).zip(found) {
            here[count] = place as u16;
            count += usize::from(found);
        }
        places.extend_from_slice(&here[..count]);
    }

    /// Adds the footprint of a splat with this shape.
    #[inline(always)]
    fn add(&self, index: usize, shape: &Shape, out: &mut Chunk) {
        let Self { splats, camera_model, settings, log2_cut, .. } = *self;
        let &Shape { offset, u, v, depth, xx, yy, det, raw_det, root_xx, root_yy, l11, l21, l22 } = shape;
        let mut opacity = f64::from(splats.opacities[index]);
        if settings.compensate {
            opacity *= (raw_det / det).sqrt();
            if opacity < settings.alpha_cut {
                return;
            }
        }
        if !(l11.is_finite() && l21.is_finite() && l11 > 0.0 && l22 > 0.0 && u.is_finite() && v.is_finite()) {
            out.degenerate += 1;
            return;
        }
        let log2_opacity = num::f64::log2(opacity);
        let reach = match settings.bounds {
            _ if !self.bounded => Some(camera_model.everywhere()),
            Bounds::Inria => camera_model.inria_reach(u, v, xx, yy, det),
            _ => {
                let sigmas = (2.0 * std::f64::consts::LN_2 * (log2_opacity - log2_cut).max(0.0)).sqrt();
                camera_model.exact_reach(u, v, sigmas * root_xx, sigmas * root_yy)
            }
        };
        let Some(reach) = reach else { return };

        let mut direction = [0.0; 3];
        // The constant function needs no direction.
        if self.degree > 0 || !settings.skip_harmonics {
            direction = (offset / offset.length()).to_array().map(|c| c as f32);
            out.directed += 1;
        }
        let each = splats.sh_len();
        let coefficients = &splats.sh[index * each..(index + 1) * each];
        let rgb = match settings.skip_harmonics {
            true => sh::colour(self.degree, coefficients, direction),
            false => sh::colour_of_all(self.degree, coefficients, direction),
        };
        out.held += u64::from(rgb.contains(&sh::LARGEST));
        let by = match settings.sort {
            Sort::Depth => depth,
            Sort::Distance => offset.length(),
        };
        // The bits of positive floats are ordered like the floats.
        let key = match settings.precision {
            // A key of 44 bits saves two digits of the sort. It is still finer than the f32 keys of other
            // renderers, which cause false ties that cost 10 dB on `playbot`.
            Precision::F32 => by.to_bits() >> 20,
            Precision::F64 => by.to_bits(),
        };
        out.reaches.push((key, reach));
        if self.indexed {
            out.indices.push(index as u32);
        }
        let (opacity, log2_opacity, z) = (opacity as f32, log2_opacity as f32, depth as f32);
        out.footprints.push(Footprint { u, v, l11, l21, l22, opacity, log2_opacity, rgb, z });
        if settings.depth == DepthMode::RayMedian || self.limit_sigmas > 0.0 {
            let (quat, scale) = (splats.quats[index], splats.scales[index]);
            out.peaks.push(Peak::of(camera_model, offset, (depth, settings.near), quat, scale));
        }
        if self.limit_sigmas > 0.0 {
            let [a, b, c] = splats.scales[index].map(f64::from);
            let middle = a.max(b).min(a.min(b).max(c));
            out.margins.push((self.limit_sigmas * middle) as f32);
        }
    }

    /// Projects the splats of a chunk.
    #[inline(always)]
    fn chunk(&self, range: Range<usize>) -> Chunk {
        let Self { splats, camera_model, eye, .. } = *self;
        let mut out = Chunk::default();
        let mut places = Vec::with_capacity(range.len());
        for first in range.clone().step_by(BLOCK) {
            let block = first..(first + BLOCK).min(range.end);
            if self.is_unseen(first) {
                out.skipped += block.len() as u64;
            } else {
                self.find(block, first - range.start, &mut places);
            }
        }
        out.footprints.reserve_exact(places.len());
        out.reaches.reserve_exact(places.len());
        if self.limit_sigmas > 0.0 {
            out.margins.reserve_exact(places.len());
        }
        if self.limit_sigmas > 0.0 || self.settings.depth == DepthMode::RayMedian {
            out.peaks.reserve_exact(places.len());
        }
        let mut batch = Batch::new();
        for places in places.chunks(BATCH) {
            for (lane, place) in places.iter().enumerate() {
                let index = range.start + usize::from(*place);
                batch.set(lane, splats.mean(index) - eye, splats.quats[index], splats.scales[index]);
            }
            batch.project(camera_model, self.settings.low_pass_px2);
            for (lane, place) in places.iter().enumerate() {
                self.add(range.start + usize::from(*place), &batch.get(lane), &mut out);
            }
        }
        out
    }
}

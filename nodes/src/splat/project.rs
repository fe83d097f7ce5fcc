//! From splats to footprints on the image plane: EWA splatting (Zwicker et al. 2001, "EWA Splatting",
//! eq. 24 to 26) with the constants of the INRIA rasterizer. All in f64.

use std::ops::Range;

use engine::{Context, NodeError};
use fearless_simd::{Level, Simd, dispatch};
use glam::DVec3;

use super::bin::TILE;
use super::block::{BLOCK, Blocks};
use super::lens::{Lens, Reach, SLACK_PX, Seen, Sight};
use super::{Bounds, Precision, Settings, Sort, Work, sh};
use crate::num;
use crate::types::Splats;

/// Splats a job, as a power of two; fixed, so that the order of footprints does not depend on the number
/// of threads.
const CHUNK_BITS: u32 = 13;
const CHUNK: usize = 1 << CHUNK_BITS;

/// A splat on the image plane. Its alpha at the pixel centre (x, y) is
/// `opacity * 2^-(t^2 + s^2)` with `t = l11 (x - u) + l21 (y - v)` and `s = l22 (y - v)`: the Cholesky
/// factor of the inverse covariance, which keeps needles exact where `a dx^2 + 2 b dx dy + c dy^2` cancels.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
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

/// The footprints of one job, in file order.
#[derive(Default)]
struct Chunk {
    footprints: Vec<Footprint>,
    reaches: Vec<Reach>,
    keys: Vec<u64>,
    skipped: u64,
    directed: u64,
    degenerate: u64,
}

/// The footprints of a view, in file order. They stay in the chunks they were made in: joining them would take
/// longer than all that looks them up.
pub(crate) struct Projected {
    chunks: Vec<Chunk>,
    /// Splats of the scene.
    splats: u64,
    /// Of these, the ones at or below the near plane; 0 unless next to nothing is seen.
    behind: u64,
    /// log2 of the smallest alpha blended.
    pub log2_cut: f64,
    /// Columns after which the picture repeats, of a panorama.
    pub period: Option<u32>,
}

impl Projected {
    /// Of one chunk, for calibration.
    pub(super) fn of(footprints: Vec<Footprint>) -> Self {
        let chunks = vec![Chunk { footprints, ..Chunk::default() }];
        Self { chunks, splats: 0, behind: 0, log2_cut: 0.0, period: None }
    }

    /// (sort key, index) of each footprint, in file order; keys ascend from front to back.
    pub(super) fn keys(&self) -> Vec<(u64, u32)> {
        let mut keys = Vec::with_capacity(self.chunks.iter().map(|chunk| chunk.keys.len()).sum());
        for (number, chunk) in (0_u32..).zip(&self.chunks) {
            keys.extend(chunk.keys.iter().zip(number << CHUNK_BITS..).map(|(key, index)| (*key, index)));
        }
        keys
    }

    #[inline(always)]
    pub(super) fn footprint(&self, index: u32) -> &Footprint {
        &self.chunks[(index >> CHUNK_BITS) as usize].footprints[index as usize % CHUNK]
    }

    /// The tiles that a footprint touches.
    #[inline(always)]
    pub(super) fn reach(&self, index: u32) -> Reach {
        self.chunks[(index >> CHUNK_BITS) as usize].reaches[index as usize % CHUNK]
    }

    /// What the projection took.
    pub(super) fn work(&self) -> Work {
        let mut work = Work { behind: self.behind, ..Work::default() };
        for chunk in &self.chunks {
            work.projected += chunk.footprints.len() as u64;
            work.skipped += chunk.skipped;
            work.directed += chunk.directed;
            work.degenerate += chunk.degenerate;
        }
        Work { visited: self.splats - work.skipped, ..work }
    }
}

impl Footprint {
    /// Fills buffers.
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

    /// Where, from left to right, the ellipse of `alpha >= cut` is in the row of tiles whose first pixel row
    /// is `y`; in pixels, with slack.
    pub(super) fn extent_in(&self, y: usize, log2_cut: f64) -> (f64, f64) {
        let reach = f64::from(self.log2_opacity) - log2_cut;
        let (low, high) = (y as f64 + 0.5 - self.v - SLACK_PX, (y + TILE) as f64 - 0.5 - self.v + SLACK_PX);
        // Where, seen from the centre, the ellipse is widest: the rightmost point lies at dy = widest.
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

/// Projects every splat that can change a pixel; those of blocks that cannot are not looked at.
pub(super) fn project<L: Lens>(
    splats: &Splats,
    blocks: Option<&Blocks>,
    lens: &L,
    settings: &Settings,
    cx: &Context,
    level: Level,
) -> Result<Projected, NodeError> {
    let log2_cut = num::f64::log2(settings.alpha_cut);
    let chunks = cx.for_each_tile(splats.len().div_ceil(CHUNK), |job| {
        let range = job * CHUNK..((job + 1) * CHUNK).min(splats.len());
        dispatch!(level, simd => chunk(simd, splats, blocks, range, lens, settings, log2_cut))
    })?;
    let splats_behind = |job: usize| {
        let range = job * CHUNK..((job + 1) * CHUNK).min(splats.len());
        let drawn = range.filter(|index| is_drawn(splats.opacities[*index], settings));
        let offsets = drawn.map(|index| splats.mean(index) - lens.eye());
        offsets.filter(|d| matches!(lens.see(*d, settings.near, || (0.0, 0.0)), Sight::Behind)).count() as u64
    };
    let mut projected =
        Projected { chunks, splats: splats.len() as u64, behind: 0, log2_cut, period: lens.period() };
    // Only then is it asked for.
    if projected.work().projected * 100 < projected.splats {
        projected.behind = cx.for_each_tile(splats.len().div_ceil(CHUNK), splats_behind)?.iter().sum();
    }
    Ok(projected)
}

/// True for an opacity that reaches the cut.
#[inline(always)]
fn is_drawn(opacity: f32, settings: &Settings) -> bool {
    f64::from(opacity) >= settings.alpha_cut && opacity > 0.0
}

/// The principal axes of a splat, each as long as the standard deviation.
#[inline(always)]
fn axes(quat: [f32; 4], scale: [f32; 3]) -> [DVec3; 3] {
    let [w, x, y, z] = quat.map(f64::from);
    let scale = scale.map(f64::from);
    [
        DVec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)) * scale[0],
        DVec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)) * scale[1],
        DVec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)) * scale[2],
    ]
}

/// What the projection of a splat asks for.
struct Projection<'a, L> {
    splats: &'a Splats,
    blocks: Option<&'a Blocks>,
    lens: &'a L,
    settings: &'a Settings,
    log2_cut: f64,
    eye: DVec3,
    /// Degree of the harmonics that are used.
    degree: u32,
    /// False where every splat is drawn everywhere.
    bounded: bool,
    /// Standard deviations that a splat spreads over at most, in the world, and pixels beyond that.
    sigmas: f64,
    beyond: f64,
}

impl<'a, L: Lens> Projection<'a, L> {
    #[inline(always)]
    fn new(
        splats: &'a Splats,
        blocks: Option<&'a Blocks>,
        lens: &'a L,
        settings: &'a Settings,
        log2_cut: f64,
    ) -> Self {
        let bounded = settings.bounds != Bounds::None && settings.alpha_cut > 0.0;
        // 2 ln(255) is 11.1 and INRIA's 3 sigma, squared, 9; 12 covers both.
        let sigmas = (2.0 * std::f64::consts::LN_2 * -log2_cut).max(12.0).sqrt();
        // A pixel covers rounding, two tiles how INRIA counts them.
        let rounding = if settings.bounds == Bounds::Exact { 1.0 } else { 2.0 * TILE as f64 };
        let beyond = sigmas * settings.low_pass_px2.sqrt() + rounding;
        let (sigmas, beyond) = if bounded { (sigmas, beyond) } else { (f64::INFINITY, 0.0) };
        let (eye, degree) = (lens.eye(), settings.sh_degree.min(splats.sh_degree));
        Self { splats, blocks, lens, settings, log2_cut, eye, degree, bounded, sigmas, beyond }
    }

    /// True where no splat of the block of this one can be in the picture.
    #[inline(always)]
    fn is_unseen(&self, first: usize) -> bool {
        self.blocks.is_some_and(|blocks| {
            let block = blocks.around(first, self.eye);
            self.lens.misses(&block, self.settings.near, self.sigmas, self.beyond)
        })
    }

    /// Adds what is to be drawn of a splat.
    #[inline(always)]
    fn add(&self, index: usize, out: &mut Chunk) {
        let Self { splats, lens, settings, log2_cut, bounded, .. } = *self;
        if !is_drawn(splats.opacities[index], settings) {
            return;
        }
        let offset = splats.mean(index) - self.eye;
        let reach = || {
            let [a, b, c] = splats.scales[index].map(f64::from);
            let world = if bounded { self.sigmas * a.max(b).max(c) } else { f64::INFINITY };
            (world, self.beyond)
        };
        let Sight::Seen(seen) = lens.see(offset, settings.near, reach) else { return };
        let Seen { u, v, row_x, row_y, depth } = seen;

        let axes = axes(splats.quats[index], splats.scales[index]);
        let p = DVec3::new(row_x.dot(axes[0]), row_x.dot(axes[1]), row_x.dot(axes[2]));
        let q = DVec3::new(row_y.dot(axes[0]), row_y.dot(axes[1]), row_y.dot(axes[2]));
        let (raw_xx, xy, raw_yy) = (p.dot(p), p.dot(q), q.dot(q));
        let low_pass = settings.low_pass_px2;
        let (xx, yy) = (raw_xx + low_pass, raw_yy + low_pass);
        // By Lagrange's identity, so that the determinant of a needle does not cancel.
        let raw_det = p.cross(q).length_squared();
        let det = raw_det + low_pass * (raw_xx + raw_yy) + low_pass * low_pass;
        let mut opacity = f64::from(splats.opacities[index]);
        if settings.compensate {
            opacity *= (raw_det / det).sqrt();
            if opacity < settings.alpha_cut {
                return;
            }
        }
        // Exponents are to base 2: half of log2(e) goes into the factor.
        let to_base_2 = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let (root_det, root_yy) = (det.sqrt(), yy.sqrt());
        let (l11, l21, l22) =
            (to_base_2 * root_yy / root_det, -to_base_2 * xy / (root_yy * root_det), to_base_2 / root_yy);
        if !(l11.is_finite() && l21.is_finite() && l11 > 0.0 && l22 > 0.0 && u.is_finite() && v.is_finite()) {
            out.degenerate += 1;
            return;
        }

        let log2_opacity = num::f64::log2(opacity);
        let reach = match settings.bounds {
            _ if !bounded => Some(lens.everywhere()),
            Bounds::Inria => lens.inria_reach(u, v, xx, yy, det),
            _ => {
                let sigmas = (2.0 * std::f64::consts::LN_2 * (log2_opacity - log2_cut).max(0.0)).sqrt();
                lens.exact_reach(u, v, sigmas * xx.sqrt(), sigmas * root_yy)
            }
        };
        let Some(reach) = reach else { return };

        let mut direction = [0.0; 3];
        // The constant function asks for none.
        if self.degree > 0 {
            direction = (offset / offset.length()).to_array().map(|c| c as f32);
            out.directed += 1;
        }
        let each = splats.sh_len();
        let rgb = sh::colour(self.degree, &splats.sh[index * each..(index + 1) * each], direction);
        let by = match settings.sort {
            Sort::Depth => depth,
            Sort::Distance => offset.length(),
        };
        // Bits of positive floats ascend as they do.
        out.keys.push(match settings.precision {
            // 32 bits of mantissa: two digits of the sort fewer, and finer than the f32 that others sort by,
            // whose false ties cost 10 dB on `playbot`.
            Precision::F32 => by.to_bits() >> 20,
            Precision::F64 => by.to_bits(),
        });
        out.reaches.push(reach);
        out.footprints.push(Footprint {
            u,
            v,
            l11,
            l21,
            l22,
            opacity: opacity as f32,
            log2_opacity: log2_opacity as f32,
            rgb,
            z: depth as f32,
        });
    }
}

/// Scalar code, compiled once an instruction set: the wider ones round, compare and move in fewer steps.
#[inline(always)]
fn chunk<S: Simd, L: Lens>(
    _simd: S,
    splats: &Splats,
    blocks: Option<&Blocks>,
    range: Range<usize>,
    lens: &L,
    settings: &Settings,
    log2_cut: f64,
) -> Chunk {
    let projection = Projection::new(splats, blocks, lens, settings, log2_cut);
    let mut out = Chunk::default();
    for first in range.clone().step_by(BLOCK) {
        let block = first..(first + BLOCK).min(range.end);
        if projection.is_unseen(first) {
            out.skipped += block.len() as u64;
            continue;
        }
        block.for_each(|index| projection.add(index, &mut out));
    }
    out
}

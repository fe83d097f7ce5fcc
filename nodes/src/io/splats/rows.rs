//! Rows of splats, common to all formats: activation, errors of single rows, and parallel reading.

use engine::{Context, NodeError};

use super::frame::Turn;
use crate::math::num;

/// Reason why a row is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowFault {
    /// A field is NaN or infinite.
    NotFinite,
    /// The quaternion is zero: as in rows of incomplete exports.
    ZeroQuaternion,
    /// An axis is longer than `max_extent`.
    TooLarge,
    /// A scale is below 0 (in formats that store scales directly), or `filter_3D` is.
    NegativeScale,
    /// An opacity is not between 0 and 1 (in formats that store it directly).
    BadOpacity,
    /// The row refers to an entry beyond the end of a table.
    NoSuchEntry,
}

impl RowFault {
    /// Every fault, in order of the discriminant.
    pub const ALL: [Self; 6] = [
        Self::NotFinite,
        Self::ZeroQuaternion,
        Self::TooLarge,
        Self::NegativeScale,
        Self::BadOpacity,
        Self::NoSuchEntry,
    ];

    /// Stable id of the note that counts it.
    pub fn id(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::ZeroQuaternion => "zero-quaternion",
            Self::TooLarge => "too-large",
            Self::NegativeScale => "negative-scale",
            Self::BadOpacity => "bad-opacity",
            Self::NoSuchEntry => "no-such-entry",
        }
    }

    /// The reason in words, after "splats" or "the splat".
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "with a field that is NaN or infinite",
            Self::ZeroQuaternion => "with a zero quaternion",
            Self::TooLarge => "with an axis longer than `max_extent`",
            Self::NegativeScale => "with a scale or a filter below 0",
            Self::BadOpacity => "with an opacity that is not between 0 and 1",
            Self::NoSuchEntry => "that point past the end of a table of the file",
        }
    }
}

/// A splat after activation, without its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Centre.
    pub mean: [f32; 3],
    /// Part of the centre that f32 loses.
    pub mean_low: [f32; 3],
    /// Unit quaternion (w, x, y, z).
    pub quat: [f32; 4],
    /// Standard deviations.
    pub scale: [f32; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
}

impl Row {
    /// Activates the parameters of the optimiser: log scales, logit opacity, a quaternion of any length. `filter`
    /// is `filter_3D` of Mip-Splatting (Yu et al. 2024, eq. 9; `get_scaling_with_3D_filter`): it widens every axis
    /// and reduces the opacity by the ratio of the volumes.
    pub fn activate(
        mean: [f64; 3],
        quat: [f64; 4],
        log_scale: [f64; 3],
        logit: f64,
        filter: Option<f64>,
        max_extent: f64,
    ) -> Result<Self, RowFault> {
        let numbers = mean.iter().chain(&quat).chain(&log_scale).chain([&logit]).chain(filter.as_ref());
        if numbers.into_iter().any(|value| !value.is_finite()) {
            return Err(RowFault::NotFinite);
        }
        let mut scale = log_scale.map(num::f64::exp);
        let mut opacity = 1.0 / (1.0 + num::f64::exp(-logit));
        if let Some(filter) = filter {
            if filter < 0.0 {
                return Err(RowFault::NegativeScale);
            }
            let mut kept = 1.0;
            for s in &mut scale {
                let wide = (*s * *s + filter * filter).sqrt();
                // 0 / 0 if both are 0: then the opacity stays the same.
                kept *= if wide > 0.0 { *s / wide } else { 1.0 };
                *s = wide;
            }
            opacity *= kept;
        }
        Self::checked(mean, quat, scale, opacity, max_extent)
    }

    /// A row whose scales and opacity are already activated.
    pub fn checked(
        mean: [f64; 3],
        quat: [f64; 4],
        scale: [f64; 3],
        opacity: f64,
        max_extent: f64,
    ) -> Result<Self, RowFault> {
        let numbers = mean.iter().chain(&quat).chain([&opacity]);
        if numbers.into_iter().any(|value| !value.is_finite()) || scale.iter().any(|s| s.is_nan()) {
            return Err(RowFault::NotFinite);
        }
        let quat = unit(quat).ok_or(RowFault::ZeroQuaternion)?;
        if !scale.iter().all(|s| *s <= max_extent) {
            return Err(RowFault::TooLarge);
        }
        if scale.iter().any(|s| *s < 0.0) {
            return Err(RowFault::NegativeScale);
        }
        // Rounding in the program that wrote the file may put it slightly outside.
        if !(-1e-6..=1.0 + 1e-6).contains(&opacity) {
            return Err(RowFault::BadOpacity);
        }
        let mut row = Self {
            mean: [0.0; 3],
            mean_low: [0.0; 3],
            quat,
            scale: scale.map(|s| s as f32),
            opacity: opacity.clamp(0.0, 1.0) as f32,
        };
        row.set_mean(mean);
        let finite = row.mean.iter().chain(&row.mean_low).chain(&row.scale).all(|v| v.is_finite());
        if finite { Ok(row) } else { Err(RowFault::NotFinite) }
    }

    /// Sets the centre and the part of it that f32 loses.
    pub fn set_mean(&mut self, mean: [f64; 3]) {
        self.mean = mean.map(|c| c as f32);
        self.mean_low = mean.map(|c| (c - f64::from(c as f32)) as f32);
    }
}

/// The quaternion from three components; the omitted one is the largest, and positive. `which` is its index in the
/// result.
pub fn largest_left_out(which: usize, [a, b, c]: [f64; 3]) -> [f64; 4] {
    let d = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
    match which {
        0 => [d, a, b, c],
        1 => [a, d, b, c],
        2 => [a, b, d, c],
        _ => [a, b, c, d],
    }
}

/// The quaternion normalised to length 1; `None` if it is all zero.
pub fn unit(quat: [f64; 4]) -> Option<[f32; 4]> {
    // Scaled by the largest component first, so that neither 1e-200 nor 1e200 under- or overflows when squared.
    let largest = quat.iter().fold(0.0_f64, |m, q| m.max(q.abs()));
    let quat = quat.map(|q| q / largest);
    let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
    (largest != 0.0).then(|| quat.map(|q| (q / length) as f32))
}

/// The factor of the constant function: colour = 0.5 + this times the coefficient.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;

/// Number of coefficients of a degree besides the constant one.
pub fn sh_rest(degree: u32) -> usize {
    ((degree + 1) * (degree + 1) - 1) as usize
}

/// Number of rows per job.
const CHUNK: usize = 16_384;

/// A part of a scene: the rows of one job.
#[derive(Default)]
pub struct Part {
    /// The splats that can be drawn.
    pub rows: Vec<Row>,
    /// Their colours: triples per splat by the degree of the file.
    pub sh: Vec<[f32; 3]>,
    /// Number of dropped rows, by reason.
    pub dropped: [u64; RowFault::ALL.len()],
    /// Index in the file of the first dropped row, and its reason.
    pub first_fault: Option<(usize, RowFault)>,
    /// True if a centre has more digits than f32 holds.
    pub finer: bool,
}

/// True without NaN or infinity: the largest magnitude as bits, which vectorises where a search does not.
fn all_finite(values: &[f32]) -> bool {
    values.iter().fold(0, |most, value| (value.to_bits() & 0x7fff_ffff).max(most)) < 0x7f80_0000
}

/// Reads `count` rows in parallel with `read(index, sh)`, which appends the colour of a row; for a row with an
/// error it need not remove the colour. `first` is the index of the first row in the file.
pub fn read_rows(
    first: usize,
    count: usize,
    turn: Option<&Turn>,
    cx: &Context,
    read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
) -> Result<Vec<Part>, NodeError> {
    cx.for_each_tile(count.div_ceil(CHUNK), |chunk| {
        let rows = chunk * CHUNK..((chunk + 1) * CHUNK).min(count);
        let mut part = Part { rows: Vec::with_capacity(rows.len()), ..Part::default() };
        let count = rows.len();
        for index in rows {
            let start = part.sh.len();
            if part.rows.len() == 1 && part.sh.capacity() < start * count {
                // The first row determines the size of the colour of each row.
                part.sh.reserve_exact(start * count - start);
            }
            let row = read(index, &mut part.sh).and_then(|mut row| {
                let own = part.sh.get_mut(start..).unwrap_or_default();
                if let Some(turn) = turn {
                    turn.apply(&mut row, own);
                }
                let finite =
                    all_finite(own.as_flattened()) && all_finite(&row.mean) && all_finite(&row.scale);
                if finite { Ok(row) } else { Err(RowFault::NotFinite) }
            });
            match row {
                Ok(row) => {
                    part.finer |= row.mean_low != [0.0; 3];
                    part.rows.push(row);
                }
                Err(fault) => {
                    part.sh.truncate(start);
                    part.dropped[fault as usize] += 1;
                    part.first_fault.get_or_insert((first + index, fault));
                }
            }
        }
        part
    })
}

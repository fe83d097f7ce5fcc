//! What every format of splats shares: activation, and the faults of single rows.

use crate::num;

/// Why a row is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowFault {
    /// A field is NaN or infinite.
    NotFinite,
    /// The quaternion is zero: exports that failed halfway leave such rows.
    ZeroQuaternion,
    /// An axis is longer than `max_extent`.
    TooLarge,
}

impl RowFault {
    /// Every fault, in order of the discriminant.
    pub const ALL: [Self; 3] = [Self::NotFinite, Self::ZeroQuaternion, Self::TooLarge];

    /// Stable id of the note that counts it.
    pub fn id(self) -> &'static str {
        match self {
            Self::NotFinite => "not-finite",
            Self::ZeroQuaternion => "zero-quaternion",
            Self::TooLarge => "too-large",
        }
    }

    /// In words, after "splats" or "the splat".
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "with a field that is NaN or infinite",
            Self::ZeroQuaternion => "with a zero quaternion",
            Self::TooLarge => "with an axis longer than `max_extent`",
        }
    }
}

/// A splat, activated, without its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Centre.
    pub mean: [f32; 3],
    /// What f32 loses of it.
    pub mean_low: [f32; 3],
    /// Unit quaternion (w, x, y, z).
    pub quat: [f32; 4],
    /// Standard deviations.
    pub scale: [f32; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
}

impl Row {
    /// Activates what the optimiser stores: log scales, logit opacity, a quaternion of any length.
    /// `filter` is `filter_3D` of Mip-Splatting (Yu et al. 2024, eq. 9; `get_scaling_with_3D_filter`):
    /// it widens every axis and takes from the opacity what it adds to the volume.
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
            let mut kept = 1.0;
            for s in &mut scale {
                let wide = (*s * *s + filter * filter).sqrt();
                // 0 / 0 where both vanish: then the filter takes nothing.
                kept *= if wide > 0.0 { *s / wide } else { 1.0 };
                *s = wide;
            }
            opacity *= kept;
        }
        Self::checked(mean, quat, scale, opacity, max_extent)
    }

    /// A row whose scales and opacity are what they mean already.
    pub fn checked(
        mean: [f64; 3],
        quat: [f64; 4],
        scale: [f64; 3],
        opacity: f64,
        max_extent: f64,
    ) -> Result<Self, RowFault> {
        // Scaled by the largest first, so that neither 1e-200 nor 1e200 is lost in the squares.
        let largest = quat.iter().fold(0.0_f64, |m, q| m.max(q.abs()));
        if largest == 0.0 {
            return Err(RowFault::ZeroQuaternion);
        }
        let quat = quat.map(|q| q / largest);
        let length = quat.iter().map(|q| q * q).sum::<f64>().sqrt();
        if !scale.iter().all(|s| *s <= max_extent) {
            return Err(RowFault::TooLarge);
        }
        let row = Self {
            mean: mean.map(|c| c as f32),
            mean_low: mean.map(|c| (c - f64::from(c as f32)) as f32),
            quat: quat.map(|q| (q / length) as f32),
            scale: scale.map(|s| s as f32),
            opacity: opacity as f32,
        };
        let finite = row
            .mean
            .iter()
            .chain(&row.mean_low)
            .chain(&row.scale)
            .chain([&row.opacity])
            .all(|v| v.is_finite());
        if finite { Ok(row) } else { Err(RowFault::NotFinite) }
    }
}

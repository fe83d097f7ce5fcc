//! Rows of splats, common to all formats: activation, and errors of single rows.

use crate::math::num;

/// Reason why a row is dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowFault {
    /// A field is NaN, or is infinite although infinity has no meaning for it.
    NotFinite,
    /// The quaternion is zero, as in rows of incomplete exports.
    ZeroQuaternion,
    /// An axis is longer than `max_extent`.
    TooLarge,
    /// A scale is below 0 in a format that stores scales directly, or `filter_3D` is below 0.
    NegativeScale,
    /// An opacity is not between 0 and 1, in a format that stores it directly.
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

    /// Stable id of the note that reports the number of rows with this fault.
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

    /// Description of the fault for messages: a noun phrase that follows "has" or "because of".
    pub fn words(self) -> &'static str {
        match self {
            Self::NotFinite => "a field that is NaN or infinite",
            Self::ZeroQuaternion => "a zero quaternion",
            Self::TooLarge => "an axis longer than `max_extent`",
            Self::NegativeScale => "a scale or a filter below 0",
            Self::BadOpacity => "an opacity that is not between 0 and 1",
            Self::NoSuchEntry => "an index past the end of a table of the file",
        }
    }
}

/// A splat after activation, without its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// Centre.
    pub mean: [f32; 3],
    /// Remainder of the centre that f32 cannot hold.
    pub mean_low: [f32; 3],
    /// Unit quaternion (w, x, y, z).
    pub quat: [f32; 4],
    /// Standard deviations in the units of the file or the world.
    pub scale: [f32; 3],
    /// Opacity, 0 to 1.
    pub opacity: f32,
}

impl Row {
    /// Activates the parameters of the optimiser: log scales, logit opacity, a quaternion of any length. `filter`
    /// is `filter_3D` of Mip-Splatting (Yu et al. 2024, eq. 9; `get_scaling_with_3D_filter`): it widens every axis
    /// and reduces the opacity by the ratio of the volumes.
    ///
    /// Infinite values are treated as limits: a logit of +inf gives an opacity of 1, a logit of -inf an opacity of
    /// 0, and a log scale of -inf a thickness of 0. A log scale of +inf is an error ([`RowFault::TooLarge`]).
    pub fn activate(
        mean: [f64; 3],
        quat: [f64; 4],
        log_scale: [f64; 3],
        logit: f64,
        filter: Option<f64>,
        max_extent: f64,
    ) -> Result<Self, RowFault> {
        let numbers = mean.iter().chain(&quat).chain(filter.as_ref());
        if numbers.into_iter().any(|value| !value.is_finite())
            || log_scale.iter().chain([&logit]).any(|value| value.is_nan())
        {
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

    /// Creates a row whose scales and opacity are already activated, and checks them.
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

    /// Sets the centre and the remainder that f32 cannot hold.
    pub fn set_mean(&mut self, mean: [f64; 3]) {
        self.mean = mean.map(|c| c as f32);
        self.mean_low = mean.map(|c| (c - f64::from(c as f32)) as f32);
    }
}

/// Restores a quaternion from three of its components. The omitted component is the largest and is positive;
/// `which` is its index in the result.
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

/// The value of the constant spherical harmonic: a colour is 0.5 plus this value times the constant coefficient.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;

/// Number of coefficients per channel for a degree, without the constant coefficient.
pub fn sh_rest(degree: u32) -> usize {
    ((degree + 1) * (degree + 1) - 1) as usize
}

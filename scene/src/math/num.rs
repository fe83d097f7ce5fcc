//! Portable transcendental functions: the same bits on every machine.
//!
//! Each function calls the pure-Rust crate `libm` in f64. The f32 functions round the result once, which gave the
//! correctly rounded f32 for all measured inputs. IEEE `+ - * / sqrt floor round trunc` need no wrapper, since they
//! give the same bits everywhere.

macro_rules! unary {
    ($($name:ident = $libm:ident, $doc:literal;)*) => {
        /// f64 functions.
        pub mod f64 { $(#[doc = $doc] #[inline] pub fn $name(x: f64) -> f64 { libm::$libm(x) })* }
        /// f32 functions, computed in f64 and rounded once.
        pub mod f32 { $(#[doc = $doc] #[inline] pub fn $name(x: f32) -> f32 { libm::$libm(f64::from(x)) as f32 })* }
    };
}
unary! {
    sin = sin, "Sine of an angle in radians.";
    cos = cos, "Cosine of an angle in radians.";
    tan = tan, "Tangent of an angle in radians.";
    asin = asin, "Arc sine, in radians.";
    acos = acos, "Arc cosine, in radians.";
    atan = atan, "Arc tangent, in radians.";
    exp = exp, "e to the power x.";
    exp2 = exp2, "2 to the power x.";
    ln = log, "Natural logarithm.";
    log2 = log2, "Logarithm to base 2.";
    log10 = log10, "Logarithm to base 10.";
}

/// Angle of (x, y) from the x axis, in radians, in (-pi, pi].
#[inline]
pub fn atan2(y: core::primitive::f64, x: core::primitive::f64) -> core::primitive::f64 {
    libm::atan2(y, x)
}

/// x to the power y.
#[inline]
pub fn pow(x: core::primitive::f64, y: core::primitive::f64) -> core::primitive::f64 {
    libm::pow(x, y)
}

/// x to the power y, computed in f64 and rounded once.
#[inline]
pub fn powf(x: core::primitive::f32, y: core::primitive::f32) -> core::primitive::f32 {
    libm::pow(x.into(), y.into()) as core::primitive::f32
}

/// Sine and cosine of an angle in radians.
#[inline]
pub fn sin_cos(x: core::primitive::f64) -> (core::primitive::f64, core::primitive::f64) {
    libm::sincos(x)
}

/// Sum of the values, added in f64 in the order of the iterator.
pub fn ordered_sum(values: impl IntoIterator<Item = core::primitive::f32>) -> core::primitive::f64 {
    values.into_iter().fold(0.0, |sum, v| sum + core::primitive::f64::from(v))
}

/// True if the current thread keeps subnormal numbers. A library that was compiled with `-ffast-math` may have set
/// the processor to replace them with 0 when it was loaded. Threads inherit this setting from the thread that
/// starts them.
pub fn keeps_subnormals() -> bool {
    std::hint::black_box(core::primitive::f32::MIN_POSITIVE) * std::hint::black_box(0.5) > 0.0
}

/// Sine and cosine of an angle in degrees; exact at multiples of a quarter turn.
pub fn sin_cos_deg(degrees: core::primitive::f64) -> (core::primitive::f64, core::primitive::f64) {
    let quarters = (degrees / 90.0).round();
    let (s, c) = sin_cos((degrees - 90.0 * quarters).to_radians());
    match quarters.rem_euclid(4.0) as u8 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Subnormal numbers are kept. If a library that makes the processor flush them to 0 is loaded before the
    /// program, `path-trace` returns an error (tested by hand).
    #[test]
    fn the_smallest_numbers_are_kept() {
        assert!(keeps_subnormals());
    }

    #[test]
    fn f32_results_are_the_rounded_f64_results() {
        for i in 0..10_000 {
            let x = (i as core::primitive::f32) * 0.001 + 0.0005;
            assert_eq!(f32::exp(x), f64::exp(x.into()) as core::primitive::f32);
            assert_eq!(powf(x, 2.4), pow(x.into(), (2.4_f32).into()) as core::primitive::f32);
        }
    }

    // These bits must never change: every artifact depends on them.
    #[test]
    fn bits_are_the_ones_written_down() {
        assert_eq!(f64::sin(1.0).to_bits(), 0x3fea_ed54_8f09_0cee);
        assert_eq!(f64::exp(1.0).to_bits(), 0x4005_bf0a_8b14_576a);
    }
}

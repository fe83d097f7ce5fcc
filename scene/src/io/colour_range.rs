//! Inference of the value that stands for white in the point colours of a file, which file formats do not specify.

use engine::Notes;

use super::ply::Scalar;

/// The colour value that stands for white in a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Colour value that stands for white.
    pub white: f64,
    /// True if `white` was inferred from the colour values and not from their type.
    pub guessed: bool,
}

/// Maximum value of colours from 0 to 1, with a margin for rounding.
const SLACK: f64 = 1.5;
/// Maximum value of colours from 0 to 255, with a margin for rounding.
const BYTE: f64 = 255.5;

impl Range {
    /// Colours from 0 to 1.
    pub const UNIT: Self = Self { white: 1.0, guessed: false };

    /// Determines the range of colours of the type `scalar`. For integers of 8 and 16 bits, white is the largest
    /// number of the type. Some programs store codes of 8 bits with a wider type: integers of 32 bits are assumed to
    /// hold such codes, and for integers of 16 bits this is inferred from their values, as for floats
    /// ([`of_floats`](Self::of_floats)).
    pub fn of<I: Iterator<Item = f64>>(scalar: Scalar, numbers: impl FnOnce() -> I) -> Self {
        match scalar {
            Scalar::I32 | Scalar::U32 => Self { white: 255.0, guessed: false },
            Scalar::F32 | Scalar::F64 => Self::of_floats(numbers()),
            Scalar::I16 | Scalar::U16 => {
                let bytes = Self::of_floats(numbers());
                if bytes.guessed { bytes } else { Self::of_type(scalar) }
            }
            Scalar::I8 | Scalar::U8 => Self::of_type(scalar),
        }
    }

    /// The range of integers whose white is the largest number of their type.
    fn of_type(scalar: Scalar) -> Self {
        Self { white: scalar.whole_range().map_or(1.0, |(_, high)| high), guessed: false }
    }

    /// The range of floats, inferred from their values: white is 1, or 255 if at least half of the numbers above 0
    /// exceed 1.5 and no number exceeds 255.5. Of codes from 0 to 255 nearly all numbers above 0 exceed 1.5. Of
    /// colours from 0 to 1 only lights or wrong numbers do, which are few.
    pub fn of_floats(numbers: impl Iterator<Item = f64>) -> Self {
        let (mut count, mut above, mut most) = (0_u64, 0_u64, 0.0_f64);
        for number in numbers.filter(|number| number.is_finite() && *number > 0.0) {
            count += 1;
            above += u64::from(number > SLACK);
            most = most.max(number);
        }
        let bytes = above > 0 && above >= count - above && most <= BYTE;
        Self { white: if bytes { 255.0 } else { 1.0 }, guessed: bytes }
    }

    /// Warns that the range of the colours of a mesh was inferred.
    pub fn warn(self, notes: &mut Notes) {
        notes.warning("colour-range", format!("vertex colours are assumed to range {}", self.words()));
    }

    /// The range in words, to follow the word "colours".
    pub fn words(self) -> String {
        if self.guessed {
            format!("from 0 to {} (inferred from their values)", self.white)
        } else {
            format!("from 0 to {}", self.white)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_up_to_255_are_known_by_their_numbers() {
        let of = |numbers: &[f64]| Range::of_floats(numbers.iter().copied()).white;
        assert_eq!(of(&[0.0, 204.0, 255.0]), 255.0);
        assert_eq!(of(&[3.0, 2.0, 1.0, 0.5]), 255.0);
        assert_eq!(of(&[0.0, 0.5, 1.0]), 1.0);
        assert_eq!(of(&[0.2, 1.01, 1.3]), 1.0, "rounding");
        assert_eq!(of(&[0.2, 1000.0]), 1.0, "another range");
        assert_eq!(of(&[0.2, f64::NAN, f64::INFINITY]), 1.0);
        assert_eq!(of(&[]), 1.0);
        let mut one = vec![0.5; 1000];
        one[3] = 200.0;
        assert_eq!(of(&one), 1.0, "a stray number");
        // One of four vertices is a light.
        let lit = [0.1, 0.2, 0.3, 0.5, 0.4, 0.3, 0.2, 0.2, 0.1, 3.5, 3.5, 3.5];
        assert_eq!(of(&lit), 1.0, "a few lights");
        assert_eq!(of(&[255.0, 0.0, 0.0, 0.0, 0.0, 255.0, 0.0, 0.0, -1.0]), 255.0, "pure colours");
        let none = || std::iter::empty();
        assert_eq!(Range::of(Scalar::U8, none).white, 255.0);
        assert_eq!(Range::of(Scalar::U16, none).white, 65_535.0);
        assert_eq!(Range::of(Scalar::I32, none).white, 255.0);
    }

    /// Codes of 8 bits in integers of 16 bits. This test fails if `of` does not look at the values of such integers,
    /// or infers 255 from codes of 0 and 1.
    #[test]
    fn codes_of_8_bits_in_16_bits_are_known_by_their_values() {
        for (scalar, white) in [(Scalar::U16, 65_535.0), (Scalar::I16, 32_767.0)] {
            let of = |numbers: &[f64]| Range::of(scalar, || numbers.iter().copied());
            for codes in [&[0.0, 255.0, 128.0][..], &[3.0, 2.0, 1.0], &[0.0, 0.0, 200.0]] {
                assert_eq!(of(codes), Range { white: 255.0, guessed: true }, "{codes:?}");
            }
            for codes in [&[0.0, 0.0, 0.0][..], &[0.0, 1.0, 1.0], &[255.0, 256.0, 0.0], &[30_000.0, 7.0, 9.0]]
            {
                assert_eq!(of(codes), Range { white, guessed: false }, "{codes:?}");
            }
        }
    }
}

//! `.splat` (antimatter15/splat, `convert.py`). There is no header. Each splat has 32 bytes: centre and scales as
//! floats, then red, green, blue, opacity and the quaternion (w, x, y, z) as bytes. There are no spherical
//! harmonics.

use engine::{NodeError, Notes};

use super::bytes::{f32_at, u8_at};
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, SH_C0};
use crate::error::Error;
use crate::io::foreign::is_text;

/// Number of bytes per splat.
const ROW: usize = 32;

/// True if the bytes can be a `.splat` file, even a truncated one: there is at least one row, and at least half of
/// the first rows have finite numbers and sizes that are not negative. A first coordinate below 1e-38 indicates the
/// header of another format. The bytes of text are numbers of any size, so text is never a `.splat` file.
pub(super) fn is_splat(bytes: &[u8]) -> bool {
    if f32_at(bytes, 0).is_subnormal() || is_text(bytes) {
        return false;
    }
    let rows = bytes.as_chunks::<ROW>().0;
    let sane = |row: &[u8; ROW]| {
        let numbers: [f32; 6] = [0, 4, 8, 12, 16, 20].map(|at| f32_at(row, at));
        let [centre @ .., _, _, _] = numbers;
        let [_, _, _, scales @ ..] = numbers;
        centre.iter().all(|v| v.is_finite() && v.abs() < 1e12)
            && scales.iter().all(|s| (0.0..1e9).contains(s))
    };
    let first = rows.iter().take(64);
    first.len() > 0 && first.clone().filter(|r| sane(r)).count() * 2 >= first.len()
}

/// Loads a file.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let (rows, rest) = bytes.as_chunks::<ROW>();
    if !rest.is_empty() {
        let what = format!(
            "the file begins like a `.splat` file but ends within a splat (complete splats of {ROW} bytes: {}; further bytes: {})",
            rows.len(),
            rest.len()
        );
        return Err(Error::format(file, what).into());
    }
    let turn = reading.turn(file, None, false, notes);
    let parts = reading.rows(rows.len(), turn.as_ref(), |index, sh| {
        let row: &[u8] = rows.get(index).map_or(&[], |row| row);
        let real = |at: usize| f64::from(f32_at(row, at));
        let [r, g, b, opacity] = [24, 25, 26, 27].map(|at| f64::from(u8_at(row, at)) / 255.0);
        sh.push([r, g, b].map(|c| ((c - 0.5) / SH_C0) as f32));
        // The writer stores 128 + 128 q, clamped to 0..255.
        let quat = [28, 29, 30, 31].map(|at| (f64::from(u8_at(row, at)) - 128.0) / 128.0);
        Row::checked([0, 4, 8].map(real), quat, [12, 16, 20].map(real), opacity, reading.max_extent)
    })?;
    Ok(Loaded::new(parts, rows.len(), 0))
}

//! PlayCanvas compressed PLY: splats in chunks of 256, quantised between the bounds of their chunk
//! (playcanvas engine, `gsplat-compressed-data.js`; splat-transform, `write-compressed-ply.ts`).
//!
//! Element `chunk` holds floats `min_x .. max_z`, `min_scale_x .. max_scale_z` (logarithms) and, since 2024,
//! `min_r .. max_b`. Element `vertex` holds four words: position and scale 11:10:11 bits, rotation 2:10:10:10
//! with the largest component left out, colour 8:8:8:8 with the opacity last. An optional element `sh` holds
//! one byte for each `f_rest_*`.

use engine::{NodeError, Notes};

use super::bytes::{u8_at, u32_at};
use super::fixed_rows::{Element, Field, FixedRows};
use super::loaded::Loaded;
use super::reading::Reading;
use super::rows::{Row, SH_C0, largest_left_out};
use super::training;
use crate::error::Error;
use crate::io::ply::Scalar;
use crate::math::num;

/// Number of splats per chunk.
const CHUNK: usize = 256;

/// True if a header has the fields of a compressed PLY.
pub(super) fn is_packed(header: &FixedRows) -> bool {
    header.find("vertex").is_some_and(|vertex| vertex.find("packed_position").is_some())
}

fn reals<const N: usize>(file: &str, element: &Element, names: [&str; N]) -> Result<[Field; N], Error> {
    fields(file, element, names, Scalar::F32)
}

fn fields<const N: usize>(
    file: &str,
    element: &Element,
    names: [&str; N],
    scalar: Scalar,
) -> Result<[Field; N], Error> {
    let mut found = [Field { at: 0, scalar }; N];
    for (field, name) in found.iter_mut().zip(names) {
        *field = element.find(name).filter(|field| field.scalar == scalar).ok_or_else(|| {
            Error::format(file, format!("the element `{}` has no field `{name}`", element.name))
        })?;
    }
    Ok(found)
}

/// Extracts `bits` bits of `word` from bit `shift` on, as a number from 0 to 1.
fn unit(word: u32, shift: u32, bits: u32) -> f64 {
    let largest = (1_u32 << bits) - 1;
    f64::from(word >> shift & largest) / f64::from(largest)
}

fn three(word: u32) -> [f64; 3] {
    [unit(word, 21, 11), unit(word, 11, 10), unit(word, 0, 11)]
}

/// Decodes `f_rest_*` from a byte: 256 steps from -4 to 4, with exact ends.
fn harmonic(byte: u8) -> f32 {
    let t = match byte {
        0 => 0.0,
        255 => 1.0,
        b => (f32::from(b) + 0.5) / 256.0,
    };
    (t - 0.5) * 8.0
}

/// Loads a file, given its header.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    header: &FixedRows,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    let need = |name: &str| {
        header.find(name).ok_or_else(|| Error::format(file, format!("the PLY file has no element `{name}`")))
    };
    let (vertex, chunk) = (need("vertex")?, need("chunk")?);
    let [position, rotation, scale, colour] = fields(
        file,
        vertex,
        ["packed_position", "packed_rotation", "packed_scale", "packed_color"],
        Scalar::U32,
    )?;
    let bounds = [
        (reals(file, chunk, ["min_x", "min_y", "min_z"])?, reals(file, chunk, ["max_x", "max_y", "max_z"])?),
        (
            reals(file, chunk, ["min_scale_x", "min_scale_y", "min_scale_z"])?,
            reals(file, chunk, ["max_scale_x", "max_scale_y", "max_scale_z"])?,
        ),
    ];
    let colour_bounds = match chunk.find("min_r") {
        Some(_) => Some((
            reals(file, chunk, ["min_r", "min_g", "min_b"])?,
            reals(file, chunk, ["max_r", "max_g", "max_b"])?,
        )),
        None => None,
    };
    let (rows, chunks) = (vertex.rows(file, bytes)?, chunk.rows(file, bytes)?);
    if chunk.count < vertex.count.div_ceil(CHUNK) {
        let (c, n) = (chunk.count, vertex.count);
        return Err(Error::format(file, format!("the number of splats, {n}, is too large for the number of chunks, {c} (a chunk holds 256 splats)")).into());
    }
    let harmonics = harmonics(file, bytes, header, vertex.count)?;
    let turn = reading.turn(file, None, false, notes);
    let [means, scales] = bounds;
    let parts = reading.rows(vertex.count, turn.as_ref(), |index, sh| {
        let row = rows.get(index * vertex.stride..).unwrap_or_default();
        let bounds = chunks.get(index / CHUNK * chunk.stride..).unwrap_or_default();
        let between = |(low, high): &([Field; 3], [Field; 3]), t: [f64; 3]| {
            [0, 1, 2].map(|i| low[i].get(bounds) * (1.0 - t[i]) + high[i].get(bounds) * t[i])
        };
        let mean = between(&means, three(u32_at(row, position.at)));
        let scale = between(&scales, three(u32_at(row, scale.at))).map(num::f64::exp);
        let turned = u32_at(row, rotation.at);
        let smaller = [20, 10, 0].map(|shift| (unit(turned, shift, 10) - 0.5) * std::f64::consts::SQRT_2);
        let quat = largest_left_out((turned >> 30) as usize, smaller);
        let packed = u32_at(row, colour.at);
        let mut rgb = [24, 16, 8].map(|shift| unit(packed, shift, 8));
        if let Some(bounds) = &colour_bounds {
            rgb = between(bounds, rgb);
        }
        sh.push(rgb.map(|c| ((c - 0.5) / SH_C0) as f32));
        if let Some((bytes, stride, places)) = &harmonics {
            let row = bytes.get(index * stride..).unwrap_or_default();
            let each = places.len() / 3;
            for i in 0..each {
                sh.push([0, 1, 2].map(|c| harmonic(u8_at(row, places[c * each + i]))));
            }
        }
        Row::checked(mean, quat, scale, unit(packed, 0, 8), reading.max_extent)
    })?;
    let sh_degree = match harmonics.map_or(0, |(_, _, places)| places.len()) {
        0 => 0,
        9 => 1,
        24 => 2,
        _ => 3,
    };
    let mut loaded = Loaded::new(parts, vertex.count, sh_degree);
    loaded.antialiased = training::antialiased(&header.comments, file, notes);
    Ok(loaded)
}

/// The element `sh`: its rows, their length in bytes, and the offsets of the fields, channel by channel.
type Harmonics<'a> = (&'a [u8], usize, Vec<usize>);

fn harmonics<'a>(
    file: &str,
    bytes: &'a [u8],
    header: &FixedRows,
    count: usize,
) -> Result<Option<Harmonics<'a>>, Error> {
    let Some(element) = header.find("sh") else { return Ok(None) };
    let wrong = |what: String| Error::format(file, what);
    if element.count != count {
        return Err(wrong(format!(
            "the number of rows of the element `sh` is {}, but the number of splats is {count}",
            element.count
        )));
    }
    let fields = element.fields.len();
    if ![9, 24, 45].contains(&fields) {
        return Err(wrong(format!(
            "the number of fields of the element `sh` is {fields}; harmonics of degree 1, 2 or 3 need 9, 24 or 45"
        )));
    }
    let places = (0..fields).map(|i| {
        let field = element.find(&format!("f_rest_{i}")).filter(|f| f.scalar == Scalar::U8);
        field
            .map(|f| f.at)
            .ok_or_else(|| wrong(format!("the element `sh` has no field `f_rest_{i}` of the type `uchar`")))
    });
    let places = places.collect::<Result<Vec<_>, _>>()?;
    Ok(Some((element.rows(file, bytes)?, element.stride, places)))
}

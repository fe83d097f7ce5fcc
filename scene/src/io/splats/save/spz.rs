//! SPZ (nianticlabs/spz). Version 3 is one gzip stream, and every reader of the format supports it. Version 4 has
//! one Zstandard stream per attribute. It can be decompressed in parallel, and is the only version with harmonics
//! of degree 4. Harmonics are stored with 8 bits; the reference implementation rounds them to 5 and 4 bits.

use std::io::Write;

use engine::{Context, NodeError, Notes};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use super::chunks::chunks;
use crate::io::splats::{SH_C0, SPZ_COLOUR_SCALE, sh_rest, spz_rotation, unit};
use crate::math::num;
use crate::types::Splats;

/// Number of fraction bits, if the size of the scene permits: a step is 1/65536 of a unit. The reference always
/// writes 12.
const FRACTION_BITS: u32 = 16;
/// Maximum number of fraction bits, for a scene of small splats. The shortest axis that the format can store,
/// e^-10, is then 24 steps.
const MOST_FRACTION_BITS: u32 = 19;
/// Largest signed 24-bit integer.
const LARGEST: f64 = 8_388_607.0;
/// Length of the header in bytes. In version 4, the position of the table of contents follows.
const HEADER: usize = 16;
const HEADER_4: usize = 32;

/// Statistics of numbers that were clamped to the range of a byte: their count, and the largest change of a number
/// in steps of the byte.
#[derive(Default, Clone, Copy)]
struct Cut {
    count: u64,
    steps: f64,
}

impl Cut {
    /// Rounds to a byte. Numbers that are more than a step outside the range of a byte are counted.
    fn byte(&mut self, value: f64) -> u8 {
        let rounded = (value + 0.5).floor();
        let within = rounded.clamp(0.0, 255.0);
        if (rounded - within).abs() > 1.0 {
            self.count += 1;
            self.steps = self.steps.max((value - within).abs());
        }
        within as u8
    }
}

/// The attributes of some splats, each in a separate stream, and counts of clamped scales, colours and harmonics.
#[derive(Default)]
struct EncodedChunk {
    streams: [Vec<u8>; 6],
    cut: [Cut; 3],
}

/// Median of the longest axes, in world units; 0 if there are no splats.
fn median_size(splats: &Splats) -> f64 {
    let mut longest: Vec<f32> = splats.scales.iter().map(|s| s[0].max(s[1]).max(s[2])).collect();
    let middle = longest.len() / 2;
    if longest.is_empty() {
        return 0.0;
    }
    f64::from(*longest.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Number of fraction bits of the centres.
fn fraction_bits(splats: &Splats, notes: &mut Notes) -> Result<u32, NodeError> {
    let widest = splats.means.as_flattened().iter().fold(0.0_f64, |m, v| m.max(f64::from(v.abs())));
    let step = |bits: u32| 1.0 / f64::from(1_u32 << bits);
    let size = median_size(splats);
    let fine = |bits: &u32| 16.0 * step(*bits) <= size;
    let wanted = (FRACTION_BITS..MOST_FRACTION_BITS).find(fine).unwrap_or(MOST_FRACTION_BITS);
    let fits = |bits: &u32| widest <= (LARGEST - 1.0) * step(*bits);
    let bits = (0..=wanted).rev().find(fits).ok_or_else(|| {
        NodeError::new(format!("SPZ cannot store a coordinate of {widest}; the largest is about 8 million"))
    })?;
    // A centre moves by up to half a step.
    if 4.0 * step(bits) > size && !splats.is_empty() {
        let text = format!(
            "centres are rounded to {:.1e} units, and half of the splats are smaller than {size:.1e} units: the scene is \
             too wide, or its splats are too small, for the 24 bits of an SPZ coordinate",
            step(bits)
        );
        notes.warning("coarse-centres", text);
    }
    Ok(bits)
}

/// The bytes of a file of version 3 or 4.
pub(super) fn encode(
    splats: &Splats,
    version: u32,
    cx: &Context,
    notes: &mut Notes,
) -> Result<Vec<u8>, NodeError> {
    let count = u32::try_from(splats.len()).map_err(|_| {
        NodeError::new(format!("SPZ cannot store {} splats; the maximum is 2^32 - 1", splats.len()))
    })?;
    let bits = fraction_bits(splats, notes)?;
    report_grown(splats, notes);
    let rest = sh_rest(splats.sh_degree);
    let parts = chunks(splats.len(), cx, |range| {
        let mut part = EncodedChunk::default();
        let [centres, opacities, colours, scales, rotations, harmonics] = &mut part.streams;
        let [cut_scales, cut_colours, cut_harmonics] = &mut part.cut;
        for i in range {
            for value in splats.mean(i).to_array() {
                let fixed = (value * f64::from(1_u32 << bits) + 0.5).floor().clamp(-LARGEST, LARGEST) as i32;
                centres.extend_from_slice(&fixed.to_le_bytes()[..3]);
            }
            // Between 0 and 1: never clamped.
            opacities.push(Cut::default().byte(f64::from(splats.opacities[i]) * 255.0));
            let sh = &splats.sh[i * (rest + 1)..(i + 1) * (rest + 1)];
            for value in sh[0] {
                let unit = f64::from(value) * SPZ_COLOUR_SCALE + 0.5;
                colours.push(cut_colours.byte(unit * 255.0));
            }
            for scale in splats.scales[i] {
                // Smaller ones are reported above; only larger ones count as clamped.
                let log = num::f64::ln(scale.into()).max(-10.0);
                scales.push(cut_scales.byte((log + 10.0) * 16.0));
            }
            rotations.extend_from_slice(&rotation(splats.quats[i]).to_le_bytes());
            for value in sh[1..].as_flattened() {
                harmonics.push(cut_harmonics.byte(f64::from(*value) * 128.0 + 128.0));
            }
        }
        part
    })?;
    report_cut(&parts, (splats.len(), rest), notes);
    let mut header = b"NGSP".to_vec();
    header.extend_from_slice(&version.to_le_bytes());
    header.extend_from_slice(&count.to_le_bytes());
    header.extend_from_slice(&[splats.sh_degree as u8, bits as u8, u8::from(splats.antialiased), 0]);
    let stream = |which: usize| parts.iter().flat_map(move |part| &part.streams[which]).copied();
    match version {
        4 => streams_apart(header, |which| stream(which).collect(), cx),
        _ => one_stream(header.into_iter().chain((0..6).flat_map(stream)).collect(), cx),
    }
}

/// Warns about axes that are shorter than the minimum of the format.
fn report_grown(splats: &Splats, notes: &mut Notes) {
    // Scales begin at e^-10: smaller ones grow, which is visible if the whole scene is small.
    let smallest = num::f64::exp(-10.0);
    let axes = splats.scales.as_flattened();
    let grown = axes.iter().filter(|v| f64::from(**v) < 0.9 * smallest).count();
    if grown > 0 {
        let least = axes.iter().copied().fold(f32::INFINITY, f32::min);
        let text = format!(
            "splat axes shorter than {smallest:.1e} units, the minimum of SPZ, were lengthened to this minimum ({grown} of {}); the shortest axis was {least:.1e} units long. Scale the scene up if this is visible",
            axes.len()
        );
        notes.warning("splats-grown", text);
    }
}

/// Warns about values outside the range of the format. `rest` is the number of coefficients per splat and channel
/// except the constant one.
fn report_cut(parts: &[EncodedChunk], (splats, rest): (usize, usize), notes: &mut Notes) {
    let [scales, colours, harmonics] = [0, 1, 2].map(|which| {
        parts.iter().map(|part| part.cut[which]).fold(Cut::default(), |sum, part| Cut {
            count: sum.count + part.count,
            steps: sum.steps.max(part.steps),
        })
    });
    let width = 3 * splats as u64;
    let beyond = |which: &str, of: u64, cut: Cut, range: &str, loss: String| {
        format!(
            "{which} outside the range of SPZ, {range}, were clamped to this range ({} of {of}); {loss}",
            cut.count
        )
    };
    // A step of a scale is a factor of e^(1/16); colours change by the coefficient times the constant function.
    for (id, cut, text) in [
        (
            "scales-cut",
            scales,
            format!(
                "splat axes longer than e^5.94 (379 units), the maximum of SPZ, were shortened to this maximum ({} of {width}); the longest axis is divided by {:.3}",
                scales.count,
                num::f64::exp(scales.steps / 16.0)
            ),
        ),
        (
            "colours-cut",
            colours,
            beyond("constant coefficients", width, colours, "-3.3 to 3.3", {
                let off = colours.steps / 255.0 / SPZ_COLOUR_SCALE * SH_C0;
                format!("colours change by up to {off:.3}, where white is 1")
            }),
        ),
        (
            "harmonics-cut",
            harmonics,
            beyond("other coefficients", width * rest as u64, harmonics, "-1 to 1", {
                format!("these coefficients change by up to {:.3}", harmonics.steps / 128.0)
            }),
        ),
    ] {
        if cut.count > 0 {
            notes.warning(id, text);
        }
    }
}

/// Writes version 3: header and attributes in one gzip stream. The gzip header contains neither name nor time, so
/// that equal scenes give equal files.
fn one_stream(plain: Vec<u8>, cx: &Context) -> Result<Vec<u8>, NodeError> {
    let room = Vec::with_capacity(plain.len() / 2);
    let mut packed =
        flate2::GzBuilder::new().operating_system(255).write(room, flate2::Compression::default());
    for piece in plain.chunks(1 << 20) {
        cx.check()?;
        packed.write_all(piece)?;
    }
    Ok(packed.finish()?)
}

/// Writes version 4: the uncompressed header, the compressed and original length of each stream, and the streams.
/// Attributes without bytes have no stream.
fn streams_apart(
    mut header: Vec<u8>,
    stream: impl Fn(usize) -> Vec<u8> + Send + Sync,
    cx: &Context,
) -> Result<Vec<u8>, NodeError> {
    let packed = cx.for_each_tile(6, |which| {
        let plain = stream(which);
        (compress_to_vec(&*plain, CompressionLevel::Fastest), plain.len())
    })?;
    let packed: Vec<_> = packed.into_iter().filter(|(_, length)| *length > 0).collect();
    header[HEADER - 1] = packed.len() as u8;
    header.extend_from_slice(&(HEADER_4 as u32).to_le_bytes());
    header.resize(HEADER_4, 0);
    for (bytes, length) in &packed {
        header.extend_from_slice(&(bytes.len() as u64).to_le_bytes());
        header.extend_from_slice(&(*length as u64).to_le_bytes());
    }
    packed.iter().for_each(|(bytes, _)| header.extend_from_slice(bytes));
    Ok(header)
}

/// Maximum difference by which another component may exceed the omitted component. If all four components are
/// equal, rounding three of them by up to half a step of 0.0014 can cause almost this difference.
const AS_LARGE: f32 = 0.004;

/// The bits of a rotation. If several components are practically equal to the largest, the one whose omission makes
/// the decoded rotation most accurate is omitted. For a rotation that was read from a file, this is the component
/// that the file omitted, so the rotation is written unchanged.
pub(super) fn rotation(quat: [f32; 4]) -> u32 {
    let [w, x, y, z] = quat;
    let parts = [x, y, z, w];
    let largest = parts.iter().fold(0.0_f32, |most, part| most.max(part.abs()));
    // Distance of the decoded rotation, whose omitted component is above 0.
    let off = |&(out, word): &(usize, u32)| {
        let sign = f64::from(1.0_f32.copysign(parts[out]));
        let back = unit(spz_rotation(word)).unwrap_or_default();
        back.into_iter().zip(quat).map(|(a, b)| (f64::from(a) - sign * f64::from(b)).abs()).sum::<f64>()
    };
    (0..4)
        .filter(|out| largest - parts[*out].abs() < AS_LARGE)
        .map(|out| (out, leaving_out(out, parts)))
        // In rotations that were read, the omitted component is above 0.
        .min_by(|a, b| off(a).total_cmp(&off(b)).then(parts[b.0].total_cmp(&parts[a.0])))
        .map_or(0, |(_, word)| word)
}

/// Encodes a rotation with one component omitted: the index of that component in the order x, y, z, w, then the
/// sign and 9 bits of magnitude of each other component.
fn leaving_out(out: usize, parts: [f32; 4]) -> u32 {
    let others = (0..4).filter(|i| *i != out).map(|i| parts[i]);
    others.fold(out as u32, |word, part| {
        let size = (f64::from(part.abs()) * std::f64::consts::SQRT_2 * 511.0 + 0.5).floor().min(511.0) as u32;
        // All components are negated if the omitted one is below 0: the same rotation.
        let negative = part.is_sign_negative() != parts[out].is_sign_negative();
        word << 10 | u32::from(negative) << 9 | size
    })
}

//! INRIA PLY (gaussian-splatting, `scene/gaussian_model.py`, `save_ply`), every field a 32-bit float.

use std::fmt::Write as _;

use engine::{Context, NodeError, Notes};

use super::chunks::chunks;
use crate::io::splats::sh_rest;
use crate::math::num;
use crate::types::Splats;

/// Lower limit of logarithms and logits. Smaller values activate to 0 in f32, and minus infinity is avoided in PLY.
const LOWEST: f64 = -110.0;
/// Upper limit of logits, which activates to 1 in f32.
const HIGHEST: f64 = 30.0;

/// The bytes of a file.
pub(super) fn encode(splats: &Splats, cx: &Context, notes: &mut Notes) -> Result<Vec<u8>, NodeError> {
    let rest = sh_rest(splats.sh_degree);
    // The comment of Brush and splat-transform; without it, the splats count as trained without antialiasing.
    let comment = if splats.antialiased { "comment SplatRenderMode: mip\n" } else { "" };
    let mut header =
        format!("ply\nformat binary_little_endian 1.0\n{comment}element vertex {}\n", splats.len());
    let fields = ["x", "y", "z", "nx", "ny", "nz"]
        .into_iter()
        .map(str::to_owned)
        .chain((0..3).map(|i| format!("f_dc_{i}")))
        .chain((0..rest * 3).map(|i| format!("f_rest_{i}")))
        .chain(["opacity".to_owned()])
        .chain((0..3).map(|i| format!("scale_{i}")))
        .chain((0..4).map(|i| format!("rot_{i}")));
    for field in fields {
        // Writing to a string cannot fail.
        let _ = writeln!(header, "property float {field}");
    }
    header.push_str("end_header\n");
    let finer = splats.means_low.iter().filter(|low| **low != [0.0; 3]).count();
    notes.count("centres-rounded", finer as u64, "of the centres had to be rounded to 32-bit floats");
    let stride = (17 + rest * 3) * 4;
    let parts = chunks(splats.len(), cx, |range| {
        let mut out: Vec<u8> = Vec::with_capacity(range.len() * stride);
        for i in range {
            let mut put = |value: f32| out.extend_from_slice(&value.to_le_bytes());
            splats.mean(i).to_array().into_iter().for_each(|v| put(v as f32));
            [0.0; 3].into_iter().for_each(&mut put);
            let sh = &splats.sh[i * (rest + 1)..(i + 1) * (rest + 1)];
            sh[0].into_iter().for_each(&mut put);
            (0..3).for_each(|c| sh[1..].iter().for_each(|triple| put(triple[c])));
            let opacity = f64::from(splats.opacities[i]);
            put(num::f64::ln(opacity / (1.0 - opacity)).clamp(LOWEST, HIGHEST) as f32);
            splats.scales[i].into_iter().for_each(|s| put(num::f64::ln(s.into()).max(LOWEST) as f32));
            splats.quats[i].into_iter().for_each(&mut put);
        }
        out
    })?;
    let mut bytes = header.into_bytes();
    bytes.reserve(splats.len() * stride);
    parts.iter().for_each(|part| bytes.extend_from_slice(part));
    Ok(bytes)
}

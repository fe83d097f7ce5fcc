//! Writers of splats: INRIA PLY and SPZ.
//!
//! Data that a format cannot store is reported in notes, with counts.

mod chunks;
mod ply;
mod spz;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests;

use engine::{Context, NodeError, Notes, Up};
use glam::DVec3;

use crate::io::splats::{Row, Turn, from_y_up};
use crate::types::{SplatEncoding, Splats};
use chunks::chunks;

/// A format to write.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SaveFormat {
    /// INRIA PLY: 32-bit floats, as stored by the optimiser (logarithms and logits).
    Ply,
    /// SPZ: quantised, about a tenth of the size of PLY. Version 3, which every reader supports, or version 4 if
    /// the harmonics have degree 4.
    Spz,
    /// SPZ, always version 4.
    Spz4,
}

impl SaveFormat {
    /// The format according to the extension of a path.
    pub fn of_path(path: &str) -> Option<Self> {
        match path.rsplit_once('.')?.1.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "spz" => Some(Self::Spz),
            _ => None,
        }
    }
}

/// Encodes a file. Returns its bytes and notes on data that the format cannot store.
///
/// `up` is the up axis of the world. SPZ defines +y as up, so the splats are rotated to it; `None` writes them
/// unchanged. PLY defines no up axis and is never rotated.
pub fn encode(
    splats: &Splats,
    format: SaveFormat,
    up: Option<Up>,
    cx: &Context,
) -> Result<(Vec<u8>, Notes), NodeError> {
    let mut notes = Notes::none();
    if splats.encoding == SplatEncoding::Linear {
        notes.warning("encoding-not-stored", "the colours are linear, which the format cannot store");
    }
    let bytes = match format {
        SaveFormat::Ply => ply::encode(splats, cx, &mut notes)?,
        SaveFormat::Spz | SaveFormat::Spz4 => {
            let version = if format == SaveFormat::Spz4 || splats.sh_degree == 4 { 4 } else { 3 };
            if version == 4 && format == SaveFormat::Spz {
                let text = "the file is written as SPZ version 4, since older versions cannot store harmonics of degree 4";
                notes.decision("spz-version", text);
            }
            let turn = up.map(|up| from_y_up(up).transpose()).filter(|m| *m != glam::DMat3::IDENTITY);
            match turn {
                Some(matrix) => {
                    let from = up.map_or("", Up::name);
                    let text = format!("the splats were rotated from {from} up to +y up, the up axis of SPZ");
                    notes.decision("frame", text);
                    let turn = Turn::new(matrix, 1.0, DVec3::ZERO);
                    spz::encode(&turned(splats, &turn, cx)?, version, cx, &mut notes)?
                }
                None => spz::encode(splats, version, cx, &mut notes)?,
            }
        }
    };
    Ok((bytes, notes))
}

/// Returns all splats, transformed by `turn`.
fn turned(splats: &Splats, turn: &Turn, cx: &Context) -> Result<Splats, NodeError> {
    let width = splats.sh_len();
    let parts = chunks(splats.len(), cx, |range| {
        let mut sh = splats.sh[range.start * width..range.end * width].to_vec();
        let rows: Vec<Row> = range
            .zip(sh.chunks_exact_mut(width))
            .map(|(i, sh)| {
                let mut row = Row {
                    mean: splats.means[i],
                    mean_low: splats.means_low.get(i).copied().unwrap_or_default(),
                    quat: splats.quats[i],
                    scale: splats.scales[i],
                    opacity: splats.opacities[i],
                };
                turn.apply(&mut row, sh);
                row
            })
            .collect();
        (rows, sh)
    })?;
    let rows = || parts.iter().flat_map(|(rows, _)| rows);
    let finer = rows().any(|row| row.mean_low != [0.0; 3]);
    Ok(Splats {
        means: rows().map(|row| row.mean).collect(),
        means_low: if finer { rows().map(|row| row.mean_low).collect() } else { Vec::new() },
        quats: rows().map(|row| row.quat).collect(),
        scales: rows().map(|row| row.scale).collect(),
        opacities: splats.opacities.clone(),
        sh_degree: splats.sh_degree,
        sh: parts.iter().flat_map(|(_, sh)| sh).copied().collect(),
        encoding: splats.encoding,
        antialiased: splats.antialiased,
    })
}

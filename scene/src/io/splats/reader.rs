//! Reading of one file of any format, and joining of several.

use std::sync::{Mutex, PoisonError};

use engine::{Context, NodeError, Notes};

use super::frame::{Frame, Placing};
use super::loaded::{Loaded, left_over};
use super::reading::{Fetch, Reading};
use super::rows::{RowFault, sh_rest};
use super::source::Format;
use super::{fixed_rows, gltf, ksplat, ply, ply_packed, sog, splat, spz, usda};
use crate::error::Error;
use crate::types::frame::Similarity;
use crate::types::{SplatEncoding, Splats};

/// Reads a file of any format.
pub(super) fn load(
    file: &str,
    bytes: &[u8],
    fetch: &Fetch<'_>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    match Format::of(file, bytes)? {
        Format::Ply => {
            ply::refuse_mesh(file, &crate::io::ply::header(file, bytes)?)?;
            let bytes = &*fixed_rows::little_endian(file, bytes, reading.cx)?;
            let header = fixed_rows::FixedRows::read(file, bytes)?;
            let packed = ply_packed::is_packed(&header);
            let read = if packed { ply_packed::load } else { ply::load };
            let loaded = read(file, bytes, &header, reading, notes)?;
            left_over(file, header.end.map_or(0, |end| bytes.len().saturating_sub(end)), notes);
            Ok(loaded)
        }
        Format::Spz => spz::load(file, bytes, None, reading, notes),
        Format::SogMeta => sog::load(file, &sog::Meta::read(file, bytes)?, None, fetch, reading, notes),
        Format::SogBundle => sog::load_bundle(file, bytes, None, reading, notes),
        Format::Glb | Format::Gltf => gltf::load(file, bytes, fetch, reading, notes),
        Format::Ksplat => ksplat::load(file, bytes, reading, notes),
        Format::Splat => splat::load(file, bytes, reading, notes),
        Format::Usda => usda::load(file, bytes, reading, notes),
    }
}

/// Reads ranges of rows of a SOG file.
pub(super) fn load_ranges(
    file: &str,
    bytes: &[u8],
    ranges: &[(usize, usize)],
    fetch: &Fetch<'_>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    match Format::of(file, bytes)? {
        Format::SogMeta => {
            sog::load(file, &sog::Meta::read(file, bytes)?, Some(ranges), fetch, reading, notes)
        }
        Format::SogBundle => sog::load_bundle(file, bytes, Some(ranges), reading, notes),
        other => {
            Err(Error::unsupported(file, format!("a streamed scene that consists of {} files", other.name()))
                .into())
        }
    }
}

/// Reads splats of any format from memory, as the kind `load-splats` does with default parameters. It is an error
/// if the format needs further files.
pub fn from_bytes(
    file: &str,
    bytes: &[u8],
    frame: Frame,
    cx: &Context,
) -> Result<(Splats, Notes), NodeError> {
    let placing = Placing { frame, up: cx.up(), metres_per_unit: cx.metres_per_unit() };
    let matrix = Similarity::IDENTITY;
    let reading = Reading { cx, placing, max_extent: 1e6, matrix, plain: false };
    let mut notes = Notes::none();
    let alone =
        |name: &str| Err(NodeError::new(format!("`{file}` needs the file `{name}` in the same folder")));
    let loaded = load(file, bytes, &alone, &reading, &mut notes)?;
    report(file, &loaded, false, &mut notes)?;
    Ok((assemble(vec![loaded], cx)?, notes))
}

/// Joins the parts of files into one scene, in order.
pub(super) fn assemble(mut files: Vec<Loaded>, cx: &Context) -> Result<Splats, NodeError> {
    let sh_degree = files.iter().map(|file| file.sh_degree).max().unwrap_or(0);
    let first = files.first().map(|file| (file.antialiased, file.encoding));
    let (antialiased, encoding) = first.unwrap_or((false, SplatEncoding::Srgb));
    for (what, differs) in [
        ("trained with antialiasing", files.iter().any(|file| file.antialiased != antialiased)),
        ("stored in linear colours", files.iter().any(|file| file.encoding != encoding)),
    ] {
        if differs {
            let what = format!("some of the files contain splats {what}, and others do not");
            return Err(NodeError::new(what).at("more").hint("load them as separate scenes"));
        }
    }
    files.iter_mut().for_each(|file| file.widen(sh_degree));
    let total: usize = files.iter().flat_map(|file| &file.parts).map(|part| part.rows.len()).sum();
    let finer = files.iter().flat_map(|file| &file.parts).any(|part| part.finer);
    let mut splats = Splats {
        means: Vec::with_capacity(total),
        means_low: Vec::with_capacity(if finer { total } else { 0 }),
        quats: Vec::with_capacity(total),
        scales: Vec::with_capacity(total),
        opacities: Vec::with_capacity(total),
        sh_degree,
        sh: vec![[0.0; 3]; total * (sh_rest(sh_degree) + 1)],
        encoding,
        antialiased,
    };
    // Colours are most of the data, so they are copied in parallel: each job has its own piece.
    let mut pieces = Vec::new();
    let mut left = splats.sh.as_mut_slice();
    for part in files.into_iter().flat_map(|file| file.parts) {
        splats.means.extend(part.rows.iter().map(|row| row.mean));
        if finer {
            splats.means_low.extend(part.rows.iter().map(|row| row.mean_low));
        }
        splats.quats.extend(part.rows.iter().map(|row| row.quat));
        splats.scales.extend(part.rows.iter().map(|row| row.scale));
        splats.opacities.extend(part.rows.iter().map(|row| row.opacity));
        let (piece, rest) = std::mem::take(&mut left).split_at_mut(part.sh.len());
        pieces.push(Mutex::new((piece, part.sh)));
        left = rest;
    }
    cx.for_each_tile(pieces.len(), |i| {
        let mut piece = pieces[i].lock().unwrap_or_else(PoisonError::into_inner);
        let (to, from) = &mut *piece;
        to.copy_from_slice(&std::mem::take(from));
    })?;
    drop(pieces);
    Ok(splats)
}

/// Share of the rows of a file above which dropped rows are worth a warning.
const MANY: f64 = 0.01;

/// Reports dropped rows. If `strict` is true, the first dropped row is an error.
pub(super) fn report(file: &str, loaded: &Loaded, strict: bool, notes: &mut Notes) -> Result<(), NodeError> {
    if strict && let Some((row, fault)) = loaded.parts.iter().find_map(|part| part.first_fault) {
        let what = format!("`{file}` contains an invalid splat: splat {row} has {}", fault.words());
        return Err(NodeError::new(what)
            .at("path")
            .hint("`strict: false` drops such splats and counts them"));
    }
    let mut all = 0;
    for fault in RowFault::ALL {
        let dropped: u64 = loaded.parts.iter().map(|part| part.dropped[fault as usize]).sum();
        all += dropped;
        notes.count(
            fault.id(),
            dropped,
            format!("of the splats of `{file}` had to be dropped because of {}", fault.words()),
        );
    }
    if all as f64 > MANY * loaded.count as f64 {
        let text = format!(
            "{all} of the {} splats of `{file}` are invalid and were dropped; is the file complete? `strict: true` \
             names the first of them",
            loaded.count
        );
        notes.warning("many-dropped", text);
    }
    Ok(())
}

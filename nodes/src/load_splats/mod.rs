//! `load-splats`: a scene of Gaussian splats from a file.

mod accessor;
mod bytes;
mod frame;
mod gltf;
mod inflate;
mod ksplat;
mod ply;
mod ply_header;
mod ply_packed;
mod rows;
mod sh_turn;
mod size;
mod sog;
mod source;
mod splat;
mod spz;
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests;
mod zip;

use std::sync::{Arc, Mutex, PoisonError};

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
    Up,
};
use glam::{DMat3, DVec3};

use crate::Error;
use crate::types::{SplatEncoding, Splats};
use frame::Placing;
use rows::Part;

pub use frame::{Frame, Turn, from_y_up};
pub(crate) use rows::unit;
pub use rows::{Row, RowFault, SH_C0, sh_rest};
pub use sh_turn::ShTurn;
pub use source::Format;
pub(crate) use spz::{COLOUR_SCALE as SPZ_COLOUR_SCALE, rotation_10 as spz_rotation};

engine::params! {
    /// Reads a scene of Gaussian splats.
    ///
    /// Formats, told by content and not by the ending: INRIA PLY (spherical harmonics of degree 0 to 4,
    /// `filter_3D` of Mip-Splatting and MILo applied, other extra fields passed over), PlayCanvas
    /// compressed PLY, SOG versions 1 and 2 (`meta.json`, its folder, a folder of chunks joined in the order of
    /// their names, or a `.sog` bundle), SPZ versions 1 to 4, `.splat`, `.ksplat`, and glTF or GLB with
    /// `KHR_gaussian_splatting`. Rows that cannot be drawn are dropped and counted by reason.
    ///
    /// Frames: SPZ and glTF say that +y is up, so they are turned to the `up` of the scene as objects are (to +z
    /// (x, -z, y), to -y (x, -y, -z)); glTF is in metres and is divided by `metres_per_unit` too.
    /// The other formats say nothing and are used as stored: set `up` of the scene to what they have,
    /// which for INRIA PLY is mostly -y. `frame` overrides the rule.
    pub struct LoadSplats {
        /// The file, or the folder of a SOG scene.
        path: InputFile, other("\"b.ply\"");
        /// More files of the same scene, such as the chunks of a capture; appended in this order.
        more: Vec<InputFile> = Vec::new(), other("[\"b.ply\"]");
        /// Stop at the first row that would be dropped, and name it.
        strict: bool = false, inert("the output is the same wherever there is one");
        /// Splats with a longer axis are dropped: they hide the scene and are a sign of scales that are
        /// not logarithms.
        max_extent: f64 = 1e6, range(1e-12, 1e30), unit("world units"), other("0.2");
        /// Which way is up in the file: what its format says, or what you say.
        frame: Frame = Frame::ByFormat, other("YUp");
    }
}
engine::inputs! {
    /// Inputs of [`LoadSplats`]: none.
    pub struct In {}
}
engine::outputs! {
    /// Outputs of [`LoadSplats`].
    pub struct Out {
        /// The scene, activated.
        splats: Arc<Splats>,
    }
}

/// Gives the bytes of a file beside the one that is read.
type Fetch<'a> = dyn Fn(&str) -> Result<Vec<u8>, NodeError> + 'a;

/// What every reader needs to know.
struct Reading<'a> {
    cx: &'a Context,
    placing: Placing,
    max_extent: f64,
}

impl Reading<'_> {
    /// Rows of a file without sections; see [`rows::read_rows`].
    fn rows(
        &self,
        count: usize,
        turn: Option<&Turn>,
        read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
    ) -> Result<Vec<Part>, NodeError> {
        rows::read_rows(0, count, turn, self.cx, read)
    }

    /// Rows of a section that begins at row `first` of the file.
    fn rows_from(
        &self,
        first: usize,
        count: usize,
        turn: Option<&Turn>,
        read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
    ) -> Result<Vec<Part>, NodeError> {
        rows::read_rows(first, count, turn, self.cx, read)
    }

    /// The turn and scale into the world, from what the format says; the decision is noted.
    fn world(
        &self,
        file: &str,
        declared: Option<Up>,
        metres: bool,
        notes: &mut Notes,
    ) -> Option<(DMat3, f64)> {
        let (turn, text) = self.placing.turn(declared, metres);
        if let Some(text) = text {
            notes.decision("frame", format!("`{file}` {text}"));
        }
        turn
    }

    /// The same, ready to be applied.
    fn turn(&self, file: &str, declared: Option<Up>, metres: bool, notes: &mut Notes) -> Option<Turn> {
        let (matrix, scale) = self.world(file, declared, metres, notes)?;
        Some(Turn::new(matrix, scale, DVec3::ZERO))
    }
}

/// One file: its rows and what they are.
struct Loaded {
    parts: Vec<Part>,
    /// Rows of the file, also those that were dropped.
    count: usize,
    sh_degree: u32,
    antialiased: bool,
    encoding: SplatEncoding,
}

impl Loaded {
    fn new(parts: Vec<Part>, count: usize, sh_degree: u32) -> Self {
        Self { parts, count, sh_degree, antialiased: false, encoding: SplatEncoding::Srgb }
    }

    /// Appends another part of the same file.
    fn join(mut self, file: &str, other: Self) -> Result<Self, NodeError> {
        if self.antialiased != other.antialiased || self.encoding != other.encoding {
            return Err(Error::format(file, "holds splats of different filters or colour spaces").into());
        }
        let degree = self.sh_degree.max(other.sh_degree);
        self.widen(degree);
        let mut other = other;
        other.widen(degree);
        self.count += other.count;
        self.parts.append(&mut other.parts);
        Ok(self)
    }

    /// Fills up with coefficients of 0 to a higher degree.
    fn widen(&mut self, degree: u32) {
        if self.sh_degree == degree {
            return;
        }
        let (own, wide) = (sh_rest(self.sh_degree) + 1, sh_rest(degree) + 1);
        for part in &mut self.parts {
            let filled = part
                .sh
                .chunks_exact(own)
                .flat_map(|one| one.iter().copied().chain(std::iter::repeat_n([0.0; 3], wide - own)));
            part.sh = filled.collect();
        }
        self.sh_degree = degree;
    }
}

/// Tells of bytes that the format has no place for.
fn left_over(file: &str, bytes: usize, notes: &mut Notes) {
    if bytes > 0 {
        let text = format!("`{file}` goes on for {bytes} bytes after its splats; they are passed over");
        notes.warning("bytes-left-over", text);
    }
}

fn load(
    file: &str,
    bytes: &[u8],
    fetch: &Fetch<'_>,
    reading: &Reading<'_>,
    notes: &mut Notes,
) -> Result<Loaded, NodeError> {
    match Format::of(file, bytes)? {
        Format::Ply => {
            let header = ply_header::Header::read(file, bytes)?;
            let packed = ply_packed::is_packed(&header);
            let read = if packed { ply_packed::load } else { ply::load };
            let loaded = read(file, bytes, &header, reading, notes)?;
            left_over(file, header.end.map_or(0, |end| bytes.len().saturating_sub(end)), notes);
            Ok(loaded)
        }
        Format::Spz => spz::load(file, bytes, None, reading, notes),
        Format::SogMeta => sog::load(file, &sog::Meta::read(file, bytes)?, fetch, reading, notes),
        Format::SogBundle => sog::load_bundle(file, bytes, reading, notes),
        Format::Glb | Format::Gltf => gltf::load(file, bytes, fetch, reading, notes),
        Format::Ksplat => ksplat::load(file, bytes, reading, notes),
        Format::Splat => splat::load(file, bytes, reading, notes),
    }
}

/// Reads splats of any format from memory, as [`LoadSplats`] does with its other parameters at their
/// defaults. A format that needs files beside it is an error.
pub fn from_bytes(
    file: &str,
    bytes: &[u8],
    frame: Frame,
    cx: &Context,
) -> Result<(Splats, Notes), NodeError> {
    let placing = Placing { frame, up: cx.up(), metres_per_unit: cx.metres_per_unit() };
    let reading = Reading { cx, placing, max_extent: 1e6 };
    let mut notes = Notes::none();
    let alone = |name: &str| Err(NodeError::new(format!("`{file}` needs the file `{name}` beside it")));
    let loaded = load(file, bytes, &alone, &reading, &mut notes)?;
    report(file, &loaded, false, &mut notes)?;
    Ok((assemble(vec![loaded], cx)?, notes))
}

impl Kind for LoadSplats {
    const NAME: &'static str = "load-splats";
    const VERSION: u32 = 3;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    const STORE: Keep = Keep::Cheap;
    const FOLDERS: bool = true;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate_files(_: &Self, files: &[FileHead<'_>]) -> Cost {
        // Each file with what it unpacks to and its rows; in the end the rows of all, and the scene that they become.
        let (mut rows, mut most) = (0_u64, 0_u64);
        for file in files {
            let (own, unpacked) = size::of(file);
            most = most.max(rows.saturating_add(own).saturating_add(unpacked).saturating_add(file.bytes));
            rows = rows.saturating_add(own);
        }
        Cost { bytes: most.max(rows.saturating_mul(2)) }
    }

    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources = Vec::new();
        for named in std::iter::once(&params.path).chain(&params.more) {
            for file in source::expand(named, &root.file(named).path)? {
                sources.extend(source::with_companions(&file, root)?);
            }
        }
        Ok(sources)
    }

    fn run(params: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let placing = Placing { frame: params.frame, up: cx.up(), metres_per_unit: cx.metres_per_unit() };
        let reading = Reading { cx, placing, max_extent: params.max_extent };
        let mut names = Vec::new();
        for (field, named) in
            std::iter::once(("path", &params.path)).chain(params.more.iter().map(|file| ("more", file)))
        {
            let expanded = source::expand(named, &cx.source(named).path).map_err(|e| e.at(field))?;
            names.extend(expanded.into_iter().map(|file| (field, file)));
        }
        let mut files = Vec::new();
        let total = names.len() as f32;
        for (done, (field, file)) in names.iter().enumerate() {
            cx.progress(done as f32 / total);
            let fetch = |name: &str| cx.read_beside(file, name);
            let read = || {
                let bytes = cx.read(file)?;
                // Notes are part of the result, which is the same wherever the file lies.
                let path = std::path::Path::new(&file.0);
                let name = path.file_name().filter(|_| path.is_absolute());
                let name = name.map_or_else(|| file.0.clone(), |name| name.to_string_lossy().into_owned());
                let loaded = load(&name, &bytes, &fetch, &reading, &mut notes)?;
                report(&name, &loaded, params.strict, &mut notes)?;
                Ok(loaded)
            };
            let mut read = read;
            files.push(read().map_err(|e: NodeError| e.at(field))?);
        }
        let splats = assemble(files, cx)?;
        cx.count("splats", splats.len() as u64);
        if splats.is_empty() {
            notes.degraded("no-splats", "the scene holds no splat that can be drawn");
        }
        Ok((Out { splats: Arc::new(splats) }, notes))
    }
}

/// Joins the parts of files into one scene, in order.
fn assemble(mut files: Vec<Loaded>, cx: &Context) -> Result<Splats, NodeError> {
    let sh_degree = files.iter().map(|file| file.sh_degree).max().unwrap_or(0);
    let first = files.first().map(|file| (file.antialiased, file.encoding));
    let (antialiased, encoding) = first.unwrap_or((false, SplatEncoding::Srgb));
    for (what, differs) in [
        ("were trained antialiased", files.iter().any(|file| file.antialiased != antialiased)),
        ("hold linear colours", files.iter().any(|file| file.encoding != encoding)),
    ] {
        if differs {
            let what = format!("some of the files say that they {what} and some do not");
            return Err(NodeError::new(what).at("more").hint("load them as scenes of their own"));
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
    // Colours are by far the most, so they are moved in parallel: each job has its own piece.
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

/// Tells what was dropped, or stops at it.
fn report(file: &str, loaded: &Loaded, strict: bool, notes: &mut Notes) -> Result<(), NodeError> {
    if strict && let Some((row, fault)) = loaded.parts.iter().find_map(|part| part.first_fault) {
        let what = format!("`{file}`: splat {row} is one {}", fault.words());
        return Err(NodeError::new(what)
            .at("path")
            .hint("`strict: false` drops such splats and counts them"));
    }
    let mut all = 0;
    for fault in RowFault::ALL {
        let dropped: u64 = loaded.parts.iter().map(|part| part.dropped[fault as usize]).sum();
        all += dropped;
        notes.count(fault.id(), dropped, format!("splats of `{file}` {}; dropped", fault.words()));
    }
    if all * 2 > loaded.count as u64 {
        let text = format!("{all} of {} splats of `{file}` were dropped; is the file whole?", loaded.count);
        notes.warning("mostly-dropped", text);
    }
    Ok(())
}

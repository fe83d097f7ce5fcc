//! `load-splats`: a scene of Gaussian splats from a file.

mod ply;
mod rows;
mod sog;
#[cfg(test)]
mod tests;

use std::sync::Arc;

use engine::{Context, Cost, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot};

use crate::types::{SplatEncoding, Splats};
pub use rows::{Row, RowFault};

engine::params! {
    /// Reads a scene of Gaussian splats.
    ///
    /// Formats, told by content: INRIA PLY (binary little-endian, spherical harmonics of degree 0 to 4,
    /// `filter_3D` of Mip-Splatting and MILo applied, other extra fields passed over) and SOG version 2
    /// (give its `meta.json`). Rows that cannot be drawn are dropped and counted by reason.
    pub struct LoadSplats {
        /// The file.
        path: InputFile, other("\"b.ply\"");
        /// More files of the same scene, such as the chunks of a capture; appended in this order.
        more: Vec<InputFile> = Vec::new(), other("[\"b.ply\"]");
        /// Stop at the first row that would be dropped, and name it.
        strict: bool = false, inert("the output is the same wherever there is one");
        /// Splats with a longer axis are dropped: they hide the scene and are a sign of scales that are
        /// not logarithms.
        max_extent: f64 = 1e6, range(1e-12, 1e30), unit("world units"), other("0.2");
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

/// Rows a job.
const CHUNK: usize = 16_384;

/// A part of a scene: what one job has read.
#[derive(Default)]
struct Part {
    rows: Vec<Row>,
    sh: Vec<[f32; 3]>,
    dropped: [u64; RowFault::ALL.len()],
    first_fault: Option<(usize, RowFault)>,
    /// True when a centre has more digits than f32 holds.
    finer: bool,
}

impl Part {
    fn add(&mut self, index: usize, row: Result<Row, RowFault>) {
        match row {
            Ok(row) => {
                self.finer |= row.mean_low != [0.0; 3];
                self.rows.push(row);
            }
            Err(fault) => {
                self.dropped[fault as usize] += 1;
                self.first_fault.get_or_insert((index, fault));
            }
        }
    }
}

/// Reads rows in parallel with `read(index, sh)`, which appends the colour of the rows it keeps.
fn read_rows(
    count: usize,
    cx: &Context,
    read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
) -> Result<Vec<Part>, NodeError> {
    cx.for_each_tile(count.div_ceil(CHUNK), |chunk| {
        let mut part = Part::default();
        for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(count) {
            let row = read(index, &mut part.sh);
            part.add(index, row);
        }
        part
    })
}

/// One file: its rows and what they are.
struct Loaded {
    parts: Vec<Part>,
    count: usize,
    sh_degree: u32,
    antialiased: bool,
}

fn is_sog(file: &InputFile) -> bool {
    file.0.ends_with(".json")
}

fn load(file: &InputFile, max_extent: f64, cx: &Context, notes: &mut Notes) -> Result<Loaded, NodeError> {
    let bytes = cx.read(file)?;
    if is_sog(file) {
        return sog::load(file, &bytes, max_extent, cx);
    }
    let layout = ply::Layout::read(&file.0, &bytes)?;
    if layout.has_filter() {
        notes
            .decision("filter-3d", format!("`filter_3D` of `{}` is applied to scales and opacities", file.0));
    }
    if !layout.unused.is_empty() {
        let text =
            format!("`{}`: {} fields are passed over: {}", file.0, layout.unused.len(), some(&layout.unused));
        notes.decision("fields-passed-over", text);
    }
    let rows = layout.rows(&bytes);
    let parts = read_rows(layout.count, cx, |index, sh| {
        let row = rows.get(index * layout.stride..(index + 1) * layout.stride).unwrap_or(&[]);
        layout.row(row, max_extent, sh)
    })?;
    Ok(Loaded { parts, count: layout.count, sh_degree: layout.sh_degree, antialiased: false })
}

/// The first few names of a list.
fn some(names: &[String]) -> String {
    let mut text = names.iter().take(4).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 4 {
        text.push_str(", ..");
    }
    text
}

impl Kind for LoadSplats {
    const NAME: &'static str = "load-splats";
    const VERSION: u32 = 1;
    const STORE: Keep = Keep::Cheap;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_params: &Self, _inputs: &In) -> Cost {
        Cost::default()
    }

    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources = Vec::new();
        for file in std::iter::once(&params.path).chain(&params.more) {
            let source = root.file(file);
            if is_sog(file) {
                let bytes = std::fs::read(&source.path)
                    .map_err(|e| NodeError::new(format!("cannot read `{}`: {e}", source.path.display())))?;
                let meta = sog::Meta::read(&file.0, &bytes)?;
                sources.extend(meta.files().map(|name| root.beside(&source, name)));
            }
            sources.push(source);
        }
        Ok(sources)
    }

    fn run(params: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        let mut files = Vec::new();
        for file in std::iter::once(&params.path).chain(&params.more) {
            let loaded = load(file, params.max_extent, cx, &mut notes).map_err(|e| e.at("path"))?;
            report(file, &loaded, params.strict, &mut notes)?;
            files.push(loaded);
        }
        let sh_degree = files.iter().map(|file| file.sh_degree).max().unwrap_or(0);
        let antialiased = files.iter().any(|file| file.antialiased);
        if files.iter().any(|file| file.antialiased != antialiased) {
            let what = "some of the files say that they were trained antialiased and some do not";
            return Err(NodeError::new(what).at("more").hint("load them as scenes of their own"));
        }
        let total: usize = files.iter().flat_map(|file| &file.parts).map(|part| part.rows.len()).sum();
        let sh_len = ((sh_degree + 1) * (sh_degree + 1)) as usize;
        let finer = files.iter().flat_map(|file| &file.parts).any(|part| part.finer);
        let mut splats = Splats {
            means: Vec::with_capacity(total),
            means_low: Vec::new(),
            quats: Vec::with_capacity(total),
            scales: Vec::with_capacity(total),
            opacities: Vec::with_capacity(total),
            sh_degree,
            sh: Vec::with_capacity(total * sh_len),
            encoding: SplatEncoding::Srgb,
            antialiased,
        };
        for file in files {
            let own_len = ((file.sh_degree + 1) * (file.sh_degree + 1)) as usize;
            for part in file.parts {
                splats.means.extend(part.rows.iter().map(|row| row.mean));
                if finer {
                    splats.means_low.extend(part.rows.iter().map(|row| row.mean_low));
                }
                splats.quats.extend(part.rows.iter().map(|row| row.quat));
                splats.scales.extend(part.rows.iter().map(|row| row.scale));
                splats.opacities.extend(part.rows.iter().map(|row| row.opacity));
                if own_len == sh_len {
                    splats.sh.extend_from_slice(&part.sh);
                } else {
                    for own in part.sh.chunks_exact(own_len) {
                        splats.sh.extend_from_slice(own);
                        splats.sh.extend(std::iter::repeat_n([0.0; 3], sh_len - own_len));
                    }
                }
            }
        }
        if splats.is_empty() {
            notes.warning("no-splats", "the scene holds no splat that can be drawn");
        }
        Ok((Out { splats: Arc::new(splats) }, notes))
    }
}

/// Tells what was dropped, or stops at it.
fn report(file: &InputFile, loaded: &Loaded, strict: bool, notes: &mut Notes) -> Result<(), NodeError> {
    if strict && let Some((row, fault)) = loaded.parts.iter().find_map(|part| part.first_fault) {
        let what = format!("`{}`: splat {row} is one {}", file.0, fault.words());
        return Err(NodeError::new(what)
            .at("path")
            .hint("`strict: false` drops such splats and counts them"));
    }
    let mut all = 0;
    for fault in RowFault::ALL {
        let dropped: u64 = loaded.parts.iter().map(|part| part.dropped[fault as usize]).sum();
        all += dropped;
        if dropped > 0 {
            notes.count(fault.id(), dropped, format!("splats of `{}` {}; dropped", file.0, fault.words()));
        }
    }
    if all * 2 > loaded.count as u64 {
        let text =
            format!("{all} of {} splats of `{}` were dropped; is the file whole?", loaded.count, file.0);
        notes.warning("mostly-dropped", text);
    }
    Ok(())
}

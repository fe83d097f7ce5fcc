//! `load-splats`: a scene of Gaussian splats from a file.

use std::sync::Arc;

use engine::{
    Context, ContextField, Cost, FileHead, InputFile, Keep, Kind, NodeError, Notes, SourceFile, SourceRoot,
};

use crate::io::splats::{Placing, Reading, assemble, load, report, size, source};
use crate::types::Splats;

pub use crate::io::splats::Frame;

engine::params! {
    /// Loads a scene of Gaussian splats.
    ///
    /// Formats, detected by content and not by the file extension: INRIA PLY (spherical harmonics of degree 0 to 4,
    /// `filter_3D` of Mip-Splatting and MILo applied, other extra fields ignored), PlayCanvas compressed PLY, SOG
    /// versions 1 and 2 (`meta.json`, its folder, a folder of chunks joined in the order of their names, or a
    /// `.sog` bundle), SPZ versions 1 to 4, `.splat`, `.ksplat`, and glTF or GLB with `KHR_gaussian_splatting`.
    /// Rows that cannot be drawn are dropped and counted by reason.
    ///
    /// Frames: SPZ and glTF define +y as up, so they are rotated to the `up` of the scene as objects are (to +z (x,
    /// -z, y), to -y (x, -y, -z)); glTF is in metres and is also divided by `metres_per_unit`. The other formats do
    /// not define an up axis and are used as stored: set `up` of the scene to theirs, which for INRIA PLY is
    /// usually -y. `frame` overrides the rule.
    pub struct LoadSplats {
        /// The file, or the folder of a SOG scene.
        path: InputFile, other("\"b.ply\"");
        /// More files of the same scene, such as the chunks of a capture; appended in this order.
        more: Vec<InputFile> = Vec::new(), other("[\"b.ply\"]");
        /// True to fail at the first row that would be dropped, with an error that names it.
        strict: bool = false, inert("the output does not change unless there is an error");
        /// Splats with a longer axis are dropped: they hide the scene, and usually mean that scales were not stored
        /// as logarithms.
        max_extent: f64 = 1e6, range(1e-12, 1e30), unit("world units"), other("0.2");
        /// Up axis of the file: by its format, or given here.
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
        /// The scene, with opacities and scales activated.
        splats: Arc<Splats>,
    }
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
        // Each file with its unpacked data and its rows; at the end the rows of all files and the resulting scene.
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
        let mut sources = Vec::new();
        for (field, file) in &names {
            sources.extend(source::with_companions(file, cx.root()).map_err(|e| e.at(field))?);
        }
        cx.check_listed(&sources)?;
        let mut files = Vec::new();
        let total = names.len() as f32;
        for (done, (field, file)) in names.iter().enumerate() {
            cx.progress(done as f32 / total);
            let fetch = |name: &str| cx.read_beside(file, name);
            let read = || {
                let bytes = cx.read(file)?;
                // Notes are part of the result, which does not depend on the location of the file.
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

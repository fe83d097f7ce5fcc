//! Scenes that consist of several files, as a graph names them.

use engine::{Context, InputFile, NodeError, Notes, SourceFile, SourceRoot};

use super::frame::{Frame, Placing};
use super::loaded::Loaded;
use super::reader::{assemble, load, load_ranges, report};
use super::reading::Reading;
use super::source;
use crate::types::Splats;
use crate::types::frame::Similarity;

/// Files of splats that form one scene, and how they are read. The fields are parameters of `load-splats`.
#[derive(Debug, Clone)]
pub struct SplatFiles {
    /// The file, or the folder of a SOG scene.
    pub path: InputFile,
    /// More files of the same scene, appended in this order.
    pub more: Vec<InputFile>,
    /// True if the first row that would be dropped is an error.
    pub strict: bool,
    /// Maximum length of the axes of a splat in world units.
    pub max_extent: f64,
    /// Level of detail of a streamed SOG scene; 0 is the finest.
    pub level: u32,
    /// Up axis of the files.
    pub frame: Frame,
    /// Rotation, uniform scale and translation applied after `frame`: a 4x4 matrix in row-major order.
    pub matrix: Option<[f64; 16]>,
}

impl SplatFiles {
    /// All files that are read, with those that they refer to.
    ///
    /// # Errors
    /// If a file is missing, or its list of other files is invalid.
    pub fn sources(&self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        let mut sources = Vec::new();
        for named in std::iter::once(&self.path).chain(&self.more) {
            let expanded = source::expand(named, &root.file(named).path, self.level)?;
            sources.extend(expanded.listing.iter().map(|file| root.file(file)));
            for piece in &expanded.pieces {
                sources.extend(source::with_companions(&piece.file, root)?);
            }
        }
        Ok(sources)
    }

    /// Reads the files. If `plain` is true, only the mean of each colour over all directions is read.
    fn read(&self, plain: bool, cx: &Context) -> Result<(Vec<Loaded>, Notes), NodeError> {
        let mut notes = Notes::none();
        let matrix = Similarity::of_parameter(self.matrix.as_ref())?;
        let placing = Placing { frame: self.frame, up: cx.up(), metres_per_unit: cx.metres_per_unit() };
        let reading = Reading { cx, placing, max_extent: self.max_extent, matrix, plain };
        let (mut names, mut sources) = (Vec::new(), Vec::new());
        for (field, named) in
            std::iter::once(("path", &self.path)).chain(self.more.iter().map(|file| ("more", file)))
        {
            let expanded =
                source::expand(named, &cx.source(named).path, self.level).map_err(|e| e.at(field))?;
            sources.extend(expanded.listing.iter().map(|file| cx.source(file)));
            for (id, text, warning) in expanded.notes {
                if warning {
                    notes.warning(id, text);
                } else {
                    notes.decision(id, text);
                }
            }
            for piece in expanded.pieces {
                sources.extend(source::with_companions(&piece.file, cx.root()).map_err(|e| e.at(field))?);
                names.push((field, piece));
            }
        }
        cx.check_listed(&sources)?;
        let mut files = Vec::new();
        let total = names.len() as f32;
        for (done, (field, piece)) in names.iter().enumerate() {
            let file = &piece.file;
            cx.progress(done as f32 / total);
            let fetch = |name: &str| cx.read_sibling(file, name);
            let read = || {
                let bytes = cx.read(file)?;
                // Notes are part of the result, which does not depend on the location of the file.
                let path = std::path::Path::new(&file.0);
                let name = path.file_name().filter(|_| path.is_absolute());
                let name = name.map_or_else(|| file.0.clone(), |name| name.to_string_lossy().into_owned());
                let loaded = match &piece.ranges {
                    Some(ranges) => load_ranges(&name, &bytes, ranges, &fetch, &reading, &mut notes)?,
                    None => load(&name, &bytes, &fetch, &reading, &mut notes)?,
                };
                report(&name, &loaded, self.strict, &mut notes)?;
                Ok(loaded)
            };
            let mut read = read;
            files.push(read().map_err(|e: NodeError| e.at(field))?);
        }
        Ok((files, notes))
    }

    /// Reads the files and joins them into one scene.
    ///
    /// # Errors
    /// If a file is missing, invalid, of no known format or has changed, with the field of the graph that names it.
    pub fn splats(&self, cx: &Context) -> Result<(Splats, Notes), NodeError> {
        let (files, notes) = self.read(false, cx)?;
        Ok((assemble(files, cx)?, notes))
    }

    /// Reads the scene without the harmonics above degree 0, which saves memory. Also returns the degree of the
    /// harmonics in the files.
    ///
    /// # Errors
    /// As [`splats`](Self::splats).
    pub fn plain(&self, cx: &Context) -> Result<(Splats, u32, Notes), NodeError> {
        let (files, notes) = self.read(true, cx)?;
        let degree = files.iter().map(|file| file.stored_degree).max().unwrap_or(0);
        Ok((assemble(files, cx)?, degree, notes))
    }
}

//! The content of one file.

use engine::{NodeError, Notes};

use super::parts::RowChunk;
use super::rows::sh_rest;
use crate::error::Error;
use crate::types::SplatEncoding;

/// The content of one file: its rows and their properties.
pub(crate) struct Loaded {
    pub(super) parts: Vec<RowChunk>,
    /// Number of rows of the file, including dropped rows.
    pub(super) count: usize,
    /// Degree of the harmonics in memory.
    pub(super) sh_degree: u32,
    /// Degree of the harmonics in the file.
    pub(crate) stored_degree: u32,
    pub(super) antialiased: bool,
    pub(super) encoding: SplatEncoding,
}

impl Loaded {
    pub(super) fn new(parts: Vec<RowChunk>, count: usize, stored_degree: u32) -> Self {
        let sh_degree = if parts.iter().any(|part| part.plain) { 0 } else { stored_degree };
        let (antialiased, encoding) = (false, SplatEncoding::Srgb);
        Self { parts, count, sh_degree, stored_degree, antialiased, encoding }
    }

    /// Appends another part of the same file.
    pub(super) fn join(mut self, file: &str, other: Self) -> Result<Self, NodeError> {
        if self.antialiased != other.antialiased || self.encoding != other.encoding {
            return Err(
                Error::format(file, "the parts of the file differ in antialiasing or colour space").into()
            );
        }
        let degree = self.sh_degree.max(other.sh_degree);
        self.widen(degree);
        let mut other = other;
        other.widen(degree);
        self.count += other.count;
        self.stored_degree = self.stored_degree.max(other.stored_degree);
        self.parts.append(&mut other.parts);
        Ok(self)
    }

    /// Extends the harmonics to a higher degree with coefficients of 0.
    pub(super) fn widen(&mut self, degree: u32) {
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

/// Warns about bytes after the end of the data.
pub(super) fn left_over(file: &str, bytes: usize, notes: &mut Notes) {
    if bytes > 0 {
        let text = format!("the bytes after the splats of `{file}` are ignored (count: {bytes})");
        notes.warning("bytes-left-over", text);
    }
}

//! Settings of the readers.

use engine::{Context, NodeError, Notes, Up};
use glam::{DMat3, DVec3};

use super::frame::{Placing, Turn};
use super::parts::{self, RowChunk};
use super::rows::{Row, RowFault};
use crate::types::frame::Similarity;

/// Function that reads the bytes of another file. Its argument is the name by which the current file refers to that
/// file.
pub(crate) type Fetch<'a> = dyn Fn(&str) -> Result<Vec<u8>, NodeError> + 'a;

/// Settings for all readers.
pub(crate) struct Reading<'a> {
    pub(crate) cx: &'a Context,
    pub(crate) placing: Placing,
    pub(crate) max_extent: f64,
    /// The additional transform in the world that the user requested.
    pub(crate) matrix: Similarity,
    /// True to drop the harmonics above degree 0, so that only the mean of each colour over all directions is kept.
    /// Splats of degree 3 then take a quarter of the memory.
    pub(crate) plain: bool,
}

impl Reading<'_> {
    /// Reads rows of a file without sections; see [`parts::read_rows`].
    pub(super) fn rows(
        &self,
        count: usize,
        turn: Option<&Turn>,
        read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
    ) -> Result<Vec<RowChunk>, NodeError> {
        parts::read_rows(0, count, turn, (self.plain, self.cx), read)
    }

    /// Reads rows of a section that begins at row `first` of the file.
    pub(super) fn rows_from(
        &self,
        first: usize,
        count: usize,
        turn: Option<&Turn>,
        read: impl Fn(usize, &mut Vec<[f32; 3]>) -> Result<Row, RowFault> + Send + Sync,
    ) -> Result<Vec<RowChunk>, NodeError> {
        parts::read_rows(first, count, turn, (self.plain, self.cx), read)
    }

    /// The transform into the world, according to the format of the file and the user's parameters. Adds a note
    /// about the decision.
    pub(super) fn world(
        &self,
        file: &str,
        declared: Option<Up>,
        metres: bool,
        notes: &mut Notes,
    ) -> Option<Similarity> {
        let (turn, text) = self.placing.turn(declared, metres);
        if let Some(text) = text {
            notes.decision("frame", format!("`{file}` {text}"));
        }
        let (rotation, scale) = turn.unwrap_or((DMat3::IDENTITY, 1.0));
        let all = self.matrix.after(&Similarity { rotation, scale, offset: DVec3::ZERO });
        (all != Similarity::IDENTITY).then_some(all)
    }

    /// Like [`world`](Self::world), but returns a transform that applies to rows.
    pub(super) fn turn(
        &self,
        file: &str,
        declared: Option<Up>,
        metres: bool,
        notes: &mut Notes,
    ) -> Option<Turn> {
        let Similarity { rotation, scale, offset } = self.world(file, declared, metres, notes)?;
        Some(Turn::new(rotation, scale, offset))
    }
}

//! Stand-in for builds without a tensor library. Every call returns an error that names the missing feature.

use engine::{Context, NodeError, Notes, SourceFile, SourceRoot};
use render::light::energy_table::EnergyTable;
use render::light::linear::LinearPixels;

use super::{Kontext, WHERE};

impl Kontext<'_> {
    pub(in super::super) fn check(&self) -> Result<(), NodeError> {
        Err(NodeError::new("this build lacks the feature `learned`, which contains the diffusion model")
            .at("method")
            .hint(format!("build it with `--features learned`, or use another method; {WHERE}")))
    }

    pub(in super::super) fn memory(&self, _width: usize) -> u64 {
        0
    }

    pub(in super::super) fn sources(&self, _root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(Vec::new())
    }

    pub(in super::super) fn predict(
        &self,
        _pixels: &LinearPixels,
        _mask: &[bool],
        _darkest: f64,
        _books: &mut EnergyTable,
        _notes: &mut Notes,
        _cx: &Context,
    ) -> Result<Vec<f32>, NodeError> {
        self.check().map(|()| Vec::new())
    }
}

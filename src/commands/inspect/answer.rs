//! The measured properties of a file.

use engine::Notes;
use render::geometry::inspect::mesh;
use render::geometry::inspect::splats::Inspection;
use serde::Serialize;

use super::picture;

/// The properties of a file, which are printed as text or as JSON.
#[derive(Serialize)]
pub(super) struct Answer<'a> {
    pub(super) file: String,
    /// Type of the content: `splats`, `mesh` or `picture`.
    pub(super) holds: &'static str,
    pub(super) format: Option<&'static str>,
    /// The up axis that the format defines or the file states; `None` if there is none. Coordinates are reported as stored in either
    /// case.
    pub(super) declared_up: Option<&'static str>,
    /// True if `declared_up` is the statement of a comment, for which the loader does not rotate the splats.
    #[serde(skip)]
    pub(super) is_up_comment: bool,
    #[serde(flatten)]
    pub(super) scene: Option<&'a Inspection>,
    #[serde(flatten)]
    pub(super) mesh: Option<&'a mesh::Inspection>,
    #[serde(flatten)]
    pub(super) picture: Option<&'a picture::Inspection>,
    pub(super) notes: &'a Notes,
}

//! Decides by the objects which input is in the wrong frame.
//!
//! Once a transform of the mesh is known, mesh and splats agree, and the objects stand either in the frame of the splats
//! or in that of the mesh. An object that is inside a surface in one of them stands in the other.

use engine::{Context, NodeError};
use glam::DVec3;
use scene::types::frame::Similarity;

use super::moved::{Likely, Moved};
use super::place::{AROUND, CapturedPlace, matrix};
use super::sight::Sight;
use super::spots::Spots;
use crate::splat::Blocks;

/// Minimum share of the surfaces around an object that the mesh hides from its middle for the object to be inside a
/// surface, where splats and mesh agree.
const INSIDE: f64 = 0.1;

/// The transform with a decision which input is wrong, if it was not decided and the objects show it.
pub(super) fn decided(place: &CapturedPlace<'_>, found: Moved, cx: &Context) -> Result<Moved, NodeError> {
    // A view cannot be mirrored.
    if found.is_decided || found.is_mirrored() || place.around.is_empty() {
        return Ok(found);
    }
    cx.check()?;
    let inside = |at: &Similarity| -> Result<Option<bool>, NodeError> {
        let hidden = hidden(place, &found.by, at, cx)?;
        Ok(hidden.map(|hidden| hidden > INSIDE))
    };
    Ok(match (inside(&Similarity::IDENTITY)?, inside(&found.by)?) {
        (Some(true), Some(false)) => found.blamed(Likely::Splats),
        (Some(false), Some(true)) => found.blamed(Likely::Mesh),
        _ => found,
    })
}

/// Share of the surfaces of the splats around the middles of the objects, moved by `at`, in front of which the mesh has a
/// surface when it is transformed by `by`. `None` if no surface is visible from there.
fn hidden(
    place: &CapturedPlace<'_>,
    by: &Similarity,
    at: &Similarity,
    cx: &Context,
) -> Result<Option<f64>, NodeError> {
    let blocks = Blocks::of(place.splats, cx)?;
    let frame = (place.axes.map(|axis| at.rotation * axis), place.metre * at.scale);
    let mut sights = Vec::new();
    for eye in place.around.iter().take(AROUND).map(|middle: &DVec3| at.point(*middle)) {
        sights.extend(Sight::around(place.splats, &blocks, eye, frame, cx)?);
    }
    Ok(Spots::of(place.splats, &sights).map(|spots| {
        let depths = spots.depths(&sights, place.mesh, &matrix(by));
        spots.agreement(&sights, &depths, &depths).hidden
    }))
}

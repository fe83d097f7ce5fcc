//! Transforms that bring a mesh into agreement with the splats, and the input that is probably wrong.

use glam::DVec3;
use scene::math::num;
use scene::types::frame::Similarity;

use super::place::{CapturedPlace, UPRIGHT};
use super::search;
use super::spots::Spots;
use crate::geometry::level::{self, LevelEstimate};

/// Minimum increase of the agreement that a transform must cause to be reported.
pub(super) const GAIN: f64 = 0.12;
/// Maximum amount by which the agreement of a simpler transform may be below the highest agreement for the simpler
/// transform to be preferred.
const SIMILAR: f64 = 0.06;
/// A transform with at least this shift is large enough to be reported. The shift is a share of the median distance
/// from the eye to the points.
pub(super) const SHIFTED: f64 = 0.1;
/// Like [`SHIFTED`], as a share of the median distance of the splats from their middle, for a transform that is
/// found by the surfaces.
pub(super) const SHIFTED_SURFACES: f64 = 0.03;
/// A transform with at least this relative change of scale is large enough to be reported.
const SCALED: f64 = 0.06;
/// A transform with at least this angle of rotation, in degrees, is large enough to be reported.
const TURNED_DEG: f64 = 3.0;
/// If the views show less than this share of the splats, and less than half as much of the splats as of the mesh,
/// the splats are probably in the wrong frame.
const SEEN_LITTLE: f64 = 0.3;

/// Input that is probably in the wrong frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Likely {
    /// The mesh. This is the usual case, since splats and cameras come from one program.
    Mesh,
    /// The splats. This is assumed if the wanted views show only the mesh, or if the mesh is upright and the splats
    /// are not.
    Splats,
}

/// A transform of the mesh, and the agreement of the transformed mesh with the splats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// Transform of the mesh.
    pub by: Similarity,
    /// Agreement of the transformed mesh with the splats, 0 to 1.
    pub agreement: f64,
    /// Agreement of the mesh at its own position, measured in the same way.
    pub before: f64,
    /// Angle of the rotation in degrees; 180 for a reflection.
    pub turn_deg: f64,
    /// Distance by which the transform moves the middle of the place, in world units.
    pub shift: f64,
    /// Input that is probably in the wrong frame.
    pub likely: Likely,
    /// True if the views or the up directions show which input is in the wrong frame.
    pub is_decided: bool,
}

impl Moved {
    /// True if the transform contains a reflection.
    pub fn is_mirrored(&self) -> bool {
        self.by.rotation.determinant() < 0.0
    }
}

impl Moved {
    /// Computes the angle and the shift of a transform with which the agreement changes from `before` to
    /// `agreement`. Sets `likely` to `Mesh`, not decided; see [`judged`](Self::judged).
    pub(super) fn of(by: Similarity, [before, agreement]: [f64; 2], spots: &Spots) -> Self {
        let turn = by.rotation;
        let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
        let turn_deg = num::f64::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
        let shift = (by.point(spots.middle) - spots.middle).length();
        let mut found =
            Self { by, agreement, before, turn_deg, shift, likely: Likely::Mesh, is_decided: false };
        if found.is_mirrored() {
            found.turn_deg = 180.0;
        }
        found
    }

    /// True if the transform is large enough to be reported, and its agreement is at least `least` and sufficiently
    /// higher than at the own position of the mesh. A shift is large enough if it is at least the share `shifted`
    /// of the median distance of the points.
    pub(super) fn is_found(&self, [least, shifted]: [f64; 2], spots: &Spots) -> bool {
        let far = self.shift >= shifted * spots.distance
            || (self.by.scale - 1.0).abs() >= SCALED
            || self.turn_deg >= TURNED_DEG;
        far && self.agreement >= least && self.agreement >= self.before + GAIN
    }

    /// The same transform, with a decision which input is in the wrong frame.
    pub(super) fn blamed(self, likely: Likely) -> Self {
        Self { likely, is_decided: true, ..self }
    }

    /// Decides which input is probably in the wrong frame, if this is not decided, given the shares of the wanted views
    /// that show splats and mesh.
    pub(super) fn judged(self, place: &CapturedPlace<'_>, visible: Option<[f64; 2]>) -> Self {
        let decided = |likely| self.blamed(likely);
        if self.is_decided {
            return self;
        }
        if let Some([splats, mesh]) = visible {
            if splats < SEEN_LITTLE && splats < 0.5 * mesh {
                return decided(Likely::Splats);
            }
            if mesh < SEEN_LITTLE && mesh < 0.5 * splats {
                return decided(Likely::Mesh);
            }
        }
        if self.turn_deg < 45.0 || self.is_mirrored() {
            return self;
        }
        let stands = |found: Option<LevelEstimate>| {
            let found = found.filter(LevelEstimate::is_sure)?;
            Some(DVec3::from_array(found.up).dot(place.axes[2]) > UPRIGHT)
        };
        let mesh = stands(level::of_mesh(place.mesh, None));
        match (stands(level::of_sample(place.splats)), mesh) {
            (Some(false), Some(true) | None) => decided(Likely::Splats),
            (Some(true), Some(false)) => decided(Likely::Mesh),
            _ => self,
        }
    }
}

/// Returns the simplest of the transforms (see [`search::parts`]) whose agreement is within [`SIMILAR`] of the
/// highest.
pub(super) fn simplest(mut found: Vec<Moved>) -> Option<Moved> {
    let most = found.iter().map(|one| one.agreement).fold(0.0, f64::max);
    found.retain(|one| one.agreement >= most - SIMILAR);
    found.sort_by(|a, b| {
        search::parts(&a.by).cmp(&search::parts(&b.by)).then(b.agreement.total_cmp(&a.agreement))
    });
    found.into_iter().next()
}

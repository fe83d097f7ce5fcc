//! Decides whether a transform of the mesh explains why splats and mesh disagree.

use engine::{Context, NodeError};
use scene::types::frame::Similarity;

use super::cloud::Placed;
use super::explained::Explained;
use super::moved::{GAIN, Moved, SHIFTED, SHIFTED_SURFACES, simplest};
use super::place::{AGREES, CapturedPlace, FOUND, FOUND_BY_VIEWS, IN_PLACE, PART, PART_AGREES};
use super::sight::Sight;
use super::spots::{Agreement, Spots};
use super::surfaces::{Both, Surfaces};

/// Maximum share of the points in front of which a transformed mesh may have a surface for the transform to be
/// reported, unless the mesh hides as many at its own position.
const HIDDEN: f64 = 0.1;
/// Maximum share of what floats and what is missing that a transform may leave for it to count as the explanation.
const EXPLAINED: f64 = 0.3;

/// Minimum increase of the agreement of the surfaces for a transform of a mesh that agrees as a whole. In a place that looks
/// the same after a rotation, a rotated mesh hides its debris from the views, and has it all the same.
const CLEARER: f64 = 0.02;
/// If the surfaces of splats and mesh agree less than this, both ways, a transform is searched for even if the depths
/// agree: the views may show little of the place.
const UNSURE: f64 = 0.5;

/// The mesh at its own position, with which transforms are compared.
pub(super) struct Rated<'a> {
    place: &'a CapturedPlace<'a>,
    sights: &'a [Sight],
    spots: &'a Spots,
    surfaces: &'a Surfaces<'a>,
    both: Both,
    /// Comparison of the depths.
    pub here: Explained,
    /// Share of the mesh that the views confirm; see [`Spots::confirmed`].
    confirmed: f64,
    /// True if the mesh agrees as a whole, so that only parts of it may be wrong.
    pub agrees: bool,
}

impl<'a> Rated<'a> {
    /// Compares the mesh at its own position with the points `spots` of the views `sights`. `both` is the agreement of
    /// the surfaces.
    pub fn of(
        place: &'a CapturedPlace<'a>,
        (sights, spots): (&'a [Sight], &'a Spots),
        (surfaces, both): (&'a Surfaces<'a>, Both),
        cx: &Context,
    ) -> Result<Self, NodeError> {
        let cloud = surfaces.cloud;
        let here = Explained::of(place, (sights, spots, cloud), &Similarity::IDENTITY, None, cx)?;
        let confirmed = spots.confirmed(sights, &Placed { cloud, at: Similarity::IDENTITY });
        // A mesh of a part of the place, such as the ground near the object, agrees where it is visible. A transform
        // could make it fit a larger part of the splats.
        let Agreement { all, known, share, .. } = here.agreement;
        let is_part = (share >= PART && known.min(confirmed) >= PART_AGREES)
            || (both.mesh >= PART_AGREES && cloud.radius >= surfaces.tolerance());
        let agrees = all >= AGREES || both.mean() >= IN_PLACE || is_part;
        Ok(Self { place, sights, spots, surfaces, both, here, confirmed, agrees })
    }

    /// True if a transform is to be searched for.
    pub fn is_doubtful(&self) -> bool {
        !self.agrees || self.here.has_findings() || self.both.splats.max(self.both.mesh) < UNSURE
    }

    /// The simplest of the transforms that make splats and mesh agree; `None` if none does. Each may have the
    /// agreement of the surfaces with it. Transforms on which the surfaces agree take precedence over those on which
    /// only the depths agree.
    pub fn best(
        &self,
        tried: impl IntoIterator<Item = (Option<Both>, Similarity)>,
        cx: &Context,
    ) -> Result<Option<Moved>, NodeError> {
        let views = (self.sights, self.spots, self.surfaces.cloud);
        let (mut by_surfaces, mut by_views) = (Vec::new(), Vec::new());
        for (both, by) in tried {
            let there = Explained::of(self.place, views, &by, Some(&self.here.depths), cx)?;
            let explains = there.left() < EXPLAINED * self.here.left();
            let is_clearer = || {
                let there = both.unwrap_or_else(|| self.surfaces.agreement(by, usize::MAX, 1.0));
                there.mean() >= self.both.mean() + CLEARER
            };
            if there.agreement.hidden > HIDDEN.max(self.here.agreement.hidden)
                || (self.agrees && !(explains && is_clearer()))
            {
                continue;
            }
            // A small shift is within the accuracy of usual meshes, unless parts would be reported without it.
            let least_shift = |share| if explains && self.here.has_findings() { 0.0 } else { share };
            if let Some(both) = both {
                let spots = &self.surfaces.spots;
                let found = Moved::of(by, [self.both.mean(), both.mean()], spots);
                let is_found = found.is_found([FOUND, least_shift(SHIFTED_SURFACES)], spots);
                by_surfaces.extend(is_found.then_some(found));
            }
            let found = Moved::of(by, [self.here.agreement.all, there.agreement.all], self.spots);
            let is_found = found.is_found([FOUND_BY_VIEWS, least_shift(SHIFTED)], self.spots);
            by_views.extend((is_found && self.gains(&there, by)).then_some(found));
        }
        Ok(simplest(by_surfaces).or_else(|| simplest(by_views)))
    }

    /// True if the mesh also agrees better where it is visible, or where it is confirmed. A mesh of a part of the
    /// place could otherwise be moved or scaled to fit a larger part of the splats.
    fn gains(&self, there: &Explained, by: Similarity) -> bool {
        let here = self.here.agreement;
        let placed = Placed { cloud: self.surfaces.cloud, at: by };
        here.share < PART
            || there.agreement.known >= here.known + GAIN
            || self.spots.confirmed(self.sights, &placed) >= self.confirmed + GAIN
    }
}

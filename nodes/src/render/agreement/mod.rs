//! Compares the splats and the mesh of a place by their depths, in the views that the graph renders (the wanted
//! views) and around the inserted objects.
//!
//! Small pictures of the splats (depth mode `RayMedian`) give points on their surface. The mesh is rasterized in
//! the same views. The agreement is a number from 0 to 1 that states how near the mesh is to these points.
//!
//! If the mesh does not agree with the splats, a search finds out whether a rotation, a scale and a shift explain
//! the difference. The comparison also finds parts of the mesh that the splats do not show, and surfaces of the
//! splats that the mesh lacks.

mod cloud;
mod fit;
mod raster;
mod regions;
mod search;
mod sight;
mod spots;
#[cfg(test)]
mod tests;

use engine::{Context, NodeError};
use glam::{DMat4, DVec3};

use crate::geometry::level::{self, LevelEstimate};
use crate::math::num;
use crate::types::frame::Similarity;
use crate::types::{Camera, Mesh, Splats};
use cloud::{Cloud, Placed};
pub use regions::Regions;
use sight::Sight;
use spots::Spots;

/// Maximum number of wanted views that are compared.
const WANTED: usize = 3;
/// Maximum number of points in free space from which the surroundings are rendered and compared.
const AROUND: usize = 2;
/// Minimum agreement at which the mesh counts as being in the frame of the splats, so that no better transform is
/// searched for.
const AGREES: f64 = 0.8;
/// Minimum agreement of a transformed mesh for the transform to be reported.
const FOUND: f64 = 0.4;
/// Minimum increase of the agreement that a transform must cause to be reported.
const GAIN: f64 = 0.12;
/// Maximum amount by which the agreement of a simpler transform may be below the highest agreement for the simpler
/// transform to be preferred.
const SIMILAR: f64 = 0.06;
/// Minimum share of the points at which the mesh must be visible for the agreement at these points alone to be
/// considered.
const PART: f64 = 0.02;
/// Minimum agreement, at the points where the mesh is visible, at which a mesh that covers only a part of the place
/// counts as being in the frame of the splats.
const PART_AGREES: f64 = 0.9;
/// If the agreement is below this value, and the agreement where the mesh is visible is below [`PART_DISAGREES`],
/// splats and mesh are reported as being in different frames even if no transform is found.
const DISAGREES: f64 = 0.12;
/// Limit of the agreement at the points where the mesh is visible, used together with [`DISAGREES`].
const PART_DISAGREES: f64 = 0.5;
/// A transform with at least this shift is large enough to be reported. The shift is a share of the median distance
/// from the eye to the points.
const SHIFTED: f64 = 0.1;
/// A transform with at least this relative change of scale is large enough to be reported.
const SCALED: f64 = 0.06;
/// A transform with at least this angle of rotation, in degrees, is large enough to be reported.
const TURNED_DEG: f64 = 3.0;
/// Minimum share of the pixels of the wanted views that the splats, or the mesh, must cover to count as visible.
const UNSEEN: f64 = 0.02;
/// Minimum cosine of the angle between the up direction of the scene and the up direction estimated from the splats
/// or from the mesh, for these splats or this mesh to count as upright.
const UPRIGHT: f64 = 0.94;
/// Minimum share of the pixels of a view that debris must cover to be reported.
const DEBRIS: f64 = 0.006;
/// Minimum share of the pixels of a view that missing surfaces must cover to be reported.
const MISSING: f64 = 0.03;
/// Half of the minimum distance between splats and mesh for a part of the mesh to count as debris, or for a surface
/// of the splats to count as missing. It is a share of the distance from the eye.
const TOLERANCE: f64 = 0.05;

/// Place whose splats and mesh are compared.
#[derive(Debug, Clone, Copy)]
pub struct Place<'a> {
    /// The splats, in the world.
    pub splats: &'a Splats,
    /// The mesh, in the world.
    pub mesh: &'a Mesh,
    /// Cameras of the wanted views; the views of the first, the middle and the last one are compared.
    pub cameras: &'a [Camera],
    /// Points in free space at or near the inserted objects, such as the middle of each object. The first two are
    /// used.
    pub around: &'a [DVec3],
    /// Unit vectors to the right, forward and up.
    pub axes: [DVec3; 3],
    /// World units per metre.
    pub metre: f64,
}

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
    /// Angle of the rotation in degrees.
    pub turn_deg: f64,
    /// Distance by which the transform moves the middle of the place, in world units.
    pub shift: f64,
    /// Input that is probably in the wrong frame.
    pub likely: Likely,
}

/// Result of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Number of compared points on the surface of the splats.
    pub points: usize,
    /// Mean agreement of the depths, 0 to 1. The points are weighted so that surfaces of all orientations
    /// contribute about equally.
    pub agreement: f64,
    /// Mean agreement at the points where the mesh is visible; 0 if the mesh is not visible at any point.
    pub known: f64,
    /// The transform that brings the mesh into agreement with the splats. `None` if the mesh is in place, or if no
    /// such transform was found.
    pub best: Option<Moved>,
    /// Parts of the mesh that float in front of the surfaces that the splats show.
    pub debris: Regions,
    /// Surfaces of the splats that the mesh lacks, within the bounding box of the mesh.
    pub missing: Regions,
    /// Share of the pixels of the wanted views that show splats, and share that show the mesh; `None` if there are
    /// no wanted views.
    pub visible: Option<[f64; 2]>,
}

/// A finding of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// The splats and the mesh are in different frames.
    Elsewhere,
    /// The wanted cameras see neither the splats nor the mesh.
    Cameras,
    /// Parts of the mesh float in front of the surfaces that the splats show.
    Debris,
    /// The mesh lacks surfaces that the splats show.
    Missing,
}

impl Comparison {
    /// The findings that are worth a warning.
    pub fn findings(&self) -> Vec<Finding> {
        if self.visible.is_some_and(|shares| shares.into_iter().all(|share| share < UNSEEN)) {
            return vec![Finding::Cameras];
        }
        if self.best.is_some() || (self.agreement < DISAGREES && self.known < PART_DISAGREES) {
            return vec![Finding::Elsewhere];
        }
        let mut found = Vec::new();
        if self.debris.share >= DEBRIS {
            found.push(Finding::Debris);
        }
        if self.missing.share >= MISSING {
            found.push(Finding::Missing);
        }
        found
    }
}

/// Up to three of the cameras: the first, the middle and the last.
fn chosen(cameras: &[Camera]) -> Vec<Camera> {
    let count = cameras.len();
    if count <= WANTED {
        return cameras.to_vec();
    }
    [0, count / 2, count - 1].map(|i| cameras[i].clone()).to_vec()
}

/// Compares splats and mesh. Returns `None` if there is nothing to compare: the mesh has no area, or there are no
/// opaque splats.
pub fn compare(place: &Place<'_>, cx: &Context) -> Result<Option<Comparison>, NodeError> {
    let around = &place.around[..place.around.len().min(AROUND)];
    let frame = (place.axes, place.metre);
    let sights = Sight::all(place.splats, &chosen(place.cameras), around, frame, cx)?;
    let Some(cloud) = Cloud::of(place.mesh) else { return Ok(None) };
    cx.check()?;
    match Spots::of(place.splats, &sights) {
        Some(spots) => by_views(place, &sights, &spots, &cloud, cx).map(Some),
        None => Ok(by_centres(place, &sights, &cloud)),
    }
}

/// Compares splats and mesh by their depths in the views.
fn by_views(
    place: &Place<'_>,
    sights: &[Sight],
    spots: &Spots,
    cloud: &Cloud,
    cx: &Context,
) -> Result<Comparison, NodeError> {
    let depths = spots.depths(sights, place.mesh, &DMat4::IDENTITY);
    let here = spots.agreement(sights, &depths, &depths);
    let confirmed = |at: Similarity| spots.confirmed(sights, &Placed { cloud, at });
    let here_confirmed = confirmed(Similarity::IDENTITY);
    // A mesh of a part of the place, such as the ground near the object, agrees where it is visible. A transform
    // could make it fit a larger part of the splats.
    let is_part = here.share >= PART && here.known.min(here_confirmed) >= PART_AGREES;
    let measured = |by: Similarity| {
        let moved = spots.depths(sights, place.mesh, &matrix(&by));
        let there = spots.agreement(sights, &moved, &depths);
        let gains =
            here.share < PART || there.known >= here.known + GAIN || confirmed(by) >= here_confirmed + GAIN;
        (Moved::of(by, there.all, spots), gains)
    };
    let mut tried = Vec::new();
    if here.all < AGREES && !is_part {
        tried.push(measured(search::nearby(cloud, spots)));
        if tried[0].0.agreement < AGREES {
            cx.check()?;
            tried.extend(search::anywhere(cloud, spots).into_iter().map(measured));
        }
    }
    let is_better = |(found, gains): &(Moved, bool)| *gains && found.is_found(here.all, spots);
    let best = simplest(tried.into_iter().filter(is_better).map(|(found, _)| found).collect());
    let visible = visible(sights, &depths);
    Ok(Comparison {
        points: spots.list.len(),
        agreement: here.all,
        known: here.known,
        best: best.map(|found| Moved { likely: likely(place, found.turn_deg, visible), ..found }),
        debris: regions::debris(sights, &depths, spots, TOLERANCE),
        missing: regions::missing(sights, &depths, spots, cloud.extents(), TOLERANCE),
        visible,
    })
}

/// Compares the mesh with the centres of the splats. Used if the views show hardly any splats.
fn by_centres(place: &Place<'_>, sights: &[Sight], cloud: &Cloud) -> Option<Comparison> {
    let spots = Spots::of_centres(place.splats)?;
    let depths = spots.depths(sights, place.mesh, &DMat4::IDENTITY);
    let visible = visible(sights, &depths);
    let fits = |at: Similarity| Placed { cloud, at }.agreement(&spots, 1, 1.0);
    let agreement = fits(Similarity::IDENTITY);
    let tried = search::anywhere(cloud, &spots).into_iter().map(|by| Moved::of(by, fits(by), &spots));
    let best = simplest(tried.filter(|found| found.is_found(agreement, &spots)).collect());
    let best = best.map(|found| Moved { likely: likely(place, found.turn_deg, visible), ..found });
    let (debris, missing) = (Regions::default(), Regions::default());
    Some(Comparison { points: spots.list.len(), agreement, known: agreement, best, debris, missing, visible })
}

/// Returns the simplest of the transforms (see [`search::parts`]) whose agreement is within [`SIMILAR`] of the
/// highest.
fn simplest(mut found: Vec<Moved>) -> Option<Moved> {
    let most = found.iter().map(|one| one.agreement).fold(0.0, f64::max);
    found.retain(|one| one.agreement >= most - SIMILAR);
    found.sort_by(|a, b| {
        search::parts(&a.by).cmp(&search::parts(&b.by)).then(b.agreement.total_cmp(&a.agreement))
    });
    found.into_iter().next()
}

/// Share of the pixels of the wanted views that show splats, and share that show the mesh.
fn visible(sights: &[Sight], depths: &[Vec<f64>]) -> Option<[f64; 2]> {
    let wanted = || sights.iter().zip(depths).filter(|(sight, _)| sight.wanted);
    let all: usize = wanted().map(|(sight, _)| sight.depth.len()).sum();
    let splats: usize = wanted().map(|(sight, _)| sight.empty.iter().filter(|empty| !**empty).count()).sum();
    let mesh: usize = wanted().map(|(_, mesh)| mesh.iter().filter(|depth| depth.is_finite()).count()).sum();
    (all > 0).then(|| [splats, mesh].map(|count| count as f64 / all as f64))
}

impl Moved {
    /// Computes the angle and the shift of a transform. Sets `likely` to `Mesh`; the caller may change it.
    fn of(by: Similarity, agreement: f64, spots: &Spots) -> Self {
        let turn = by.rotation;
        let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
        let turn_deg = num::f64::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
        let shift = (by.point(spots.middle) - spots.middle).length();
        Self { by, agreement, turn_deg, shift, likely: Likely::Mesh }
    }

    /// True if the transform is large enough to be reported and its agreement is sufficiently higher than `here`,
    /// the agreement of the mesh at its own position.
    fn is_found(&self, here: f64, spots: &Spots) -> bool {
        let far = self.shift >= SHIFTED * spots.distance
            || (self.by.scale - 1.0).abs() >= SCALED
            || self.turn_deg >= TURNED_DEG;
        far && self.agreement >= FOUND && self.agreement >= here + GAIN
    }
}

/// Input that is probably in the wrong frame, given the shares of the wanted views that show splats and mesh.
fn likely(place: &Place<'_>, turn_deg: f64, visible: Option<[f64; 2]>) -> Likely {
    if visible.is_some_and(|[splats, mesh]| splats < UNSEEN && mesh >= 10.0 * UNSEEN) {
        return Likely::Splats;
    }
    if turn_deg < 45.0 {
        return Likely::Mesh;
    }
    let stands = |found: Option<LevelEstimate>| {
        let found = found.filter(LevelEstimate::is_sure)?;
        Some(DVec3::from_array(found.up).dot(place.axes[2]) > UPRIGHT)
    };
    let mesh = stands(level::of_mesh(place.mesh, None));
    let splats = stands(level::of_splats(place.splats, None));
    if splats == Some(false) && mesh != Some(false) { Likely::Splats } else { Likely::Mesh }
}

fn matrix(by: &Similarity) -> DMat4 {
    DMat4::from_cols_array(&by.rows()).transpose()
}

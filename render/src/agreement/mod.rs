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
mod explained;
mod eyes;
mod fit;
mod moved;
mod place;
mod raster;
mod rated;
mod regions;
mod search;
mod sight;
mod spots;
mod standing;
mod surfaces;
#[cfg(test)]
mod tests;

use engine::{Context, NodeError};
use glam::{DMat3, DMat4, DVec3};
use scene::types::Camera;
use scene::types::frame::Similarity;

use crate::geometry::level::{self, LevelEstimate};
use cloud::{Cloud, Placed};
pub use moved::{Likely, Moved};
use moved::{SHIFTED, SHIFTED_SURFACES, simplest};
pub use place::CapturedPlace;
use place::{AROUND, DEBRIS, FOUND, FOUND_BY_VIEWS, IN_PLACE, MISSING, PART_AGREES, UPRIGHT};
use rated::Rated;
pub use regions::Regions;
use sight::Sight;
use spots::Spots;
use surfaces::{Both, Surfaces};

/// Maximum number of wanted views that are compared.
const WANTED: usize = 3;
/// Minimum agreement of the depths, without the parts that float or are missing, at which only these parts count as
/// wrong. If it is lower, splats and mesh disagree as a whole.
const REST_AGREES: f64 = 0.75;
/// If the agreement is below this value, and the agreement where the mesh is visible is below [`PART_DISAGREES`],
/// splats and mesh are reported as being in different frames even if no transform is found.
const DISAGREES: f64 = 0.12;
/// Limit of the agreement at the points where the mesh is visible, used together with [`DISAGREES`].
const PART_DISAGREES: f64 = 0.5;
/// Minimum share of the pixels of the wanted views that the splats, or the mesh, must cover to count as visible.
const UNSEEN: f64 = 0.02;
/// Minimum share of the pixels that debris and missing surfaces must cover for a mesh without a transform to count as
/// being in another frame. Meshes of other places reach 0.139; the mesh of the garden, near its edge, 0.036.
const NEARLY_ALL: f64 = 0.07;
/// Number of transforms that the surfaces suggest and the views verify.
const VERIFIED: usize = 3;

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
    /// True if the mesh is in the frame of the splats, so that only parts of it may be wrong.
    pub in_place: bool,
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
        // In a mesh that is elsewhere, nearly every part floats or lacks something.
        let is_much = self.debris.share + self.missing.share >= NEARLY_ALL;
        if !self.in_place && is_much { vec![Finding::Elsewhere] } else { found }
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
pub fn compare(place: &CapturedPlace<'_>, cx: &Context) -> Result<Option<Comparison>, NodeError> {
    let found = compared(place, cx)?;
    let is_wrong = found.as_ref().is_some_and(|found| !found.findings().is_empty());
    let is_turned = || {
        let up = level::of_sample(place.splats).filter(LevelEstimate::is_sure);
        up.is_some_and(|found| DVec3::from_array(found.up).dot(place.axes[2]) < UPRIGHT)
    };
    if is_wrong && !place.around.is_empty() && is_turned() {
        // If another axis of the splats points up, the objects stand at wrong places, possibly inside surfaces.
        return compared(&CapturedPlace { around: &[], ..*place }, cx);
    }
    Ok(found)
}

fn compared(place: &CapturedPlace<'_>, cx: &Context) -> Result<Option<Comparison>, NodeError> {
    let around = &place.around[..place.around.len().min(AROUND)];
    let frame = (place.axes, place.metre);
    let sights = eyes::sights(place.splats, &chosen(place.cameras), around, frame, cx)?;
    let Some(cloud) = Cloud::of(place.mesh) else { return Ok(None) };
    let Some(surfaces) = Surfaces::of(place.splats, &cloud) else { return Ok(None) };
    cx.check()?;
    match Spots::of(place.splats, &sights) {
        Some(spots) => by_views(place, &sights, &spots, &surfaces, cx).map(Some),
        None => by_centres(place, &sights, &surfaces, cx).map(Some),
    }
}

/// Share of the splats that lie on a mesh, above which the mesh is in its place if no transform fits better. The
/// demo places with debris reach 0.74 and 0.89, and meshes that are elsewhere 0.2.
const HOLDS: f64 = 0.65;
/// Number of points that are sampled on a mesh to find whether it contains the surfaces of the place.
const DENSE: usize = 400_000;

/// Compares splats and mesh by their depths in the views, and by their surfaces.
fn by_views(
    place: &CapturedPlace<'_>,
    sights: &[Sight],
    spots: &Spots,
    surfaces: &Surfaces<'_>,
    cx: &Context,
) -> Result<Comparison, NodeError> {
    let cloud = surfaces.cloud;
    let both = surfaces.here();
    let rated = Rated::of(place, (sights, spots), (surfaces, both), cx)?;
    let mut best = None;
    if rated.is_doubtful() {
        let mut first = search::by_surfaces(surfaces, place.axes[2]);
        first.truncate(VERIFIED);
        best = rated.best(first.iter().map(|&(there, by)| (Some(there), by)), cx)?;
        if best.is_none() {
            best = by_moved_views(place, (surfaces, both), &first, cx)?;
        }
        if best.is_none() {
            cx.check()?;
            best = rated.best([(None, search::nearby(cloud, spots))], cx)?;
        }
        if best.is_none() {
            cx.check()?;
            best = rated.best(search::anywhere(cloud, spots).into_iter().map(|by| (None, by)), cx)?;
        }
    }
    let (agrees, here) = (rated.agrees, rated.here);
    let visible = visible(sights, &here.depths);
    // Debris of a large area leaves few of the sampled points on the surfaces of the place.
    let holds_the_place = || {
        let dense = Cloud::with(place.mesh, DENSE);
        dense.is_some_and(|dense| {
            let at = Placed { cloud: &dense, at: Similarity::IDENTITY };
            at.agreement(&surfaces.spots, 1, 1.0) >= HOLDS
        })
    };
    Ok(Comparison {
        points: spots.list.len(),
        agreement: here.agreement.all,
        known: here.agreement.known,
        best: best.map(|found| standing::decided(place, found.judged(place, visible), cx)).transpose()?,
        in_place: agrees
            || both.splats >= IN_PLACE
            || here.rest >= REST_AGREES
            || (best.is_none() && holds_the_place()),
        debris: here.debris,
        missing: here.missing,
        visible,
    })
}

/// Compares the mesh with the centres of the splats. Used if the views show hardly any splats.
fn by_centres(
    place: &CapturedPlace<'_>,
    sights: &[Sight],
    surfaces: &Surfaces<'_>,
    cx: &Context,
) -> Result<Comparison, NodeError> {
    let (spots, cloud) = (&surfaces.spots, surfaces.cloud);
    let depths = spots.depths(sights, place.mesh, &DMat4::IDENTITY);
    let visible = visible(sights, &depths);
    let both = surfaces.here();
    let in_place = both.mean() >= IN_PLACE || both.mesh >= PART_AGREES;
    let fits = |at: Similarity| Placed { cloud, at }.agreement(spots, 1, 1.0);
    let agreement = fits(Similarity::IDENTITY);
    let mut best = None;
    if !in_place {
        let first = search::by_surfaces(surfaces, place.axes[2]);
        best = by_moved_views(place, (surfaces, both), &first[..first.len().min(VERIFIED)], cx)?;
        best = best.or_else(|| of_surfaces(surfaces, both, first));
    }
    if !in_place && best.is_none() {
        let moved = |by| Moved::of(by, [agreement, fits(by)], spots);
        let tried = search::anywhere(cloud, spots).into_iter().map(moved);
        best = simplest(tried.filter(|found| found.is_found([FOUND_BY_VIEWS, SHIFTED], spots)).collect());
    }
    let best = best.map(|found| found.judged(place, visible));
    let (debris, missing) = (Regions::default(), Regions::default());
    Ok(Comparison {
        points: spots.list.len(),
        agreement,
        known: agreement.max(both.mesh),
        best,
        in_place,
        debris,
        missing,
        visible,
    })
}

/// The transform with which the surfaces agree. `None` if no transform reaches [`FOUND`] and [`moved::GAIN`].
fn of_surfaces(surfaces: &Surfaces<'_>, here: Both, tried: Vec<(Both, Similarity)>) -> Option<Moved> {
    let moved = |(both, by): (Both, Similarity)| Moved::of(by, [here.mean(), both.mean()], &surfaces.spots);
    let found = tried.into_iter().map(moved);
    simplest(found.filter(|found| found.is_found([FOUND, SHIFTED_SURFACES], &surfaces.spots)).collect())
}

/// The first of the transforms that makes splats and mesh agree in views that are moved like the mesh. If the splats
/// are in the wrong frame, and mesh and cameras are not, only these views show the place.
fn by_moved_views(
    place: &CapturedPlace<'_>,
    (surfaces, both): (&Surfaces<'_>, Both),
    tried: &[(Both, Similarity)],
    cx: &Context,
) -> Result<Option<Moved>, NodeError> {
    // A camera cannot be mirrored.
    for &(there, by) in tried.iter().filter(|(_, by)| by.rotation.determinant() > 0.0) {
        cx.check()?;
        let cameras: Vec<Camera> =
            chosen(place.cameras).iter().map(|camera| moved_camera(camera, &by)).collect();
        let around: Vec<DVec3> = place.around.iter().take(AROUND).map(|point| by.point(*point)).collect();
        let frame = (place.axes.map(|axis| by.rotation * axis), place.metre * by.scale);
        let sights = eyes::sights(place.splats, &cameras, &around, frame, cx)?;
        let Some(spots) = Spots::of(place.splats, &sights) else { continue };
        let rated = Rated::of(place, (&sights, &spots), (surfaces, both), cx)?;
        if let Some(found) = rated.best([(Some(there), by)], cx)? {
            return Ok(Some(found.blamed(Likely::Splats)));
        }
    }
    Ok(None)
}

/// The camera, moved by a similarity without a reflection.
fn moved_camera(camera: &Camera, by: &Similarity) -> Camera {
    let turned = by.rotation * DMat3::from_mat4(camera.world_from_camera());
    let world_from_camera = DMat4::from_mat3_translation(turned, by.point(camera.eye()));
    Camera { world_from_camera: world_from_camera.to_cols_array(), ..camera.clone() }
}

/// Share of the pixels of the wanted views that show splats, and share that show the mesh.
fn visible(sights: &[Sight], depths: &[Vec<f64>]) -> Option<[f64; 2]> {
    let wanted = || sights.iter().zip(depths).filter(|(sight, _)| sight.wanted);
    let all: usize = wanted().map(|(sight, _)| sight.depth.len()).sum();
    let splats: usize = wanted().map(|(sight, _)| sight.empty.iter().filter(|empty| !**empty).count()).sum();
    let mesh: usize = wanted().map(|(_, mesh)| mesh.iter().filter(|depth| depth.is_finite()).count()).sum();
    (all > 0).then(|| [splats, mesh].map(|count| count as f64 / all as f64))
}

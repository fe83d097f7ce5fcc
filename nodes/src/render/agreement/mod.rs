//! Comparison of the splats and the mesh of a place by their depths, in the wanted views and around the object.
//!
//! Small pictures of the splats give points of their surface (the depth of peaks, `RayMedian`). The mesh is rasterized in
//! the same views. Where it does not agree, a search for a turn, a factor and a shift finds out whether one transform
//! explains the difference. Where it does, what remains are parts that only one of both has.

mod cloud;
mod fit;
mod raster;
mod regions;
mod search;
mod sight;
mod spots;


use engine::{Context, NodeError};
use glam::{DMat4, DVec3};

use crate::geometry::level::{self, LevelEstimate};
use crate::math::num;
use crate::types::frame::Similarity;
use crate::types::{Camera, Mesh, Splats};
use cloud::Cloud;
pub use regions::Regions;
use sight::Sight;
use spots::Spots;

/// Number of wanted views and of points that are compared at most.
const WANTED: usize = 3;
const AROUND: usize = 2;
/// Agreement from which a mesh is where the splats are, so that other places are not searched.
const AGREES: f64 = 0.8;
/// Minimum agreement of another place of the mesh for it to be reported, and minimum gain.
const FOUND: f64 = 0.4;
const GAIN: f64 = 0.12;
/// Agreement below which both disagree, though no transform is found.
const DISAGREES: f64 = 0.12;
/// Shift, relative to the median distance, relative change of size, and turn in degrees from which a transform is
/// reported.
const SHIFTED: f64 = 0.045;
const SCALED: f64 = 0.045;
const TURNED_DEG: f64 = 3.0;
/// Share of the wanted views that shows less than this shows nothing.
const UNSEEN: f64 = 0.02;
/// Minimum cosine between up of the scene and of what stands upright.
const UPRIGHT: f64 = 0.94;
/// Minimum share of pixels of debris and of missing surfaces that is reported.
const DEBRIS: f64 = 0.006;
const MISSING: f64 = 0.03;
/// Distance from the splats at which a mesh does not agree, as a share of the distance.
const TOLERANCE: f64 = 0.05;

/// What is compared.
#[derive(Debug, Clone, Copy)]
pub struct Place<'a> {
    /// The splats, in the world.
    pub splats: &'a Splats,
    /// The mesh, in the world.
    pub mesh: &'a Mesh,
    /// Cameras of the wanted views; the first, the middle and the last one are compared.
    pub cameras: &'a [Camera],
    /// Points in free space near the inserted objects, such as their middles; the first two are used.
    pub around: &'a [DVec3],
    /// Unit vectors to the right, forward and up.
    pub axes: [DVec3; 3],
    /// World units per metre.
    pub metre: f64,
}

/// What is likely in a wrong frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Likely {
    /// The mesh: the usual case, since splats and cameras come from one program.
    Mesh,
    /// The splats: the wanted views show the mesh only, or it stands upright and they do not.
    Splats,
}

/// A place of the mesh at which it agrees with the splats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// Transform of the mesh.
    pub by: Similarity,
    /// Agreement there, 0 to 1.
    pub agreement: f64,
    /// Angle of the rotation in degrees.
    pub turn_deg: f64,
    /// Distance by which the middle of the place moves, in world units; meaningful without a turn and a factor.
    pub shift: f64,
    /// What is likely in a wrong frame.
    pub likely: Likely,
}

/// Result of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Number of points of the splats that were compared.
    pub points: usize,
    /// Mean agreement of the depths, 0 to 1; the directions in which surfaces face weigh about the same.
    pub agreement: f64,
    /// The place of the mesh at which it agrees best, if that is elsewhere.
    pub best: Option<Moved>,
    /// Parts of the mesh that float in front of what the splats show.
    pub debris: Regions,
    /// Surfaces of the splats that the mesh lacks, within its extents.
    pub missing: Regions,
    /// Shares of the wanted views in which the splats and the mesh are visible; `None` without wanted views.
    pub visible: Option<[f64; 2]>,
}

/// A finding of a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Finding {
    /// Splats and mesh are in different frames.
    Elsewhere,
    /// The wanted cameras see neither the splats nor the mesh.
    Cameras,
    /// Parts of the mesh float in front of what the splats show.
    Debris,
    /// The mesh lacks surfaces of the splats.
    Missing,
}

impl Comparison {
    /// The findings that are worth a warning.
    pub fn findings(&self) -> Vec<Finding> {
        if self.visible.is_some_and(|shares| shares.into_iter().all(|share| share < UNSEEN)) {
            return vec![Finding::Cameras];
        }
        if self.best.is_some() || self.agreement < DISAGREES {
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

/// Three of the cameras: the first, the middle and the last.
fn chosen(cameras: &[Camera]) -> Vec<Camera> {
    let count = cameras.len();
    if count <= WANTED {
        return cameras.to_vec();
    }
    [0, count / 2, count - 1].map(|i| cameras[i].clone()).to_vec()
}

/// Compares splats and mesh. `None` if the splats show too few surfaces, or the mesh has no area.
pub fn compare(place: &Place<'_>, cx: &Context) -> Result<Option<Comparison>, NodeError> {
    let around = &place.around[..place.around.len().min(AROUND)];
    let frame = (place.axes, place.metre);
    let sights = Sight::all(place.splats, &chosen(place.cameras), around, frame, cx)?;
    let (Some(spots), Some(cloud)) = (Spots::of(&sights), Cloud::of(place.mesh)) else { return Ok(None) };
    cx.check()?;
    let depths = spots.depths(&sights, place.mesh, &DMat4::IDENTITY);
    let agreement = spots.agreement(&sights, &depths);
    let measured = |by: Similarity| {
        let moved = spots.depths(&sights, place.mesh, &matrix(&by));
        moved_by(by, spots.agreement(&sights, &moved), &spots)
    };
    let mut best: Option<Moved> = None;
    if agreement < AGREES {
        best = Some(measured(search::nearby(&cloud, &spots)));
    }
    if best.is_some_and(|found| found.agreement < AGREES) {
        cx.check()?;
        for found in search::anywhere(&cloud, &spots).into_iter().map(measured) {
            best = best.filter(|known| known.agreement >= found.agreement).or(Some(found));
        }
    }
    let visible = (!place.cameras.is_empty()).then(|| {
        let wanted = || sights.iter().zip(&depths).filter(|(sight, _)| sight.wanted);
        let all: usize = wanted().map(|(sight, _)| sight.depth.len()).sum();
        let splats: usize = wanted().map(|(sight, _)| sight.empty.iter().filter(|empty| !**empty).count()).sum();
        let mesh: usize = wanted().map(|(_, mesh)| mesh.iter().filter(|depth| depth.is_finite()).count()).sum();
        [splats, mesh].map(|count| count as f64 / all.max(1) as f64)
    });
    let best = best.filter(|found| {
        let far = found.shift >= SHIFTED * spots.distance
            || (found.by.scale - 1.0).abs() >= SCALED
            || found.turn_deg >= TURNED_DEG;
        far && found.agreement >= FOUND && found.agreement >= agreement + GAIN
    });
    let best = best.map(|found| Moved { likely: likely(place, found.turn_deg, visible), ..found });
    Ok(Some(Comparison {
        points: spots.list.len(),
        agreement,
        best,
        debris: regions::debris(&sights, &depths, &spots, TOLERANCE),
        missing: regions::missing(&sights, &depths, &spots, cloud.extents(), TOLERANCE),
        visible,
    }))
}

/// A transform with its measures.
fn moved_by(by: Similarity, agreement: f64, spots: &Spots) -> Moved {
    let turn = by.rotation;
    let cosine = 0.5 * (turn.x_axis.x + turn.y_axis.y + turn.z_axis.z - 1.0);
    let turn_deg = num::f64::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
    let shift = (by.point(spots.middle) - spots.middle).length();
    Moved { by, agreement, turn_deg, shift, likely: Likely::Mesh }
}

/// What is likely in a wrong frame, given the shares of the wanted views that show splats and mesh.
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
    if mesh == Some(true) && splats == Some(false) { Likely::Splats } else { Likely::Mesh }
}

fn matrix(by: &Similarity) -> DMat4 {
    DMat4::from_cols_array(&by.rows()).transpose()
}

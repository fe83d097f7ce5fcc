//! Comparison of a transformed mesh with the splats by the depths in the views, and its unexplained rest.

use engine::{Context, NodeError};
use scene::types::frame::Similarity;

use super::cloud::Cloud;
use super::place::{CapturedPlace, DEBRIS, MISSING, TOLERANCE, matrix};
use super::regions::{self, Regions};
use super::sight::Sight;
use super::spots::{Agreement, Spots};

/// Comparison of the transformed mesh with the splats.
pub(super) struct Explained {
    /// Depths of the transformed mesh, for each pixel of each view.
    pub depths: Vec<Vec<f64>>,
    /// Agreement with the points of the splats.
    pub agreement: Agreement,
    /// Parts of the mesh that float in front of the surfaces that the splats show.
    pub debris: Regions,
    /// Surfaces of the splats that the mesh lacks.
    pub missing: Regions,
    /// Agreement at the points that are neither behind debris nor on missing surfaces.
    pub rest: f64,
}

impl Explained {
    /// Compares the mesh, transformed by `by`, with the points. `known` holds the depths of the mesh at its own
    /// position, to which [`Agreement::known`] refers; `None` if `by` is the identity.
    pub fn of(
        place: &CapturedPlace<'_>,
        (sights, spots, cloud): (&[Sight], &Spots, &Cloud),
        by: &Similarity,
        known: Option<&[Vec<f64>]>,
        cx: &Context,
    ) -> Result<Self, NodeError> {
        cx.check()?;
        let depths = spots.depths(sights, place.mesh, &matrix(by));
        let agreement = spots.agreement(sights, &depths, known.unwrap_or(&depths));
        let (debris, floating) = regions::debris(sights, &depths, spots, TOLERANCE);
        let extents = cloud.extents_after(by);
        let (missing, lacking) = regions::missing(sights, &depths, spots, extents, TOLERANCE);
        let rest = spots.agreement(sights, &depths, &without(&depths, [&floating, &lacking])).known;
        Ok(Self { depths, agreement, debris, missing, rest })
    }

    /// True if enough of the mesh floats or is missing to be reported.
    pub fn has_findings(&self) -> bool {
        self.debris.share >= DEBRIS || self.missing.share >= MISSING
    }

    /// Share of the pixels that debris and missing surfaces cover.
    pub fn left(&self) -> f64 {
        self.debris.share + self.missing.share
    }
}

/// The depths without the marked pixels.
fn without(depths: &[Vec<f64>], marked: [&[Vec<bool>]; 2]) -> Vec<Vec<f64>> {
    let is_marked = |view: usize, pixel: usize| marked.iter().any(|all| all[view][pixel]);
    let rest = |(view, depths): (usize, &Vec<f64>)| {
        let all = depths.iter().enumerate();
        all.map(|(pixel, depth)| if is_marked(view, pixel) { f64::INFINITY } else { *depth }).collect()
    };
    depths.iter().enumerate().map(rest).collect()
}

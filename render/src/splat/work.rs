//! Work counts of one view.

use std::ops::AddAssign;

use engine::{Context, Notes};

use super::settings::{Precision, Settings};
use super::sh;

/// Work counts of one view, which are the same on every machine.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Number of splats that were tested individually.
    pub visited: u64,
    /// Number of splats in blocks that were skipped because no splat of the block can be in the picture.
    pub skipped: u64,
    /// Number of splats that were projected, coloured and sorted.
    pub projected: u64,
    /// Number of projected splats whose harmonics were evaluated in a direction; 0 for a scene of degree 0.
    pub directed: u64,
    /// Number of splats with an opacity of 0 or below `alpha_cut`; counted only if almost nothing is visible.
    pub faint: u64,
    /// Number of splats that are at or below the near plane and not counted in `faint`; counted only if almost
    /// nothing is visible.
    pub behind: u64,
    /// Number of splats whose footprint is not a finite ellipse.
    pub degenerate: u64,
    /// Number of splats with a colour that was clamped to the maximum or overflowed.
    pub held: u64,
    /// Number of pairs of a splat and a tile that lists it.
    pub tile_pairs: u64,
    /// Number of times that a splat was evaluated at a pixel.
    pub evaluations: u64,
    /// Number of times that a splat was blended into a pixel.
    pub blends: u64,
}

impl AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.visited += other.visited;
        self.skipped += other.skipped;
        self.projected += other.projected;
        self.directed += other.directed;
        self.faint += other.faint;
        self.behind += other.behind;
        self.degenerate += other.degenerate;
        self.held += other.held;
        self.tile_pairs += other.tile_pairs;
        self.evaluations += other.evaluations;
        self.blends += other.blends;
    }
}

impl Work {
    /// Reports the counts to `cx`, and adds notes about splats that were left out. `splats` is the number of splats
    /// of the scene.
    pub fn report(&self, splats: usize, settings: &Settings, cx: &Context, notes: &mut Notes) {
        let near = settings.near;
        cx.count("splats_visited", self.visited);
        cx.count("splats_skipped", self.skipped);
        cx.count("splats_projected", self.projected);
        cx.count("splats_directed", self.directed);
        cx.count("splat_tile_pairs", self.tile_pairs);
        cx.count("splat_evaluations", self.evaluations);
        if settings.precision == Precision::F64 {
            cx.count("splat_evaluations_f64", self.evaluations);
        }
        cx.count("splat_blends", self.blends);
        notes.count(
            "degenerate-splats",
            self.degenerate,
            "of the footprints had to be left out because of a shape that is not a finite ellipse",
        );
        let text = format!(
            "of the colours exceeded the maximum of {:e} (white is 1) or overflowed, and had to be clamped to that maximum",
            sh::LARGEST
        );
        notes.count("colours-held", self.held, text);
        // A scene and an eye in different frames give an empty picture, not an error.
        if self.projected * 100 < splats as u64 {
            let most = |count: u64| count * 2 >= self.visited + self.skipped;
            let why = if splats > 0 && most(self.faint) {
                format!(
                    "most splats have an opacity that is 0 or below `alpha_cut` ({:.6})",
                    settings.alpha_cut
                )
            } else if most(self.behind) {
                format!(
                    "most splats are behind the camera or nearer than `near` ({near} world units); check that `near` is not too large for this scene, and that the camera looks towards it"
                )
            } else if self.degenerate > self.projected {
                format!(
                    "footprints that are not finite ellipses were left out (number: {}); check the scales of the splats",
                    self.degenerate
                )
            } else {
                "check that the camera and the splats use the same frame and scale".to_owned()
            };
            let text = format!("only {} of {splats} splats can be seen; {why}", self.projected);
            notes.warning("few-splats-seen", text);
        }
    }
}

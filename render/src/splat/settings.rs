//! Settings of splat rendering, common to all kinds that draw splats.

use engine::{Context, Former, NodeError, Notes};
use scene::types::Splats;

engine::choices! {
    /// Pixels at which a splat is evaluated.
    pub enum Bounds {
        /// Pixels inside the exact ellipse where the alpha of the splat reaches `alpha_cut`.
        Exact,
        /// All pixels of the tiles that a square of 3 standard deviations around the splat touches, as in the INRIA
        /// rasterizer.
        Inria,
        /// All pixels.
        None,
    }
}
engine::choices! {
    /// Arithmetic of blending; the projection is always in f64.
    pub enum Precision {
        /// Single precision, 8 pixels at once.
        F32,
        /// Double precision: the slow reference.
        F64,
    }
}
engine::choices! {
    /// Sort key of the splats of a pixel.
    pub enum Sort {
        /// Planar depth of the centre, as in nearly every trainer.
        Depth,
        /// Distance of the centre, which does not change as the camera rotates.
        Distance,
    }
}
engine::choices! {
    /// Compensation of opacity for the area that the low-pass filter adds to a splat.
    pub enum Compensation {
        /// Compensates if the file says that the splats were trained with compensation.
        File,
        /// Always compensates.
        On,
        /// Never compensates.
        Off,
    }
}
engine::choices! {
    /// Depth of a pixel.
    pub enum DepthMode {
        /// Mean depth of the blended splats, weighted by their contributions.
        Expected,
        /// Depth of the splat at which transmittance falls to one half or below; +inf if it stays above one half.
        Median,
        /// Same as `Expected`, but each weight is multiplied again by the transmittance in front of the splat.
        /// Splats that are seen through other splats count less, so the depth is closer to the first surface.
        Transmittance,
        /// Same as `Median`, but uses the depth at which the splat is densest along the ray of the pixel, at most
        /// two standard deviations in depth from its centre. This estimates the surface that the splats represent.
        /// For flat splats these depths are too small by 0.02 %, while depths of centres are too small by 0.8 %.
        RayMedian,
    }
}

engine::params! {
    /// Settings of splat rendering, for any type of picture.
    pub struct Drawing {
        /// Pixels at which a splat is evaluated.
        bounds: Bounds = Bounds::Exact, other("Inria");
        /// Arithmetic of blending; the projection is always in f64.
        precision: Precision = Precision::F32, other("F64"), knob(Precision, "F32", "F32", "F32", "F64");
        /// Highest degree of spherical harmonics that is used.
        sh_degree: u32 = 4, range(0, 4), other("0"), knob(Depth, "", "", "", "4");
        /// Near plane: splats at or below this planar depth (in a panorama, this distance) are left out. Trainers
        /// use 0.2 or less; within this distance a capture has haze around the eye. The value is in metres and is
        /// converted to world units by `metres_per_unit` of the scene. If the near plane cuts away a large share of
        /// the scene, a warning reports it.
        near: f64 = 0.2, range(1e-12, 1e12), unit("m"), other("1.5");
        /// Variance of the low-pass filter added to every footprint, in square pixels (in a panorama, square
        /// samples).
        low_pass_px2: f64 = 0.3, range(0.0, 100.0), unit("px^2"), other("1.0");
        /// Compensation of opacity for the area that the low-pass filter adds to a splat (as in
        /// Mip-Splatting).
        compensation: Compensation = Compensation::File, other("On");
        /// Smallest alpha that is blended; 0 blends every splat at every pixel.
        alpha_cut: f64 = 1.0 / 255.0, range(0.0, 0.5), other("0.1"),
            knob(Cutoff, "0.002", "0.0005", "0.0001", "0.00001");
        /// Largest alpha of one splat.
        alpha_cap: f64 = 0.99, range(0.01, 1.0), other("0.5");
        /// Transmittance below which a pixel is finished; 0 never stops early.
        stop: f64 = 1e-4, range(0.0, 0.5), other("0.3"), knob(Cutoff, "0.001", "0.0001", "0.0001", "0.0");
        /// Depth of a pixel.
        depth: DepthMode = DepthMode::Expected, other("RayMedian");
        /// True to count the splats blended into each pixel, for the output `blends`.
        count_blends: bool = false, other("true");
    }
}

/// Replacement for the parameter `name`, which versions of the splat kinds up to `last` had. `None` if they had no
/// such parameter.
pub fn former(name: &str, last: u32) -> Option<Former> {
    let fields: &[&str] = &["skip_unseen", "skip_harmonics"];
    fields.contains(&name).then(|| Former::exhaustive(fields, last))
}

impl Drawing {
    /// Settings for a scene. Shortcuts that skip work are turned off if the run is `exhaustive`. Adds a warning if
    /// the file of the scene says that the splats were trained with different settings.
    pub fn settings(&self, sort: Sort, splats: &Splats, cx: &Context, notes: &mut Notes) -> Settings {
        let exhaustive = cx.exhaustive();
        let compensate = match self.compensation {
            Compensation::File => splats.antialiased,
            Compensation::On => true,
            Compensation::Off => false,
        };
        if compensate != splats.antialiased {
            let text = if compensate {
                "`compensation` is on, but the file does not say that the splats were trained with compensation; thin details may vanish"
            } else {
                "`compensation` is off, but the file says that the splats were trained with compensation"
            };
            notes.warning("compensation-mismatch", text);
        }
        Settings {
            bounds: self.bounds,
            precision: self.precision,
            sort,
            sh_degree: self.sh_degree,
            near: self.near / cx.metres_per_unit(),
            low_pass_px2: self.low_pass_px2,
            compensate,
            alpha_cut: self.alpha_cut,
            alpha_cap: self.alpha_cap,
            stop: self.stop,
            depth: self.depth,
            count_blends: self.count_blends,
            skip_unseen: !exhaustive,
            skip_harmonics: !exhaustive,
            list_bytes: LIST_BYTES,
        }
    }

    /// Checks that the numbers are consistent.
    ///
    /// # Errors
    /// If `alpha_cap` is below `alpha_cut`, since then no splat could be visible.
    pub fn check(&self) -> Result<(), NodeError> {
        if self.alpha_cap >= self.alpha_cut {
            return Ok(());
        }
        let what = format!("`alpha_cap` ({}) is less than `alpha_cut` ({})", self.alpha_cap, self.alpha_cut);
        Err(NodeError::new(what).at("alpha_cap").hint("with these values, no splat could be visible"))
    }
}

/// Settings of the renderer: the settings of [`Drawing`], resolved for a scene and a run, and the sort key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Pixels at which a splat is evaluated.
    pub bounds: Bounds,
    /// Arithmetic of blending.
    pub precision: Precision,
    /// Sort key of the splats.
    pub sort: Sort,
    /// Highest degree of spherical harmonics that is used.
    pub sh_degree: u32,
    /// Planar depth at or below which splats are left out, in world units.
    pub near: f64,
    /// Variance added to both axes of the footprint, in square pixels.
    pub low_pass_px2: f64,
    /// True if the opacity of a splat is multiplied by the area of its footprint without the low-pass filter,
    /// divided by the area with it.
    pub compensate: bool,
    /// Smallest alpha that is blended.
    pub alpha_cut: f64,
    /// Largest alpha of one splat.
    pub alpha_cap: f64,
    /// Transmittance below which a pixel is finished. A splat that would reduce the transmittance below this value
    /// is not blended.
    pub stop: f64,
    /// Depth of a pixel.
    pub depth: DepthMode,
    /// True to count the blends of each pixel.
    pub count_blends: bool,
    /// True to leave out blocks of splats that cannot be in the picture.
    pub skip_unseen: bool,
    /// True to skip harmonics above the available degree.
    pub skip_harmonics: bool,
    /// Maximum memory of the lists of tiles, in bytes. A group whose lists contain each splat only once may
    /// exceed it. This limit does not change a bit of the result.
    pub list_bytes: u64,
}

/// Side of a tile, in pixels. It is the same as in the INRIA rasterizer, whose bounds depend on it.
pub const TILE: usize = 16;

/// Maximum memory of the lists of tiles, in bytes. This is enough for all lists of an ordinary view, but not for
/// the lists of a view in which many large splats overlap.
pub(crate) const LIST_BYTES: u64 = 1 << 26;

impl Settings {
    /// True if each splat is evaluated only within its bounds, false if at every pixel.
    pub(super) fn is_bounded(&self) -> bool {
        self.bounds != Bounds::None && self.alpha_cut > 0.0
    }
}

impl Default for Settings {
    /// Returns the constants of the INRIA rasterizer (diff-gaussian-rasterization 59f5f77) with exact bounds.
    fn default() -> Self {
        Self {
            bounds: Bounds::Exact,
            precision: Precision::F32,
            sort: Sort::Depth,
            sh_degree: 4,
            near: 0.2,
            low_pass_px2: 0.3,
            compensate: false,
            alpha_cut: 1.0 / 255.0,
            alpha_cap: 0.99,
            stop: 1e-4,
            depth: DepthMode::Expected,
            count_blends: false,
            skip_unseen: true,
            skip_harmonics: true,
            list_bytes: LIST_BYTES,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_says_how_it_was_trained_and_another_choice_is_reported() {
        for antialiased in [false, true] {
            let splats = Splats { antialiased, ..Splats::empty() };
            for (compensation, on, reported) in [
                (Compensation::File, antialiased, false),
                (Compensation::On, true, !antialiased),
                (Compensation::Off, false, antialiased),
            ] {
                let mut notes = Notes::none();
                let drawing = Drawing { compensation, ..Drawing::default() };
                let settings = drawing.settings(Sort::Depth, &splats, &testing::context(), &mut notes);
                assert_eq!(settings, Settings { compensate: on, ..Settings::default() });
                assert_eq!(notes.iter().any(|note| note.id == "compensation-mismatch"), reported);
            }
        }
    }
}

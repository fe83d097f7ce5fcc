//! `splat-panorama`: everything that a splat scene shows around a point, without cameras in between.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes};

use crate::equirect;
use crate::splat::{self, Bounds, Compensation, DepthMode, Precision, Settings, Sort};
use crate::stitch::{self, Found, Holes};
use crate::types::{Data, Image, Images, Panorama, Pose, SplatEncoding, Splats};

engine::params! {
    /// Renders a splat scene straight into an equirectangular panorama.
    ///
    /// One projection and one sort, by distance, for the whole sphere: no faces, so no seams between them,
    /// and the two ends of a row meet exactly. Instead of `cube-rig`, `splat-render` and `stitch`. Splats
    /// close to the zenith and the nadir, where the layout is stretched, are less exact than elsewhere.
    pub struct SplatPanorama {
        /// Height of the point above the foot of the pose, along up.
        height_metres: f64 = 0.5, range(-1000.0, 1000.0), unit("m"), other("0.75");
        /// Width of the panorama, even; the height is half of it.
        width_px: u32 = 2048, range(2, 16384), unit("px"), other("64");
        /// Which pixels a splat is evaluated at.
        bounds: Bounds = Bounds::Exact, other("Inria");
        /// Arithmetic of the blend; the projection is always in f64.
        precision: Precision = Precision::F32, other("F64");
        /// Highest degree of the spherical harmonics that is used.
        sh_degree: u32 = 4, range(0, 4), other("0");
        /// Splats at or within this distance are left out. In world units, so that it scales with the scene.
        near: f64 = 0.2, range(1e-12, 1e12), unit("world units"), other("1.5");
        /// Variance of the low-pass filter added to every footprint.
        low_pass_px2: f64 = 0.3, range(0.0, 100.0), unit("px^2"), other("1.0");
        /// Whether opacity makes up for what the low-pass filter adds to a splat's area (mip splatting).
        compensation: Compensation = Compensation::File, other("On");
        /// Smallest alpha that is blended; 0 blends all, everywhere.
        alpha_cut: f64 = 1.0 / 255.0, range(0.0, 0.5), other("0.1");
        /// Largest alpha of one splat.
        alpha_cap: f64 = 0.99, range(0.01, 1.0), other("0.5");
        /// A pixel is finished when its transmittance would fall below; 0 never stops early.
        stop: f64 = 1e-4, range(0.0, 0.5), other("0.3");
        /// What the depth of a pixel is.
        depth: DepthMode = DepthMode::Expected, other("Median");
        /// What shows where nothing was seen. Alpha tells where that is, whatever fills it.
        holes: Holes = Holes::PushPull, other("Black");
        /// Below this alpha a pixel counts as a hole in part: it is mixed with what surrounds it.
        hole_alpha: f64 = 0.25, range(1e-6, 1.0), other("0.9");
        /// Whether to count the splats added to each pixel, for `blends`.
        count_blends: bool = false, other("true");
    }
}
engine::inputs! {
    /// Inputs of [`SplatPanorama`].
    pub struct In {
        /// The scene.
        splats: Arc<Splats>,
        /// Where the object stands; only its translation enters.
        at: Arc<Pose>,
    }
}
engine::outputs! {
    /// Outputs of [`SplatPanorama`].
    pub struct Out {
        /// The panorama.
        pano: Arc<Panorama>,
        /// Its colours, for `write-image`.
        image: Arc<Images>,
        /// How much of each pixel was seen, 0 to 1.
        alpha: Arc<Images>,
        /// Distance from the point in world units, +inf where nothing is seen.
        depth: Arc<Images>,
        /// Splats added to each pixel; no picture unless `count_blends`.
        blends: Arc<Images>,
    }
}

impl SplatPanorama {
    fn settings(&self, splats: &Splats) -> Settings {
        Settings {
            bounds: self.bounds,
            precision: self.precision,
            sort: Sort::Distance,
            sh_degree: self.sh_degree,
            near: self.near,
            low_pass_px2: self.low_pass_px2,
            compensate: self.compensation.applies(splats),
            alpha_cut: self.alpha_cut,
            alpha_cap: self.alpha_cap,
            stop: self.stop,
            depth: self.depth,
            count_blends: self.count_blends,
        }
    }
}

impl Kind for SplatPanorama {
    const NAME: &'static str = "splat-panorama";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Up, ContextField::MetresPerUnit];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let pixels = u64::from(params.width_px) * u64::from(params.width_px) / 2;
        let splats = inputs.splats.len() as u64;
        // Every splat is seen: a footprint, its key, its place in the order and in the tiles.
        Cost { bytes: pixels * 120 + splats * 240, work: (splats * 30 + pixels * 150) as f64 }
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        stitch::check_width(params.width_px)
    }

    fn run(params: &Self, In { splats, at }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(params)?;
        let mut notes = Notes::none();
        params.compensation.warn(&splats, &mut notes);
        let up = cx.up();
        let origin = at.translation() + equirect::axes(up)[2] * (params.height_metres / cx.metres_per_unit());
        if !origin.is_finite() {
            return Err(NodeError::new("the point of the panorama is not finite").at("at"));
        }
        let settings = params.settings(&splats);
        let seen = splat::panorama(&splats, origin, up, params.width_px, &settings, cx)?;
        cx.progress(0.8);
        seen.work.report(cx, &mut notes);
        let (width, height) = (params.width_px as usize, params.width_px as usize / 2);
        let encoded = splats.encoding == SplatEncoding::Srgb;
        let rgba = seen.rgba.as_chunks::<4>().0;
        let rows =
            cx.for_each_tile(height, |y| stitch::linear_row(&rgba[y * width..(y + 1) * width], encoded))?;
        let found = Found { premultiplied: rows.concat(), width, encoded, up, origin };
        let pano = stitch::finish(found, params.holes, params.hole_alpha, &mut notes, cx)?;
        let data = |samples| Images::single("pano", Image::<Data>::from_samples(width, height, 1, samples));
        let out = Out {
            image: Arc::new(Images::single("pano", pano.image.clone())),
            alpha: Arc::new(Images::single("pano", pano.alpha.clone())),
            depth: Arc::new(data(seen.depth)),
            blends: Arc::new(if params.count_blends { data(seen.blends) } else { Images::default() }),
            pano: Arc::new(pano),
        };
        Ok((out, notes))
    }
}

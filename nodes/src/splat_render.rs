//! `splat-render`: what the cameras of a rig see of a splat scene.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes};

use crate::splat::{
    Bounds, Compensation, DepthMode, MAX_PIXELS, Precision, Settings, Sort, Work, render, render_before,
};
use crate::types::{Data, Image, Images, NamedImage, Picture, Rig, Splats, View, Views, tagged};

engine::params! {
    /// Renders a splat scene for each camera of a rig.
    ///
    /// EWA splatting as the INRIA rasterizer defines it, with exact bounds, one stable sort (equal keys
    /// stay in file order) and the same bytes on every machine. Colours are blended in the encoding they
    /// were trained in, over black, and are not clipped: un-premultiply, then linearise, where light is
    /// meant. The reference for error tables is `bounds: None, precision: F64, alpha_cut: 0, stop: 0`.
    pub struct SplatRender {
        /// Which pixels a splat is evaluated at.
        bounds: Bounds = Bounds::Exact, other("Inria");
        /// Arithmetic of the blend; the projection is always in f64.
        precision: Precision = Precision::F32, other("F64");
        /// What orders the splats of a pixel.
        sort: Sort = Sort::Depth, other("Distance");
        /// Highest degree of the spherical harmonics that is used.
        sh_degree: u32 = 4, range(0, 4), other("0");
        /// Splats at or below this planar depth are left out. In world units, so that it scales with the scene.
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
        /// Whether to count the splats added to each pixel, for `blends`.
        count_blends: bool = false, other("true");
    }
}
engine::inputs! {
    /// Inputs of [`SplatRender`].
    pub struct In {
        /// The scene.
        splats: Arc<Splats>,
        /// The cameras.
        rig: Arc<Rig>,
        /// Planar depth of a surface in front for each view, as `path-trace.depth` gives it: splats at or
        /// beyond it are left out. 0 and +inf are no surface.
        limit: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`SplatRender`].
    pub struct Out {
        /// Colour and depth with their cameras, for `stitch`.
        views: Arc<Views>,
        /// RGB premultiplied by alpha, over black, and alpha.
        colour: Arc<Images>,
        /// Coverage, 0 to 1.
        alpha: Arc<Images>,
        /// Planar depth in world units, +inf where nothing is seen.
        depth: Arc<Images>,
        /// Splats added to each pixel; no picture unless `count_blends`.
        blends: Arc<Images>,
    }
}

impl SplatRender {
    /// Every parameter at its default.
    #[cfg(test)]
    pub(crate) fn tests_default() -> Self {
        let of = Settings::default();
        Self {
            bounds: of.bounds,
            precision: of.precision,
            sort: of.sort,
            sh_degree: of.sh_degree,
            near: of.near,
            low_pass_px2: of.low_pass_px2,
            compensation: Compensation::File,
            alpha_cut: of.alpha_cut,
            alpha_cap: of.alpha_cap,
            stop: of.stop,
            depth: of.depth,
            count_blends: of.count_blends,
        }
    }

    fn settings(&self, splats: &Splats) -> Settings {
        Settings {
            bounds: self.bounds,
            precision: self.precision,
            sort: self.sort,
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

impl Kind for SplatRender {
    const NAME: &'static str = "splat-render";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(_params: &Self, inputs: &In) -> Cost {
        let pixels =
            |c: &crate::types::Camera| (u64::from(c.width_px) * u64::from(c.height_px)).min(MAX_PIXELS);
        let all: u64 = inputs.rig.cameras.iter().map(pixels).sum();
        let largest = inputs.rig.cameras.iter().map(pixels).max().unwrap_or(0);
        let splats = inputs.splats.len() as u64;
        // Per pixel: colour, alpha and depth of the outputs; tiles of the view at hand. Per splat: a
        // footprint, its key, its place in the order and in the tiles.
        Cost {
            bytes: all * 44 + largest * 24 + splats * 160,
            work: (splats * inputs.rig.cameras.len() as u64 * 10 + all * 50) as f64,
        }
    }

    fn run(params: &Self, In { splats, rig, limit }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let mut notes = Notes::none();
        params.compensation.warn(&splats, &mut notes);
        if rig.cameras.is_empty() {
            return Err(NodeError::new("the rig has no camera").at("rig"));
        }
        let settings = params.settings(&splats);
        let mut views = Vec::with_capacity(rig.cameras.len());
        let (mut alphas, mut depths, mut colours) = (Vec::new(), Vec::new(), Vec::new());
        let mut blends = Vec::new();
        let mut total = Work::default();
        for (index, camera) in rig.cameras.iter().enumerate() {
            cx.progress(index as f32 / rig.cameras.len() as f32);
            let seen = match &limit {
                None => render(&splats, camera, &settings, cx)?,
                Some(limits) => match limits.view(&camera.name) {
                    Some(Picture::Data(limit)) => render_before(&splats, camera, limit, &settings, cx)?,
                    Some(_) => return Err(NodeError::new("a depth is no colour").at("limit")),
                    None => {
                        let what = format!("no depth of view `{}`", camera.name);
                        return Err(NodeError::new(what).at("limit"));
                    }
                },
            };
            total.projected += seen.work.projected;
            total.degenerate += seen.work.degenerate;
            total.tile_pairs += seen.work.tile_pairs;
            total.evaluations += seen.work.evaluations;
            total.blends += seen.work.blends;
            let (width, height) = (camera.width_px as usize, camera.height_px as usize);
            let alpha = seen.rgba.as_chunks::<4>().0.iter().map(|p| p[3]).collect();
            let colour = tagged(splats.encoding, width, height, 4, seen.rgba);
            let depth = Image::<Data>::from_samples(width, height, 1, seen.depth);
            let named = |picture| NamedImage { name: camera.name.clone(), picture };
            alphas.push(named(Image::<Data>::from_samples(width, height, 1, alpha).into()));
            depths.push(named(depth.clone().into()));
            colours.push(named(colour.clone()));
            if settings.count_blends {
                blends.push(named(Image::<Data>::from_samples(width, height, 1, seen.blends).into()));
            }
            views.push(View { camera: camera.clone(), colour, depth });
        }
        total.report(cx, &mut notes);
        // A scene and a camera in different frames give an empty picture, not an error.
        if total.projected * 100 < splats.len() as u64 {
            notes.warning(
                "few-splats-seen",
                format!(
                    "the cameras see {} of {} splats; do the rig and the splats share a frame and a scale?",
                    total.projected,
                    splats.len()
                ),
            );
        }
        let out = Out {
            views: Arc::new(Views(views)),
            colour: Arc::new(Images(colours)),
            alpha: Arc::new(Images(alphas)),
            depth: Arc::new(Images(depths)),
            blends: Arc::new(Images(blends)),
        };
        Ok((out, notes))
    }
}

//! `splat-render`: renders a splat scene with the cameras of a rig.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Former, Kind, NodeError, Notes, Sizes, ViewCount};
use render::splat::near;
use render::splat::{
    self, Blocks, DepthMode, Drawing, Limit, MAX_PIXELS, Sort, Work, most_bytes, render_with,
};
use scene::types::{Camera, Data, Image, Images, NamedImage, Picture, Rig, Splats, View, Views, tagged};

engine::params! {
    /// Renders a splat scene for each camera of a rig.
    ///
    /// The method is EWA splatting as defined by the INRIA rasterizer, with exact bounds, a stable sort (splats
    /// with equal keys stay in file order) and the same bytes on every machine. Colours are blended over black in
    /// the encoding in which they were trained, and are not clipped. To obtain light, un-premultiply the colours
    /// and then linearise them. For the exact sum of all splats, set `bounds: None, precision: F64, alpha_cut: 0,
    /// stop: 0`.
    pub struct SplatRender {
        /// Key by which the splats of a pixel are sorted.
        sort: Sort = Sort::Depth, other("Distance");
        /// Minimum distance in front of `limit` at which a splat must lie to be kept, in standard deviations of the
        /// splat along its middle axis. It applies to the depth at which the splat is densest along the ray of the
        /// pixel, and its centre must also lie in front of `limit`. The distance allows for splats that scatter
        /// around the surface that they represent, and for a mesh slightly below them. At 0, a splat is kept if
        /// its centre lies in front of `limit`.
        limit_sigmas: f64 = 3.0, range(0.0, 100.0), other("0.0");
    }
}
engine::inputs! {
    /// Inputs of [`SplatRender`].
    pub struct In {
        /// The scene.
        splats: Arc<Splats>,
        /// The cameras.
        rig: Arc<Rig>,
        /// Planar depth of a surface for each view, such as the output `nearest` of `path-trace`. Splats at or
        /// behind the surface, or in front of it by less than `limit_sigmas`, are left out. 0 and +inf mean that
        /// there is no surface.
        limit: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`SplatRender`].
    pub struct Out {
        /// Colour and depth of each view, with its camera, for `stitch`.
        views: Arc<Views>,
        /// RGB over black, premultiplied by alpha, followed by alpha.
        colour: Arc<Images>,
        /// Coverage, 0 to 1.
        alpha: Arc<Images>,
        /// Planar depth in world units, +inf where nothing is seen.
        depth: Arc<Images>,
        /// Number of splats blended into each pixel; empty unless `count_blends` is set.
        blends: Arc<Images>,
    }
}

/// Share of the pixels of all views below which the views are reported as empty.
const EMPTY: f64 = 0.02;

/// Warns if the splats cover almost nothing of the views. `covered` is the sum of alpha over all pixels of all
/// views.
fn warn_of_empty(covered: f64, rig: &Rig, notes: &mut Notes) {
    let pixels = rig.cameras.iter().map(|c| f64::from(c.width_px) * f64::from(c.height_px)).sum::<f64>();
    if covered < EMPTY * pixels {
        let views = match rig.cameras.as_slice() {
            [camera] => format!("the view `{}`", camera.name),
            cameras => format!("all {} views", cameras.len()),
        };
        let text = format!(
            "the splats cover only {:.2} % of {views}: the cameras look elsewhere, or cameras and splats are in different \
             coordinate frames. To bring them into one frame, set `matrix` or `dataparser` of `LoadCameras`, or `matrix` \
             of `LoadSplats`; for splats from nerfstudio, set `dataparser` to its file `dataparser_transforms.json`",
            100.0 * covered / pixels
        );
        notes.warning("views-empty", text);
    }
}

/// Depth limit for each camera.
fn limits_of<'a>(rig: &Rig, limits: &'a Images) -> Result<Vec<&'a Image<Data>>, NodeError> {
    // A single depth applies to a single camera, but not to each of several.
    let known =
        |camera: &Camera| rig.cameras.len() == 1 || limits.0.iter().any(|one| one.name == camera.name);
    let of = |camera: &Camera| match limits.view(&camera.name).filter(|_| known(camera)) {
        Some(Picture::Data(limit)) => Ok(limit),
        Some(_) => Err(NodeError::new("`limit` must be a depth, not a colour").at("limit")),
        None => {
            Err(NodeError::new(format!("`limit` has no depth for the view `{}`", camera.name)).at("limit"))
        }
    };
    rig.cameras.iter().map(of).collect()
}

impl Kind for SplatRender {
    const NAME: &'static str = "splat-render";
    const VERSION: u32 = 8;
    const READS: &'static [ContextField] = &[ContextField::Exhaustive, ContextField::MetresPerUnit];
    type Params = (Self, Drawing);
    type In = In;
    type Out = Out;

    fn estimate((_, drawing): &Self::Params, inputs: &In) -> Cost {
        let pixels = |c: &Camera| (u64::from(c.width_px) * u64::from(c.height_px)).min(MAX_PIXELS);
        let all: u64 = inputs.rig.cameras.iter().map(pixels).sum();
        let largest = inputs.rig.cameras.iter().map(pixels).max().unwrap_or(0);
        let splats = inputs.splats.len() as u64;
        let size = |c: &Camera| (u64::from(c.width_px), u64::from(c.height_px));
        let lists = inputs.rig.cameras.iter().map(|c| most_bytes(splats, size(c))).max().unwrap_or(0);
        let peaks = inputs.limit.is_some() || drawing.depth == DepthMode::RayMedian;
        let peaks = if peaks { splats } else { 0 };
        // Per pixel: colour, alpha and depth of the outputs; tiles of the current view.
        Cost::of([(all, 44), (largest, 24), (peaks, splat::PEAK_BYTES), (lists, 1)])
    }

    // Splats are read once per view; a megapixel of a view costs about as much as its share of them.
    fn work(_params: &Self::Params, sizes: &Sizes) -> f64 {
        sizes.of("splats") * (sizes.of("rig") / 1e6).max(1.0) + sizes.of("rig") * 5.0
    }

    fn views(_: &Self::Params, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["rig"])
    }

    fn former(name: &str, _: &[(&str, &str)]) -> Option<Former> {
        splat::former(name, 4)
    }

    fn check((_, drawing): &Self::Params) -> Result<(), NodeError> {
        drawing.check()
    }

    fn run(
        both @ (params, drawing): &Self::Params,
        In { splats, rig, limit }: In,
        cx: &Context,
    ) -> Result<(Out, Notes), NodeError> {
        Self::check(both)?;
        let mut notes = Notes::none();
        if rig.cameras.is_empty() {
            return Err(NodeError::new("the rig has no camera").at("rig"));
        }
        let settings = drawing.settings(params.sort, &splats, cx, &mut notes);
        let cut =
            rig.cameras.iter().map(|camera| (near::cut_by_camera(&splats, camera, settings.near), camera));
        let most = cut.reduce(|most, other| if other.0 > most.0 { other } else { most });
        let warning = most.and_then(|(share, camera)| {
            near::warning(share, drawing.near, settings.near, &format!(" in the view `{}`", camera.name))
        });
        if let Some(text) = warning {
            notes.warning("near-cuts", text);
        }
        let limits = limit.as_deref().map(|limits| limits_of(&rig, limits)).transpose()?;
        if let (Some(limits), [camera]) = (&limit, rig.cameras.as_slice())
            && let [one] = limits.0.as_slice()
            && one.name != camera.name
        {
            let text =
                format!("the depth of `{}` is used as the limit for the view `{}`", one.name, camera.name);
            notes.decision("limit-view", text);
        }
        let blocks = (settings.skip_unseen && rig.cameras.len() > 1).then(|| Blocks::of(&splats, cx));
        let blocks = blocks.transpose()?;
        let mut views = Vec::with_capacity(rig.cameras.len());
        let (mut alphas, mut depths, mut colours) = (Vec::new(), Vec::new(), Vec::new());
        let mut blends = Vec::new();
        let mut total = Work::default();
        let mut covered = 0.0;
        for (index, camera) in rig.cameras.iter().enumerate() {
            cx.progress(index as f32 / rig.cameras.len() as f32);
            let limit = limits.as_ref().and_then(|limits| limits.get(index).copied());
            let limit = limit.map(|depth| Limit { depth, sigmas: params.limit_sigmas });
            let seen = render_with(&splats, blocks.as_ref(), camera, limit, &settings, cx)?;
            total += seen.work;
            let (width, height) = (camera.width_px as usize, camera.height_px as usize);
            let alpha: Vec<f32> = seen.rgba.as_chunks::<4>().0.iter().map(|p| p[3]).collect();
            covered += alpha.iter().map(|&alpha| f64::from(alpha)).sum::<f64>();
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
        if limits.is_none() && !splats.is_empty() {
            warn_of_empty(covered, &rig, &mut notes);
        }
        total.report(splats.len(), &settings, cx, &mut notes);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::cube_rig::{Turn, cube};
    use scene::math::equirect;
    use testing::context;

    /// `near` is in metres: in a capture scaled so that a unit is 20 m, as by nerfstudio, splats 0.1 units away are seen. The
    /// picture is that of the same capture in metres. Without the scale they are cut away, with a warning. This test fails
    /// if `Drawing::settings` ignores `metres_per_unit`.
    #[test]
    fn near_is_in_metres() {
        let at_scale = |scale: f32| {
            let mut splats = Splats::empty();
            for i in 0..12_u8 {
                let angle = f64::from(i) / 12.0 * std::f64::consts::TAU;
                let (sin, cos) = scene::math::num::sin_cos(angle);
                // No two at the same depth, or the order of ties would decide.
                let distance = 2.0 + 0.13 * f32::from(i);
                splats
                    .means
                    .push([cos as f32, sin as f32, 0.02 * f32::from(i)].map(|v| v * distance * scale));
                splats.quats.push([1.0, 0.0, 0.0, 0.0]);
                splats.scales.push([0.8 * scale; 3]);
                splats.opacities.push(0.9);
                splats.sh.push([0.5, 0.1 * f32::from(i), -0.3]);
            }
            Arc::new(splats)
        };
        let run = |scale: f32, metres_per_unit: f64, near: f64| {
            let rig = cube(glam::DVec3::ZERO, equirect::axes(engine::Up::PlusZ), 16, 0.0, Turn::Aligned);
            let input = In { splats: at_scale(scale), rig: Arc::new(rig), limit: None };
            let world = engine::Scene { up: engine::Up::PlusZ, metres_per_unit, seed: 7, exhaustive: false };
            let params = (SplatRender::default(), Drawing { near, ..Drawing::default() });
            let (out, notes) =
                SplatRender::run(&params, input, &Context::detached(world, ".")).expect("renders");
            let samples: Vec<f32> =
                out.colour.0.iter().flat_map(|one| one.picture.samples().to_vec()).collect();
            (samples, notes.iter().any(|note| note.id == "near-cuts"))
        };
        for (metres_per_unit, near) in [(20.0, 0.2), (0.01, 0.2), (20.0, 1.5), (1000.0, 0.2)] {
            let (wanted, cut) = run(1.0, 1.0, near);
            let (found, warned) = run((1.0 / metres_per_unit) as f32, metres_per_unit, near);
            assert!(!cut && !warned, "{metres_per_unit}");
            let off = wanted.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < 1e-4 && wanted.iter().any(|v| *v > 0.4), "{metres_per_unit}: {off}");
        }
        let (dark, warned) = run(0.05, 1.0, 0.2);
        assert!(warned && dark.iter().all(|v| *v < 0.5 * 0.9), "a unit is taken as a metre");
    }

    /// Views of nothing are reported, but not if another camera of the rig sees the splats, or `limit` hides them.
    #[test]
    fn empty_views_are_reported() {
        let mut splats = Splats::empty();
        splats.means.push([0.0, 0.0, -5.0]);
        splats.quats.push([1.0, 0.0, 0.0, 0.0]);
        splats.scales.push([1.6; 3]);
        splats.opacities.push(0.9);
        splats.sh.push([0.5; 3]);
        let splats = Arc::new(splats);
        let all = cube(glam::DVec3::ZERO, equirect::axes(engine::Up::PlusZ), 16, 0.0, Turn::Aligned);
        let warned = |cameras: Vec<Camera>, limit: Option<Images>| {
            let rig = Arc::new(Rig { cameras });
            let input = In { splats: splats.clone(), rig, limit: limit.map(Arc::new) };
            let run = SplatRender::run(&(SplatRender::default(), Drawing::default()), input, &context());
            let (out, notes) = run.expect("renders");
            let text = notes.iter().find(|note| note.id == "views-empty").map(|note| note.text.clone());
            (out.alpha.0.iter().any(|one| one.picture.samples().iter().any(|&a| a > 0.5)), text)
        };
        assert_eq!(warned(all.cameras.clone(), None), (true, None));
        let mut texts = Vec::new();
        for camera in &all.cameras {
            let (seen, text) = warned(vec![camera.clone()], None);
            assert_eq!(seen, text.is_none(), "{}: {text:?}", camera.name);
            texts.extend(text);
            let near = Image::<Data>::from_samples(16, 16, 1, vec![0.5; 256]);
            let limit = Images(vec![NamedImage { name: camera.name.clone(), picture: near.into() }]);
            assert_eq!(warned(vec![camera.clone()], Some(limit)), (false, None));
        }
        assert_eq!(texts.len(), 5);
        assert!(texts[0].starts_with("the splats cover only 0.00 % of the view `"), "{}", texts[0]);
        let other = all.cameras.iter().filter(|camera| camera.world_from_camera[10].abs() < 0.5);
        let (_, text) = warned(other.cloned().collect(), None);
        assert!(text.expect("a warning").starts_with("the splats cover only 0.00 % of all 4 views:"));
    }
}

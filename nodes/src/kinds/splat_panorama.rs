//! `splat-panorama`: a panorama of a splat scene, rendered directly.

use std::sync::Arc;

use engine::{Context, ContextField, Cost, Former, Kind, NodeError, Notes, Sizes};
use render::light::panorama::{Unfilled, check_width, finish, linear_row};
use render::splat::near;
use render::splat::{self, Drawing, MAX_PIXELS, PanoramaCamera, Rendered, Sort, Surface, most_bytes};
use scene::math::equirect;
use scene::types::{Data, Image, Images, Mesh, Panorama, Pose, SplatEncoding, Splats};

pub use render::light::panorama::Holes;

engine::params! {
    /// Renders a splat scene directly into an equirectangular panorama.
    ///
    /// Splats are sorted by distance for the whole sphere, and both ends of a row match exactly, so there are
    /// no seams, unlike between the faces of a cube. Near the zenith and the nadir, where the layout is
    /// stretched, two pinhole cameras are used instead and blended with the layout between 25 and 30 degrees
    /// from the pole. Replaces `cube-rig`, `splat-render` and `stitch`.
    pub struct SplatPanorama {
        /// Height of the panorama's viewpoint above the origin of the pose, along the up axis.
        height_metres: f64 = 0.5, range(-1000.0, 1000.0), unit("m"), other("0.75");
        /// Width of the panorama, even; the height is half of it.
        width_px: u32 = 2048, range(16, 16384), unit("px"), other("64"),
            knob(Resolution, "256", "512", "1024", "2048");
        /// Samples per pixel along each axis. The low-pass filter acts on samples: with few of them, small splats
        /// become too large, which is by far the largest error of a small panorama.
        supersample: u32 = 2, range(1, 8), other("1"), knob(Samples, "1", "2", "2", "4");
        /// Content of pixels where nothing was seen. Alpha marks these pixels, no matter how they are filled.
        holes: Holes = Holes::PushPull, other("Black");
        /// Alpha below which a pixel is partly a hole and is blended with its surroundings.
        hole_alpha: f64 = 0.25, range(1e-6, 1.0), other("0.9");
    }
}
engine::inputs! {
    /// Inputs of [`SplatPanorama`].
    pub struct In {
        /// The scene.
        splats: Arc<Splats>,
        /// Pose of the object; only its translation is used.
        at: Arc<Pose>,
        /// Mesh that hides splats: a sample shows only the splats in front of the mesh.
        limit: Option<Arc<Mesh>>,
    }
}
engine::outputs! {
    /// Outputs of [`SplatPanorama`].
    pub struct Out {
        /// The panorama.
        pano: Arc<Panorama>,
        /// Colours of the panorama, for `write-image`.
        image: Arc<Images>,
        /// Coverage of each pixel, 0 to 1.
        alpha: Arc<Images>,
        /// Distance from the panorama's viewpoint in world units: the mean over the samples of a pixel, weighted by
        /// alpha. It is +inf where nothing is seen.
        depth: Arc<Images>,
        /// Number of splats blended into each pixel, over all its samples; empty unless `count_blends` is set.
        blends: Arc<Images>,
    }
}

/// Row of the panorama. Each pixel is the mean of `per` by `per` samples, weighted by solid angle.
struct Row {
    premultiplied: Vec<[f32; 4]>,
    depth: Vec<f32>,
    blends: Vec<f32>,
}

impl Row {
    fn new(seen: &Rendered, y: usize, width: usize, per: usize, encoded: bool) -> Self {
        let fine = width * per;
        let rgba = seen.rgba.as_chunks::<4>().0;
        let mut sums = vec![[0.0_f64; 4]; width];
        let mut depths = vec![[0.0_f64; 2]; width];
        let mut blends = vec![0.0_f32; if seen.blends.is_empty() { 0 } else { width }];
        let mut weights = 0.0;
        for row in y * per..(y + 1) * per {
            let weight = equirect::pixel_solid_angle(fine, fine / 2, row);
            weights += weight * per as f64;
            let at = row * fine..(row + 1) * fine;
            for (x, pixel) in linear_row(&rgba[at.clone()], encoded).iter().enumerate() {
                for (sum, value) in sums[x / per].iter_mut().zip(pixel) {
                    *sum += weight * f64::from(*value);
                }
                let depth = seen.depth[at.start + x];
                if depth.is_finite() {
                    let weight = weight * f64::from(pixel[3]);
                    depths[x / per][0] += weight * f64::from(depth);
                    depths[x / per][1] += weight;
                }
                if let Some(sum) = blends.get_mut(x / per) {
                    *sum += seen.blends[at.start + x];
                }
            }
        }
        let depth = depths.iter().map(|[sum, by]| if *by > 0.0 { (sum / by) as f32 } else { f32::INFINITY });
        Self {
            premultiplied: sums.iter().map(|sum| sum.map(|v| (v / weights) as f32)).collect(),
            depth: depth.collect(),
            blends,
        }
    }
}

impl Kind for SplatPanorama {
    const NAME: &'static str = "splat-panorama";
    const VERSION: u32 = 7;
    const READS: &'static [ContextField] =
        &[ContextField::Exhaustive, ContextField::Up, ContextField::MetresPerUnit];
    type Params = (Self, Drawing);
    type In = In;
    type Out = Out;

    fn estimate((params, _): &Self::Params, inputs: &In) -> Cost {
        let pixels = u64::from(params.width_px) * u64::from(params.width_px) / 2;
        let samples = pixels * u64::from(params.supersample) * u64::from(params.supersample);
        let fine = u64::from(params.width_px) * u64::from(params.supersample);
        let lists = most_bytes(inputs.splats.len() as u64, (fine, fine / 2));
        // Per sample: its tile or row, the pictures of the belt and of the caps, and their union.
        Cost::of([(pixels, 80), (samples, 60), (lists, 1)])
    }

    fn work((params, _): &Self::Params, sizes: &Sizes) -> f64 {
        let fine = f64::from(params.width_px) * f64::from(params.supersample);
        sizes.of("splats") * 30.0 + fine * fine * 50.0
    }

    fn former(name: &str, _: &[(&str, &str)]) -> Option<Former> {
        splat::former(name, 5)
    }

    fn check((params, drawing): &Self::Params) -> Result<(), NodeError> {
        drawing.check()?;
        check_width(params.width_px)?;
        let fine = u64::from(params.width_px) * u64::from(params.supersample);
        if fine * fine / 2 <= MAX_PIXELS {
            return Ok(());
        }
        let what = format!("a panorama of {fine} by {} samples is too large", fine / 2);
        Err(NodeError::new(what).at("supersample").hint(format!("the limit is {MAX_PIXELS} samples")))
    }

    fn run(
        both @ (params, drawing): &Self::Params,
        In { splats, at, limit }: In,
        cx: &Context,
    ) -> Result<(Out, Notes), NodeError> {
        Self::check(both)?;
        let mut notes = Notes::none();
        let up = cx.up();
        let origin = at.translation() + equirect::axes(up)[2] * (params.height_metres / cx.metres_per_unit());
        if !origin.is_finite() {
            return Err(NodeError::new("the viewpoint of the panorama is not finite").at("at"));
        }
        let settings = drawing.settings(Sort::Distance, &splats, cx, &mut notes);
        let share = near::cut_by_panorama(&splats, origin, settings.near);
        if let Some(text) = near::warning(share, drawing.near, settings.near, "") {
            notes.warning("near-cuts", text);
        }
        let around = PanoramaCamera { eye: origin, up, width_px: params.width_px * params.supersample };
        let limit = limit.map(|mesh| Surface::new(&mesh, origin));
        let seen = splat::panorama(&splats, &around, limit.as_ref(), &settings, cx)?;
        cx.progress(0.8);
        seen.work.report(splats.len(), &settings, cx, &mut notes);
        let (width, height) = (params.width_px as usize, params.width_px as usize / 2);
        let encoded = splats.encoding == SplatEncoding::Srgb;
        let per = params.supersample as usize;
        let rows = cx.for_each_tile(height, |y| Row::new(&seen, y, width, per, encoded))?;
        drop(seen);
        let mut premultiplied = Vec::with_capacity(width * height);
        let (mut depth, mut blends) = (Vec::with_capacity(width * height), Vec::new());
        for row in rows {
            premultiplied.extend(row.premultiplied);
            depth.extend(row.depth);
            blends.extend(row.blends);
        }
        let found = Unfilled { premultiplied, width, encoded, up, origin };
        let pano = finish(found, params.holes, params.hole_alpha, &mut notes, cx)?;
        let data = |samples| Images::single("pano", Image::<Data>::from_samples(width, height, 1, samples));
        let out = Out {
            image: Arc::new(Images::single("pano", pano.image.clone())),
            alpha: Arc::new(Images::single("pano", pano.alpha.clone())),
            depth: Arc::new(data(depth)),
            blends: Arc::new(if drawing.count_blends { data(blends) } else { Images::default() }),
            pano: Arc::new(pano),
        };
        Ok((out, notes))
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, DVec3};

    use super::*;
    use crate::kinds::cube_rig::{Turn, cube};
    use crate::kinds::splat_render;
    use crate::kinds::splat_render::SplatRender;
    use crate::kinds::stitch;
    use testing::context;

    fn params(width_px: u32, supersample: u32) -> (SplatPanorama, Drawing) {
        let own = SplatPanorama {
            height_metres: 0.0,
            width_px,
            supersample,
            holes: Holes::PushPull,
            hole_alpha: 0.25,
        };
        (own, Drawing { count_blends: true, ..Drawing::default() })
    }

    /// Sky of overlapping splats whose colour changes slowly with direction.
    fn sky(eye: DVec3) -> Arc<Splats> {
        let mut splats = Splats::empty();
        for i in 0..60 {
            for j in 0..120 {
                let d =
                    equirect::direction(engine::Up::PlusZ, f64::from(j) / 120.0, (f64::from(i) + 0.5) / 60.0);
                // No two splats at the same distance, or the order of ties would decide the comparison.
                let distance = 5.0 + 1e-5 * f64::from((i * 120 + j) * 2741 % 7200);
                splats.means.push((eye + d * distance).to_array().map(|v| v as f32));
                splats.quats.push([1.0, 0.0, 0.0, 0.0]);
                splats.scales.push([0.25; 3]);
                splats.opacities.push(0.9);
                splats.sh.push([d.x as f32, d.y as f32, d.z as f32]);
            }
        }
        Arc::new(splats)
    }

    fn run(params: &(SplatPanorama, Drawing), splats: &Arc<Splats>, eye: DVec3) -> Out {
        let at = Arc::new(Pose { world_from_local: DMat4::from_translation(eye) });
        SplatPanorama::run(params, In { splats: splats.clone(), at, limit: None }, &context())
            .expect("runs")
            .0
    }

    /// `near` is in metres: a capture in units of 20 m has the panorama of the same capture in metres. Without the scale it is
    /// cut away, with a warning. This test fails if `Drawing::settings` ignores `metres_per_unit`.
    #[test]
    fn near_is_in_metres() {
        let run = |scale: f32, metres_per_unit: f64| {
            let mut splats = Splats::clone(&sky(DVec3::ZERO));
            splats.means.iter_mut().for_each(|mean| *mean = mean.map(|v| v * 0.2 * scale));
            splats.scales.iter_mut().for_each(|axes| *axes = axes.map(|v| v * 0.2 * scale));
            let at = Arc::new(Pose { world_from_local: DMat4::IDENTITY });
            let world = engine::Scene { up: engine::Up::PlusZ, metres_per_unit, seed: 7, exhaustive: false };
            let input = In { splats: Arc::new(splats), at, limit: None };
            let (out, notes) =
                SplatPanorama::run(&params(32, 1), input, &Context::detached(world, ".")).expect("runs");
            (out.image.0[0].picture.samples().to_vec(), notes.iter().any(|note| note.id == "near-cuts"))
        };
        let (wanted, cut) = run(1.0, 1.0);
        for metres_per_unit in [20.0, 0.01, 1000.0] {
            let (found, warned) = run((1.0 / metres_per_unit) as f32, metres_per_unit);
            assert!(!cut && !warned, "{metres_per_unit}");
            let off = wanted.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < 1e-3, "{metres_per_unit}: {off}");
        }
        assert!(run(0.05, 1.0).1, "a unit is taken as a metre");
    }

    // Two independent paths to the same panorama: they share the blend, but not the mapping of directions.
    #[test]
    fn it_shows_what_the_faces_of_a_cube_show() {
        let eye = DVec3::new(1.0, -2.0, 0.5);
        let splats = sky(eye);
        let direct = run(&params(64, 3), &splats, eye);
        let rig = Arc::new(cube(eye, equirect::axes(engine::Up::PlusZ), 96, 3.0, Turn::OffAxis));
        let render = (SplatRender { sort: Sort::Distance, limit_sigmas: 1.0 }, Drawing::default());
        let views = SplatRender::run(&render, splat_render::In { splats, rig, limit: None }, &context());
        let params =
            stitch::Stitch { width_px: 64, holes: Holes::PushPull, hole_alpha: 0.25, as_views: false };
        let input = stitch::In { views: views.expect("renders").0.views };
        let faces = stitch::Stitch::run(&params, input, &context()).expect("stitches").0.pano;
        assert_eq!((direct.pano.up, direct.pano.origin), (faces.up, faces.origin));
        for y in 0..32 {
            for x in 0..64 {
                for c in 0..3 {
                    let at = (y * 64 + x) * 3 + c;
                    let (a, b) = (direct.pano.image.samples()[at], faces.image.samples()[at]);
                    // The layout is stretched at the poles, where the two differ in linearisation.
                    let bar = if (8..24).contains(&y) { 0.02 } else { 0.12 };
                    assert!((a - b).abs() < bar, "({x}, {y}): {a} against {b}");
                }
            }
        }
        let Some(scene::types::Picture::Data(depth)) = direct.depth.view("pano") else { panic!("no depth") };
        assert!(depth.samples.iter().all(|d| (d - 5.0).abs() < 0.1));
        assert!(direct.alpha.0[0].picture.samples().iter().all(|a| *a > 0.9));
        assert_eq!(direct.blends.0.len(), 1);
    }

    #[test]
    fn holes_are_filled_and_reported_and_sizes_are_checked() {
        let eye = DVec3::ZERO;
        let mut half = Arc::unwrap_or_clone(sky(eye));
        half.opacities.iter_mut().zip(&half.means).for_each(|(o, m)| *o = if m[1] > 0.0 { *o } else { 0.0 });
        let at = Arc::new(Pose { world_from_local: DMat4::IDENTITY });
        let input = In { splats: Arc::new(half), at, limit: None };
        let (out, notes) = SplatPanorama::run(&params(48, 2), input, &context()).expect("runs");
        assert!(notes.iter().any(|note| note.id == "holes"));
        assert!(out.pano.image.samples().iter().all(|v| v.is_finite()));
        assert!(out.pano.alpha.samples[12 * 48] == 0.0 && out.pano.alpha.samples[12 * 48 + 24] > 0.9);
        assert!(SplatPanorama::check(&params(7, 1)).is_err());
        assert!(SplatPanorama::check(&params(16384, 8)).is_err());
        let (own, mut drawing) = params(64, 1);
        (drawing.alpha_cap, drawing.alpha_cut) = (0.05, 0.1);
        assert!(SplatPanorama::check(&(own, drawing)).is_err());
    }
}

//! `fit-probe`: reduces the resolution of views to the resolution that the materials and shadows of objects can
//! show.

use std::sync::Arc;

use engine::{Context, Keep, Kind, NodeError, Notes, ViewCount};
use render::light::env_resolution::EnvResolution;
use render::light::panorama::COLUMNS_A_PIXEL;
use scene::types::{Environment, Placed, Rig};

engine::params! {
    /// Reduces the resolution of the views around a point to the resolution that the objects lit by them can show.
    ///
    /// A coarse panorama of the same light (128 columns, for example) gives the size of its lights; the objects
    /// give the roughness of their smoothest material. Both determine how many columns the panorama needs
    /// (`path-trace` reports the same number), and a view gets half that number of pixels per side. Views are never
    /// enlarged. Set `as_views: true` on `stitch` so that the panorama gets the number of columns that its views
    /// support.
    pub struct FitProbe {
        /// True to reduce the views to the resolution that is enough; `false` leaves the views unchanged and only
        /// reports that resolution.
        skip_fine: bool = true, other("false");
    }
}
engine::inputs! {
    /// Inputs of [`FitProbe`].
    pub struct In {
        /// The views at full size, such as those of a `cube-rig`. Each must be as wide as high.
        rig: Arc<Rig>,
        /// Objects to be lit.
        objects: Vec<Arc<Placed>>,
        /// Coarse panorama of the same light. Its pixels can make a light appear up to half a pixel wider, so half
        /// a pixel is subtracted from the width of each light.
        look: Arc<Environment>,
    }
}
engine::outputs! {
    /// Outputs of [`FitProbe`].
    pub struct Out {
        /// The same views with the reduced number of pixels.
        rig: Arc<Rig>,
    }
}

impl Kind for FitProbe {
    const NAME: &'static str = "fit-probe";
    const VERSION: u32 = 2;
    const STORE: Keep = Keep::Cheap;
    const PREVIEW: engine::Preview = engine::Preview { looks: &["look"], ..engine::Preview::NONE };
    type Params = Self;
    type In = In;
    type Out = Out;

    fn views(_: &Self, _: &engine::SourceRoot) -> ViewCount {
        ViewCount::As(&["rig"])
    }

    fn run(params: &Self, In { rig, objects, look }: In, _: &Context) -> Result<(Out, Notes), NodeError> {
        let Some(side) = rig.cameras.first().map(|camera| camera.width_px) else {
            return Err(NodeError::new("the rig has no camera").at("rig"));
        };
        if let Some(odd) = rig.cameras.iter().find(|c| [c.width_px, c.height_px] != [side; 2]) {
            let text = format!(
                "view `{}` is {}x{} pixels instead of {side}x{side}",
                odd.name, odd.width_px, odd.height_px
            );
            let hint = "all views must be squares of equal size, such as those of `cube-rig`";
            return Err(NodeError::new(text).at("rig").hint(hint));
        }
        let most = side.saturating_mul(COLUMNS_A_PIXEL) as usize;
        let needed = EnvResolution::of(&look, &objects, most);
        // Columns are at most `most`, or 64.
        let enough = (needed.columns as u32 / COLUMNS_A_PIXEL).min(side);
        let why = needed.why();
        let mut notes = Notes::none();
        notes.decision(
            "probe-size",
            match (enough < side, params.skip_fine) {
                (true, true) => format!("views of {enough} px are enough, instead of {side}: {why}"),
                (true, false) => {
                    format!("views of {enough} px would be enough ({why}), but they keep {side} px because of `skip_fine: false`")
                }
                (false, _) => format!("all {side} px of a view are needed: {why}"),
            },
        );
        if enough == side || !params.skip_fine {
            return Ok((Out { rig }, notes));
        }
        let mut fitted = Rig::clone(&rig);
        let scale = f64::from(enough) / f64::from(side);
        for camera in &mut fitted.cameras {
            (camera.width_px, camera.height_px) = (enough, enough);
            for length in [&mut camera.fx, &mut camera.fy, &mut camera.cx, &mut camera.cy] {
                *length *= scale;
            }
        }
        Ok((Out { rig: Arc::new(fitted) }, notes))
    }
}

#[cfg(test)]
mod tests {
    use engine::Up;
    use glam::{DMat4, DVec3};

    use super::*;
    use crate::kinds::cube_rig::{Turn, cube};
    use scene::math::equirect::{axes, direction};
    use scene::types::{Image, Material, Object, Primitive};

    /// Dim sky with a disc of light of the given diameter in degrees, 40 degrees above the horizon.
    fn lit(width: usize, disc_deg: f64) -> Arc<Environment> {
        let (sin, cos) = scene::math::num::sin_cos_deg(40.0);
        let (towards, edge) = (DVec3::new(cos, 0.0, sin), scene::math::num::sin_cos_deg(disc_deg / 2.0).1);
        let at = |i: usize| ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let light = |i: usize| {
            let (x, y) = at(i);
            let bright = direction(Up::PlusZ, x / width as f64, 2.0 * y / width as f64).dot(towards) > edge;
            if bright { [100.0_f32; 3] } else { [0.4; 3] }
        };
        let image =
            Image::from_samples(width, width / 2, 3, (0..width * width / 2).flat_map(light).collect());
        Arc::new(Environment { image: image.into(), up: Up::PlusZ, origin: None })
    }

    fn of(roughness: f32) -> Arc<Placed> {
        let material = Material { metallic: 0.0, roughness, ior: 1.5, ..Material::default() };
        let object = Object {
            primitives: vec![Primitive { triangles: vec![[0; 3]], ..Primitive::default() }],
            materials: vec![material],
            textures: Vec::new(),
        };
        Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY })
    }

    fn run(side: u32, roughness: f32, look: Arc<Environment>, skip_fine: bool) -> (Arc<Rig>, String) {
        let rig = cube(DVec3::ONE, axes(Up::PlusZ), side, 3.0, Turn::OffAxis);
        let inputs = In { rig: Arc::new(rig), objects: vec![of(roughness)], look };
        let (out, notes) = FitProbe::run(&FitProbe { skip_fine }, inputs, &testing::context()).expect("runs");
        (out.rig, notes.iter().map(|note| note.text.clone()).collect())
    }

    #[test]
    fn views_are_those_of_a_smaller_rig_and_never_of_a_larger_one() {
        let smaller = |side| cube(DVec3::ONE, axes(Up::PlusZ), side, 3.0, Turn::OffAxis);
        for (side, roughness, disc_deg, enough) in [
            (512, 1.0, 24.0, 64),
            (512, 0.3, 24.0, 128),
            (512, 0.0, 24.0, 512),
            (256, 1.0, 6.0, 256),
            (32, 1.0, 24.0, 32),
            (100, 0.0, 24.0, 100),
        ] {
            let (rig, reported) = run(side, roughness, lit(128, disc_deg), true);
            assert_eq!(rig.cameras[0].width_px, enough, "{side} {roughness} {disc_deg}: {reported}");
            let expected = smaller(enough);
            for (a, b) in rig.cameras.iter().zip(&expected.cameras) {
                assert_eq!(
                    (a.width_px, a.height_px, a.world_from_camera),
                    (b.width_px, b.height_px, b.world_from_camera)
                );
                assert!(
                    [a.fx - b.fx, a.fy - b.fy, a.cx - b.cx, a.cy - b.cy].iter().all(|off| off.abs() < 1e-9)
                );
            }
            assert_eq!(reported.contains("instead of"), enough < side, "{reported}");
            let (kept, reported) = run(side, roughness, lit(128, disc_deg), false);
            assert_eq!(*kept, smaller(side), "{reported}");
        }
    }

    /// The environment, downsampled by a factor of `times` in width and in height.
    fn seen_by_fewer(environment: &Environment, times: usize) -> Arc<Environment> {
        let fine = &environment.image;
        let (width, height) = (fine.width / times, fine.height / times);
        let mean = |i: usize| {
            let (x, y) = (i % width * times, i / width * times);
            let block = (0..times * times).map(|k| fine.rgb(x + k % times, y + k / times)[0]);
            [block.sum::<f32>() / (times * times) as f32; 3]
        };
        let image = Image::from_samples(width, height, 3, (0..width * height).flat_map(mean).collect());
        Arc::new(Environment { image: image.into(), up: environment.up, origin: None })
    }

    // A coarse `look` leads to the same number of columns as the full image, or up to twice as many. This test
    // fails if the blur of the coarse pixels is not subtracted.
    #[test]
    fn a_coarse_look_asks_for_no_less() {
        for disc_deg in [30.0, 24.0, 22.0, 15.0, 11.0, 9.0, 6.0, 5.0, 4.0] {
            let fine = lit(1024, disc_deg);
            let asked = |look: Arc<Environment>| run(512, 1.0, look, true).0.cameras[0].width_px;
            let (coarse, fine) = (asked(seen_by_fewer(&fine, 8)), asked(fine));
            assert!((fine..=2 * fine).contains(&coarse), "{disc_deg}: {coarse} of {fine}");
        }
    }

    #[test]
    fn what_is_no_probe_is_refused() {
        let refused = |change: fn(&mut Rig)| {
            let mut rig = cube(DVec3::ONE, axes(Up::PlusZ), 64, 3.0, Turn::OffAxis);
            change(&mut rig);
            let inputs = In { rig: Arc::new(rig), objects: Vec::new(), look: lit(64, 9.0) };
            let reported = FitProbe::run(&FitProbe { skip_fine: true }, inputs, &testing::context());
            reported.err().map(|error| error.to_string()).unwrap_or_default()
        };
        assert!(refused(|rig| rig.cameras.clear()).contains("no camera"));
        assert!(refused(|rig| rig.cameras[2].height_px = 63).contains("64x63"));
    }
}

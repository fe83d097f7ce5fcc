//! Tests of camera rays through lenses with distortion.

use scene::types::LensModel;

use super::*;

/// The edges of an object are where OpenCV shows its corners. The camera has the coefficients of a test of
/// `load-cameras`, whose positions OpenCV 5.0.0 computed; the object is a triangle of three of its points. At each
/// pixel, alpha is the share of the pixel inside the outline, which is made of 400 points on each edge. This test fails
/// if `CameraRays::through` ignores the lens (the largest difference is 0.9 then).
#[test]
fn edges_are_where_the_lens_shows_them() {
    let lens = LensModel::Radial {
        numerator: [-0.28, 0.07, 0.0, 0.0],
        denominator: [0.0; 3],
        tangential: [1.2e-3, -8e-4],
    };
    // A tenth of the size of 640x480 pixels, for speed.
    let camera = Camera {
        name: "v".to_owned(),
        width_px: 64,
        height_px: 48,
        fx: 50.0,
        fy: 51.0,
        cx: 32.0,
        cy: 25.0,
        lens: lens.into(),
        world_from_camera: DMat4::IDENTITY.to_cols_array(),
    };
    // Points 0, 2 and 9 of the test of `load-cameras`, and where OpenCV shows them.
    let corners = [DVec3::new(-1.1, -0.8, 2.0), DVec3::new(-1.1, 0.7, 2.2), DVec3::new(1.2, -0.8, 2.9)];
    let shown = [[7.633_180_5, 6.966_278_9], [9.189_640_9, 39.818_373_1], [51.308_179_4, 11.878_847_0]];
    for (corner, [u, v]) in corners.into_iter().zip(shown) {
        let [x, y] = camera.pixel(corner).expect("in front");
        assert!((x - u).abs() < 1e-6 && (y - v).abs() < 1e-6, "{corner}: {x} {y}");
    }
    let outline: Vec<[f64; 2]> = (0..1200)
        .map(|i| {
            let (a, b) = (corners[i / 400], corners[(i / 400 + 1) % 3]);
            camera.pixel(a.lerp(b, (i % 400) as f64 / 400.0)).expect("in front")
        })
        .collect();
    let primitive = Primitive {
        positions: corners.map(|corner| corner.as_vec3().to_array()).to_vec(),
        triangles: vec![[0, 1, 2]],
        ..Primitive::default()
    };
    let material = Material { double_sided: true, ..Material::default() };
    let object = Object { primitives: vec![primitive], materials: vec![material], textures: Vec::new() };
    let placed = Arc::new(Placed { object: Arc::new(object), world_from_object: DMat4::IDENTITY });
    let rig = Arc::new(Rig { cameras: vec![camera] });
    let mut wall = plane(30.0);
    wall.positions.iter_mut().for_each(|position| position[2] = 6.0);
    // 1024 samples: the standard error of alpha is at most 0.016.
    let (out, _) = render(&params(1024, Surroundings::OPEN), &wall, &[placed], &rig, &white());
    let alpha: Vec<f64> = samples(&out.object).iter().skip(3).step_by(4).map(|a| f64::from(*a)).collect();
    let inside = |x: f64, y: f64| {
        let crossings = outline.iter().zip(outline.iter().cycle().skip(1)).filter(|(a, b)| {
            (a[1] > y) != (b[1] > y) && x < a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])
        });
        crossings.count() % 2 == 1
    };
    let mut worst = 0.0_f64;
    for (i, alpha) in alpha.iter().enumerate() {
        let (x, y) = ((i % 64) as f64, (i / 64) as f64);
        let grid = (0..256)
            .filter(|k| inside(x + (f64::from(k % 16) + 0.5) / 16.0, y + (f64::from(k / 16) + 0.5) / 16.0));
        worst = worst.max((alpha - grid.count() as f64 / 256.0).abs());
    }
    // Four standard errors, and the grid of 16 by 16 points. A shift of an edge by 0.2 pixels would change alpha by up
    // to 0.2.
    assert!(worst < 0.09, "{worst}");
    // All depths are along the axis, as those of splats.
    let depth = samples(&out.depth)[24 * 64 + 20];
    assert!(depth.is_finite(), "{depth}");
}

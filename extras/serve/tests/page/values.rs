//! Values by digest: description, display, raw samples, caching.

use crate::lab::{GRAPH, Lab};

#[test]
fn a_picture_is_described_displayed_and_read_out() {
    let lab = Lab::new(GRAPH);
    let state = lab.idle();
    let outputs = state["nodes"]["view"]["outputs"].as_array().unwrap();
    let digest = |port: &str| {
        let output = outputs.iter().find(|output| output["port"] == port).unwrap();
        output["digest"].as_str().unwrap().to_owned()
    };
    let colour = digest("colour");
    let about = lab.get(&format!("/value/{colour}")).json();
    let picture = &about["pictures"][0];
    assert_eq!((&picture["width"], &picture["height"]), (&32.into(), &18.into()), "{about}");
    assert_eq!(picture["encoding"], "srgb");
    let channels = picture["channels"].as_u64().unwrap() as usize;
    let floats = lab.get(&format!("/value/{colour}/0.f32"));
    assert_eq!((floats.status, floats.body.len()), (200, 32 * 18 * channels * 4));
    let halves = lab.get(&format!("/value/{colour}/0.f16")).body;
    let samples: Vec<f32> =
        floats.body.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    assert!(samples.iter().any(|sample| *sample > 0.1), "the picture is not black");
    for (bytes, sample) in halves.as_chunks::<2>().0.iter().zip(&samples) {
        let half = half::f16::from_le_bytes(*bytes).to_f32();
        assert!((half - sample).abs() <= sample.abs() / 2048.0 + 1e-7, "{half} {sample}");
    }
    let png = lab.get(&format!("/value/{colour}/0.png"));
    assert_eq!(png.header("content-type"), Some("image/png"));
    assert_eq!(png.header("cache-control"), Some("private, max-age=31536000, immutable"));
    assert!(png.header("etag").unwrap().contains(&colour));
    let raster = scene::io::png::read("a.png", &png.body).unwrap();
    let code = |sample: f32| (sample.clamp(0.0, 1.0) * 255.0 + 0.5) as u16;
    assert_eq!((raster.width, raster.height), (32, 18));
    let expected =
        samples.chunks(channels).flat_map(|pixel| [code(pixel[0]), code(pixel[1]), code(pixel[2])]);
    assert!(raster.codes.iter().copied().eq(expected));
    let small = lab.get(&format!("/value/{colour}/0.png?size=8")).body;
    let small = scene::io::png::read("a.png", &small).unwrap();
    assert_eq!((small.width, small.height), (8, 5));

    let depth = lab.get(&format!("/value/{}", digest("depth"))).json();
    assert_eq!(
        (&depth["pictures"][0]["encoding"], &depth["pictures"][0]["channels"]),
        (&"data".into(), &1.into())
    );
    let views = lab.get(&format!("/value/{}", digest("views"))).json();
    assert_eq!(views["pictures"].as_array().unwrap().len(), 2, "colour and depth of one camera");
    for path in [
        "1.png",
        "0.jpg",
        "0",
        "png",
        "-1.png",
        "0.png?exposure=nan",
        "0.png?exposure=1e9",
        "0.png?size=0",
        "0.png?x=1",
    ] {
        let response = lab.get(&format!("/value/{colour}/{path}"));
        assert!(matches!(response.status, 400 | 404), "{path}: {}", response.status);
    }
}

#[test]
fn results_of_earlier_texts_stay_for_comparison() {
    let lab = Lab::new(GRAPH);
    let before = lab.idle()["nodes"]["view"]["outputs"][1]["digest"].as_str().unwrap().to_owned();
    assert_eq!(lab.set("camera", "fov_y_deg", &[], Some("55.0")).status, 200);
    lab.until("the picture follows", |lab| lab.idle()["history"]["shots"].as_array().unwrap().len() == 2);
    let state = lab.idle();
    let shots = state["history"]["shots"].as_array().unwrap();
    assert_eq!(shots[1]["label"], "camera.fov_y_deg = 55.0");
    assert_eq!(shots[0]["values"]["view.colour"][1], before.as_str());
    assert_ne!(state["nodes"]["view"]["outputs"][1]["digest"], before.as_str());
    assert_eq!(lab.get(&format!("/value/{before}/0.png")).status, 200);
}

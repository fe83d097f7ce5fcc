//! Tests of recovered light on real panoramas.

use std::sync::Arc;

use engine::{InputFile, Kind, Up};
use nodes::kinds::fuse_hdr::{self, Blend, FuseHdr, Gain, Hue};
use nodes::kinds::load_panorama::{self, FileEncoding, LoadPanorama};
use nodes::kinds::predict_exposure::{self, Method, PredictExposure};
use nodes::kinds::score_env::{self, ScoreEnv};
use render::light::linear::Transfer;
use scene::types::{Brackets, Cell, Image, Panorama, Srgb};

use super::data;

/// A picture that shows the probe of the bench case, in display values.
fn picture(name: &str) -> Image<Srgb> {
    let bytes = data().bytes(&format!("bench-case/probe/{name}"));
    let raster = scene::io::png::read(name, &bytes).unwrap();
    let (width, height, channels) = (raster.width, raster.height, raster.channels);
    let samples = raster.samples();
    let rgb = samples.chunks_exact(channels).flat_map(|p| [p[0], p[1], p[2]]).collect();
    Image::from_samples(width, height, 3, rgb)
}

fn pano() -> Arc<Panorama> {
    let image = picture("truth_equirect_ev0.png");
    let alpha = Image::from_samples(image.width, image.height, 1, vec![1.0; image.width * image.height]);
    Arc::new(Panorama { image: image.into(), alpha, up: Up::PlusZ, origin: None, turned_deg: 0.0 })
}

fn fusion(gain: Gain) -> FuseHdr {
    FuseHdr {
        threshold: 0.9,
        blend: Blend::Ramp,
        transfer: Transfer::Srgb,
        gain,
        hue: Hue::Predicted,
        feather_deg: 0.0,
        ground_albedo: None,
    }
}

fn number(cell: &Cell) -> f64 {
    if let Cell::Number(value) = cell { *value } else { f64::NAN }
}

// The sun of the bench case lies at pixel (273.9, 80.6) of 768x384 by its README. The clipped region around it is a
// few degrees wide and not symmetric, hence 5 degrees.
#[test]
fn the_sun_of_the_bench_case_is_the_strongest_light() {
    let base = pano();
    let params =
        PredictExposure { evs: vec![-6.0, -3.0], method: Method::Region, white: 0.95, weights: None };
    let inputs = predict_exposure::In { pano: base.clone() };
    let (predicted, _) = PredictExposure::run(&params, inputs, &data().context()).unwrap();
    let params = fusion(Gain::Direct);
    let inputs = fuse_hdr::In { base, brackets: predicted.brackets };
    let (fused, _) = FuseHdr::run(&params, inputs, &data().context()).unwrap();
    let first = &fused.report.tables[0].rows[0];
    let (azimuth, elevation) = (number(&first[0]), number(&first[1]));
    let (want_azimuth, want_elevation) = (360.0 * (273.9 / 768.0 - 0.5), 90.0 - 180.0 * 80.6 / 384.0);
    assert!((azimuth - want_azimuth).abs() < 5.0, "{azimuth} {want_azimuth}");
    assert!((elevation - want_elevation).abs() < 5.0, "{elevation} {want_elevation}");
}

// With the true exposures, all light except the sun is recovered to one step of an 8-bit code. The sun (radiance
// 1500) is above the maximum of 64 that EV -6 can represent, which must be reported.
#[test]
fn the_true_bracket_gives_the_true_light_but_for_the_sun() {
    let exposures = vec![picture("truth_equirect_ev-6.png"), picture("truth_equirect_ev-3.png")];
    let (width, height) = (exposures[0].width, exposures[0].height);
    let brackets = Brackets {
        log2_gain: Image::new(width, height, 1),
        colour: None,
        evs: vec![-6.0, -3.0],
        exposures,
        taken: scene::types::Taken::Display,
        report: scene::types::Report::default(),
    };
    let params = fusion(Gain::Brackets);
    let inputs = fuse_hdr::In { base: pano(), brackets: Arc::new(brackets) };
    let (fused, notes) = FuseHdr::run(&params, inputs, &data().context()).unwrap();
    assert!(notes.iter().any(|note| note.id == "saturated-at-darkest"));
    let bytes = data().bytes("bench-case/probe/truth_equirect.exr");
    let truth = scene::io::exr::read("truth_equirect.exr", &bytes).unwrap();
    let green = truth.find("G").unwrap();
    let (mut off, mut judged) = (0_u64, 0_u64);
    for (at, want) in green.iter().enumerate().filter(|(_, want)| **want < 50.0) {
        let found = fused.env.image.samples[3 * at + 1];
        judged += 1;
        // Half a code of the exposure that shows it: about 2 % where an exposure takes over, and the
        // first code of 255 in the dark.
        off += u64::from((found - want).abs() > 0.03 * want + 0.003);
    }
    assert!(judged > 290_000 && off * 100 < judged, "{off} of {judged} pixels are off");
}

/// True if every second panorama of the training set is tested and not only every sixth: if `LIGHTHARMONY_PLACES` is `all`.
fn all_places() -> bool {
    std::env::var("LIGHTHARMONY_PLACES").is_ok_and(|which| which == "all")
}

/// Mean errors of irradiance and of contrast, in stops, over every sixth panorama of the training set, or every second one
/// if `LIGHTHARMONY_PLACES` is `all`, photographed at EV 0. The first pair contains the errors of the photographs themselves, the second pair the
/// errors after `method` has recovered the light.
fn errors(method: &Method) -> [[f64; 2]; 2] {
    let mut files: Vec<_> =
        std::fs::read_dir(data().path("hdri-train")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|ending| ending == "exr"));
    files.sort();
    let mut sums = [[0.0; 2]; 2];
    let step = if all_places() { 2 } else { 6 };
    let count = files.iter().step_by(step).count() as f64;
    for file in files.iter().step_by(step) {
        let params = LoadPanorama {
            path: InputFile(file.to_str().unwrap().to_owned()),
            encoding: FileEncoding::Auto,
            layer: String::new(),
            photograph_ev: Some(0.0),
            rotation_deg: 0.0,
            origin: Some([0.0; 3]),
        };
        let (loaded, _) = LoadPanorama::run(&params, load_panorama::In {}, &data().context()).unwrap();
        for (sums, method) in sums.iter_mut().zip([&Method::Skip, method]) {
            let params =
                PredictExposure { evs: Vec::new(), method: method.clone(), white: 0.95, weights: None };
            let inputs = predict_exposure::In { pano: loaded.pano.clone() };
            let brackets = PredictExposure::run(&params, inputs, &data().context()).unwrap().0.brackets;
            let inputs = fuse_hdr::In { base: loaded.pano.clone(), brackets };
            let env = FuseHdr::run(&fusion(Gain::Direct), inputs, &data().context()).unwrap().0.env;
            let inputs = score_env::In { env, truth: loaded.env.clone() };
            let (scored, _) = ScoreEnv::run(&ScoreEnv { normals: 512 }, inputs, &data().context()).unwrap();
            let row = |name: &str| {
                let rows = &scored.report.tables[0].rows;
                let row =
                    rows.iter().find(|row| matches!(&row[0], Cell::Text(text) if text.starts_with(name)));
                number(&row.unwrap()[1]).abs()
            };
            sums[0] += row("mean irradiance") / count;
            sums[1] += row("contrast of the dominant light") / count;
        }
    }
    sums
}

// docs/light.md states 0.54 and 1.00 stops for 37 places, on which the shipped weights were trained; every third of them has
// 0.33 and 0.86. Reading one number wrongly increases them by more than the margin of the bounds. This test fails if two numbers of `OVERVIEW` or of `CELL` are exchanged.
#[test]
fn learned_light_is_as_good_as_the_docs_say() {
    let [plain, learned] = errors(&Method::Learned);
    println!("as photographed {plain:.3?}, learned {learned:.3?} stops of irradiance and contrast");
    assert!(plain[0] > 1.2 && plain[1] > 2.5, "{plain:?}: there is light to be recovered");
    let most = if all_places() { [0.60, 1.25] } else { [0.38, 1.05] };
    assert!(learned[0] < most[0] && learned[1] < most[1], "{learned:?}");
}

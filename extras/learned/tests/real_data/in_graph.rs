//! The model as a part of graphs.

use std::sync::Arc;

use engine::{InputFile, Kind, SourceRoot, Up};
use nodes::kinds::predict_exposure::{CLIPPED, In, Method, PredictExposure};
use safetensors::SafeTensors;
use scene::types::{Image, Panorama, Srgb};

use crate::fixture;

fn flux_kontext(files: [&str; 4]) -> Method {
    let [transformer, vae, prompt, lora] = files.map(|file| InputFile(file.to_owned()));
    Method::FluxKontext {
        transformer,
        vae,
        prompt,
        lora,
        strength: 1.0,
        steps: 2,
        guidance: 2.5,
        width_px: 64,
        seamless: true,
        seed: 3,
    }
}

/// A room with a window and a lamp, both clipped.
fn room() -> Arc<Panorama> {
    let mut samples = Vec::new();
    for (x, y) in (0..64).flat_map(|y| (0..128).map(move |x| (2 * x, 2 * y))) {
        let window = (44..64).contains(&y) && !(14..246).contains(&x);
        let lamp = (30..34).contains(&y) && (100..104).contains(&x);
        samples.extend(if window || lamp { [1.0, 1.0, 0.99] } else { [0.5, 0.45, 0.4] });
    }
    Arc::new(Panorama {
        image: Image::<Srgb>::from_samples(128, 64, 3, samples).into(),
        alpha: Image::from_samples(128, 64, 1, vec![1.0; 128 * 64]),
        up: Up::PlusZ,
        origin: None,
        turned_deg: 0.0,
    })
}

/// The small model with random weights, run by the kind, changes only clipped pixels and gives the same result
/// every time. The values that it predicts are meaningless.
#[test]
fn the_diffusion_model_fills_clipped_pixels_only() {
    let at = |name: &str| fixture().join(name).display().to_string();
    let bytes = std::fs::read(at("tensors.safetensors")).expect("is there");
    let tensors = SafeTensors::deserialize(&bytes).expect("is sound");
    let folder = tempfile::tempdir().expect("a folder");
    let prompt = folder.path().join("prompt.safetensors");
    let of = |name: &str| tensors.tensor(name).expect("is there");
    let named = [("t5", of("prompt_embeds")), ("clip", of("pooled_prompt_embeds"))];
    std::fs::write(&prompt, safetensors::serialize(named, None).expect("serializes")).expect("is written");
    let files = [
        &at("transformer/diffusion_pytorch_model.safetensors"),
        &at("vae/diffusion_pytorch_model.safetensors"),
        prompt.to_str().expect("is text"),
        &at("lora_kohya.safetensors"),
    ];
    learned::diffusion::install();
    let params =
        PredictExposure { evs: vec![-6.0, -3.0], method: flux_kontext(files), white: CLIPPED, weights: None };
    PredictExposure::check(&params).unwrap();
    let cx = testing::context();
    let sources = PredictExposure::sources(&params, &SourceRoot::new(".")).expect("are there");
    // The four files, and the files next to two of them.
    assert_eq!(sources.len(), 6);
    let (out, notes) = PredictExposure::run(&params, In { pano: room() }, &cx).expect("runs");
    assert!(notes.iter().any(|note| note.id == "kontext"
        && note.text.contains("exposures of 64 x 32")
        && note.text.ends_with("(count: 2)")));
    // Two exposures, two steps, each done twice.
    assert_eq!(cx.counts()["diffusion-steps"], 8);
    let gain = &out.brackets.log2_gain.samples;
    let (again, _) = PredictExposure::run(&params, In { pano: room() }, &cx).expect("runs");
    assert_eq!(*gain, again.brackets.log2_gain.samples);
    assert!(gain.iter().all(|v| v.is_finite() && (0.0..=24.0).contains(v)));
    let by_region = PredictExposure { method: Method::Region, ..params.clone() };
    let (skipped, _) = PredictExposure::run(&by_region, In { pano: room() }, &cx).expect("runs");
    let clipped = |at: usize| skipped.brackets.log2_gain.samples[at] > 0.0;
    assert!(gain.iter().enumerate().all(|(at, v)| clipped(at) || *v == 0.0));
    let missing = PredictExposure { method: flux_kontext(["nowhere"; 4]), ..params };
    let error = PredictExposure::sources(&missing, &SourceRoot::new(".")).expect_err("is missing");
    assert!(error.to_string().contains("cannot find `nowhere`"), "{error}");
}

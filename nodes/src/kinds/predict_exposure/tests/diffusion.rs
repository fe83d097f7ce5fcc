//! Tests of the method that predicts exposures with a diffusion model.

use super::*;

fn flux_kontext(files: [&str; 4], steps: u32, seed: u64) -> Method {
    let [transformer, vae, prompt, lora] = files.map(|file| InputFile(file.to_owned()));
    let (strength, guidance, width_px, seamless) = (1.0, 2.5, 64, true);
    Method::FluxKontext {
        transformer,
        vae,
        prompt,
        lora,
        strength,
        steps,
        guidance,
        width_px,
        seamless,
        seed,
    }
}

#[test]
fn files_of_the_diffusion_model_count_by_content_and_a_build_without_it_says_so() {
    use engine::ParamType;
    let method = flux_kontext(["a.gguf", "b", "c", "d"], 4, 0);
    assert_eq!(method.paths(), ["a.gguf", "b", "c", "d"]);
    let key = |method: &Method| method.key_text().expect("is canonical").expect("has a text");
    assert_eq!(key(&method), "FluxKontext(1.0,4,2.5,64,true,0) by candle 0.11 in f32");
    assert_eq!(key(&method), key(&flux_kontext(["z.gguf", "b", "c", "d"], 4, 0)));
    assert_ne!(key(&method), key(&flux_kontext(["a.gguf", "b", "c", "d"], 4, 1)));
    assert_eq!(key(&Method::Region), "Region");
    let numbers = |method: &Method| method.kontext().expect("is it").check_numbers();
    assert!(numbers(&method).is_ok());
    let error = numbers(&flux_kontext(["a", "b", "c", "d"], 0, 0)).expect_err("takes no steps").to_string();
    assert!(error.contains("`steps` of `FluxKontext` must be 1 to 200, but is 0"), "{error}");
    let checked =
        PredictExposure::check(&PredictExposure { evs: vec![-3.0], method, white: CLIPPED, weights: None });
    if cfg!(feature = "learned") {
        assert!(checked.is_ok());
    } else {
        assert!(checked.expect_err("is not built in").to_string().contains("feature `learned`"));
    }
}

/// The small model with random weights, run by the kind, changes only clipped pixels and gives the same result
/// every time. The values that it predicts are meaningless.
#[cfg(all(feature = "learned", feature = "real-data"))]
#[test]
fn the_diffusion_model_fills_clipped_pixels_only() {
    use safetensors::SafeTensors;
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/flux-kontext-tiny");
    let at = |name: &str| format!("{fixture}/{name}");
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
    let params = PredictExposure {
        evs: vec![-6.0, -3.0],
        method: flux_kontext(files, 2, 3),
        white: CLIPPED,
        weights: None,
    };
    let cx = cx();
    let sources = PredictExposure::sources(&params, &SourceRoot::new(".")).expect("are there");
    // The four files, and the files next to two of them.
    assert_eq!(sources.len(), 6);
    let (out, notes) = PredictExposure::run(&params, In { pano: room(128) }, &cx).expect("runs");
    assert!(notes.iter().any(|note| note.id == "kontext"
        && note.text.contains("exposures of 64 x 32")
        && note.text.ends_with("(count: 2)")));
    // Two exposures, two steps, each done twice.
    assert_eq!(cx.counts()["diffusion-steps"], 8);
    let gain = &out.brackets.log2_gain.samples;
    let (again, _) = PredictExposure::run(&params, In { pano: room(128) }, &cx).expect("runs");
    assert_eq!(*gain, again.brackets.log2_gain.samples);
    assert!(gain.iter().all(|v| v.is_finite() && (0.0..=24.0).contains(v)));
    let (skipped, _) = run(room(128), &[-3.0]);
    let clipped = |at: usize| skipped.log2_gain.samples[at] > 0.0;
    assert!(gain.iter().enumerate().all(|(at, v)| clipped(at) || *v == 0.0));
    let missing = PredictExposure { method: flux_kontext(["nowhere"; 4], 2, 3), ..params };
    let error = PredictExposure::sources(&missing, &SourceRoot::new(".")).expect_err("is missing");
    assert!(error.to_string().contains("cannot find `nowhere`"), "{error}");
}

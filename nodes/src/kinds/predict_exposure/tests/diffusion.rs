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
    assert!(checked.expect_err("is not built in").to_string().contains("feature `learned`"));
}

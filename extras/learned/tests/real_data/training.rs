//! Test of the training of a LoRA, with the small model.

use std::path::Path;

use candle_core::{DType, Device, Tensor, Var};
use learned::flux::{
    Config, Files, Given, Kontext, Lora, Prompt, Settings, Source, TrainSettings, Trainer, Transformer,
    Update, grid,
};

use crate::fixture;
use crate::parity::{difference, prompt_file, reference};

fn files(folder: &Path, lora: Option<(&Path, f64)>) -> Files {
    Files {
        transformer: fixture().join("transformer/diffusion_pytorch_model.safetensors"),
        vae: fixture().join("vae/diffusion_pytorch_model.safetensors"),
        prompt: prompt_file(folder, &reference()),
        loras: lora.map(|(path, strength)| (path.to_owned(), strength)).into_iter().collect(),
    }
}

fn kontext(folder: &Path, lora: Option<(&Path, f64)>) -> Kontext {
    Kontext::load(&files(folder, lora), &Device::Cpu, DType::F32).unwrap()
}

const SETTINGS: TrainSettings = TrainSettings { rank: 3, alpha: 6.0, rate: 2e-3, guidance: 1.0, seed: 4 };

/// A picture, and the same picture with all values divided by 4.
fn pictures() -> (Tensor, Tensor) {
    let picture = ((reference()["image_pre"].squeeze(0).unwrap() + 1.0).unwrap() * 0.5).unwrap();
    let picture = picture.narrow(1, 0, 32).unwrap().narrow(2, 0, 64).unwrap().contiguous().unwrap();
    (picture.clone(), (picture * 0.25).unwrap())
}

#[test]
fn gradients_a_block_at_a_time_are_those_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let tensors = reference();
    let source = Source::open(&fixture().join("transformer/diffusion_pytorch_model.safetensors")).unwrap();
    let mut transformer = Transformer::load(&source, &Device::Cpu, DType::F32).unwrap();
    let random = |rows: u32, columns: u32| {
        let t = Tensor::arange(0_u32, rows * columns, &Device::Cpu).unwrap().to_dtype(DType::F32).unwrap();
        let t = ((t * 0.7).unwrap().sin().unwrap() * 0.2).unwrap();
        Var::from_tensor(&t.reshape((rows as usize, columns as usize)).unwrap()).unwrap()
    };
    let vars: Vec<[Var; 2]> = (0..4).map(|_| [random(2, 32), random(32, 2)]).collect();
    let layers = [
        "double_blocks.0.txt_attn.qkv",
        "double_blocks.1.img_attn.proj",
        "single_blocks.0.linear1",
        "single_blocks.2.linear1",
    ];
    let starts = [32, 0, 0, 64];
    for layer in transformer.linears() {
        let Some(i) = layers.iter().position(|name| *name == layer.name()) else { continue };
        let [down, up] = vars[i].each_ref().map(|var| var.as_tensor().clone());
        layer.update(Update { start: starts[i], down, up, scale: 1.5 }).unwrap();
    }
    let prompt =
        Prompt::read(&prompt_file(folder.path(), &tensors), transformer.config(), &Device::Cpu).unwrap();
    let tokens = tensors["step0.hidden_states"].squeeze(0).unwrap();
    let places: Vec<_> = [0.0, 1.0].into_iter().flat_map(|frame| grid(frame, 4, 8)).collect();
    let given = Given { tokens: &tokens, places: &places, prompt: &prompt, time: 0.7, guidance: 2.5 };
    let flat: Vec<Var> = vars.iter().flatten().cloned().collect();
    let loss = |velocity: &Tensor| Ok(velocity.narrow(0, 0, 32)?.sqr()?.mean_all()?);
    let (value, gradients) = transformer.gradients(&given, &flat, &loss, &mut ()).unwrap();
    let forward = || {
        let velocity = transformer.forward(&tokens, &places, &prompt, 0.7, 2.5, &mut ()).unwrap();
        loss(&velocity).unwrap()
    };
    let whole = forward();
    assert!((whole.to_scalar::<f32>().unwrap() - value).abs() < 1e-6);
    let whole = whole.backward().unwrap();
    for (var, gradient) in flat.iter().zip(&gradients) {
        let (gradient, wanted) = (gradient.as_ref().unwrap(), whole.get(var).unwrap());
        let size = wanted.abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap();
        assert!(size > 0.0 && difference(gradient, wanted) < 1e-4 * size, "{:?}", var.dims());
        // With its history, the gradient would keep the values inside its block alive.
        assert!(!gradient.track_op());
    }
    // Compares with a difference quotient along the gradient itself.
    let (var, gradient) = (&flat[1], gradients[1].as_ref().unwrap());
    let square = gradient.sqr().unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap();
    let step = 0.02 / f64::from(square.sqrt());
    let start = var.as_tensor().copy().unwrap();
    let at = |side: f64| {
        var.set(&(&start + (gradient * (side * step)).unwrap()).unwrap()).unwrap();
        f64::from(forward().to_scalar::<f32>().unwrap())
    };
    let slope = (at(1.0) - at(-1.0)) / (2.0 * step);
    assert!((slope / f64::from(square) - 1.0).abs() < 0.01, "{slope} {square}");
}

#[test]
fn the_loss_falls_only_the_lora_changes_and_going_on_is_as_never_having_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (from, to) = pictures();
    let begin = || {
        let trainer = Trainer::new(kontext(folder.path(), None), SETTINGS).unwrap();
        let pair = trainer.pair(&from, &to, &mut ()).unwrap();
        (trainer, pair)
    };
    let (mut trainer, pair) = begin();
    let before = trainer.loss(&pair, &mut ()).unwrap();
    for _ in 0..4 {
        trainer.step(&pair, &mut ()).unwrap();
    }
    trainer.save_state(&at("state"), "these").unwrap();
    for _ in 0..56 {
        trainer.step(&pair, &mut ()).unwrap();
    }
    let after = trainer.loss(&pair, &mut ()).unwrap();
    println!("loss {before} to {after} in {} steps", trainer.done());
    assert!(after < 0.8 * before, "{before} {after}");
    trainer.save(&at("lora.safetensors")).unwrap();

    // The file holds nothing but updates of layers that the model has, each with its alpha.
    let config: Config = {
        let source = Source::open(&files(folder.path(), None).transformer).unwrap();
        Transformer::survey(&source).unwrap().0
    };
    let lora = Lora::read(&at("lora.safetensors"), &config, &Device::Cpu).unwrap();
    assert_eq!(lora.layers(), 2 * 2 * 4 + 3 * 2);
    assert!(lora.updates("single_blocks.1.linear1").iter().all(|update| update.scale == 2.0));
    assert!(lora.updates("double_blocks.0.img_mod.lin").is_empty());
    // At strength 0 the model equals the base model bit for bit; at full strength it does not.
    let settings = Settings { steps: 1, guidance: 2.5, seed: 0, seamless: false };
    let edit = |kontext: Kontext| {
        let noise = kontext.noise(64, 32, 0, 0).unwrap();
        kontext.edit(&from, &noise, &settings, &mut ()).unwrap()
    };
    let base = edit(kontext(folder.path(), None));
    let path = at("lora.safetensors");
    assert_eq!(difference(&base, &edit(kontext(folder.path(), Some((&path, 0.0))))), 0.0);
    assert!(difference(&base, &edit(kontext(folder.path(), Some((&path, 1.0))))) > 1e-3);

    let run = |mut trainer: Trainer, steps: u64, name: &str| {
        let pair = trainer.pair(&from, &to, &mut ()).unwrap();
        while trainer.done() < steps {
            trainer.step(&pair, &mut ()).unwrap();
        }
        trainer.save(&at(name)).unwrap();
        std::fs::read(at(name)).unwrap()
    };
    let (mut resumed, _) = begin();
    resumed.load_state(&at("state"), "these").unwrap();
    assert_eq!(resumed.done(), 4);
    assert_eq!(run(resumed, 8, "a"), run(begin().0, 8, "b"));
    let other = TrainSettings { rate: 1e-3, ..SETTINGS };
    for (settings, from) in [(other, "these"), (SETTINGS, "others")] {
        let mut trainer = Trainer::new(kontext(folder.path(), None), settings).unwrap();
        let error = trainer.load_state(&at("state"), from).unwrap_err();
        assert!(error.to_string().contains("remove the file to start again"), "{error}");
    }
}

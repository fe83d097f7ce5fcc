//! Tests with unusual user files: shards, quantised weights, wrong LoRAs, damaged headers.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use candle_core::quantized::{GgmlDType, QTensor, gguf_file};
use candle_core::{DType, Device, Tensor};
use learned::flux::{Config, Edge, Files, Kontext, Lora, Prompt, Settings, Source, Transformer, Vae};

use crate::parity::{difference, prompt_file, reference};
use crate::{fixture, small_config};

fn tensors(path: &Path) -> BTreeMap<String, Tensor> {
    candle_core::safetensors::load(path, &Device::Cpu).unwrap().into_iter().collect()
}

fn save(tensors: &BTreeMap<String, Tensor>, path: &Path) {
    let map: HashMap<&str, Tensor> = tensors.iter().map(|(k, v)| (k.as_str(), v.clone())).collect();
    candle_core::safetensors::save(&map, path).unwrap();
}

/// Prepares a two-step edit of a picture of 128 x 64 pixels.
fn edited(transformer: &Path, folder: &Path, seamless: bool) -> Kontext2 {
    let reference = reference();
    let files = Files {
        transformer: transformer.to_owned(),
        vae: fixture().join("vae/diffusion_pytorch_model.safetensors"),
        prompt: prompt_file(folder, &reference),
        loras: Vec::new(),
    };
    let kontext = Kontext::load(&files, &Device::Cpu, DType::F32).unwrap();
    let settings = Settings { steps: 2, guidance: 2.5, seed: 9, seamless };
    let picture = ((reference["image_pre"].squeeze(0).unwrap() + 1.0).unwrap() * 0.5).unwrap();
    Kontext2 { kontext, settings, picture }
}

struct Kontext2 {
    kontext: Kontext,
    settings: Settings,
    picture: Tensor,
}

impl Kontext2 {
    fn run(&self) -> Tensor {
        let noise = self.kontext.noise(128, 64, self.settings.seed, 0).unwrap();
        self.kontext.edit(&self.picture, &noise, &self.settings, &mut ()).unwrap()
    }
}

#[test]
fn shards_are_one_file_and_quantised_blocks_are_what_they_stand_for() {
    let folder = tempfile::tempdir().unwrap();
    small_config(folder.path());
    let whole = tensors(&fixture().join("transformer_bfl.safetensors"));

    let plain = folder.path().join("plain.safetensors");
    save(&whole, &plain);
    let wanted = edited(&plain, folder.path(), false).run();
    let middle = whole.keys().nth(whole.len() / 2).unwrap().clone();
    let mut first = whole.clone();
    let second = first.split_off(&middle);
    let shard = |i: usize| folder.path().join(format!("part-0000{i}-of-00002.safetensors"));
    save(&first, &shard(1));
    save(&second, &shard(2));
    assert_eq!(difference(&edited(&shard(1), folder.path(), false).run(), &wanted), 0.0);

    // A file with eight bits per weight, and a file with the same weights dequantised.
    let (mut blocks, mut stands_for) = (Vec::new(), BTreeMap::new());
    for (key, tensor) in &whole {
        let columns = *tensor.dims().last().unwrap();
        let quantised = tensor.rank() == 2 && columns % 32 == 0;
        let dtype = if quantised { GgmlDType::Q8_0 } else { GgmlDType::F32 };
        let block = QTensor::quantize(tensor, dtype).unwrap();
        stands_for.insert(key.clone(), block.dequantize(&Device::Cpu).unwrap());
        blocks.push((key.as_str(), block));
    }
    let (gguf, same) = (folder.path().join("small.gguf"), folder.path().join("same.safetensors"));
    let references: Vec<(&str, &QTensor)> = blocks.iter().map(|(key, block)| (*key, block)).collect();
    gguf_file::write(&mut std::fs::File::create(&gguf).unwrap(), &[], &references).unwrap();
    save(&stands_for, &same);
    let quantised = edited(&gguf, folder.path(), false).run();
    assert_eq!(difference(&quantised, &edited(&same, folder.path(), false).run()), 0.0);
    let loss = difference(&quantised, &wanted);
    println!("difference of the image with 8 bits per weight from that with 32: {loss:.1e}");
    assert!(loss > 0.0 && loss < 0.05, "{loss}");

    // bf16 keeps eight bits too, and is widened exactly.
    let half: BTreeMap<String, Tensor> =
        whole.iter().map(|(key, t)| (key.clone(), t.to_dtype(DType::BF16).unwrap())).collect();
    let wide: BTreeMap<String, Tensor> =
        half.iter().map(|(key, t)| (key.clone(), t.to_dtype(DType::F32).unwrap())).collect();
    let [a, b] = [("half.safetensors", half), ("wide.safetensors", wide)].map(|(name, tensors)| {
        let path = folder.path().join(name);
        save(&tensors, &path);
        edited(&path, folder.path(), false).run()
    });
    assert_eq!(difference(&a, &b), 0.0);
}

fn rolled(picture: &Tensor, by: usize) -> Tensor {
    let width = picture.dim(2).unwrap();
    let (left, right) = (picture.narrow(2, 0, by).unwrap(), picture.narrow(2, by, width - by).unwrap());
    Tensor::cat(&[right, left], 2).unwrap()
}

#[test]
fn a_panorama_turned_by_half_gives_the_result_turned_by_half() {
    let folder = tempfile::tempdir().unwrap();
    let transformer = fixture().join("transformer/diffusion_pytorch_model.safetensors");
    for (seamless, most) in [(true, 2e-5), (false, f32::INFINITY)] {
        let Kontext2 { kontext, settings, picture } = edited(&transformer, folder.path(), seamless);
        let noise = kontext.noise(128, 64, 9, 0).unwrap();
        let straight = kontext.edit(&picture, &noise, &settings, &mut ()).unwrap();
        let turned = kontext.edit(&rolled(&picture, 64), &rolled(&noise, 8), &settings, &mut ()).unwrap();
        let difference = difference(&rolled(&straight, 64), &turned);
        println!("seamless {seamless}: {difference:.1e}");
        assert!(difference <= most && (seamless || difference > 1e-2), "{seamless} {difference}");
    }
}

#[test]
fn the_autoencoder_is_the_same_by_its_authors_names() {
    let folder = tempfile::tempdir().unwrap();
    let theirs = fixture().join("vae/diffusion_pytorch_model.safetensors");
    let renamed = tensors(&theirs).into_iter().map(|(key, tensor)| {
        let mut name = key
            .replace("mid_block.resnets.0", "mid.block_1")
            .replace("mid_block.resnets.1", "mid.block_2")
            .replace("mid_block.attentions.0", "mid.attn_1")
            .replace("down_blocks", "down")
            .replace("resnets", "block")
            .replace("conv_shortcut", "nin_shortcut")
            .replace("downsamplers.0", "downsample")
            .replace("upsamplers.0", "upsample")
            .replace("conv_norm_out", "norm_out")
            .replace("group_norm", "norm")
            .replace("to_out.0", "proj_out");
        for part in ["q", "k", "v"] {
            name = name.replace(&format!("to_{part}."), &format!("{part}."));
        }
        for level in 0..4 {
            name = name.replace(&format!("up_blocks.{level}"), &format!("up.{}", 3 - level));
        }
        let pixelwise = name.contains("attn_1") && tensor.rank() == 2;
        (name, if pixelwise { tensor.reshape((64, 64, 1, 1)).unwrap() } else { tensor })
    });
    let path = folder.path().join("ae.safetensors");
    save(&renamed.collect(), &path);
    let picture = reference()["image_pre"].squeeze(0).unwrap();
    let there_and_back = |path: &Path| {
        let vae = Vae::load(path, &Device::Cpu, DType::F32).unwrap();
        let latents = vae.encode(&picture, Edge::Wraps, &mut ()).unwrap();
        vae.decode(&latents, Edge::Wraps, &mut ()).unwrap()
    };
    assert_eq!(difference(&there_and_back(&path), &there_and_back(&theirs)), 0.0);
}

#[test]
fn an_update_of_the_last_modulation_goes_to_the_right_half() {
    // `diffusers` keeps (scale, shift) there, the authors (shift, scale).
    let folder = tempfile::tempdir().unwrap();
    let random = |stream, rows, columns| {
        learned::flux::normals(3, stream, (1, rows, columns), &Device::Cpu).unwrap().squeeze(0).unwrap()
    };
    let (down, up) = (random(0, 2, 32), random(1, 64, 2));
    let halves = [up.narrow(0, 32, 32).unwrap(), up.narrow(0, 0, 32).unwrap()];
    let swapped = Tensor::cat(&halves, 0).unwrap();
    let file = |name: &str, tensors: [(&str, &Tensor); 2]| {
        let path = folder.path().join(name);
        save(&tensors.into_iter().map(|(key, t)| (key.to_owned(), t.clone())).collect(), &path);
        path
    };
    let module = "transformer.norm_out.linear";
    let [a, b] = ["lora_A", "lora_B"].map(|part| format!("{module}.{part}.weight"));
    let one = file("one", [(&a, &down), (&b, &up)]);
    let module = "lora_unet_final_layer_adaLN_modulation_1";
    let [a, b] = ["lora_down", "lora_up"].map(|part| format!("{module}.{part}.weight"));
    let other = file("other", [(&a, &down), (&b, &swapped)]);
    let edited = |lora: Option<&Path>| {
        let files = Files {
            transformer: fixture().join("transformer/diffusion_pytorch_model.safetensors"),
            vae: fixture().join("vae/diffusion_pytorch_model.safetensors"),
            prompt: prompt_file(folder.path(), &reference()),
            loras: lora.map(|path| (path.to_owned(), 0.5)).into_iter().collect(),
        };
        let kontext = Kontext::load(&files, &Device::Cpu, DType::F32).unwrap();
        let settings = Settings { steps: 1, guidance: 2.5, seed: 0, seamless: false };
        let noise = kontext.noise(64, 32, 0, 0).unwrap();
        let picture = Tensor::full(0.5_f32, (3, 32, 64), &Device::Cpu).unwrap();
        kontext.edit(&picture, &noise, &settings, &mut ()).unwrap()
    };
    assert_eq!(difference(&edited(Some(&one)), &edited(Some(&other))), 0.0);
    assert!(difference(&edited(Some(&one)), &edited(None)) > 1e-3);
}

#[test]
fn each_darker_picture_is_made_from_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let transformer = fixture().join("transformer/diffusion_pytorch_model.safetensors");
    let Kontext2 { kontext, settings, picture } = edited(&transformer, folder.path(), false);
    let made = kontext.darker(&picture, 2, &settings, &mut ()).unwrap();
    let noise = |stream| kontext.noise(128, 64, settings.seed, stream).unwrap();
    assert!(difference(&noise(0), &noise(1)) > 1.0);
    let first = kontext.edit(&picture, &noise(0), &settings, &mut ()).unwrap();
    let second = kontext.edit(&first, &noise(1), &settings, &mut ()).unwrap();
    assert_eq!((difference(&made[0], &first), difference(&made[1], &second)), (0.0, 0.0));
    assert_eq!(made[0].dims(), [3, 64, 128]);
    // Sizes are kept or refused, never changed.
    let odd = Tensor::zeros((3, 64, 120), DType::F32, &Device::Cpu).unwrap();
    let message = kontext.darker(&odd, 1, &settings, &mut ()).unwrap_err().to_string();
    assert!(message.contains("a picture of 120 x 64 pixels"), "{message}");
}

#[test]
fn what_is_wrong_with_a_lora_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let source = Source::open(&fixture().join("transformer/diffusion_pytorch_model.safetensors")).unwrap();
    let (config, _) = Transformer::survey(&source).unwrap();
    let good = tensors(&fixture().join("lora_diffusers.safetensors"));
    let said = |config: &Config, change: &dyn Fn(&mut BTreeMap<String, Tensor>)| {
        let mut changed = good.clone();
        change(&mut changed);
        let path = folder.path().join("lora.safetensors");
        save(&changed, &path);
        Lora::read(&path, config, &Device::Cpu).map(|lora| lora.layers()).map_err(|error| error.to_string())
    };
    // In each of two double blocks, the file changes the eight layers other than modulations. It also changes one
    // layer of each of three single blocks, and a second layer of one of them.
    assert_eq!(said(&config, &|_| ()).unwrap(), 20);
    let key = "transformer.transformer_blocks.1.ff.net.2.lora_A.weight";
    let message = said(&config, &|map| {
        let tensor = map.remove(key).unwrap();
        map.insert("transformer.transformer_blocks.1.ff.net.3.lora_A.weight".to_owned(), tensor);
    });
    assert!(message.unwrap_err().contains("`transformer.transformer_blocks.1.ff.net.3.lora_A.weight`"));
    let message = said(&config, &|map| {
        map.remove(key);
    });
    assert!(
        message
            .unwrap_err()
            .contains("one of the two matrices of `transformer_blocks.1.ff.net.2` is missing")
    );
    let message = said(&Config::kontext(), &|_| ()).unwrap_err();
    assert!(
        message.contains("the layer has 9216 x 3072") || message.contains("the layer has 3072 x"),
        "{message}"
    );
    let message = said(&config, &|map| {
        let nan = Tensor::full(f32::NAN, (4, 128), &Device::Cpu).unwrap();
        map.insert(key.to_owned(), nan);
    });
    assert!(message.unwrap_err().contains("contains NaN"));
}

/// Checks that a prompt with NaN, infinity or values that overflow f32 gives an error and no picture. This test
/// fails if `Kontext::decode` checks `is_sign_positive` instead of `is_finite`.
#[test]
fn a_model_that_overflows_makes_no_picture() {
    let folder = tempfile::tempdir().unwrap();
    let transformer = fixture().join("transformer/diffusion_pytorch_model.safetensors");
    let prompt = folder.path().join("extreme.safetensors");
    let vae = fixture().join("vae/diffusion_pytorch_model.safetensors");
    let settings = Settings { steps: 1, guidance: 2.5, seed: 0, seamless: false };
    let picture = Tensor::zeros((3, 32, 64), DType::F32, &Device::Cpu).unwrap();
    for value in [f32::NAN, f32::INFINITY, f32::MAX] {
        let of = |rows, columns| Tensor::full(value, (rows, columns), &Device::Cpu).unwrap();
        save(&BTreeMap::from([("t5".to_owned(), of(3, 24)), ("clip".to_owned(), of(1, 16))]), &prompt);
        let (transformer, vae, prompt) = (transformer.clone(), vae.clone(), prompt.clone());
        let files = Files { transformer, vae, prompt, loras: Vec::new() };
        let kontext = Kontext::load(&files, &Device::Cpu, DType::F32).unwrap();
        let message = kontext.darker(&picture, 1, &settings, &mut ()).unwrap_err().to_string();
        assert!(message.contains("NaN or infinity"), "{value}: {message}");
    }
}

#[test]
fn damaged_headers_are_refused_and_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (path, config) = (folder.path().join("a"), Config::kontext());
    let prompt = prompt_file(folder.path(), &reference());
    let mut gguf = b"GGUF\x03\0\0\0\x01\0\0\0\0\0\0\0\x01\0\0\0\0\0\0\0".to_vec();
    gguf.extend(17_u64.to_le_bytes());
    gguf.extend(b"general.alignment");
    gguf.extend(4_u32.to_le_bytes());
    gguf.extend(0_u32.to_le_bytes());
    for bytes in [std::fs::read(prompt).unwrap()[..600].to_vec(), gguf] {
        for cut in 0..bytes.len() {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            assert!(Source::open(&path).is_err());
        }
        // Each byte of the header is changed in turn.
        for at in 0..bytes.len().min(400) {
            let mut changed = bytes.clone();
            changed[at] ^= 0x55;
            std::fs::write(&path, &changed).unwrap();
            if let Ok(source) = Source::open(&path) {
                let _ = Transformer::survey(&source).map(|_| ());
                let _ = Prompt::read(&path, &config, &Device::Cpu);
            }
        }
    }
    assert!(Source::open(&path).is_err());
}

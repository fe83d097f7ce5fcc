//! Tests with the keys of the published model: every key of its files is used, and the memory estimate is correct.
//! The test files are sparse and contain only headers, and no weights are read.

use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use learned::flux::{Config, Error, Memory, Source, Tally, Transformer, VaeConfig};

use crate::fixture;

/// The size of an axis in the published model that corresponds to the size `size` in the small test model.
fn grown(key: &str, size: usize) -> usize {
    match size {
        32 => 3072,
        64 => 6144,
        96 => 9216,
        128 => 12288,
        160 => 15360,
        192 => 18432,
        224 => 21504,
        24 => 4096,
        16 if key.contains("norm") => 128,
        16 if key.contains("vector_in") || key.contains("text_embedder") => 768,
        16 => 64,
        other => other,
    }
}

/// The keys and shapes of the published model. They are derived from a file of the small model: its blocks are
/// repeated, and its sizes are replaced with the sizes of the published model.
fn keys(file: &str) -> Vec<(String, Vec<usize>)> {
    let small = Source::open(&fixture().join(file)).unwrap();
    let mut list = Vec::new();
    for (key, entry) in small.entries() {
        let shape: Vec<usize> = entry.shape.iter().map(|size| grown(key, *size)).collect();
        let words: Vec<&str> = key.split('.').collect();
        let blocks = match words[0] {
            "transformer_blocks" | "double_blocks" => 19,
            "single_transformer_blocks" | "single_blocks" => 38,
            _ => {
                list.push((key.clone(), shape));
                continue;
            }
        };
        // The first block stands for all.
        if words[1] == "0" {
            let name = |i: usize| format!("{}.{i}.{}", words[0], words[2..].join("."));
            list.extend((0..blocks).map(|i| (name(i), shape.clone())));
        }
    }
    list
}

fn safetensors(path: &Path, keys: &[(String, Vec<usize>)]) {
    let mut start = 0;
    let mut header = serde_json::Map::new();
    for (key, shape) in keys {
        let end = start + 2 * shape.iter().product::<usize>();
        let entry = serde_json::json!({ "dtype": "BF16", "shape": shape, "data_offsets": [start, end] });
        header.insert(key.clone(), entry);
        start = end;
    }
    let text = serde_json::to_vec(&header).unwrap();
    let mut file = File::create(path).unwrap();
    file.write_all(&(text.len() as u64).to_le_bytes()).unwrap();
    file.write_all(&text).unwrap();
    file.set_len((8 + text.len() + start) as u64).unwrap();
}

/// Writes a GGUF file that contains matrices with four bits per weight and all other tensors in f32, as the usual
/// converters do.
fn gguf(path: &Path, keys: &[(String, Vec<usize>)]) {
    let mut file = File::create(path).unwrap();
    let mut put = |bytes: &[u8]| file.write_all(bytes).unwrap();
    put(b"GGUF");
    put(&3_u32.to_le_bytes());
    put(&(keys.len() as u64).to_le_bytes());
    put(&2_u64.to_le_bytes());
    for (key, value) in [("general.architecture", "flux"), ("general.name", "zeros")] {
        put(&(key.len() as u64).to_le_bytes());
        put(key.as_bytes());
        put(&8_u32.to_le_bytes());
        put(&(value.len() as u64).to_le_bytes());
        put(value.as_bytes());
    }
    let mut start = 0;
    for (key, shape) in keys {
        put(&(key.len() as u64).to_le_bytes());
        put(key.as_bytes());
        put(&(shape.len() as u32).to_le_bytes());
        shape.iter().rev().for_each(|size| put(&(*size as u64).to_le_bytes()));
        let count = shape.iter().product::<usize>();
        let (code, bytes) = if shape.len() == 2 { (2_u32, count / 32 * 18) } else { (0, count * 4) };
        put(&code.to_le_bytes());
        put(&(start as u64).to_le_bytes());
        start += bytes.next_multiple_of(32);
    }
    let end = file.stream_position().unwrap() + 32 + start as u64;
    file.set_len(end).unwrap();
}

fn peak_of_this_process() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM"));
    line.unwrap_or("unknown").replace(['\t', ' '], "")
}

#[test]
fn every_key_of_the_published_model_finds_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let vae = VaeConfig::flux();
    let diffusers = keys("transformer/diffusion_pytorch_model.safetensors");
    let original = keys("transformer_bfl.safetensors");
    println!(
        "| file | tensors | weights | in memory | one matrix widened | computed at 1440 x 720 | at 512 x 256 |\n|---|---|---|---|---|---|---|"
    );
    let mut tallies: Vec<(PathBuf, Tally)> = Vec::new();
    for (name, keys, write) in [
        ("diffusers-bf16.safetensors", &diffusers, safetensors as fn(&Path, &[(String, Vec<usize>)])),
        ("original-bf16.safetensors", &original, safetensors),
        ("original-q4_0.gguf", &original, gguf),
    ] {
        let path = folder.path().join(name);
        write(&path, keys);
        let (config, tally) = Transformer::survey(&Source::open(&path).unwrap()).unwrap();
        assert_eq!(config, Config::kontext(), "{name}");
        let at = |size| Memory::of((&config, &tally), (&vae, &Tally::default()), size, 512);
        let gb = |bytes: u64| format!("{:.2} GB", bytes as f64 / 1e9);
        let (large, small) = (at((1440, 720)), at((512, 256)));
        println!(
            "| {name} | {} | {} | {} | {} | {} | {} |",
            tally.tensors,
            tally.weights,
            gb(large.weights),
            gb(large.widened),
            gb(large.activations),
            gb(small.activations)
        );
        // The memory that is requested before a file is opened suffices for each file.
        assert!(large.total() - large.weights <= Memory::published((1440, 720)), "{name}");
        tallies.push((path, tally));
    }
    println!("peak memory of the process that mapped them: {}", peak_of_this_process());
    // The published number of weights.
    assert!(tallies.iter().all(|(_, tally)| tally.weights == 11_901_408_320), "{tallies:?}");
    let resident: Vec<u64> = tallies.iter().map(|(_, tally)| tally.resident).collect();
    assert!(
        resident[0] == resident[1] && resident[0] < 23_900_000_000 && resident[2] < 6_800_000_000,
        "{resident:?}"
    );
}

#[test]
fn a_key_too_many_or_too_few_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let said = |keys: &[(String, Vec<usize>)]| {
        safetensors(&path, keys);
        let survey = Source::open(&path).and_then(|source| Transformer::survey(&source));
        survey.map(|_| ()).map_err(|error: Error| error.to_string()).expect_err("is wrong")
    };
    let keys = keys("transformer_bfl.safetensors");
    let mut more = keys.clone();
    more.push(("vae.encoder.conv_in.weight".to_owned(), vec![8, 3, 3, 3]));
    let message = said(&more);
    assert!(
        message.contains(
            "the file contains tensors that do not belong to this part of the model: `vae.encoder.conv_in.weight`"
        ),
        "{message}"
    );
    let at = |name: &str| keys.iter().position(|(key, _)| key == name).unwrap();
    let mut fewer = keys.clone();
    fewer.remove(at("double_blocks.7.txt_mlp.2.bias"));
    let message = said(&fewer);
    assert!(message.contains("`double_blocks.7.txt_mlp.2.bias` is missing"), "{message}");
    let mut other = keys.clone();
    other[at("single_blocks.3.linear1.weight")].1 = vec![21504, 3000];
    let message = said(&other);
    assert!(
        message.contains("`single_blocks.3.linear1.weight` has the wrong shape [21504, 3000]"),
        "{message}"
    );
    assert!(said(&[]).contains("is not a Flux transformer"));
    // A file that was truncated while it was copied.
    safetensors(&path, &keys);
    let length = std::fs::metadata(&path).unwrap().len();
    File::options().write(true).open(&path).unwrap().set_len(length - 1).unwrap();
    assert!(Source::open(&path).unwrap_err().to_string().contains("copy the file again"));
}

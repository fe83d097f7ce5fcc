//! Measures the cost of repeatedly rotating the object and rendering it with two samples per pixel. Prints the CPU
//! seconds and a digest of the pictures. If a change of the program leaves the digest unchanged, it affects only
//! the speed.

use nodes::kinds::path_trace::surroundings::Surroundings;
use testkit::{Case, Data, denoised};

/// Prints the minimum and the median CPU seconds of `rounds` rounds, and a digest of the pictures of the last
/// round.
pub fn seconds(data: &Data, rounds: u32) {
    let case = Case::load(data, "sunny_plane");
    let mut lists = [const { Vec::new() }; 5];
    let mut digest = String::new();
    for _ in 0..rounds {
        let trace = |with| case.trace(1, 2, with, Surroundings::OPEN);
        let (alone, all) = (trace(false), trace(true));
        let (filtered, filter) = denoised(&all.out, data);
        let reported = [alone.setup, all.setup, alone.seconds, all.seconds - alone.seconds, filter];
        lists.iter_mut().zip(reported).for_each(|(list, seconds)| list.push(seconds));
        let mut hasher = blake3::Hasher::new();
        let out = &all.out;
        let pictures = [&out.without, &out.with, &out.object, &out.depth, &out.normal, &out.variance];
        for images in pictures.into_iter().chain([&filtered.without, &filtered.with, &filtered.object]) {
            images.0[0].picture.samples().iter().for_each(|v| {
                hasher.update(&v.to_le_bytes());
            });
        }
        digest = hasher.finalize().to_hex()[..16].to_owned();
    }
    for (name, list) in ["setup alone", "setup", "without", "objects", "filter"].into_iter().zip(&mut lists) {
        list.sort_by(f64::total_cmp);
        println!("{name}: minimum {:.4}, median {:.4} CPU-s", list[0], list[list.len() / 2]);
    }
    println!("digest {digest}");
}

//! Prints the tables of `docs/evidence/trace.md`: the error of each output of `path-trace`, and the CPU seconds
//! spent, for several numbers of samples per pixel. Run it as `cargo bench -p lightharmony-testkit --bench trace --
//! DATA [plane|ratio|rooms|crop|turn|rays] [SAMPLES ..]`, where DATA is a folder with `render-refs` and `gltf`.
//! `ratio` takes numbers of samples. `small` only checks that `plane` and `ratio` run. `rays` compares with Embree
//! if it is installed. `peers OUT SAMPLES ..` is used by `tests/tables/peers.py`.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a benchmark prints its results and may panic")]

mod error;
mod peers;
mod ratio;
mod rays;
mod turn;

use std::path::Path;

use engine::Up;
use testkit::Data;

fn main() {
    let mut words = std::env::args().skip(1).filter(|arg| !arg.starts_with("--"));
    let data =
        Data::of(Path::new(&words.next().expect("the first argument must be the data folder")), Up::PlusY, 1);
    let (numbers, wanted): (Vec<String>, Vec<String>) = words.partition(|word| word.parse::<u32>().is_ok());
    let samples: Vec<u32> = numbers.iter().map(|word| word.parse().unwrap()).collect();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let asked = |name: &str| wanted.is_empty() || wanted.iter().any(|word| word == name);
    one.install(|| {
        let small = wanted.iter().any(|word| word == "small");
        if asked("plane") {
            error::plane(&data, small);
        }
        if asked("ratio") {
            let numbers: &[u32] = if small { &[2, 4] } else { &[2, 4, 8, 16, 64] };
            ratio::table(&data, if samples.is_empty() { numbers } else { &samples }, small);
        }
        if asked("rooms") {
            error::rooms(&data);
        }
        if asked("crop") {
            error::crop(&data);
        }
        if let Some(at) = wanted.iter().position(|word| word == "peers") {
            peers::once(
                &data,
                Path::new(wanted.get(at + 1).expect("`peers` needs an output folder")),
                &samples,
            );
        }
        if wanted.iter().any(|word| word == "turn") {
            turn::seconds(&data, samples.first().copied().unwrap_or(9));
        }
        if asked("rays") {
            rays::table(&data);
        }
    });
}

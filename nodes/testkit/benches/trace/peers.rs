//! One round of the comparison with other programs by `tests/tables/peers.py`: prints the CPU seconds as a line of
//! JSON, and writes pictures to files.

use std::path::Path;
use std::sync::Arc;

use nodes::kinds::path_trace::surroundings::Surroundings;
use scene::types::Images;
use testkit::{Case, Data, denoised, rgb};

fn write(path: &Path, images: &Images) {
    let bytes: Vec<u8> = rgb(images).into_iter().flat_map(f32::to_le_bytes).collect();
    std::fs::write(path, bytes).unwrap();
}

/// Measures the CPU seconds of one thread for each number of samples. Prints the times for setup, for tracing the
/// receiver alone and for denoising, and the additional times for tracing the object and for tracing only its
/// shadow. Loading is not included. Writes `without` and `with`, each with and without denoising, to `folder`, as
/// RGB in little-endian f32.
pub fn once(data: &Data, folder: &Path, numbers: &[u32]) {
    let case = Case::load(data, "sunny_plane");
    std::fs::create_dir_all(folder).unwrap();
    for &samples in numbers {
        let how = Surroundings::OPEN;
        let alone = case.trace(1, samples, false, how);
        let all = case.trace(1, samples, true, how);
        let shadow = case.shadow(1, samples, how);
        // One sample has no variance, so nothing can be filtered.
        let (clean, filter) = denoised(&all.out, data);
        assert_eq!(rgb(&shadow.out.with), rgb(&all.out.with), "`shadow_only` must not change the shadow");
        let pictures = [
            ("without", Arc::clone(&all.out.without)),
            ("with", Arc::clone(&all.out.with)),
            ("clean-without", clean.without),
            ("clean-with", clean.with),
        ];
        for (name, images) in pictures {
            write(&folder.join(format!("{name}-{samples}")), &images);
        }
        let reported = serde_json::json!({
            "samples": samples,
            "setup": all.setup,
            "without": alone.seconds,
            "objects": all.seconds - alone.seconds,
            "shadow": shadow.seconds - alone.seconds,
            "filter": filter,
        });
        println!("{reported}");
    }
}

//! Open Image Denoise, Intel's denoiser, which is also used in Blender. The library is loaded at run time if it is
//! installed.
//!
//! The crate passes arrays of colours to the library and does not depend on graphs or images. [`find()`] looks for
//! the library and reports the searched folders if it is not found. [`Installation::load`] loads it. [`Library::denoise`]
//! filters one picture on the calling thread. Only version 2 for Linux is supported; version 1 has other function
//! names.

mod find;
mod library;

pub use find::{Installation, Missing, find};
pub use library::{Library, MEMORY_BYTES, Surfaces};

/// Errors that occur when the library is loaded or used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The caller stopped the filter.
    #[error("stopped")]
    Stopped,
    /// The file is not the expected library.
    #[error("`{path}` cannot be loaded: {why}")]
    Load {
        /// The file.
        path: String,
        /// The error message of the dynamic linker.
        why: String,
    },
    /// The library reported an error.
    #[error("Open Image Denoise {version} failed: {why}")]
    Failed {
        /// Version of the library.
        version: String,
        /// The error message of the library.
        why: String,
    },
}

#[cfg(test)]
mod tests {
    #![allow(clippy::print_stderr, reason = "skipped tests are printed")]

    use super::*;

    const SIZE: [usize; 2] = [48, 40];

    /// Returns the library if it is installed. Otherwise prints that the test `test` is skipped.
    fn installed(test: &str) -> Option<Library> {
        match find() {
            Ok(found) => Some(found.load().expect("what is installed can be loaded")),
            Err(missing) => {
                eprintln!("{test} is skipped: {missing}");
                None
            }
        }
    }

    /// A noisy grey picture whose mean is 1 in the left half and 0.25 in the right half.
    fn noisy() -> Vec<f32> {
        let pixel = |i: usize| {
            let noise = ((i as u32).wrapping_mul(0x9e37_79b9) >> 16) as f32 / 65536.0;
            let grey = if i % SIZE[0] < SIZE[0] / 2 { 1.0 } else { 0.25 };
            [grey * (0.5 + noise); 3]
        };
        (0..SIZE[0] * SIZE[1]).flat_map(pixel).collect()
    }

    fn error(pixels: &[f32]) -> f32 {
        let truth = |i: usize| if i / 3 % SIZE[0] < SIZE[0] / 2 { 1.0 } else { 0.25 };
        let squares = pixels.iter().enumerate().map(|(i, v)| (v - truth(i)) * (v - truth(i)));
        (squares.sum::<f32>() / pixels.len() as f32).sqrt()
    }

    // This test fails if `denoise` passes width and height to `set_image` in the wrong order.
    #[test]
    fn where_it_is_installed_noise_goes_and_the_edge_stays() {
        let Some(library) = installed("where_it_is_installed_noise_goes_and_the_edge_stays") else { return };
        let colour = noisy();
        let on = || true;
        let alone = library.denoise(SIZE, &colour, None, &on).expect("filters");
        assert!(error(&alone) * 3.0 < error(&colour), "{} of {}", error(&alone), error(&colour));
        let (albedo, normal) = (vec![0.5; colour.len()], [0.0, 0.0, 1.0].repeat(SIZE[0] * SIZE[1]));
        let surfaces = Some(Surfaces { albedo: &albedo, normal: &normal });
        let guided = library.denoise(SIZE, &colour, surfaces, &on).expect("filters");
        assert!(error(&guided) * 3.0 < error(&colour), "{} of {}", error(&guided), error(&colour));
        assert_ne!(alone, guided, "surfaces count");
        assert_eq!(alone, library.denoise(SIZE, &colour, None, &on).expect("filters"), "the same again");
    }

    #[test]
    fn where_it_is_installed_it_stops_when_reported() {
        let Some(library) = installed("where_it_is_installed_it_stops_when_reported") else { return };
        let stopped = library.denoise(SIZE, &noisy(), None, &|| false);
        assert_eq!(stopped, Err(Error::Stopped));
    }

    #[test]
    fn what_is_not_the_library_is_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("libOpenImageDenoise.so.2");
        std::fs::write(&path, b"\0libOpenImageDenoise_core.so.2.3.3\0").expect("is written");
        let error = Installation { path, version: "2.3.3".to_owned() }.load().err().expect("not a library");
        let text = error.to_string();
        assert!(text.contains("libOpenImageDenoise.so.2` cannot be loaded: "), "{text}");
    }
}

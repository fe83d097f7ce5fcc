//! What unit tests share.

use engine::{Context, Scene, Up};
use fearless_simd::Level;

use crate::types::{SplatEncoding, Splats};

#[path = "../../tests/extremes/row.rs"]
mod row;

pub use row::row;

/// A context outside of any run: z up, metres, seed 7.
pub fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7 }, ".")
}

/// A scene of degree 0 without splats.
pub fn no_splats() -> Splats {
    Splats {
        means: Vec::new(),
        means_low: Vec::new(),
        quats: Vec::new(),
        scales: Vec::new(),
        opacities: Vec::new(),
        sh_degree: 0,
        sh: Vec::new(),
        encoding: SplatEncoding::Srgb,
        antialiased: false,
    }
}

/// Every set of vector instructions that this machine has.
pub fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = vec![Level::baseline()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse2().map(Level::Sse2));
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_avx512().map(Level::Avx512));
    }
    levels.push(best);
    levels
}

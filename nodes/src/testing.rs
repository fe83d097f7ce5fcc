//! What unit tests share.

use engine::{Context, Scene, Up};

/// A context outside of any run: z up, metres, seed 7.
pub fn context() -> Context {
    Context::detached(Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 7 }, ".")
}

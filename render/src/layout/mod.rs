//! Places in a captured scene where an object may stand, and cameras that see them well.

mod arrange;
mod camera;
mod grid;
mod surface;

pub use arrange::{Arrangement, Extents, arrange};
pub use camera::{Subject, Viewpoint, best_view};
pub use grid::Grid;
pub use surface::{Surface, Wish, surfaces};

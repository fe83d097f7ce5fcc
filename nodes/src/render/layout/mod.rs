//! Where in a captured scene an object may stand, and from where it is seen well.

mod arrange;
mod camera;
mod grid;
mod surface;

pub use arrange::{Arrangement, Extents, arrange};
pub use camera::{Subject, View, best_view};
pub use grid::Grid;
pub use surface::{Surface, Wish, surfaces};

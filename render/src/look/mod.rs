//! Pictures of a scene for a person who does not know it: a plan from above, and views with their cameras.

mod canvas;
mod plan;
mod solid;
mod views;

pub use canvas::Canvas;
pub use plan::{Plan, below};
pub use solid::{of_mesh, of_object};
pub use views::views;

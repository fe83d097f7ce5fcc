//! Training of Gaussian splats from photographs, on the CPU.
//!
//! One iteration renders one photograph's view with the renderer of [`crate::splat`], compares it with the
//! photograph ([`loss`]), computes the gradients of all splats that were blended, and moves those splats with Adam
//! ([`adam`]). Splats that have faded are moved to others, and more are added until the budget is reached
//! (`relocate`), as in "3D Gaussian Splatting as Markov Chain Monte Carlo" (Kheradmand et al. 2024).
//!
//! An iteration is a function of the state before it, the photographs, the settings and its number, and gives the
//! same bits for any number of threads and any instruction set. It does not depend on the number of iterations that
//! follow, so a longer training continues a shorter one.

pub mod adam;
pub mod init;
pub mod loss;
mod random;
mod relocate;
pub mod schedule;
pub mod state;
pub mod step;
#[cfg(test)]
mod tests;
mod window;

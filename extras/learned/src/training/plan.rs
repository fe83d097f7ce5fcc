//! Settings and progress of a training run.

use crate::exposure::Recipe;

/// Settings of a training run.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of networks whose predictions are averaged.
    pub members: usize,
    /// Number of folds of the cross-validation; 0 for no cross-validation.
    pub folds: usize,
    /// Number of procedural panoramas.
    pub procedural: u32,
    /// Training parameters of the networks.
    pub recipe: Recipe,
}

/// Progress of a training run.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress {
    /// Number of panoramas that have been photographed, and number of all panoramas.
    Examples(usize, usize),
    /// A step of a network.
    Step {
        /// Number of the network that is trained, counted from 1.
        network: usize,
        /// Number of networks to train.
        networks: usize,
        /// Number of the step, counted from 1.
        step: usize,
        /// Number of steps of each network.
        steps: usize,
        /// Mean loss since the last report.
        loss: f32,
    },
}

//! Forward pass of small convolutional networks. Every sum has a fixed order, so it gives the same bits on every
//! machine and for any number of threads. No tensor library is used, since in such libraries the order depends on
//! the machine.

mod conv;
mod tensor;
mod weights;

pub use conv::{Conv, max_pool, relu};
pub use tensor::Tensor;
pub use weights::Weights;

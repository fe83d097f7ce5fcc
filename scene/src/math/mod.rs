//! Numbers: portable transcendental functions, colour, equirectangular coordinates, a small neural network, and
//! metrics of pictures. Everything gives the same bits on every machine.

pub mod color;
pub mod equirect;
pub mod metrics;
pub mod nn;
pub mod num;

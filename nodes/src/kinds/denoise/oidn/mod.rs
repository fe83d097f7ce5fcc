//! `Method::Oidn`: filters the ratio and the object with Open Image Denoise.

#[cfg(not(feature = "oidn"))]
mod absent;
#[cfg(feature = "oidn")]
mod present;

#[cfg(not(feature = "oidn"))]
pub(super) use absent::{bytes, filter, report, sources};
#[cfg(feature = "oidn")]
pub(super) use present::{bytes, filter, report, sources};

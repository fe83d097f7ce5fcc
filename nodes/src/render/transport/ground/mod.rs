//! Analysis before pixels are traced: the surfaces that objects rest on, and the point of capture.

pub(crate) mod capture_point;
pub mod contact;
pub(crate) mod embedded;
pub(crate) mod light_share;
pub(crate) mod limits;
pub(crate) mod probe;
pub(crate) mod side;
pub(crate) mod standing;

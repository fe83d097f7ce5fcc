//! Analysis before pixels are traced: the surfaces that objects rest on, and the point of capture.

pub mod capture_point;
pub mod contact;
pub mod embedded;
pub mod light_share;
pub mod limits;
pub mod probe;
pub mod side;
pub mod standing;

//! Results that several machines share.
//!
//! [`reapi::SharedCache`] reads results from a server, and stores new ones there.
//!
//! [`SecretKey`], [`TrustedKeys`] and [`signed`] decide which results of other users are used: only results that
//! are signed by a trusted key. The signature covers the key of the result and the digests of its values, so a
//! result that the server or another user has changed is detected.

mod config;
mod credentials;
mod public_key;
pub mod reapi;
mod secret_key;
pub mod signed;
#[cfg(test)]
mod testing;
mod trust_error;
mod trusted_keys;

pub use config::Config;
pub use credentials::Credentials;
pub use public_key::PublicKey;
pub use secret_key::SecretKey;
pub use trust_error::TrustError;
pub use trusted_keys::{Standing, TrustedKeys};

//! Public keys, which verify signatures.

use std::fmt;
use std::str::FromStr;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::{Signature, VerifyingKey};

use crate::trust_error::TrustError;

/// Maximum length of a name in bytes.
const LONGEST_NAME: usize = 64;

/// A public key of Ed25519 with a name. The name is only for display: two keys are equal if their bytes are equal.
/// The text form is `NAME:BASE64`.
#[derive(Debug, Clone)]
pub struct PublicKey {
    name: String,
    /// The key, which is a valid point of the curve.
    bytes: [u8; 32],
}

impl PartialEq for PublicKey {
    fn eq(&self, other: &Self) -> bool {
        self.bytes == other.bytes
    }
}

impl Eq for PublicKey {}

impl PublicKey {
    pub(crate) fn new(name: String, key: &VerifyingKey) -> Self {
        Self { name, bytes: key.to_bytes() }
    }

    /// Makes a key from its 32 bytes; `None` if the bytes or the name are not valid.
    pub(crate) fn from_bytes(name: String, bytes: &[u8]) -> Option<Self> {
        let bytes = bytes.try_into().ok()?;
        let key = VerifyingKey::from_bytes(&bytes).ok()?;
        // With a weak key, a signature could be valid for several messages.
        (is_name(&name) && !key.is_weak()).then_some(Self { name, bytes })
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The 32 bytes.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.bytes
    }

    /// True if the owner of this key signed the message.
    pub(crate) fn verifies(&self, message: &[u8], signature: &[u8; 64]) -> bool {
        let signature = Signature::from_bytes(signature);
        VerifyingKey::from_bytes(&self.bytes).is_ok_and(|key| key.verify_strict(message, &signature).is_ok())
    }
}

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.name, STANDARD.encode(self.as_bytes()))
    }
}

impl FromStr for PublicKey {
    type Err = TrustError;

    fn from_str(text: &str) -> Result<Self, TrustError> {
        let wrong = || TrustError::NoPublicKey(text.to_owned());
        let (name, key) = text.trim().split_once(':').ok_or_else(wrong)?;
        if !is_name(name) {
            return Err(TrustError::Name(name.to_owned()));
        }
        let bytes = STANDARD.decode(key).map_err(|_| wrong())?;
        Self::from_bytes(name.to_owned(), &bytes).ok_or_else(wrong)
    }
}

/// True if a name is valid for a key. Names appear in files and in messages.
pub(crate) fn is_name(name: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_');
    (1..=LONGEST_NAME).contains(&name.len()) && name.bytes().all(allowed)
}

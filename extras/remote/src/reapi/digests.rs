//! Digests in the digest function of the server.

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use sha2::{Digest as _, Sha256};

/// The digest functions of the protocol that this client supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Function {
    Blake3,
    Sha256,
}

impl Function {
    /// The best function that a server offers. BLAKE3 is faster, and is the function of the store.
    pub fn of(offered: &[i32]) -> Option<Self> {
        [Self::Blake3, Self::Sha256].into_iter().find(|function| offered.contains(&function.number()))
    }

    /// The number of the function in the protocol.
    pub fn number(self) -> i32 {
        match self {
            Self::Blake3 => api::digest_function::Value::Blake3.into(),
            Self::Sha256 => api::digest_function::Value::Sha256.into(),
        }
    }

    /// The digest of some bytes.
    pub fn of_bytes(self, bytes: &[u8]) -> api::Digest {
        let hash = match self {
            Self::Blake3 => cache::Digest::of(bytes).to_string(),
            Self::Sha256 => Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect(),
        };
        api::Digest { hash, size_bytes: bytes.len() as i64 }
    }

    /// The last part of the name of a blob in a stream. The name of the function is left out for the functions of
    /// the first version of the protocol.
    pub fn blob_name(self, digest: &api::Digest) -> String {
        let function = if self == Self::Blake3 { "blake3/" } else { "" };
        format!("blobs/{function}{}/{}", digest.hash, digest.size_bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_those_of_the_protocol() {
        // The first is in FIPS 180-2, the second in the test vectors of BLAKE3.
        let of_abc = Function::Sha256.of_bytes(b"abc");
        assert_eq!(of_abc.hash, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(Function::Sha256.blob_name(&of_abc), format!("blobs/{}/3", of_abc.hash));
        let empty = Function::Blake3.of_bytes(b"");
        assert_eq!(empty.hash, "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262");
        assert_eq!(Function::Blake3.blob_name(&empty), format!("blobs/blake3/{}/0", empty.hash));
        assert_eq!((Function::Blake3.number(), Function::Sha256.number()), (9, 1));
        assert_eq!(Function::of(&[1, 9]), Some(Function::Blake3));
        assert_eq!(Function::of(&[2, 1]), Some(Function::Sha256));
        assert_eq!(Function::of(&[2, 4]), None);
    }
}

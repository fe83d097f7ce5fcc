//! [`DigestHasher`]: a cheap hash for keys that are uniformly distributed.

use std::hash::Hasher;

/// Hasher of an entry's kind and digest. It mixes the kind with the first 8 bytes of the digest. Digests are
/// uniformly distributed, so no stronger hash is needed.
#[derive(Debug, Default)]
pub(crate) struct DigestHasher(u64);

impl Hasher for DigestHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.write_u64(u64::from(*byte)));
    }

    fn write_u8(&mut self, value: u8) {
        self.write_u64(u64::from(value));
    }

    fn write_u64(&mut self, value: u64) {
        self.0 = self.0.rotate_left(5).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ value;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

//! Signed entries: the form in which results are shared.
//!
//! A signed entry is `MAGIC`, the name and the 32 bytes of the public key, the 64 bytes of the signature, and the
//! [`Entry`]. Each of these is preceded by its length. The Ed25519 signature covers the text
//! `lightharmony-record-1`, the key of the result, and the BLAKE3 digest of the entry. Since the entry contains the
//! digests of the values, the signature covers the values as well.

use cache::Digest;
use engine::{Corrupt, Decoder, Encoder, Entry};

use crate::public_key::PublicKey;
use crate::secret_key::SecretKey;
use crate::trusted_keys::{Standing, TrustedKeys};

const MAGIC: &str = "lightharmony signed 1";
/// Start of every signed message, so that a signature made for another purpose is never valid for an entry.
const PURPOSE: &[u8] = b"lightharmony-record-1";

/// The reason why an entry from a server is not used.
#[derive(Debug, thiserror::Error)]
pub enum Distrust {
    /// The bytes are not a signed entry.
    #[error("the entry is not signed")]
    Unsigned,
    /// The key that signed the entry is not in the list of trusted keys.
    #[error("the entry is signed by the key {name}, which is not trusted; if you trust the owner of this key, run `lightharmony key trust {0}`", name = .0.name())]
    Unknown(PublicKey),
    /// The key that signed the entry was revoked.
    #[error("the entry is signed by the key {}, which was revoked", .0.name())]
    Revoked(PublicKey),
    /// The signature does not match the content.
    #[error("the signature of the entry by the key {} is not valid", .0.name())]
    Forged(PublicKey),
    /// The signature is valid, but the entry is damaged or belongs to another result.
    #[error("the entry is damaged: {0}")]
    Damaged(#[from] Corrupt),
}

/// Signs an entry.
pub fn seal(entry: &Entry, by: &SecretKey) -> Vec<u8> {
    let (bytes, public) = (entry.encode(), by.public());
    let signature = by.sign(&message(&entry.key, &bytes));
    let mut to = Encoder::default();
    to.str(MAGIC);
    to.str(public.name());
    to.u8s(public.as_bytes());
    to.u8s(&signature);
    to.u8s(&bytes);
    to.finish()
}

/// Decodes the signed entry of the result with the key `key`, and checks that it is signed by a trusted key.
///
/// # Errors
/// The reason why the entry is not used.
pub fn open(bytes: &[u8], key: &Digest, trusted: &TrustedKeys) -> Result<Entry, Distrust> {
    let (public, signature, entry) = parts(bytes).ok_or(Distrust::Unsigned)?;
    match trusted.standing(&public) {
        Standing::Trusted => {}
        Standing::Unknown => return Err(Distrust::Unknown(public)),
        Standing::Revoked => return Err(Distrust::Revoked(public)),
    }
    if !public.verifies(&message(key, &entry), &signature) {
        return Err(Distrust::Forged(public));
    }
    Ok(Entry::decode(&entry, key)?)
}

fn parts(bytes: &[u8]) -> Option<(PublicKey, [u8; 64], Vec<u8>)> {
    let mut from = Decoder::new(bytes);
    if from.str().ok()? != MAGIC {
        return None;
    }
    let (name, public) = (from.str().ok()?, from.u8s().ok()?);
    let (signature, entry) = (from.u8s().ok()?, from.u8s().ok()?);
    from.end().ok()?;
    Some((PublicKey::from_bytes(name, &public)?, signature.try_into().ok()?, entry))
}

fn message(key: &Digest, entry: &[u8]) -> Vec<u8> {
    [PURPOSE, key.as_bytes(), Digest::of(entry).as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::entry;

    struct Keys {
        mine: SecretKey,
        other: SecretKey,
        trusted: TrustedKeys,
        _folder: tempfile::TempDir,
    }

    fn keys() -> Keys {
        let folder = tempfile::tempdir().expect("a folder");
        let key = |name: &str| SecretKey::create(&folder.path().join(name), name).expect("a key");
        let (mine, other) = (key("mine"), key("other"));
        let mut trusted = TrustedKeys::read(&folder.path().join("trusted")).expect("an empty list");
        trusted.trust(&mine.public()).expect("trusts");
        Keys { mine, other, trusted, _folder: folder }
    }

    #[test]
    fn only_entries_of_trusted_keys_are_read() {
        let Keys { mine, other, mut trusted, _folder } = keys();
        let (first, second) = (entry(1), entry(2));
        let sealed = seal(&first, &mine);
        assert_eq!(open(&sealed, &first.key, &trusted).expect("it is good"), first);
        let refused =
            |bytes: &[u8], trusted: &TrustedKeys| open(bytes, &first.key, trusted).expect_err("refused");
        assert!(matches!(refused(&first.encode(), &trusted), Distrust::Unsigned));
        assert!(matches!(refused(&[], &trusted), Distrust::Unsigned));
        let by_other = seal(&first, &other);
        let error = refused(&by_other, &trusted);
        assert!(
            error.to_string().contains(&format!("`lightharmony key trust {}`", other.public())),
            "{error}"
        );
        // A signature of one result is not one of another.
        assert!(matches!(refused(&seal(&second, &mine), &trusted), Distrust::Forged(_)));
        trusted.trust(&other.public()).expect("trusts");
        assert_eq!(open(&by_other, &first.key, &trusted).expect("it is good"), first);
        trusted.revoke(&other.public()).expect("revokes");
        assert!(matches!(refused(&by_other, &trusted), Distrust::Revoked(_)));
    }

    /// Every byte that is changed, and every byte that is missing, makes the whole entry useless.
    #[test]
    fn no_changed_byte_is_accepted() {
        let Keys { mine, trusted, .. } = keys();
        let entry = entry(1);
        let sealed = seal(&entry, &mine);
        for at in 0..sealed.len() {
            for bit in 0..8 {
                let mut bad = sealed.clone();
                bad[at] ^= 1 << bit;
                // The name of the key is not signed: it is only shown.
                match open(&bad, &entry.key, &trusted) {
                    Err(_) => {}
                    Ok(read) => {
                        assert_eq!(read, entry, "byte {at}");
                        let name = 8 + MAGIC.len() + 8..8 + MAGIC.len() + 8 + "mine".len();
                        assert!(name.contains(&at), "byte {at}");
                    }
                }
            }
            assert!(open(&sealed[..at], &entry.key, &trusted).is_err(), "cut to {at} bytes");
        }
        assert!(open(&[sealed.as_slice(), &[0]].concat(), &entry.key, &trusted).is_err());
    }
}

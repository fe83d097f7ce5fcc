//! Secret keys, which sign results.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::{Signer, SigningKey};

use crate::credentials;
use crate::public_key::{PublicKey, is_name};
use crate::trust_error::TrustError;

/// First word of the file. It prevents a secret key from being mistaken for a public key.
const WORD: &str = "secret";
/// Maximum length of the file in bytes.
const LONGEST: u64 = 1024;

/// A secret key of Ed25519 with its name. It has a text form only in its file, so that it cannot appear in a
/// message or a log.
pub struct SecretKey {
    name: String,
    key: SigningKey,
}

impl SecretKey {
    /// Makes a new key and writes it to a new file that only its owner can read.
    ///
    /// # Errors
    /// If the name is not valid, the file exists or cannot be written, or random bytes are not available.
    pub fn create(path: &Path, name: &str) -> Result<Self, TrustError> {
        if !is_name(name) {
            return Err(TrustError::Name(name.to_owned()));
        }
        let mut seed = [0; 32];
        getrandom::fill(&mut seed).map_err(|error| TrustError::Random(error.to_string()))?;
        let key = Self { name: name.to_owned(), key: SigningKey::from_bytes(&seed) };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(TrustError::io("create", folder))?;
        }
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        // Windows has no permission bits; a new file inherits the access list of its folder.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut file = options.open(path).map_err(|error| match error.kind() {
            ErrorKind::AlreadyExists => TrustError::Exists(path.to_owned()),
            _ => TrustError::io("create", path)(error),
        })?;
        let text = format!("{WORD} {name}:{}\n", STANDARD.encode(seed));
        let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
        if let Err(error) = written {
            // A part of a key is of no use, and would prevent the next attempt.
            let _ = std::fs::remove_file(path);
            return Err(TrustError::io("write", path)(error));
        }
        Ok(key)
    }

    /// Reads a key from its file. On systems with file permissions, other users must not have access to the file.
    ///
    /// # Errors
    /// If the file cannot be read or is not a key, or if other users have access to it.
    pub fn read(path: &Path) -> Result<Self, TrustError> {
        let text = credentials::text(path, LONGEST, true)?;
        // The message must not contain the text.
        let wrong = || TrustError::Line {
            path: path.to_owned(),
            line: 1,
            why: "the line is not a secret key".to_owned(),
        };
        let (word, rest) = text.trim_end().split_once(' ').ok_or_else(wrong)?;
        let (name, seed) = rest.split_once(':').ok_or_else(wrong)?;
        let seed: [u8; 32] =
            STANDARD.decode(seed).ok().and_then(|seed| seed.try_into().ok()).ok_or_else(wrong)?;
        if word != WORD || !is_name(name) {
            return Err(wrong());
        }
        Ok(Self { name: name.to_owned(), key: SigningKey::from_bytes(&seed) })
    }

    /// The public key.
    pub fn public(&self) -> PublicKey {
        PublicKey::new(self.name.clone(), &self.key.verifying_key())
    }

    pub(crate) fn sign(&self, message: &[u8]) -> [u8; 64] {
        self.key.sign(message).to_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_read_back_and_never_overwritten() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("keys/signing-key");
        let key = SecretKey::create(&path, "farm-1").expect("a key");
        let read = SecretKey::read(&path).expect("the key");
        assert_eq!(read.public(), key.public());
        assert_eq!(read.sign(b"message"), key.sign(b"message"), "signatures are deterministic");
        assert_eq!(key.public().to_string().parse::<PublicKey>().expect("a public key"), key.public());
        let other = SecretKey::create(&folder.path().join("other"), "farm-1").expect("a key");
        assert_ne!(other.public(), key.public(), "the same name is not the same key");
        assert!(matches!(SecretKey::create(&path, "farm-1"), Err(TrustError::Exists(_))));
        for name in ["", "a b", "a:b", "a/b", "ä", &"n".repeat(65)] {
            let refused = SecretKey::create(&folder.path().join("named"), name);
            assert!(matches!(refused, Err(TrustError::Name(_))), "{name}");
        }
        for text in ["", "secret", "secret farm-1:AAAA", "farm-1:AAAA", &key.public().to_string()] {
            std::fs::write(&path, text).expect("writes");
            let error = SecretKey::read(&path).err().expect("it is not a secret key");
            assert!(!error.to_string().contains("AAAA"), "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn other_users_must_not_read_a_secret_key() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("key");
        SecretKey::create(&path, "a").expect("a key");
        let mode = || std::fs::metadata(&path).expect("the file").permissions().mode() & 0o777;
        assert_eq!(mode(), 0o600);
        for open in [0o640, 0o604, 0o620, 0o777] {
            std::fs::set_permissions(&path, PermissionsExt::from_mode(open)).expect("sets permissions");
            assert!(matches!(SecretKey::read(&path), Err(TrustError::Permissions { .. })), "{open:o}");
        }
    }
}

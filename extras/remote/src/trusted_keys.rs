//! The list of keys whose results are used.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use cache::publish_file;

use crate::public_key::PublicKey;
use crate::trust_error::TrustError;

const TRUST: &str = "trust";
const REVOKE: &str = "revoke";

/// The standing of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Results signed by it are used.
    Trusted,
    /// The key is not in the list.
    Unknown,
    /// The key was revoked. Results signed by it are not used.
    Revoked,
}

/// A list of keys in a text file, with one key per line: `trust NAME:KEY`, or `revoke NAME:KEY`. Empty lines and
/// lines that begin with `#` are ignored. A revocation applies regardless of its position in the file.
#[derive(Debug, Clone)]
pub struct TrustedKeys {
    path: PathBuf,
    text: String,
    trusted: Vec<PublicKey>,
    revoked: Vec<PublicKey>,
}

impl TrustedKeys {
    /// Reads a list. If the file does not exist, the list is empty.
    ///
    /// # Errors
    /// If the file cannot be read, or if one of its lines is not valid. The error names the first such line.
    pub fn read(path: &Path) -> Result<Self, TrustError> {
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            Err(error) => return Err(TrustError::io("read", path)(error)),
        };
        let mut list =
            Self { path: path.to_owned(), text: String::new(), trusted: Vec::new(), revoked: Vec::new() };
        for (index, line) in text.lines().enumerate().map(|(index, line)| (index, line.trim())) {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let wrong = |why: String| TrustError::Line { path: path.to_owned(), line: index + 1, why };
            let keys = match line.split_once(' ') {
                Some((TRUST, key)) => (&mut list.trusted, key),
                Some((REVOKE, key)) => (&mut list.revoked, key),
                _ => return Err(wrong(format!("write `{TRUST} NAME:KEY` or `{REVOKE} NAME:KEY`"))),
            };
            keys.0.push(keys.1.parse().map_err(|error: TrustError| wrong(error.to_string()))?);
        }
        Ok(Self { text, ..list })
    }

    /// The standing of a key.
    pub fn standing(&self, key: &PublicKey) -> Standing {
        match (self.revoked.contains(key), self.trusted.contains(key)) {
            (true, _) => Standing::Revoked,
            (false, true) => Standing::Trusted,
            (false, false) => Standing::Unknown,
        }
    }

    /// The keys in the list with their standing, without duplicates.
    pub fn keys(&self) -> Vec<(&PublicKey, Standing)> {
        let mut keys: Vec<(&PublicKey, Standing)> = Vec::new();
        for key in self.trusted.iter().chain(&self.revoked) {
            if !keys.iter().any(|(known, _)| *known == key) {
                keys.push((key, self.standing(key)));
            }
        }
        keys
    }

    /// Adds a key to the list and writes the file.
    ///
    /// # Errors
    /// If the key was revoked, or the file cannot be written.
    pub fn trust(&mut self, key: &PublicKey) -> Result<(), TrustError> {
        match self.standing(key) {
            Standing::Trusted => Ok(()),
            Standing::Revoked => Err(TrustError::Revoked(key.name().to_owned())),
            Standing::Unknown => {
                self.append(TRUST, key)?;
                self.trusted.push(key.clone());
                Ok(())
            }
        }
    }

    /// Revokes a key, whether or not it is in the list, and writes the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn revoke(&mut self, key: &PublicKey) -> Result<(), TrustError> {
        if self.standing(key) != Standing::Revoked {
            self.append(REVOKE, key)?;
            self.revoked.push(key.clone());
        }
        Ok(())
    }

    /// The trusted keys with this name. Several keys may have the same name.
    pub fn named(&self, name: &str) -> Vec<&PublicKey> {
        let trusted = self.trusted.iter().filter(|key| self.standing(key) == Standing::Trusted);
        trusted.filter(|key| key.name() == name).collect()
    }

    fn append(&mut self, word: &str, key: &PublicKey) -> Result<(), TrustError> {
        let gap = if self.text.is_empty() || self.text.ends_with('\n') { "" } else { "\n" };
        let text = format!("{}{gap}{word} {key}\n", self.text);
        publish_file(&self.path, text.as_bytes())?;
        self.text = text;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::secret_key::SecretKey;

    #[test]
    fn a_revocation_holds_wherever_it_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let key = |name: &str| SecretKey::create(&folder.path().join(name), name).expect("a key").public();
        let (a, b, c) = (key("a"), key("b"), key("c"));
        let path = folder.path().join("trusted-keys");
        let mut list = TrustedKeys::read(&path).expect("an empty list");
        assert_eq!(list.standing(&a), Standing::Unknown);
        list.trust(&a).expect("trusts");
        list.trust(&b).expect("trusts");
        list.revoke(&a).expect("revokes");
        assert!(matches!(list.trust(&a), Err(TrustError::Revoked(_))));
        let standings = |list: &TrustedKeys| [&a, &b, &c].map(|key| list.standing(key));
        let wanted = [Standing::Revoked, Standing::Trusted, Standing::Unknown];
        assert_eq!(standings(&list), wanted);
        let read = TrustedKeys::read(&path).expect("the list");
        assert_eq!((standings(&read), read.keys().len()), (wanted, 2));
        assert_eq!((read.named("a").len(), read.named("b")), (0, vec![&b]));
        // By hand, in the other order, under another name, with comments.
        let text = format!(
            "# mine\n\nrevoke {b}\n  trust {b}\ntrust other:{}",
            a.to_string().split_once(':').expect("a name").1
        );
        fs::write(&path, &text).expect("writes");
        let mut read = TrustedKeys::read(&path).expect("the list");
        assert_eq!(standings(&read), [Standing::Trusted, Standing::Revoked, Standing::Unknown]);
        read.trust(&c).expect("trusts");
        let now = fs::read_to_string(&path).expect("the file");
        assert_eq!(now, format!("{text}\ntrust {c}\n"), "everything else stays as it is");
        for line in ["trust", "a:AAAA", "trust a", "trust a:AAAA", "believe a:AAAA"] {
            fs::write(&path, format!("# first\n{line}\n")).expect("writes");
            assert!(matches!(TrustedKeys::read(&path), Err(TrustError::Line { line: 2, .. })), "{line}");
        }
    }
}

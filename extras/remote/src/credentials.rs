//! Certificates and tokens with which a client and a server prove their identity.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::config::Config;
use crate::trust_error::TrustError;

/// Maximum length of a token in bytes. HTTP servers limit the headers of a request to 8 KiB or more.
const LONGEST_TOKEN: u64 = 4096;
/// Maximum length of a file of certificates in bytes. The certificates of all public authorities take 0.3 MB.
const LONGEST_FILE: u64 = 4 << 20;

/// Certificates and a token. The default trusts the authorities of the operating system and names no user.
#[derive(Clone, Default)]
pub struct Credentials {
    /// Certificates of authorities in PEM; the certificate of the server must be signed by one of them. `None` for
    /// the authorities that the operating system trusts.
    pub authorities: Option<String>,
    /// Certificate of the client and its private key, both in PEM.
    pub identity: Option<[String; 2]>,
    /// Token that is sent with each call, as `authorization: Bearer TOKEN`.
    pub token: Option<String>,
}

/// Secrets are left out, so that they cannot appear in a log.
impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials")
            .field("authorities", &self.authorities.is_some())
            .field("identity", &self.identity.is_some())
            .field("token", &self.token.is_some())
            .finish()
    }
}

impl Credentials {
    /// Reads the files that `config` names. Their paths are relative to `folder`. `token` is used instead of the
    /// token file, if given.
    ///
    /// # Errors
    /// If a file cannot be read, if only one of certificate and private key is given, or if other users can read the
    /// private key or the token.
    pub fn read(config: &Config, folder: &Path, token: Option<String>) -> Result<Self, TrustError> {
        let open = |path: &String| text(&folder.join(path), LONGEST_FILE, false);
        let identity = match (&config.certificate, &config.private_key) {
            (Some(certificate), Some(key)) => {
                Some([open(certificate)?, text(&folder.join(key), LONGEST_FILE, true)?])
            }
            (None, None) => None,
            (Some(_), None) => return Err(TrustError::Incomplete("private_key")),
            (None, Some(_)) => return Err(TrustError::Incomplete("certificate")),
        };
        let token = match (token, &config.token) {
            (Some(token), _) => Some(token),
            (None, Some(path)) => Some(text(&folder.join(path), LONGEST_TOKEN, true)?),
            (None, None) => None,
        };
        let token = token.map(|token| token.trim().to_owned());
        if token
            .as_ref()
            .is_some_and(|token| token.is_empty() || !token.bytes().all(|b| b.is_ascii_graphic()))
        {
            return Err(TrustError::Token);
        }
        Ok(Self { authorities: config.authorities.as_ref().map(open).transpose()?, identity, token })
    }
}

/// Reads a text file of at most `longest` bytes. If it is secret, other users must not have access to it.
pub(crate) fn text(path: &Path, longest: u64, is_secret: bool) -> Result<String, TrustError> {
    let file = File::open(path).map_err(TrustError::io("open", path))?;
    #[cfg(unix)]
    if is_secret {
        let metadata = file.metadata().map_err(TrustError::io("read", path))?;
        if std::os::unix::fs::PermissionsExt::mode(&metadata.permissions()) & 0o077 != 0 {
            return Err(TrustError::Permissions { path: path.to_owned() });
        }
    }
    // Windows has no permission bits to check.
    #[cfg(not(unix))]
    let _ = is_secret;
    let mut text = String::new();
    file.take(longest).read_to_string(&mut text).map_err(TrustError::io("read", path))?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(certificate: Option<&str>, private_key: Option<&str>, token: Option<&str>) -> Config {
        let owned = |name: Option<&str>| name.map(str::to_owned);
        Config {
            certificate: owned(certificate),
            private_key: owned(private_key),
            token: owned(token),
            ..Config::default()
        }
    }

    #[test]
    fn files_are_read_next_to_the_settings_and_secrets_are_not_printed() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["me.pem", "me.key", "token"] {
            let path = folder.path().join(name);
            std::fs::write(&path, format!("{name}-text\n")).expect("writes");
            #[cfg(unix)]
            std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600))
                .expect("permissions");
        }
        let all = config(Some("me.pem"), Some("me.key"), Some("token"));
        let read = |config: &Config, token: Option<&str>| {
            Credentials::read(config, folder.path(), token.map(str::to_owned))
        };
        let found = read(&all, None).expect("credentials");
        assert_eq!(found.token.as_deref(), Some("token-text"));
        assert_eq!(found.identity.as_ref().map(|[_, key]| key.as_str()), Some("me.key-text\n"));
        assert!(!format!("{found:?}").contains("text"), "{found:?}");
        assert_eq!(read(&all, Some("other")).expect("credentials").token.as_deref(), Some("other"));
        for (config, token, says) in [
            (config(Some("me.pem"), None, None), None, "`private_key`"),
            (config(None, Some("me.key"), None), None, "`certificate`"),
            (config(None, None, Some("absent")), None, "cannot open"),
            (config(None, None, None), Some(""), "token"),
            (config(None, None, None), Some("a b"), "token"),
        ] {
            let error = read(&config, token).err().map(|e| e.to_string()).unwrap_or_default();
            assert!(error.contains(says), "{error}");
        }
        #[cfg(unix)]
        for name in ["me.key", "token"] {
            let path = folder.path().join(name);
            std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o640))
                .expect("permissions");
            assert!(matches!(read(&all, None), Err(TrustError::Permissions { .. })), "{name}");
            std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600))
                .expect("permissions");
        }
    }
}

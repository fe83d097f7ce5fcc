//! The user's settings for a server.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

use serde::Deserialize;

use crate::trust_error::TrustError;

/// Settings from a file with text such as `Remote(address: "grpc://127.0.0.1:8980", write: true)`. Options on the
/// command line override them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(rename = "Remote", deny_unknown_fields, default)]
pub struct Config {
    /// The address of the server; `None` if no server is used.
    pub address: Option<String>,
    /// True to store new results on the server.
    pub write: bool,
    /// True to fail if the server cannot be reached.
    pub no_fallback: bool,
    /// True to have nodes computed by the workers of the server.
    pub execute: bool,
    /// The program on the workers: a path, or a name that is looked for in their `PATH`. If `None`, this program is
    /// sent to them.
    pub program: Option<String>,
    /// Platform properties that a worker must have, by name.
    pub properties: BTreeMap<String, String>,
    /// Name of the platform property for memory.
    pub memory_property: Option<String>,
    /// The amounts of memory in GiB that workers offer, as values of `memory_property`, in increasing order.
    pub memory_gib: Vec<u32>,
    /// Maximum number of nodes that workers compute at once for this client.
    pub in_flight: Option<usize>,
    /// Priority of the nodes on the server; nodes with a smaller number are computed earlier.
    pub priority: i32,
    /// Time limit for a node, such as `6h`.
    pub timeout: Option<String>,
    /// The share of the nodes that are computed here as well to check the workers, such as `2%`.
    pub verify: Option<String>,
    /// File with the certificates of the authorities that sign the certificate of the server, in PEM. Without it,
    /// the authorities of the operating system count. This path and the following ones are relative to the folder of
    /// the settings.
    pub authorities: Option<String>,
    /// File with the certificate of the client, in PEM, for servers that require one.
    pub certificate: Option<String>,
    /// File with the private key of `certificate`, in PEM.
    pub private_key: Option<String>,
    /// File with the token that is sent with each call.
    pub token: Option<String>,
}

impl Config {
    /// Reads the settings. If the file does not exist, returns the defaults.
    ///
    /// # Errors
    /// If the file cannot be read or is not valid.
    pub fn read(path: &Path) -> Result<Self, TrustError> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            Err(error) => return Err(TrustError::io("read", path)(error)),
        };
        let options =
            ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
        options.from_str(&text).map_err(|error| TrustError::Line {
            path: path.to_owned(),
            line: error.span.start.line,
            why: error.code.to_string(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_and_mistakes_have_a_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("remote.ron");
        assert_eq!(Config::read(&path).expect("no file"), Config::default());
        std::fs::write(&path, "Remote(address: \"grpc://a:1\", write: true)").expect("writes");
        let read = Config::read(&path).expect("settings");
        assert_eq!(read, Config { address: Some("grpc://a:1".to_owned()), write: true, ..Config::default() });
        std::fs::write(&path, "Remote(\n    adress: \"grpc://a:1\",\n)").expect("writes");
        let error = Config::read(&path).expect_err("a wrong field").to_string();
        assert!(error.contains("line 2") && error.contains("adress"), "{error}");
    }
}

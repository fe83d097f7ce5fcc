//! `key`: the user's signing key, and the list of trusted keys.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use remote::{PublicKey, SecretKey, Standing, TrustedKeys};

use crate::session::{Error, config_file, secret_key_file};
use crate::terminal;

/// Makes the key that signs your results, and lists the keys whose results you use.
#[derive(Debug, Args)]
pub struct Key {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Make your key and print its public part, which other users pass to `key trust`
    New {
        /// Name of the key, such as anna-1
        name: String,
        /// File of the secret key, which only you can read [default: signing-key in the folder of your settings]
        #[arg(long, value_name = "FILE")]
        file: Option<PathBuf>,
    },
    /// Print the public part of your key
    Show,
    /// Use results that are signed by this key
    Trust {
        /// The public key, such as anna-1:BASE64
        key: String,
    },
    /// Stop using results that are signed by this key; this cannot be undone
    Revoke {
        /// The public key, or the name of a trusted key
        key: String,
    },
    /// Print the trusted and the revoked keys
    List,
}

impl Key {
    /// Runs the command and returns exit code 0.
    pub fn run(self) -> Result<u8, Error> {
        let list = || -> Result<TrustedKeys, Error> { Ok(TrustedKeys::read(&config_file("trusted-keys")?)?) };
        match self.verb {
            Verb::New { name, file } => {
                let path = file.map_or_else(secret_key_file, Ok)?;
                let mut trusted = list()?;
                let public = SecretKey::create(&path, &name)?.public();
                // Own results come back from a server as those of others do.
                trusted.trust(&public)?;
                terminal::print(&format!("{public}\n"))?;
                terminal::remark(&format!(
                    "the secret key is in `{}`; results that it signs are trusted on this machine",
                    path.display()
                ));
            }
            Verb::Show => {
                let public = SecretKey::read(&secret_key_file()?)?.public();
                terminal::print(&format!("{public}\n"))?;
            }
            Verb::Trust { key } => list()?.trust(&key.parse()?)?,
            Verb::Revoke { key } => {
                let mut trusted = list()?;
                let public = named(&trusted, &key)?;
                trusted.revoke(&public)?;
            }
            Verb::List => {
                let trusted = list()?;
                let line = |(key, standing): (&PublicKey, Standing)| {
                    let word = if standing == Standing::Trusted { "trusted" } else { "revoked" };
                    format!("{word} {key}\n")
                };
                terminal::print(&trusted.keys().into_iter().map(line).collect::<String>())?;
            }
        }
        Ok(0)
    }
}

/// The key that `text` stands for: a whole public key, or the name of a trusted key.
fn named(trusted: &TrustedKeys, text: &str) -> Result<PublicKey, Error> {
    if text.contains(':') {
        return Ok(text.parse()?);
    }
    match trusted.named(text).as_slice() {
        [key] => Ok((*key).clone()),
        [] => Err(Error::usage(format!("no trusted key is named `{text}`; `key list` prints all keys"))),
        _ => Err(Error::usage(format!("several trusted keys are named `{text}`; pass the whole key"))),
    }
}

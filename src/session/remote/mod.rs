//! Connection to a server that holds shared results and computes nodes.

mod execution;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use engine::{Engine, Event, bytes_text};
use execution::{Execution, ExecutionArgs};
use remote::reapi::{Retry, ServerWorkers, SharedCache, SharedCacheOptions, Traffic};
use remote::{Config, Credentials, SecretKey, TrustedKeys};
use serde_json::{Value, json};

use super::error::Error;

/// Environment variable with the address of the server.
const VARIABLE: &str = "LIGHTHARMONY_REMOTE";
/// Environment variable with the token for the server.
const TOKEN: &str = "LIGHTHARMONY_REMOTE_TOKEN";

/// Options for results that are shared through a server.
#[derive(Debug, Clone, Args)]
pub struct RemoteArgs {
    /// Server of the Remote Execution API whose results are used, such as grpc://127.0.0.1:8980; `none` for no
    /// server [env: LIGHTHARMONY_REMOTE; default: the server in the user's remote.ron]
    #[arg(long, value_name = "URL")]
    remote: Option<String>,
    /// Also store new results on the server, signed by your key; see `lightharmony key`
    #[arg(long)]
    remote_write: bool,
    /// Fail if the server cannot be reached, instead of computing everything here
    #[arg(long)]
    no_remote_fallback: bool,
    #[command(flatten)]
    execution: ExecutionArgs,
}

/// A connected server.
pub struct Remote {
    cache: Arc<SharedCache>,
    address: String,
}

impl RemoteArgs {
    /// True if nodes are to be computed by workers.
    pub fn executes(&self) -> Result<bool, Error> {
        let config = Config::read(&config_file("remote.ron")?)?;
        Ok(self.execution.execution(&config)?.is_some())
    }

    /// Connects the engine to the server, if one is configured. If the server cannot be reached, the engine is
    /// returned unchanged and a warning is passed to `show`; with `--no-remote-fallback`, this is an error.
    pub fn connect(
        &self,
        engine: Engine,
        cancel: &AtomicBool,
        mut show: impl FnMut(&Event),
    ) -> Result<(Engine, Option<Remote>), Error> {
        let file = config_file("remote.ron")?;
        let config = Config::read(&file)?;
        let named = self.remote.clone().or_else(|| std::env::var(VARIABLE).ok()).or(config.address.clone());
        let Some(address) = named.filter(|address| !matches!(address.as_str(), "" | "none")) else {
            let options = [
                (self.remote_write, "--remote-write"),
                (self.no_remote_fallback, "--no-remote-fallback"),
                (self.execution.remote_execute, "--remote-execute"),
                (self.execution.verify_remote.is_some(), "--verify-remote"),
            ];
            if let Some((_, option)) = options.into_iter().find(|(given, _)| *given) {
                return Err(Error::usage(format!("`{option}` needs a server; name it with `--remote`")));
            }
            return Ok((engine, None));
        };
        let fallback = !(self.no_remote_fallback || config.no_fallback);
        let execution = self.execution.execution(&config)?;
        let options = SharedCacheOptions {
            address: address.parse().map_err(|error| Error::usage(format!("{error}")))?,
            credentials: Credentials::read(
                &config,
                file.parent().unwrap_or(&file),
                std::env::var(TOKEN).ok(),
            )?,
            trusted: TrustedKeys::read(&config_file("trusted-keys")?)?,
            publish_as: (self.remote_write || config.write).then(secret_key).transpose()?,
            fallback,
            retry: Retry::default(),
        };
        match SharedCache::connect(options, cancel) {
            Ok(cache) => {
                let cache = Arc::new(cache.remember_in(engine.shared_store()));
                let engine = engine.sharing(cache.clone());
                let engine = match execution {
                    None => engine,
                    Some(Execution(options)) => match ServerWorkers::new(cache.clone(), options) {
                        Ok(workers) => engine.sending(Arc::new(workers)),
                        Err(error) if fallback => {
                            let text = format!("{address}: {error}; all nodes are computed here");
                            show(&Event::Warning { id: "remote-executes-nothing", text });
                            engine
                        }
                        Err(error) => return Err(Error::usage(format!("{address}: {error}"))),
                    },
                };
                Ok((engine, Some(Remote { cache, address })))
            }
            Err(error) if fallback => {
                let text = format!("{address}: {error}; the run continues without this server");
                show(&Event::Warning { id: "remote-lost", text });
                Ok((engine, None))
            }
            Err(error) => Err(Error::usage(format!(
                "{address}: {error}; run without `--no-remote-fallback` to compute everything here"
            ))),
        }
    }
}

impl Remote {
    /// One line that summarises what was fetched from the server and stored there; `None` if nothing was.
    pub fn summary(&self) -> Option<String> {
        let Traffic { found, stored, executed, values, bytes_down, bytes_up } = self.cache.traffic();
        if (found, stored, executed) == (0, 0, 0) {
            return None;
        }
        let computed = if executed > 0 { format!(", computed: {executed}") } else { String::new() };
        let (down, up) = (bytes_text(bytes_down), bytes_text(bytes_up));
        Some(format!(
            "shared results on {} (found: {found}, stored: {stored}{computed}; values fetched: {values}; received: {down}, sent: {up})",
            self.address
        ))
    }

    /// The summary as JSON.
    pub fn json(&self) -> Value {
        let Traffic { found, stored, executed, values, bytes_down, bytes_up } = self.cache.traffic();
        json!({
            "event": "remote", "address": self.address, "found": found, "stored": stored, "executed": executed, "values": values,
            "bytes_down": bytes_down, "bytes_up": bytes_up,
        })
    }
}

/// The path of a file in the user's folder of settings.
pub fn config_file(name: &str) -> Result<PathBuf, Error> {
    let folders = directories::ProjectDirs::from("", "", "lightharmony");
    let folders =
        folders.ok_or_else(|| Error::usage("no folder for settings: the user has no home folder"))?;
    Ok(folders.config_dir().join(name))
}

/// The path of the user's secret key.
pub fn secret_key_file() -> Result<PathBuf, Error> {
    config_file("signing-key")
}

fn secret_key() -> Result<SecretKey, Error> {
    let path = secret_key_file()?;
    if !path.exists() {
        let why = "storing results requires a key to sign them; make one with `lightharmony key new NAME`";
        return Err(Error::usage(why));
    }
    Ok(SecretKey::read(&path)?)
}

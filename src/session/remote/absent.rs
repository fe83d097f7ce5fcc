//! The options of a server in a build without the feature `remote`.

use std::sync::atomic::AtomicBool;

use clap::Args;
use engine::{Engine, Event};
use serde_json::Value;

use super::error::Error;

/// Options for shared results. They exist in every build, so that a build without the feature can explain that it
/// lacks them.
#[derive(Debug, Clone, Args)]
pub struct RemoteArgs {
    #[arg(long, value_name = "URL", hide = true)]
    remote: Option<String>,
    #[arg(long, hide = true)]
    remote_write: bool,
    #[arg(long, hide = true)]
    no_remote_fallback: bool,
    #[arg(long, hide = true)]
    remote_execute: bool,
    #[arg(long, hide = true, value_name = "SHARE")]
    verify_remote: Option<String>,
}

/// A connected server. This build has none.
pub enum Remote {}

impl RemoteArgs {
    /// True if an option names a server or its workers.
    pub fn executes(&self) -> Result<bool, Error> {
        Ok(self.remote.is_some() || self.remote_execute || self.verify_remote.is_some())
    }

    /// Returns the engine, or an error if a server is named.
    pub fn connect(
        &self,
        engine: Engine,
        _cancel: &AtomicBool,
        mut show: impl FnMut(&Event),
    ) -> Result<(Engine, Option<Remote>), Error> {
        const BUILD: &str = "build with `cargo build --release --features remote`; see docs/remote.md";
        let asked = self.remote_write || self.no_remote_fallback || self.remote_execute;
        if self.remote.is_some() || asked || self.verify_remote.is_some() {
            return Err(Error::usage(format!(
                "`--remote` is not in this build, which lacks the feature `remote`; {BUILD}"
            )));
        }
        let named = std::env::var("LIGHTHARMONY_REMOTE").is_ok_and(|name| !matches!(&*name, "" | "none"));
        if named {
            let text =
                format!("LIGHTHARMONY_REMOTE is ignored: this build lacks the feature `remote`; {BUILD}");
            show(&Event::Warning { id: "remote-absent", text });
        }
        Ok((engine, None))
    }
}

impl Remote {
    /// Never called, since this build has no servers.
    pub fn summary(&self) -> Option<String> {
        match *self {}
    }

    /// Never called, since this build has no servers.
    pub fn json(&self) -> Value {
        match *self {}
    }
}

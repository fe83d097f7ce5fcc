//! The capabilities of a server.

use std::sync::atomic::AtomicBool;

use api::capabilities_client::CapabilitiesClient;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;

use super::call_error::CallError;
use super::connection::Connection;
use super::digests::Function;

const WHAT: &str = "asking for the capabilities";
/// Maximum total size of a batch in bytes, unless the server states a smaller maximum. The size is limited because
/// messages are kept in memory.
const MOST: u64 = 4 << 20;
/// Number of bytes of a message that are reserved for fields other than the content.
const MARGIN: u64 = 64 << 10;

/// A server and the capabilities that it states.
pub(crate) struct Server {
    pub connection: Connection,
    pub function: Function,
    /// Maximum total size of the contents in one batch, in bytes.
    pub batch: u64,
    /// Maximum size of a blob in bytes.
    pub largest: u64,
    /// True if clients may store results.
    pub takes_results: bool,
    /// True if the server computes nodes.
    pub executes: bool,
}

impl Server {
    /// Asks a server for its capabilities.
    pub fn open(connection: Connection, cancel: &AtomicBool) -> Result<Self, CallError> {
        let instance = connection.address.instance.clone();
        let answer = connection.call(WHAT, &connection.address.authority, 0, cancel, |channel| {
            let request = api::GetCapabilitiesRequest { instance_name: instance.clone() };
            async move { CapabilitiesClient::new(channel).get_capabilities(request).await }
        })?;
        let answer = answer.into_inner();
        let execution = answer.execution_capabilities;
        let Some(cache) = answer.cache_capabilities else {
            let why = "the server has no cache".to_owned();
            return Err(CallError::Refused { what: WHAT, why });
        };
        let function = Function::of(&cache.digest_functions).ok_or_else(|| CallError::Refused {
            what: WHAT,
            why: "the server supports neither BLAKE3 nor SHA-256".to_owned(),
        })?;
        // 0 means no limit.
        let limit = |stated: i64, most: u64| match u64::try_from(stated) {
            Ok(0) | Err(_) => most,
            Ok(stated) => stated.min(most),
        };
        Ok(Self {
            connection,
            function,
            batch: limit(cache.max_batch_total_size_bytes, MOST).saturating_sub(MARGIN).max(1),
            largest: limit(cache.max_cas_blob_size_bytes, u64::MAX),
            takes_results: cache.action_cache_update_capabilities.is_some_and(|may| may.update_enabled),
            executes: execution.is_some_and(|may| may.exec_enabled),
        })
    }

    pub fn instance(&self) -> String {
        self.connection.address.instance.clone()
    }

    /// The name of a resource, preceded by the name of the instance.
    pub fn resource(&self, name: &str) -> String {
        match self.connection.address.instance.as_str() {
            "" => name.to_owned(),
            instance => format!("{instance}/{name}"),
        }
    }
}

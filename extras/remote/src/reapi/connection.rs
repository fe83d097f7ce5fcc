//! The connection to a server, shared by all threads of a run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Code, Request, Status};

use super::address::Address;
use super::call_error::{CallError, is_passing};
use super::retry::Retry;
use crate::credentials::Credentials;

/// Interval at which a waiting call checks whether the run was cancelled.
const LOOK: Duration = Duration::from_millis(20);
/// Time limit for opening a connection.
const OPENING: Duration = Duration::from_secs(5);
/// Interval at which an open but silent connection is tested.
const ALIVE: Duration = Duration::from_secs(20);

/// A channel that adds the token to each call.
pub(crate) type Calls = InterceptedService<Channel, Bearer>;

/// Value of the header `authorization` of each call, if there is a token.
#[derive(Clone)]
pub(crate) struct Bearer(Option<MetadataValue<Ascii>>);

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(value) = &self.0 {
            request.metadata_mut().insert("authorization", value.clone());
        }
        Ok(request)
    }
}

impl Bearer {
    fn new(token: Option<&str>) -> Result<Self, CallError> {
        let value = |token: &str| {
            // The message must not contain the token.
            let invalid = |_| CallError::Connect("the token has characters that cannot be sent".to_owned());
            let mut value: MetadataValue<Ascii> = format!("Bearer {token}").parse().map_err(invalid)?;
            value.set_sensitive(true);
            Ok(value)
        };
        token.map(value).transpose().map(Self)
    }
}

/// The settings of an encrypted connection.
fn tls(credentials: &Credentials) -> ClientTlsConfig {
    let tls = match &credentials.authorities {
        Some(authorities) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(authorities)),
        None => ClientTlsConfig::new().with_native_roots(),
    };
    match &credentials.identity {
        Some([certificate, key]) => tls.identity(Identity::from_pem(certificate, key)),
        None => tls,
    }
}

/// A connection. The first call opens it. If it was closed, the next call opens it again.
pub(crate) struct Connection {
    runtime: Runtime,
    calls: Calls,
    pub address: Address,
    pub retry: Retry,
}

impl Connection {
    /// Prepares a connection.
    ///
    /// # Errors
    /// If the certificates are not valid, or if a token would be sent to another machine without encryption.
    pub fn new(address: Address, credentials: &Credentials, retry: Retry) -> Result<Self, CallError> {
        if credentials.token.is_some() && !(address.encrypted || address.is_local()) {
            let what = "a token is only sent over an encrypted connection: use an address that begins with `grpcs://`";
            return Err(CallError::Connect(what.to_owned()));
        }
        let failed = |error: &dyn std::error::Error| CallError::Connect(error.to_string());
        // One thread moves the bytes; the threads of the run wait for it.
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("network")
            .enable_all()
            .build()
            .map_err(|error| failed(&error))?;
        let endpoint = Endpoint::from_shared(address.http()).map_err(|error| failed(&error))?;
        let endpoint = match address.encrypted {
            true => endpoint.tls_config(tls(credentials)).map_err(|error| failed(&error))?,
            false => endpoint,
        };
        let endpoint = endpoint
            .connect_timeout(OPENING)
            .keep_alive_while_idle(true)
            .http2_keep_alive_interval(ALIVE)
            .tcp_nodelay(true);
        let _inside = runtime.enter();
        let calls =
            InterceptedService::new(endpoint.connect_lazy(), Bearer::new(credentials.token.as_deref())?);
        Ok(Self { runtime, calls, address, retry })
    }

    /// Calls the server, and repeats the call after a temporary failure. `attempt` makes the future of each
    /// attempt. `subject` identifies the data of the call, so that the pauses of different calls differ. `bytes` is
    /// the number of bytes that an attempt sends or receives.
    pub fn call<T, F: Future<Output = Result<T, Status>>>(
        &self,
        what: &'static str,
        subject: &str,
        bytes: u64,
        cancel: &AtomicBool,
        mut attempt: impl FnMut(Calls) -> F,
    ) -> Result<T, CallError> {
        let limit = self.retry.limit_for(bytes);
        let attempts = async {
            let mut number = 0;
            loop {
                let outcome = tokio::time::timeout(limit, attempt(self.calls.clone())).await;
                let status = match outcome {
                    Ok(Ok(answer)) => return Ok(answer),
                    Ok(Err(status)) => status,
                    Err(_) => Status::new(
                        Code::DeadlineExceeded,
                        format!("the server did not answer within {limit:.1?}"),
                    ),
                };
                if !is_passing(status.code()) || number + 1 >= self.retry.attempts {
                    return Err(CallError::of(what, &status));
                }
                tokio::time::sleep(self.retry.pause_after(number, subject)).await;
                number += 1;
            }
        };
        self.until_cancelled(cancel, attempts)
    }

    /// Waits for `work`, or until the run is cancelled. `work` receives no time limit.
    pub fn until_cancelled<T>(
        &self,
        cancel: &AtomicBool,
        work: impl Future<Output = Result<T, CallError>>,
    ) -> Result<T, CallError> {
        let stopped = async {
            while !cancel.load(Ordering::Relaxed) {
                tokio::time::sleep(LOOK).await;
            }
        };
        self.runtime.block_on(async {
            tokio::select! {
                biased;
                () = stopped => Err(CallError::Cancelled),
                outcome = work => outcome,
            }
        })
    }

    /// Calls the server once, without regard to cancellation. Returns false if there is no answer within `limit`.
    pub fn attempt<T, F: Future<Output = Result<T, Status>>>(
        &self,
        limit: Duration,
        attempt: impl FnOnce(Calls) -> F,
    ) -> bool {
        let call = async { tokio::time::timeout(limit, attempt(self.calls.clone())).await };
        matches!(self.runtime.block_on(call), Ok(Ok(_)))
    }

    /// The channel for calls with a time limit of their own.
    pub fn calls(&self) -> Calls {
        self.calls.clone()
    }
}

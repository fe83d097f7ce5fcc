//! The connection to a server, shared by all threads of a run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use super::address::Address;
use super::call_error::{CallError, is_passing};
use super::retry::Retry;

/// Interval at which a waiting call looks whether the run was cancelled.
const LOOK: Duration = Duration::from_millis(20);
/// Time limit of opening a connection.
const OPENING: Duration = Duration::from_secs(5);
/// Interval at which an open but silent connection is tested.
const ALIVE: Duration = Duration::from_secs(20);

/// A connection. It is opened by the first call, and again after it was closed.
pub(crate) struct Connection {
    runtime: Runtime,
    channel: Channel,
    pub address: Address,
    pub retry: Retry,
}

impl Connection {
    pub fn new(address: Address, retry: Retry) -> Result<Self, CallError> {
        let failed = |error: &dyn std::error::Error| CallError::Connect(error.to_string());
        // One thread moves the bytes; the threads of the run wait for it.
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("network")
            .enable_all()
            .build()
            .map_err(|error| failed(&error))?;
        let endpoint = Endpoint::from_shared(address.http()).map_err(|error| failed(&error))?;
        let endpoint = endpoint
            .connect_timeout(OPENING)
            .keep_alive_while_idle(true)
            .http2_keep_alive_interval(ALIVE)
            .tcp_nodelay(true);
        let _inside = runtime.enter();
        let channel = endpoint.connect_lazy();
        Ok(Self { runtime, channel, address, retry })
    }

    /// Calls the server, and again after a failure that may pass. `subject` names what the call is about, so that
    /// pauses differ between calls; `bytes` is the number of bytes that an attempt moves. Each attempt is a future
    /// that `attempt` makes.
    pub fn call<T, F: Future<Output = Result<T, Status>>>(
        &self,
        what: &'static str,
        subject: &str,
        bytes: u64,
        cancel: &AtomicBool,
        mut attempt: impl FnMut(Channel) -> F,
    ) -> Result<T, CallError> {
        let stopped = async {
            while !cancel.load(Ordering::Relaxed) {
                tokio::time::sleep(LOOK).await;
            }
        };
        let limit = self.retry.limit_for(bytes);
        let calls = async {
            let mut number = 0;
            loop {
                let outcome = tokio::time::timeout(limit, attempt(self.channel.clone())).await;
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
        self.runtime.block_on(async {
            tokio::select! {
                biased;
                () = stopped => Err(CallError::Cancelled),
                outcome = calls => outcome,
            }
        })
    }
}

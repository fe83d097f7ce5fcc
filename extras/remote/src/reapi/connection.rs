//! The connection to a server, shared by all threads of a run.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Status};

use super::address::Address;
use super::call_error::{CallError, is_passing};
use super::retry::Retry;

/// Interval at which a waiting call checks whether the run was cancelled.
const LOOK: Duration = Duration::from_millis(20);
/// Time limit for opening a connection.
const OPENING: Duration = Duration::from_secs(5);
/// Interval at which an open but silent connection is tested.
const ALIVE: Duration = Duration::from_secs(20);

/// A connection. The first call opens it. If it was closed, the next call opens it again.
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

    /// Calls the server, and repeats the call after a temporary failure. `attempt` makes the future of each
    /// attempt. `subject` identifies the data of the call, so that the pauses of different calls differ. `bytes` is
    /// the number of bytes that an attempt sends or receives.
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

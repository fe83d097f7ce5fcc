//! Execution of actions by a server.

use std::cell::RefCell;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use api::execution_client::ExecutionClient;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use bazel_remote_apis::google::longrunning::operations_client::OperationsClient;
use bazel_remote_apis::google::longrunning::{CancelOperationRequest, Operation, operation};
use bazel_remote_apis::google::rpc;
use engine::Stage;
use prost::Message;
use tonic::{Code, Status, Streaming};

use super::call_error::{CallError, is_passing};
use super::server::Server;

const WHAT: &str = "computing a node";
/// Time limit for the request to cancel an action.
const CANCELLING: Duration = Duration::from_millis(500);
/// Maximum number of times that an action is started. An action that takes hours must not be repeated often.
const STARTS: u32 = 2;

/// An action that is to be executed.
pub(crate) struct Execution<'a> {
    /// The digest of the action.
    pub action: &'a api::Digest,
    /// Priority; actions with a smaller number are executed earlier. 0 is the default.
    pub priority: i32,
    /// Paths of output files that are wanted in the answer itself.
    pub inlined: &'a str,
}

/// The end of an action.
#[derive(Debug)]
pub(crate) enum Ended {
    /// The command ended, with any exit code.
    Ran(Box<api::ActionResult>),
    /// Inputs are missing on the server.
    Missing,
    /// The command was stopped at the time limit.
    TimedOut,
    /// No worker could execute the action.
    Failed(String),
}

/// State of an action between attempts.
#[derive(Default)]
struct Started {
    /// Name of the operation, once it is known.
    name: RefCell<Option<String>>,
}

impl Server {
    /// Executes an action and waits for its end. The action cache of the server is not used, since anybody may have
    /// written to it. `report` receives each new stage. If the connection is interrupted, the client reconnects to the
    /// same execution. If the run is cancelled, the execution is cancelled.
    pub fn execute(
        &self,
        execution: &Execution<'_>,
        cancel: &AtomicBool,
        report: &dyn Fn(Stage),
    ) -> Result<Ended, CallError> {
        let started = Started::default();
        let ended = self.connection.until_cancelled(cancel, self.until_ended(execution, &started, report));
        if let (Err(CallError::Cancelled), Some(name)) = (&ended, started.name.borrow().clone()) {
            self.connection.attempt(CANCELLING, |calls| async move {
                OperationsClient::new(calls).cancel_operation(CancelOperationRequest { name }).await
            });
        }
        ended
    }

    async fn until_ended(
        &self,
        execution: &Execution<'_>,
        started: &Started,
        report: &dyn Fn(Stage),
    ) -> Result<Ended, CallError> {
        let retry = &self.connection.retry;
        let (mut failures, mut starts) = (0, 1);
        loop {
            let status = match self.follow(execution, started, report).await {
                Ok(response) => match outcome(response) {
                    Ok(ended) => return Ok(ended),
                    // The worker was lost, or the server stopped the action.
                    Err(status) if starts < STARTS => {
                        starts += 1;
                        started.name.replace(None);
                        status
                    }
                    Err(status) => return Ok(Ended::Failed(described(&status))),
                },
                Err(status) if status.code() == Code::FailedPrecondition => return Ok(Ended::Missing),
                Err(status) if status.code() == Code::NotFound => {
                    // The server does not know the operation any more, for instance after a restart.
                    if started.name.replace(None).is_none() || starts >= STARTS {
                        return Ok(Ended::Missing);
                    }
                    starts += 1;
                    status
                }
                Err(status) if !is_passing(status.code()) => {
                    return match status.code() {
                        Code::InvalidArgument | Code::OutOfRange => Ok(Ended::Failed(described(&status))),
                        _ => Err(CallError::of(WHAT, &status)),
                    };
                }
                Err(status) => status,
            };
            failures += 1;
            if failures >= retry.attempts {
                return Err(CallError::of(WHAT, &status));
            }
            tokio::time::sleep(retry.pause_after(failures - 1, &execution.action.hash)).await;
        }
    }

    /// Starts the action, or reconnects to the operation if it was started, and waits for the end.
    async fn follow(
        &self,
        execution: &Execution<'_>,
        started: &Started,
        report: &dyn Fn(Stage),
    ) -> Result<api::ExecuteResponse, Status> {
        let mut client = ExecutionClient::new(self.connection.calls());
        let known = started.name.borrow().clone();
        let operations = match known {
            Some(name) => client.wait_execution(api::WaitExecutionRequest { name }).await,
            None => {
                let request = api::ExecuteRequest {
                    instance_name: self.instance(),
                    skip_cache_lookup: true,
                    action_digest: Some(execution.action.clone()),
                    execution_policy: Some(api::ExecutionPolicy { priority: execution.priority }),
                    digest_function: self.function.number(),
                    inline_stdout: true,
                    inline_stderr: true,
                    inline_output_files: vec![execution.inlined.to_owned()],
                    ..api::ExecuteRequest::default()
                };
                client.execute(request).await
            }
        };
        let mut operations: Streaming<Operation> = operations?.into_inner();
        // The caller has reported this stage.
        let mut last = Some(Stage::Queued);
        while let Some(operation) = operations.message().await? {
            if !operation.name.is_empty() {
                started.name.replace(Some(operation.name.clone()));
            }
            if let Some(stage) = stage(&operation).filter(|stage| last.as_ref() != Some(stage)) {
                report(stage.clone());
                last = Some(stage);
            }
            if operation.done {
                return response(operation);
            }
        }
        Err(Status::unavailable("the server ended the answer before the action ended"))
    }
}

/// The stage that an operation states.
fn stage(operation: &Operation) -> Option<Stage> {
    let metadata = operation.metadata.as_ref()?;
    let metadata = api::ExecuteOperationMetadata::decode(metadata.value.as_slice()).ok()?;
    let worker = metadata.partial_execution_metadata.map(|metadata| metadata.worker);
    match api::execution_stage::Value::try_from(metadata.stage) {
        Ok(api::execution_stage::Value::Queued) => Some(Stage::Queued),
        Ok(api::execution_stage::Value::Executing) => Some(Stage::Executing(worker.unwrap_or_default())),
        _ => None,
    }
}

/// The response of an operation that ended.
fn response(operation: Operation) -> Result<api::ExecuteResponse, Status> {
    match operation.result {
        Some(operation::Result::Response(any)) => api::ExecuteResponse::decode(any.value.as_slice())
            .map_err(|error| Status::internal(format!("the response cannot be decoded: {error}"))),
        Some(operation::Result::Error(status)) => Err(as_status(&status)),
        None => Err(Status::internal("the operation ended without a response")),
    }
}

/// The end of the action that a response describes, or the reason why the action must be started again.
fn outcome(response: api::ExecuteResponse) -> Result<Ended, Status> {
    let status = response.status.unwrap_or_default();
    match Code::from_i32(status.code) {
        Code::Ok if response.cached_result => {
            // A result that anybody may have stored. The request excludes such results.
            Ok(Ended::Failed("the server returned a stored result instead of a new one".to_owned()))
        }
        Code::Ok => match response.result {
            Some(result) => Ok(Ended::Ran(Box::new(result))),
            None => Ok(Ended::Failed("the response has no result".to_owned())),
        },
        Code::NotFound | Code::FailedPrecondition => Ok(Ended::Missing),
        Code::DeadlineExceeded => Ok(Ended::TimedOut),
        code if is_passing(code) => Err(as_status(&status)),
        _ => Ok(Ended::Failed(described(&as_status(&status)))),
    }
}

fn as_status(status: &rpc::Status) -> Status {
    Status::new(Code::from_i32(status.code), status.message.clone())
}

fn described(status: &Status) -> String {
    match status.message() {
        "" => status.code().description().to_owned(),
        message => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_new_result_counts() {
        let response = |code, cached_result| api::ExecuteResponse {
            result: Some(api::ActionResult::default()),
            cached_result,
            status: Some(rpc::Status { code, message: "as planned".to_owned(), details: Vec::new() }),
            ..api::ExecuteResponse::default()
        };
        assert!(matches!(outcome(response(0, false)), Ok(Ended::Ran(_))));
        assert!(matches!(outcome(response(0, true)), Ok(Ended::Failed(why)) if why.contains("stored")));
        assert!(matches!(outcome(response(4, false)), Ok(Ended::TimedOut)));
        assert!(matches!(outcome(response(5, false)), Ok(Ended::Missing)));
        assert!(matches!(outcome(response(9, false)), Ok(Ended::Missing)));
        assert!(matches!(outcome(response(3, false)), Ok(Ended::Failed(_))));
        assert_eq!(outcome(response(14, false)).map(|_| ()).expect_err("again").code(), Code::Unavailable);
        let empty = api::ExecuteResponse::default();
        assert!(matches!(outcome(empty), Ok(Ended::Failed(_))));
    }
}

//! The workers of the small server: they compute nodes in this process, and fail as planned.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use api::execution_server::Execution;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use bazel_remote_apis::google::longrunning::operations_server::Operations;
use bazel_remote_apis::google::longrunning::{
    CancelOperationRequest, DeleteOperationRequest, GetOperationRequest, ListOperationsRequest,
    ListOperationsResponse, Operation, WaitOperationRequest, operation,
};
use bazel_remote_apis::google::protobuf::{self, Any};
use bazel_remote_apis::google::rpc;
use cache::Store;
use engine::Engine;
use prost::Message;
use tonic::{Code, Request, Response, Status};

use super::fake::{Answer, Pieces, Script, Service};
use crate::reapi::digests::Function;
use crate::testing::{lying_registry, registry};

/// A planned failure of one execution.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The command does not run, and the response has this code.
    Status(Code),
    /// The call itself fails with this code.
    Call(Code),
    /// The command ends with this code and this text on standard output.
    Exit(i32, &'static str),
    /// The stream ends before the action ends, which the client can wait for.
    Interrupted,
    /// The stream ends before the action ends, and the server forgets the action.
    Forgotten,
    /// The action never ends.
    Endless,
    /// An output is reported as a link.
    Link,
    /// An output is reported as a folder.
    Folder,
    /// There is one more output, with this path.
    More(&'static str),
    /// The first value is not reported.
    Less,
    /// A value is reported with another length.
    Longer,
    /// The values are replaced by other bytes of the same length.
    Damaged,
    /// The entry is replaced by other bytes of the same length.
    DamagedEntry,
    /// The result is marked as coming from the action cache.
    Stored,
    /// The worker computes another value, with a record that matches it.
    Lie,
    /// All blobs are lost before the action starts.
    Lost,
}

/// The last line of a program whose node failed.
pub const FAILED: &str = r#"{"event":"failed","message":"`double`: as planned","hint":"plan otherwise"}"#;

fn done(name: &str, response: &api::ExecuteResponse) -> Operation {
    let value = response.encode_to_vec();
    let any = Any { type_url: "type.googleapis.com/ExecuteResponse".to_owned(), value };
    let result = Some(operation::Result::Response(any));
    Operation { name: name.to_owned(), done: true, result, metadata: None }
}

fn running(name: &str, stage: api::execution_stage::Value) -> Operation {
    let worker = api::ExecutedActionMetadata { worker: "fake-1".to_owned(), ..Default::default() };
    let metadata = api::ExecuteOperationMetadata {
        stage: stage.into(),
        partial_execution_metadata: Some(worker),
        ..Default::default()
    };
    let any = Any { type_url: "type.googleapis.com/Metadata".to_owned(), value: metadata.encode_to_vec() };
    Operation { name: name.to_owned(), metadata: Some(any), done: false, result: None }
}

/// Writes an input folder. Fails if a blob is missing.
fn stage(blobs: &BTreeMap<String, Vec<u8>>, digest: &api::Digest, to: &Path) -> Option<()> {
    let directory = api::Directory::decode(blobs.get(&digest.hash)?.as_slice()).ok()?;
    std::fs::create_dir_all(to).ok()?;
    for file in directory.files {
        std::fs::write(to.join(&file.name), blobs.get(&file.digest?.hash)?).ok()?;
    }
    for folder in directory.directories {
        stage(blobs, &folder.digest?, &to.join(&folder.name))?;
    }
    Some(())
}

/// Executes an action as a worker does. `None` if a blob is missing.
fn execute(script: &mut Script, digest: &api::Digest, fault: Option<&Fault>) -> Option<api::ActionResult> {
    let function = if digest.hash == cache::Digest::of(script.blobs.get(&digest.hash)?).to_string() {
        Function::Blake3
    } else {
        Function::Sha256
    };
    let action = api::Action::decode(script.blobs.get(&digest.hash)?.as_slice()).ok()?;
    let command = api::Command::decode(script.blobs.get(&action.command_digest?.hash)?.as_slice()).ok()?;
    script.platforms.push(action.platform.unwrap_or_default());
    script.timeouts.push(action.timeout);
    let folder = tempfile::tempdir().expect("a folder");
    stage(&script.blobs, &action.input_root_digest?, folder.path())?;
    assert_eq!(command.arguments, ["./lightharmony", "action"]);
    assert!(folder.path().join("lightharmony").exists(), "the program was sent");
    for path in &command.output_paths {
        let above = folder.path().join(path);
        std::fs::create_dir_all(above.parent().expect("a folder")).expect("creates");
    }
    let out = folder.path().join("out");
    let engine = Engine::new(Store::unavailable("none".to_owned()), 1, 1 << 30);
    let cancel = Arc::new(AtomicBool::new(false));
    let kinds = if fault == Some(&Fault::Lie) { lying_registry() } else { registry() };
    let mut result = api::ActionResult::default();
    if let Err(error) = engine.run_action(&kinds, folder.path(), &out, &cancel, |_| ()) {
        result.exit_code = 2;
        result.stderr_raw = error.to_string().into_bytes();
        return Some(result);
    }
    for path in &command.output_paths {
        let bytes = std::fs::read(folder.path().join(path)).expect("an output");
        let digest = function.of_bytes(&bytes);
        script.blobs.insert(digest.hash.clone(), bytes);
        let (path, digest) = (path.clone(), Some(digest));
        result.output_files.push(api::OutputFile { path, digest, ..Default::default() });
    }
    result.execution_metadata =
        Some(api::ExecutedActionMetadata { worker: "fake-1".to_owned(), ..Default::default() });
    Some(result)
}

/// Changes a result as planned.
fn spoil(script: &mut Script, result: &mut api::ActionResult, fault: &Fault) {
    let files = &mut result.output_files;
    let change = |script: &mut Script, file: &api::OutputFile| {
        let hash = &file.digest.as_ref().expect("a digest").hash;
        let bytes = script.blobs.get_mut(hash).expect("a blob");
        if let Some(last) = bytes.last_mut() {
            *last ^= 1;
        }
    };
    match fault {
        Fault::Link => {
            let file = files.pop().expect("a file");
            let link = api::OutputSymlink {
                path: file.path,
                target: "/etc/passwd".to_owned(),
                ..Default::default()
            };
            result.output_symlinks.push(link);
        }
        Fault::Folder => {
            let file = files.pop().expect("a file");
            result.output_directories.push(api::OutputDirectory { path: file.path, ..Default::default() });
        }
        Fault::More(path) => {
            let more = api::OutputFile { path: (*path).to_owned(), ..files[0].clone() };
            files.push(more);
        }
        Fault::Less => drop(files.pop()),
        Fault::Longer => {
            let last = files.last_mut().and_then(|file| file.digest.as_mut()).expect("a digest");
            last.size_bytes += 1;
        }
        Fault::Damaged => {
            files.iter().filter(|file| file.path != "out/entry").for_each(|file| change(script, file));
        }
        Fault::DamagedEntry => {
            files.iter().filter(|file| file.path == "out/entry").for_each(|file| change(script, file));
        }
        _ => {}
    }
}

#[tonic::async_trait]
impl Execution for Service {
    type ExecuteStream = Pieces<Operation>;

    async fn execute(&self, request: Request<api::ExecuteRequest>) -> Answer<Self::ExecuteStream> {
        let request = request.into_inner();
        assert!(request.skip_cache_lookup, "the action cache is not asked");
        let mut script = self.begin("execute")?;
        let fault = if script.faults.is_empty() { None } else { Some(script.faults.remove(0)) };
        let name = format!("operation-{}", script.calls.len());
        let stages = [api::execution_stage::Value::Queued, api::execution_stage::Value::Executing];
        let mut operations: Vec<Result<Operation, Status>> =
            stages.into_iter().map(|stage| Ok(running(&name, stage))).collect();
        let digest = request.action_digest.unwrap_or_default();
        let status = |code: Code| rpc::Status {
            code: code as i32,
            message: "as planned".to_owned(),
            details: Vec::new(),
        };
        let mut response = api::ExecuteResponse { status: Some(status(Code::Ok)), ..Default::default() };
        match &fault {
            Some(Fault::Call(code)) => return Err(Status::new(*code, "as planned")),
            Some(Fault::Status(code)) => response.status = Some(status(*code)),
            Some(Fault::Exit(code, out)) => {
                let stdout_raw = out.as_bytes().to_vec();
                let result = api::ActionResult { exit_code: *code, stdout_raw, ..Default::default() };
                response.result = Some(result);
            }
            Some(Fault::Endless) => {
                drop(script);
                let endless =
                    tokio_stream::StreamExt::chain(tokio_stream::iter(operations), tokio_stream::pending());
                return Ok(Response::new(Box::pin(endless)));
            }
            _ => {
                if fault == Some(Fault::Lost) {
                    script.blobs.clear();
                }
                match execute(&mut script, &digest, fault.as_ref()) {
                    Some(mut result) => {
                        if let Some(fault) = &fault {
                            spoil(&mut script, &mut result, fault);
                        }
                        response.result = Some(result);
                    }
                    None => response.status = Some(status(Code::NotFound)),
                }
                response.cached_result = fault == Some(Fault::Stored);
            }
        }
        let end = done(&name, &response);
        match fault {
            Some(Fault::Interrupted) => drop(script.operations.insert(name, end)),
            Some(Fault::Forgotten) => {}
            _ => operations.push(Ok(end)),
        }
        Ok(Response::new(Box::pin(tokio_stream::iter(operations))))
    }

    type WaitExecutionStream = Pieces<Operation>;

    async fn wait_execution(
        &self,
        request: Request<api::WaitExecutionRequest>,
    ) -> Answer<Self::WaitExecutionStream> {
        let script = self.begin("wait")?;
        let found = script.operations.get(&request.into_inner().name).cloned();
        let found = found.ok_or_else(|| Status::not_found("no operation"))?;
        Ok(Response::new(Box::pin(tokio_stream::iter([Ok(found)]))))
    }
}

#[tonic::async_trait]
impl Operations for Service {
    async fn list_operations(
        &self,
        _request: Request<ListOperationsRequest>,
    ) -> Answer<ListOperationsResponse> {
        Err(Status::unimplemented("not needed"))
    }

    async fn get_operation(&self, _request: Request<GetOperationRequest>) -> Answer<Operation> {
        Err(Status::unimplemented("not needed"))
    }

    async fn delete_operation(&self, _request: Request<DeleteOperationRequest>) -> Answer<protobuf::Empty> {
        Err(Status::unimplemented("not needed"))
    }

    async fn cancel_operation(&self, _request: Request<CancelOperationRequest>) -> Answer<protobuf::Empty> {
        drop(self.begin("cancel")?);
        Ok(Response::new(protobuf::Empty {}))
    }

    async fn wait_operation(&self, _request: Request<WaitOperationRequest>) -> Answer<Operation> {
        Err(Status::unimplemented("not needed"))
    }
}

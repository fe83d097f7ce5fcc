//! A small server in this process, for answers that `buildbox-casd` never gives.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use api::action_cache_server::{ActionCache, ActionCacheServer};
use api::capabilities_server::{Capabilities, CapabilitiesServer};
use api::content_addressable_storage_server::{ContentAddressableStorage, ContentAddressableStorageServer};
use api::execution_server::ExecutionServer;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use bazel_remote_apis::google::bytestream::byte_stream_server::{ByteStream, ByteStreamServer};
use bazel_remote_apis::google::bytestream::{
    QueryWriteStatusRequest, QueryWriteStatusResponse, ReadRequest, ReadResponse, WriteRequest, WriteResponse,
};
use bazel_remote_apis::google::longrunning::Operation;
use bazel_remote_apis::google::longrunning::operations_server::OperationsServer;
use bazel_remote_apis::google::{protobuf, rpc};
use tokio_stream::Stream;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::service::InterceptorLayer;
use tonic::transport::{Server, ServerTlsConfig};
use tonic::{Code, Request, Response, Status, Streaming};

use super::fake_workers::Fault;

pub type Answer<T> = Result<Response<T>, Status>;
pub type Pieces<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// How the server behaves, and what happened.
#[derive(Default)]
pub struct Script {
    /// The digest functions that it offers.
    pub functions: Vec<i32>,
    /// Its limit for batches.
    pub batch: i64,
    /// True if it takes results.
    pub updates: bool,
    /// Failures of calls: name of the call, code, how often.
    pub failures: Vec<(&'static str, Code, usize)>,
    /// If set, streams of reads break after this number of bytes.
    pub break_after: Option<usize>,
    /// Bytes that are added to every value that is read.
    pub surplus: usize,
    /// The calls so far.
    pub calls: Vec<String>,
    pub blobs: BTreeMap<String, Vec<u8>>,
    pub results: BTreeMap<String, api::ActionResult>,
    /// True if it executes actions.
    pub executes: bool,
    /// The failures of the next executions, in order. Without one, an execution succeeds.
    pub faults: Vec<Fault>,
    /// Operations that clients can wait for.
    pub operations: BTreeMap<String, Operation>,
    /// The platforms and the time limits of the actions so far.
    pub platforms: Vec<api::Platform>,
    pub timeouts: Vec<Option<protobuf::Duration>>,
    /// The largest batch and the largest piece so far, in bytes.
    pub largest: usize,
}

/// A running server, which ends when this is dropped.
pub struct Fake {
    pub script: Arc<Mutex<Script>>,
    pub address: String,
    _runtime: tokio::runtime::Runtime,
}

/// The services of the server.
#[derive(Clone)]
pub struct Service(Arc<Mutex<Script>>);

impl Fake {
    pub fn start(script: Script) -> Self {
        Self::with(script, None, None)
    }

    /// Starts a server with an encrypted connection that refuses calls without this token.
    pub fn encrypted(script: Script, tls: ServerTlsConfig, token: &'static str) -> Self {
        Self::with(script, Some(tls), Some(token))
    }

    fn with(script: Script, tls: Option<ServerTlsConfig>, token: Option<&'static str>) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.expect("a runtime");
        let script = Arc::new(Mutex::new(script));
        let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).expect("a port");
        let scheme = if tls.is_some() { "grpcs" } else { "grpc" };
        let address = format!("{scheme}://{}", listener.local_addr().expect("an address"));
        let service = Service(script.clone());
        let allowed = move |request: Request<()>| {
            let sent = request.metadata().get("authorization").and_then(|value| value.to_str().ok());
            let is_right = token.is_none_or(|token| sent == Some(&format!("Bearer {token}")));
            if is_right { Ok(request) } else { Err(Status::unauthenticated("a wrong token")) }
        };
        let mut builder = Server::builder();
        if let Some(tls) = tls {
            builder = builder.tls_config(tls).expect("certificates");
        }
        let server = builder
            .layer(InterceptorLayer::new(allowed))
            .add_service(CapabilitiesServer::new(service.clone()))
            .add_service(ActionCacheServer::new(service.clone()))
            .add_service(ExecutionServer::new(service.clone()))
            .add_service(OperationsServer::new(service.clone()))
            .add_service(
                ContentAddressableStorageServer::new(service.clone()).max_decoding_message_size(64 << 20),
            )
            .add_service(ByteStreamServer::new(service));
        runtime.spawn(server.serve_with_incoming(TcpListenerStream::new(listener)));
        Self { script, address, _runtime: runtime }
    }

    pub fn script(&self) -> MutexGuard<'_, Script> {
        self.script.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of calls with this name.
    pub fn count(&self, call: &str) -> usize {
        self.script().calls.iter().filter(|known| *known == call).count()
    }
}

impl Service {
    /// Notes a call, and fails it if the script says so.
    pub fn begin(&self, call: &'static str) -> Result<MutexGuard<'_, Script>, Status> {
        let mut script = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        script.calls.push(call.to_owned());
        let planned = script.failures.iter_mut().find(|(name, _, left)| *name == call && *left > 0);
        match planned {
            Some((_, code, left)) => {
                *left -= 1;
                Err(Status::new(*code, "as planned"))
            }
            None => Ok(script),
        }
    }
}

fn hash(digest: Option<api::Digest>) -> String {
    digest.map(|digest| digest.hash).unwrap_or_default()
}

#[tonic::async_trait]
impl Capabilities for Service {
    async fn get_capabilities(
        &self,
        _request: Request<api::GetCapabilitiesRequest>,
    ) -> Answer<api::ServerCapabilities> {
        let script = self.begin("capabilities")?;
        let cache = api::CacheCapabilities {
            digest_functions: script.functions.clone(),
            action_cache_update_capabilities: Some(api::ActionCacheUpdateCapabilities {
                update_enabled: script.updates,
            }),
            max_batch_total_size_bytes: script.batch,
            ..api::CacheCapabilities::default()
        };
        let execution = api::ExecutionCapabilities { exec_enabled: script.executes, ..Default::default() };
        let all = api::ServerCapabilities {
            cache_capabilities: Some(cache),
            execution_capabilities: Some(execution),
            ..Default::default()
        };
        Ok(Response::new(all))
    }
}

#[tonic::async_trait]
impl ActionCache for Service {
    async fn get_action_result(
        &self,
        request: Request<api::GetActionResultRequest>,
    ) -> Answer<api::ActionResult> {
        let script = self.begin("find")?;
        let found = script.results.get(&hash(request.into_inner().action_digest)).cloned();
        found.map(Response::new).ok_or_else(|| Status::new(Code::NotFound, "no result"))
    }

    async fn update_action_result(
        &self,
        request: Request<api::UpdateActionResultRequest>,
    ) -> Answer<api::ActionResult> {
        let mut script = self.begin("update")?;
        let request = request.into_inner();
        let result = request.action_result.unwrap_or_default();
        script.results.insert(hash(request.action_digest), result.clone());
        Ok(Response::new(result))
    }
}

#[tonic::async_trait]
impl ContentAddressableStorage for Service {
    async fn find_missing_blobs(
        &self,
        request: Request<api::FindMissingBlobsRequest>,
    ) -> Answer<api::FindMissingBlobsResponse> {
        let script = self.begin("missing")?;
        let asked = request.into_inner().blob_digests.into_iter();
        let missing = asked.filter(|digest| !script.blobs.contains_key(&digest.hash)).collect();
        Ok(Response::new(api::FindMissingBlobsResponse { missing_blob_digests: missing }))
    }

    async fn batch_update_blobs(
        &self,
        request: Request<api::BatchUpdateBlobsRequest>,
    ) -> Answer<api::BatchUpdateBlobsResponse> {
        let mut script = self.begin("batch update")?;
        let requests = request.into_inner().requests;
        let size: usize = requests.iter().map(|request| request.data.len()).sum();
        script.largest = script.largest.max(size);
        let mut responses = Vec::new();
        for request in requests {
            script.blobs.insert(hash(request.digest.clone()), request.data);
            let status = Some(rpc::Status::default());
            responses.push(api::batch_update_blobs_response::Response { digest: request.digest, status });
        }
        Ok(Response::new(api::BatchUpdateBlobsResponse { responses }))
    }

    async fn batch_read_blobs(
        &self,
        request: Request<api::BatchReadBlobsRequest>,
    ) -> Answer<api::BatchReadBlobsResponse> {
        let script = self.begin("batch read")?;
        let one = |digest: api::Digest| {
            let data = script.blobs.get(&digest.hash).cloned();
            let code = if data.is_some() { Code::Ok } else { Code::NotFound };
            let mut data = data.unwrap_or_default();
            data.extend(vec![0; script.surplus]);
            let status = Some(rpc::Status { code: code as i32, ..rpc::Status::default() });
            api::batch_read_blobs_response::Response { digest: Some(digest), data, compressor: 0, status }
        };
        let responses = request.into_inner().digests.into_iter().map(one).collect();
        Ok(Response::new(api::BatchReadBlobsResponse { responses }))
    }

    type GetTreeStream = Pieces<api::GetTreeResponse>;

    async fn get_tree(&self, _request: Request<api::GetTreeRequest>) -> Answer<Self::GetTreeStream> {
        Err(Status::unimplemented("not needed"))
    }

    async fn split_blob(&self, _request: Request<api::SplitBlobRequest>) -> Answer<api::SplitBlobResponse> {
        Err(Status::unimplemented("not needed"))
    }

    type GetChunkMappingStream = Pieces<api::GetChunkMappingResponse>;

    async fn get_chunk_mapping(
        &self,
        _request: Request<api::GetChunkMappingRequest>,
    ) -> Answer<Self::GetChunkMappingStream> {
        Err(Status::unimplemented("not needed"))
    }

    async fn register_chunk_mapping(
        &self,
        _request: Request<Streaming<api::RegisterChunkMappingRequest>>,
    ) -> Answer<api::RegisterChunkMappingResponse> {
        Err(Status::unimplemented("not needed"))
    }

    async fn splice_blob(
        &self,
        _request: Request<api::SpliceBlobRequest>,
    ) -> Answer<api::SpliceBlobResponse> {
        Err(Status::unimplemented("not needed"))
    }
}

#[tonic::async_trait]
impl ByteStream for Service {
    type ReadStream = Pieces<ReadResponse>;

    async fn read(&self, request: Request<ReadRequest>) -> Answer<Self::ReadStream> {
        let mut script = self.begin("read")?;
        let ReadRequest { resource_name, read_offset, .. } = request.into_inner();
        script.calls.push(format!("read {resource_name} from {read_offset}"));
        let hash = resource_name.rsplit('/').nth(1).unwrap_or_default();
        let Some(bytes) = script.blobs.get(hash) else { return Err(Status::not_found("no blob")) };
        let mut rest = bytes[read_offset as usize..].to_vec();
        rest.extend(vec![0; script.surplus]);
        let breaks = script.break_after.take().filter(|at| *at < rest.len());
        rest.truncate(breaks.unwrap_or(rest.len()));
        let mut pieces: Vec<Result<ReadResponse, Status>> =
            rest.chunks(100_000).map(|data| Ok(ReadResponse { data: data.to_vec() })).collect();
        pieces.extend(breaks.map(|_| Err(Status::unavailable("broken"))));
        Ok(Response::new(Box::pin(tokio_stream::iter(pieces))))
    }

    async fn write(&self, request: Request<Streaming<WriteRequest>>) -> Answer<WriteResponse> {
        drop(self.begin("write")?);
        let (mut pieces, mut bytes, mut name) = (request.into_inner(), Vec::new(), String::new());
        let mut largest = 0;
        while let Some(piece) = pieces.message().await? {
            if !piece.resource_name.is_empty() {
                name = piece.resource_name;
            }
            if piece.write_offset != bytes.len() as i64 {
                return Err(Status::invalid_argument("a wrong offset"));
            }
            largest = largest.max(piece.data.len());
            bytes.extend(piece.data);
        }
        let mut script = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        script.calls.push(format!("write {name}"));
        script.largest = script.largest.max(largest);
        let committed_size = bytes.len() as i64;
        script.blobs.insert(name.rsplit('/').nth(1).unwrap_or_default().to_owned(), bytes);
        Ok(Response::new(WriteResponse { committed_size }))
    }

    async fn query_write_status(
        &self,
        _request: Request<QueryWriteStatusRequest>,
    ) -> Answer<QueryWriteStatusResponse> {
        Err(Status::unimplemented("not needed"))
    }
}

//! Blobs on a server. Small blobs are sent and fetched in batches, and large blobs as streams.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use api::content_addressable_storage_client::ContentAddressableStorageClient;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use bazel_remote_apis::google::bytestream::byte_stream_client::ByteStreamClient;
use bazel_remote_apis::google::bytestream::{ReadRequest, WriteRequest};
use bazel_remote_apis::google::rpc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status};

use super::call_error::CallError;
use super::connection::Calls;
use super::server::Server;

/// Size of the pieces of a stream, in bytes.
const PIECE: usize = 256 << 10;
/// Maximum number of pieces of a stream that wait to be sent.
const WAITING: usize = 4;
/// Maximum size of a received message in bytes. A message is a batch with its protocol fields.
const LARGEST_MESSAGE: usize = 8 << 20;
/// Maximum number of digests in one request, so that the request stays below the limits of servers.
const MOST_DIGESTS: usize = 10_000;

/// A blob to upload.
pub(crate) struct Upload<'b> {
    pub digest: api::Digest,
    pub bytes: &'b [u8],
}

impl Server {
    /// Uploads those of the blobs that the server does not have. Returns the number of bytes that were sent.
    pub fn upload(&self, blobs: &[Upload<'_>], cancel: &AtomicBool) -> Result<u64, CallError> {
        blobs.iter().try_for_each(|blob| self.accepts(blob.bytes.len() as u64))?;
        let digests: Vec<&api::Digest> = blobs.iter().map(|blob| &blob.digest).collect();
        let missing = self.missing(&digests, cancel)?;
        let mut seen = BTreeSet::new();
        let wanted = |blob: &&Upload<'_>| missing.contains(&blob.digest.hash);
        let wanted: Vec<&Upload<'_>> =
            blobs.iter().filter(wanted).filter(|blob| seen.insert(&blob.digest.hash)).collect();
        self.send(&wanted, cancel)
    }

    /// Uploads blobs without asking whether the server has them. Returns the number of bytes that were sent.
    pub fn send(&self, wanted: &[&Upload<'_>], cancel: &AtomicBool) -> Result<u64, CallError> {
        let is_small = |blob: &&&Upload<'_>| blob.bytes.len() as u64 <= self.batch / 4;
        let (mut batch, mut size) = (Vec::new(), 0);
        for blob in wanted.iter().filter(is_small) {
            let bytes = blob.bytes.len() as u64;
            if size + bytes > self.batch {
                self.upload_batch(&std::mem::take(&mut batch), size, cancel)?;
                size = 0;
            }
            size += bytes;
            batch.push(*blob);
        }
        if !batch.is_empty() {
            self.upload_batch(&batch, size, cancel)?;
        }
        for blob in wanted.iter().filter(|blob| !is_small(blob)) {
            self.upload_stream(blob, cancel)?;
        }
        Ok(wanted.iter().map(|blob| blob.bytes.len() as u64).sum())
    }

    /// Returns an error if the server accepts no blob of this length.
    pub fn accepts(&self, length: u64) -> Result<(), CallError> {
        if length <= self.largest {
            return Ok(());
        }
        let why = format!("the server accepts at most {} bytes, not {length}", self.largest);
        Err(CallError::Refused { what: "storing a value", why })
    }

    /// The hashes of those of the blobs that the server does not have.
    pub fn missing(
        &self,
        digests: &[&api::Digest],
        cancel: &AtomicBool,
    ) -> Result<BTreeSet<String>, CallError> {
        const WHAT: &str = "asking for missing values";
        let mut missing = BTreeSet::new();
        for digests in digests.chunks(MOST_DIGESTS) {
            let subject = digests.first().map_or("", |digest| &digest.hash);
            let answer = self.connection.call(WHAT, subject, 0, cancel, |channel| {
                let request = api::FindMissingBlobsRequest {
                    instance_name: self.instance(),
                    blob_digests: digests.iter().map(|digest| (*digest).clone()).collect(),
                    digest_function: self.function.number(),
                };
                async move { ContentAddressableStorageClient::new(channel).find_missing_blobs(request).await }
            })?;
            missing.extend(answer.into_inner().missing_blob_digests.into_iter().map(|digest| digest.hash));
        }
        Ok(missing)
    }

    fn upload_batch(&self, blobs: &[&Upload<'_>], size: u64, cancel: &AtomicBool) -> Result<(), CallError> {
        const WHAT: &str = "storing values";
        let subject = blobs.first().map_or("", |blob| &blob.digest.hash);
        self.connection.call(WHAT, subject, size, cancel, |channel| {
            let one = |blob: &&Upload<'_>| api::batch_update_blobs_request::Request {
                digest: Some(blob.digest.clone()),
                data: blob.bytes.to_vec(),
                compressor: 0,
            };
            let request = api::BatchUpdateBlobsRequest {
                instance_name: self.instance(),
                requests: blobs.iter().map(one).collect(),
                digest_function: self.function.number(),
            };
            async move {
                let answer = ContentAddressableStorageClient::new(channel)
                    .batch_update_blobs(request)
                    .await?
                    .into_inner();
                answer.responses.into_iter().try_for_each(|response| checked(response.status))
            }
        })
    }

    fn upload_stream(&self, blob: &Upload<'_>, cancel: &AtomicBool) -> Result<(), CallError> {
        const WHAT: &str = "storing a value";
        let size = blob.bytes.len() as u64;
        let committed = self.connection.call(WHAT, &blob.digest.hash, size, cancel, |channel| {
            let (sender, receiver) = tokio::sync::mpsc::channel(WAITING);
            let name = format!("uploads/{}/{}", unique_name(), self.function.blob_name(&blob.digest));
            let name = self.resource(&name);
            let pieces = blob.bytes.chunks(PIECE).enumerate();
            async move {
                let mut client = ByteStreamClient::new(channel);
                let send = async move {
                    for (index, piece) in pieces {
                        let write_offset = (index * PIECE) as i64;
                        let request = WriteRequest {
                            resource_name: if index == 0 { name.clone() } else { String::new() },
                            write_offset,
                            finish_write: write_offset as u64 + piece.len() as u64 == size,
                            data: piece.to_vec(),
                        };
                        // The server may end the call early: because it has the blob, or with an error.
                        if sender.send(request).await.is_err() {
                            return;
                        }
                    }
                };
                let (answer, ()) = tokio::join!(client.write(ReceiverStream::new(receiver)), send);
                Ok(answer?.into_inner().committed_size)
            }
        })?;
        if u64::try_from(committed) == Ok(size) {
            Ok(())
        } else {
            Err(CallError::wrong(WHAT, format!("the server stored {committed} of {size} bytes")))
        }
    }

    /// Downloads a blob. Only its size is checked, not its digest.
    ///
    /// # Errors
    /// [`CallError::NotFound`] if the server does not have the blob any more.
    pub fn download(&self, digest: &api::Digest, cancel: &AtomicBool) -> Result<Vec<u8>, CallError> {
        const WHAT: &str = "fetching a value";
        let size = u64::try_from(digest.size_bytes)
            .map_err(|_| CallError::wrong(WHAT, "the size of the value is negative"))?;
        let bytes = if size == 0 {
            Vec::new()
        } else if size <= self.batch / 4 {
            self.connection
                .call(WHAT, &digest.hash, size, cancel, |channel| self.read_batch(channel, digest))?
        } else {
            // Kept between attempts, which continue where the last one ended.
            let bytes = Mutex::new(Vec::new());
            self.connection.call(WHAT, &digest.hash, size, cancel, |channel| {
                self.read_stream(channel, digest, size, &bytes)
            })?;
            bytes.into_inner().unwrap_or_else(PoisonError::into_inner)
        };
        if bytes.len() as u64 == size {
            Ok(bytes)
        } else {
            Err(CallError::wrong(
                WHAT,
                format!("the length of the value is {} bytes instead of {size}", bytes.len()),
            ))
        }
    }

    async fn read_batch(&self, channel: Calls, digest: &api::Digest) -> Result<Vec<u8>, Status> {
        let request = api::BatchReadBlobsRequest {
            instance_name: self.instance(),
            digests: vec![digest.clone()],
            acceptable_compressors: Vec::new(),
            digest_function: self.function.number(),
        };
        let mut client =
            ContentAddressableStorageClient::new(channel).max_decoding_message_size(LARGEST_MESSAGE);
        let answer = client.batch_read_blobs(request).await?.into_inner();
        let response = answer.responses.into_iter().next();
        let response = response.ok_or_else(|| Status::new(Code::NotFound, "the answer contains no blob"))?;
        checked(response.status)?;
        Ok(response.data)
    }

    async fn read_stream(
        &self,
        channel: Calls,
        digest: &api::Digest,
        size: u64,
        bytes: &Mutex<Vec<u8>>,
    ) -> Result<(), Status> {
        let known = bytes.lock().unwrap_or_else(PoisonError::into_inner).len();
        let request = ReadRequest {
            resource_name: self.resource(&self.function.blob_name(digest)),
            read_offset: known as i64,
            read_limit: 0,
        };
        let mut client = ByteStreamClient::new(channel).max_decoding_message_size(LARGEST_MESSAGE);
        let mut pieces = client.read(request).await?.into_inner();
        while let Some(piece) = pieces.message().await? {
            let mut bytes = bytes.lock().unwrap_or_else(PoisonError::into_inner);
            if (bytes.len() + piece.data.len()) as u64 > size {
                return Err(Status::new(Code::OutOfRange, format!("the value is longer than {size} bytes")));
            }
            bytes.extend_from_slice(&piece.data);
        }
        Ok(())
    }
}

/// The outcome for one blob of a batch.
fn checked(status: Option<rpc::Status>) -> Result<(), Status> {
    match status {
        None => Ok(()),
        Some(status) if status.code == Code::Ok as i32 => Ok(()),
        Some(status) => Err(Status::new(Code::from_i32(status.code), status.message)),
    }
}

/// A name for an upload that no other upload has: a random UUID.
fn unique_name() -> String {
    let mut bytes = [0; 16];
    if getrandom::fill(&mut bytes).is_err() {
        // Unique in this process; a collision with another one only makes a server refuse one of the uploads.
        static COUNT: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
        let count = COUNT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let seed = cache::Digest::of(format!("{}\n{count}", std::process::id()).as_bytes());
        bytes.copy_from_slice(&seed.as_bytes()[..16]);
    }
    bytes[6] = bytes[6] & 0x0f | 0x40;
    bytes[8] = bytes[8] & 0x3f | 0x80;
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    [&hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..]].join("-")
}

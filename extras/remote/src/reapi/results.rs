//! Results in the action cache of a server.

use std::sync::atomic::AtomicBool;

use api::action_cache_client::ActionCacheClient;
use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use cache::Digest;
use prost::Message;

use super::blobs::Upload;
use super::call_error::CallError;
use super::server::Server;

/// First argument of the command of a synthetic action.
const COMMAND: &str = "lightharmony-key-1";
/// Path of the signed entry in an action result.
const ENTRY: &str = "entry";
/// Folder of the values in an action result.
const VALUES: &str = "values/";
/// Maximum size of a signed entry in bytes.
const LONGEST_ENTRY: i64 = 16 << 20;

/// A result as received from the server. None of it has been verified.
pub(crate) struct UnverifiedResult {
    /// The bytes of the signed entry.
    pub sealed: Vec<u8>,
    /// For each value, its digest in the entry, and the digest under which the server stores it.
    pub values: Vec<(Digest, api::Digest)>,
}

/// The synthetic action of a key and its command.
struct Synthetic {
    command: Vec<u8>,
    action: Vec<u8>,
    digest: api::Digest,
}

impl Server {
    fn synthetic(&self, key: &Digest) -> Synthetic {
        let command =
            api::Command { arguments: vec![COMMAND.to_owned(), key.to_string()], ..api::Command::default() };
        let command = command.encode_to_vec();
        let action = api::Action {
            command_digest: Some(self.function.of_bytes(&command)),
            // Digest of the empty folder, whose encoding is empty.
            input_root_digest: Some(self.function.of_bytes(&[])),
            ..api::Action::default()
        };
        let action = action.encode_to_vec();
        let digest = self.function.of_bytes(&action);
        Synthetic { command, action, digest }
    }

    /// The result of a key.
    ///
    /// # Errors
    /// [`CallError::NotFound`] if the server has no result.
    pub fn find(&self, key: &Digest, cancel: &AtomicBool) -> Result<UnverifiedResult, CallError> {
        const WHAT: &str = "looking for a result";
        let subject = key.to_string();
        let answer = self.connection.call(WHAT, &subject, 0, cancel, |channel| {
            let request = api::GetActionResultRequest {
                instance_name: self.instance(),
                action_digest: Some(self.synthetic(key).digest),
                inline_output_files: vec![ENTRY.to_owned()],
                digest_function: self.function.number(),
                ..api::GetActionResultRequest::default()
            };
            async move { ActionCacheClient::new(channel).get_action_result(request).await }
        })?;
        let (mut sealed, mut values) = (None, Vec::new());
        for file in answer.into_inner().output_files {
            let Some(digest) = file.digest else { continue };
            if file.path == ENTRY {
                sealed = Some((file.contents, digest));
            } else if let Some(hex) = file.path.strip_prefix(VALUES)
                && let Some(value) = Digest::from_hex(hex)
            {
                values.push((value, digest));
            }
        }
        let Some((contents, digest)) = sealed else {
            return Err(CallError::wrong(WHAT, "the result has no entry"));
        };
        if digest.size_bytes > LONGEST_ENTRY {
            return Err(CallError::wrong(WHAT, "the entry is too long"));
        }
        let sealed = if contents.is_empty() { self.download(&digest, cancel)? } else { contents };
        Ok(UnverifiedResult { sealed, values })
    }

    /// Stores a result: first its values, then the signed entry that names them. Returns the number of bytes that
    /// were sent.
    pub fn store(
        &self,
        key: &Digest,
        sealed: &[u8],
        values: &[(Digest, &[u8])],
        cancel: &AtomicBool,
    ) -> Result<u64, CallError> {
        let upload = |bytes| Upload { digest: self.function.of_bytes(bytes), bytes };
        let uploads: Vec<Upload<'_>> = values.iter().map(|(_, bytes)| upload(bytes)).collect();
        let sent = self.upload(&uploads, cancel)?;
        let places = values.iter().zip(uploads).map(|((value, _), upload)| (*value, upload.digest));
        Ok(sent + self.store_entry(key, sealed, &places.collect::<Vec<_>>(), cancel)?)
    }

    /// Stores a result whose values are on the server: the signed entry that names them. Returns the number of bytes
    /// that were sent.
    pub fn store_entry(
        &self,
        key: &Digest,
        sealed: &[u8],
        values: &[(Digest, api::Digest)],
        cancel: &AtomicBool,
    ) -> Result<u64, CallError> {
        const WHAT: &str = "storing a result";
        let Synthetic { command, action, digest } = self.synthetic(key);
        let file = |path: String, digest: &api::Digest| api::OutputFile {
            path,
            digest: Some(digest.clone()),
            ..api::OutputFile::default()
        };
        let mut files: Vec<api::OutputFile> =
            values.iter().map(|(value, place)| file(format!("{VALUES}{value}"), place)).collect();
        files.push(file(ENTRY.to_owned(), &self.function.of_bytes(sealed)));
        // Servers need the files of a result in the order of their paths.
        files.sort_by(|a, b| a.path.cmp(&b.path));
        let uploads = [command.as_slice(), &action, &[], sealed]
            .map(|bytes| Upload { digest: self.function.of_bytes(bytes), bytes });
        let sent = self.upload(&uploads, cancel)?;
        let result = api::ActionResult { output_files: files, ..api::ActionResult::default() };
        self.connection.call(WHAT, &key.to_string(), 0, cancel, |channel| {
            let request = api::UpdateActionResultRequest {
                instance_name: self.instance(),
                action_digest: Some(digest.clone()),
                action_result: Some(result.clone()),
                results_cache_policy: None,
                digest_function: self.function.number(),
            };
            async move { ActionCacheClient::new(channel).update_action_result(request).await }
        })?;
        Ok(sent)
    }
}

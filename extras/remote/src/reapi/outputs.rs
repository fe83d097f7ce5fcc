//! The outputs of an action: verification of what a server reports.

use std::sync::atomic::AtomicBool;

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use engine::{Entry, WorkRequest};

use super::call_error::CallError;
use super::server::Server;

/// The folder of the outputs within the input root.
pub(crate) const OUT: &str = "out";
/// Path of the entry within the outputs folder.
pub(crate) const ENTRY: &str = "entry";
/// Maximum length of an entry in bytes.
const LONGEST_ENTRY: u64 = 16 << 20;
/// Maximum length in bytes of standard output and error that is read.
const LONGEST_TEXT: i64 = 256 << 10;

/// The verified outputs of an action.
pub(crate) struct Outputs {
    pub entry: Entry,
    /// For each value in the entry, in the same order, the digest under which the server stores it.
    pub places: Vec<(cache::Digest, api::Digest)>,
}

/// The path of an output within the input root.
pub(crate) fn path(output: &str) -> String {
    format!("{OUT}/{output}")
}

impl Server {
    /// Verifies the outputs of an action: exactly the wanted files, all of them regular files, an entry of the key of
    /// the request, and values of the lengths that the entry states. The values themselves are verified when they are
    /// fetched.
    ///
    /// # Errors
    /// The reason why the outputs are not valid, or the error of a call.
    pub fn outputs(
        &self,
        result: &api::ActionResult,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
    ) -> Result<Result<Outputs, String>, CallError> {
        #[allow(deprecated, reason = "servers for the first versions of the protocol use these fields")]
        let links =
            [&result.output_symlinks, &result.output_file_symlinks, &result.output_directory_symlinks];
        if let Some(link) = links.into_iter().flatten().next() {
            return Ok(Err(format!("the output `{}` is a link", link.path)));
        }
        if let Some(folder) = result.output_directories.first() {
            return Ok(Err(format!("the output `{}` is a folder", folder.path)));
        }
        let wanted: Vec<String> =
            [request.entry].into_iter().chain(request.values.iter().map(String::as_str)).map(path).collect();
        let mut found: Vec<Option<&api::OutputFile>> = vec![None; wanted.len()];
        for file in &result.output_files {
            let Some(at) = wanted.iter().position(|wanted| *wanted == file.path) else {
                return Ok(Err(format!("`{}` is not an output of the node", file.path)));
            };
            if found[at].replace(file).is_some() {
                return Ok(Err(format!("the output `{}` appears twice", file.path)));
            }
        }
        let mut digests = Vec::with_capacity(found.len());
        for (file, wanted) in found.iter().zip(&wanted) {
            match file.and_then(|file| file.digest.as_ref()) {
                Some(digest) => digests.push(digest),
                None => return Ok(Err(format!("the output `{wanted}` is missing"))),
            }
        }
        let (Some(place), Some(file)) = (digests.first(), found.first().copied().flatten()) else {
            return Ok(Err("the entry is missing".to_owned()));
        };
        if u64::try_from(place.size_bytes).map_or(true, |size| size > LONGEST_ENTRY) {
            return Ok(Err("the entry is too long".to_owned()));
        }
        let bytes = match file.contents.as_slice() {
            [] => match self.download(place, cancel) {
                Ok(bytes) => bytes,
                Err(CallError::NotFound) => return Ok(Err("the entry is not on the server".to_owned())),
                Err(error) => return Err(error),
            },
            contents => contents.to_vec(),
        };
        if self.function.of_bytes(&bytes) != **place {
            return Ok(Err("the entry is damaged".to_owned()));
        }
        let entry = match Entry::decode(&bytes, &request.key) {
            Ok(entry) => entry,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let values = match entry.blobs() {
            Ok(values) if values.len() + 1 == digests.len() => values,
            _ => return Ok(Err("the entry has another number of values".to_owned())),
        };
        let mut places = Vec::with_capacity(values.len());
        for ((value, length), place) in values.iter().zip(&entry.lengths).zip(digests.iter().skip(1)) {
            if u64::try_from(place.size_bytes) != Ok(*length) {
                return Ok(Err(format!(
                    "a value has {} bytes, but the entry states {length}",
                    place.size_bytes
                )));
            }
            places.push((*value, (*place).clone()));
        }
        Ok(Ok(Outputs { entry, places }))
    }

    /// The end of a text that the command wrote to standard output or standard error.
    pub fn text(&self, raw: &[u8], digest: Option<&api::Digest>, cancel: &AtomicBool) -> String {
        let stored = || digest.filter(|digest| (1..=LONGEST_TEXT).contains(&digest.size_bytes));
        let bytes = match raw {
            // A text that cannot be read only makes a message shorter.
            [] => stored().and_then(|digest| self.download(digest, cancel).ok()).unwrap_or_default(),
            raw => raw.to_vec(),
        };
        String::from_utf8_lossy(&bytes).trim().to_owned()
    }
}

//! A node as an action: its command, its input folder, and the sending of what the server lacks.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use bazel_remote_apis::google::protobuf;
use cache::Digest;
use engine::{WorkContent, WorkRequest};
use prost::Message;

use super::blobs::Upload;
use super::call_error::CallError;
use super::outputs;
use super::sender::{Sender, WHAT, read, timed};
use super::tree::Folder;
use super::worker_options::WorkerProgram;

/// Name of the program in the input folder. It is not in a folder of its own, since in the sandboxes of some servers the
/// input folder is `/`, with folders such as `bin` of the worker in it.
const PROGRAM: &str = "lightharmony";
/// Time limits are multiples of this, so that nearly equal forecasts give equal actions.
const HOUR: u64 = 3600;
/// The time limit is this many times the forecast.
const SLOWER: f64 = 10.0;

/// The origin of the bytes of an input.
enum Origin {
    Bytes(Vec<u8>),
    Value(Digest),
    File(PathBuf, Digest),
    Program(PathBuf),
}

/// An action whose inputs have not been sent yet.
pub(crate) struct WorkAction {
    /// The digest of the action.
    pub action: api::Digest,
    inputs: Vec<(api::Digest, Origin)>,
}

impl WorkAction {
    /// The action of a node. `memory` is the amount of memory in GiB that a worker must have. `None` if the bytes of
    /// an input are needed, but are not here.
    pub fn of(
        sender: &Sender,
        request: &WorkRequest<'_>,
        memory: Option<u32>,
    ) -> Result<Option<Self>, CallError> {
        let function = sender.cache.server().function;
        let (mut folder, mut inputs) = (Folder::default(), Vec::new());
        for file in request.files {
            let (digest, origin) = match &file.content {
                WorkContent::Text(text) => {
                    let bytes = text.as_bytes().to_vec();
                    (function.of_bytes(&bytes), Origin::Bytes(bytes))
                }
                WorkContent::Value(value) => {
                    let place = sender.cache.places.get(value);
                    let here = || (request.bytes)(value).map(|bytes| function.of_bytes(&bytes));
                    let Some(place) = place.or_else(here) else { return Ok(None) };
                    (place, Origin::Value(*value))
                }
                WorkContent::File { path, digest } => {
                    let place = match sender.cache.places.get(digest) {
                        Some(place) => place,
                        None => function.of_bytes(&read_file(path, digest)?),
                    };
                    (place, Origin::File(path.clone(), *digest))
                }
            };
            if !folder.add(&file.path, digest.clone(), false) {
                let why = format!("`{}` cannot be a file of the action", file.path);
                return Err(CallError::Refused { what: WHAT, why });
            }
            inputs.push((digest, origin));
        }
        let options = &sender.options;
        let program = match &options.program {
            WorkerProgram::Installed(program) => program.clone(),
            WorkerProgram::Sent(path) => {
                let digest = sender.program_place(path)?;
                folder.add(PROGRAM, digest.clone(), true);
                inputs.push((digest, Origin::Program(path.clone())));
                format!("./{PROGRAM}")
            }
        };
        let mut blobs = Vec::new();
        let root = folder.digest(function, &mut blobs);
        let platform = platform(sender, memory);
        let mut paths: Vec<String> = [request.entry]
            .into_iter()
            .chain(request.values.iter().map(String::as_str))
            .map(outputs::path)
            .collect();
        paths.sort();
        #[allow(deprecated, reason = "servers for the first versions of the protocol use this field")]
        let command = api::Command {
            arguments: [program].into_iter().chain(options.arguments.iter().cloned()).collect(),
            output_paths: paths,
            platform: platform.clone(),
            ..api::Command::default()
        };
        let command = command.encode_to_vec();
        let command_digest = function.of_bytes(&command);
        let action = api::Action {
            command_digest: Some(command_digest.clone()),
            input_root_digest: Some(root),
            timeout: timeout(options.timeout, request.forecast),
            platform,
            ..api::Action::default()
        };
        let action = action.encode_to_vec();
        let action_digest = function.of_bytes(&action);
        blobs.push((command_digest, command));
        blobs.push((action_digest.clone(), action));
        inputs.extend(blobs.into_iter().map(|(digest, bytes)| (digest, Origin::Bytes(bytes))));
        Ok(Some(Self { action: action_digest, inputs }))
    }

    /// Sends the inputs that the server does not have. Returns false if the bytes of one of them are not here.
    pub fn send(
        &self,
        sender: &Sender,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
    ) -> Result<bool, CallError> {
        let server = sender.cache.server();
        let digests: Vec<&api::Digest> = self.inputs.iter().map(|(digest, _)| digest).collect();
        let mut missing = server.missing(&digests, cancel)?;
        let guard = match missing.is_empty() {
            true => None,
            false => {
                // Another thread may be sending the same inputs.
                let guard = sender.turn(cancel)?;
                missing = server.missing(&digests, cancel)?;
                Some(guard)
            }
        };
        // Small blobs are sent together. Large ones are in memory one at a time.
        let mut small: Vec<(&api::Digest, Vec<u8>)> = Vec::new();
        let mut sent = 0;
        let (whole, time) = timed(|| -> Result<bool, CallError> {
            for (digest, origin) in &self.inputs {
                if !missing.remove(&digest.hash) {
                    continue;
                }
                let bytes = match origin {
                    Origin::Bytes(bytes) => bytes.clone(),
                    Origin::File(path, digest) => read_file(path, digest)?,
                    Origin::Program(path) => read(path)?,
                    Origin::Value(value) => match (request.bytes)(value) {
                        Some(bytes) => bytes,
                        None => {
                            sender.cache.places.remove(value);
                            return Ok(false);
                        }
                    },
                };
                if server.function.of_bytes(&bytes) != *digest {
                    let why = "an input has changed, or has another digest than the server stated".to_owned();
                    if let Origin::Value(value) = origin {
                        sender.cache.places.remove(value);
                    }
                    return Err(CallError::Refused { what: WHAT, why });
                }
                server.accepts(bytes.len() as u64)?;
                if bytes.len() as u64 <= server.batch / 4 {
                    small.push((digest, bytes));
                } else {
                    sent += server.send(&[&Upload { digest: digest.clone(), bytes: &bytes }], cancel)?;
                }
            }
            let uploads: Vec<Upload<'_>> =
                small.iter().map(|(digest, bytes)| Upload { digest: (*digest).clone(), bytes }).collect();
            sent += server.send(&uploads.iter().collect::<Vec<_>>(), cancel)?;
            Ok(true)
        });
        drop(guard);
        sender.cache.count(|traffic| traffic.bytes_up += sent);
        sender.measure(sent, time);
        if !whole? {
            return Ok(false);
        }
        for (digest, origin) in &self.inputs {
            if let Origin::Value(value) | Origin::File(_, value) = origin {
                sender.cache.places.put(*value, digest.clone());
            }
        }
        Ok(true)
    }
}

/// Reads a source file that must have the digest `digest`.
fn read_file(path: &Path, digest: &Digest) -> Result<Vec<u8>, CallError> {
    let bytes = read(path)?;
    if Digest::of(&bytes) == *digest {
        return Ok(bytes);
    }
    let why = format!("`{}` changed while the graph was running", path.display());
    Err(CallError::Refused { what: WHAT, why })
}

/// The platform that the worker must have.
fn platform(sender: &Sender, memory: Option<u32>) -> Option<api::Platform> {
    let options = &sender.options;
    let mut properties = options.properties.clone();
    if let (Some((name, _)), Some(memory)) = (&options.memory, memory) {
        properties.push((name.clone(), memory.to_string()));
    }
    // The protocol requires this order.
    properties.sort();
    let property = |(name, value)| api::platform::Property { name, value };
    let properties: Vec<_> = properties.into_iter().map(property).collect();
    (!properties.is_empty()).then_some(api::Platform { properties })
}

/// The time limit of an action: `fixed`, or else a multiple of the forecast. `None` without both.
fn timeout(fixed: Option<Duration>, forecast: Option<f64>) -> Option<protobuf::Duration> {
    let seconds = fixed.map(|fixed| fixed.as_secs().max(1)).or_else(|| {
        let hours = (forecast? * SLOWER / HOUR as f64).ceil().max(1.0);
        Some((hours as u64).saturating_mul(HOUR))
    })?;
    Some(protobuf::Duration { seconds: i64::try_from(seconds).unwrap_or(i64::MAX), nanos: 0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_limit_is_a_number_of_hours() {
        let seconds = |fixed: Option<u64>, forecast| {
            timeout(fixed.map(Duration::from_secs), forecast).map(|limit| limit.seconds)
        };
        assert_eq!(seconds(None, None), None);
        assert_eq!(seconds(None, Some(1.0)), Some(3600));
        assert_eq!(seconds(None, Some(800.0)), Some(3 * 3600));
        assert_eq!(seconds(Some(20), Some(800.0)), Some(20));
        assert_eq!(seconds(None, Some(f64::INFINITY)), Some(i64::MAX), "no overflow");
    }
}

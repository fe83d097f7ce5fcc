//! The outputs of an action in a folder. The worker writes them; the process that takes them verifies them.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use cache::{Digest, publish_file};

use crate::graph::node::Node;
use crate::record::record::Record;
use crate::remote::entry::Entry;
use crate::remote::error::ActionError;
use crate::value::artifact::decode_with;

/// Name of the file that holds the entry.
pub(crate) const ENTRY: &str = "entry";
/// Name of the folder that holds the values.
pub(crate) const VALUES: &str = "values";
/// Maximum length of an entry in bytes: the maximum of a record in the store.
pub(crate) const LONGEST_ENTRY: u64 = 16 << 20;

/// Writes the values of a node and then its entry. `values` contains the name and the bytes of each stored output,
/// in the order of the outputs. The folder may exist if it is empty or contains only an empty folder for the values, as
/// servers prepare it.
///
/// # Errors
/// If the folder already has other content, or if a file cannot be written or read back without a difference.
pub(crate) fn write(
    folder: &Path,
    key: Digest,
    record: Vec<u8>,
    values: &[(&str, &[u8])],
) -> Result<(), ActionError> {
    let inside = folder.join(VALUES);
    fs::create_dir_all(&inside).map_err(ActionError::io("create", &inside))?;
    if listing(folder)?.len() > 1 || !listing(&inside)?.is_empty() {
        let exists = std::io::ErrorKind::AlreadyExists.into();
        return Err(ActionError::io("create", folder)(exists));
    }
    let lengths = values.iter().map(|(_, bytes)| bytes.len() as u64).collect();
    let entry = Entry { key, lengths, record }.encode();
    let files = values.iter().map(|(name, bytes)| (inside.join(name), *bytes));
    for (path, bytes) in files.chain([(folder.join(ENTRY), entry.as_slice())]) {
        publish_file(&path, bytes)?;
        // A full or failing disk must not become a result that others use.
        let read = fs::read(&path).map_err(ActionError::io("read", &path))?;
        if read != bytes {
            let why = format!("`{}` does not have the content that was written", path.display());
            return Err(ActionError::Outputs { folder: folder.to_owned(), why });
        }
    }
    Ok(())
}

/// The verified outputs of an action.
pub(crate) struct Outputs {
    pub record: Record,
    /// The record with its manifest, as in the store.
    pub encoded: Vec<u8>,
    /// Digest and bytes of each stored output in the record, in the same order.
    pub values: Vec<(Digest, Vec<u8>)>,
}

/// Reads and verifies the outputs of a node with the key `key`. Every file must be a regular file with the stated
/// name, length and digest, every value must be decodable, and the folder must not contain anything else.
///
/// # Errors
/// For the first file that does not meet these conditions.
pub(crate) fn read(folder: &Path, node: &Node, key: &Digest) -> Result<Outputs, ActionError> {
    let refused = |why: String| ActionError::Outputs { folder: folder.to_owned(), why };
    let inside = folder.join(VALUES);
    let found = listing(folder)?;
    if let Some(name) = found.keys().find(|name| ![ENTRY, VALUES].contains(&name.as_str())) {
        return Err(refused(format!("the folder contains `{name}`, which is not a file of the outputs")));
    }
    let is_folder = |found: &EntryType| matches!(found, EntryType::Folder);
    if !found.get(VALUES).is_some_and(is_folder) {
        return Err(refused(format!("`{VALUES}` is not a folder")));
    }
    let bytes = match found.get(ENTRY) {
        Some(EntryType::File(length)) if *length <= LONGEST_ENTRY => {
            let path = folder.join(ENTRY);
            fs::read(&path).map_err(ActionError::io("read", &path))?
        }
        Some(EntryType::File(_)) => return Err(refused(format!("the file `{ENTRY}` is too long"))),
        _ => return Err(refused(format!("`{ENTRY}` is not a file"))),
    };
    let entry = Entry::decode(&bytes, key).map_err(|error| refused(error.to_string()))?;
    let record = Record::decode(&entry.record, node).map_err(|error| refused(error.to_string()))?;

    let found = listing(&inside)?;
    let ports = node.kind.outputs.iter().zip(&record.outputs).filter(|(_, output)| output.stored);
    let stored: Vec<_> = ports.zip(&entry.lengths).collect();
    if let Some(name) = found.keys().find(|name| !stored.iter().any(|((port, _), _)| port.name == *name)) {
        return Err(refused(format!("`{VALUES}/{name}` is not an output of `{}`", node.kind.name)));
    }
    let mut values = Vec::with_capacity(stored.len());
    for ((port, output), length) in stored {
        let name = port.name;
        match found.get(name) {
            Some(EntryType::File(found)) if found == length => {}
            Some(EntryType::File(found)) => {
                return Err(refused(format!(
                    "the length of `{VALUES}/{name}` is {found} bytes instead of {length}"
                )));
            }
            _ => return Err(refused(format!("`{VALUES}/{name}` is not a file"))),
        }
        let path = inside.join(name);
        let bytes = fs::read(&path).map_err(ActionError::io("read", &path))?;
        if Digest::of(&bytes) != output.digest {
            return Err(ActionError::Content { path, digest: output.digest });
        }
        decode_with(&port.artifact, &bytes)
            .map_err(|error| refused(format!("`{VALUES}/{name}`: {error}")))?;
        values.push((output.digest, bytes));
    }
    Ok(Outputs { record, encoded: entry.record, values })
}

/// A file or folder. Links are not followed.
enum EntryType {
    /// A regular file, with its length in bytes.
    File(u64),
    Folder,
    /// A link, a device or a pipe.
    Other,
}

fn listing(folder: &Path) -> Result<BTreeMap<String, EntryType>, ActionError> {
    let read = |folder| fs::read_dir(folder).map_err(ActionError::io("read", folder));
    let mut found = BTreeMap::new();
    for entry in read(folder)? {
        let entry = entry.map_err(ActionError::io("read", folder))?;
        let path = entry.path();
        let metadata = fs::symlink_metadata(&path).map_err(ActionError::io("read", &path))?;
        let what = match metadata {
            data if data.is_file() => EntryType::File(data.len()),
            data if data.is_dir() => EntryType::Folder,
            _ => EntryType::Other,
        };
        found.insert(entry.file_name().to_string_lossy().into_owned(), what);
    }
    Ok(found)
}

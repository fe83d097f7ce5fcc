//! The input folder of an action as a tree of directories, each of which is a blob.

use std::collections::BTreeMap;

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use prost::Message;

use super::digests::Function;

/// A folder with files whose content is on the server or will be.
#[derive(Default)]
pub(crate) struct Folder {
    files: BTreeMap<String, (api::Digest, bool)>,
    folders: BTreeMap<String, Folder>,
}

impl Folder {
    /// Adds a file. `path` has `/` between its parts. Returns false if the path is not a path of a file in this
    /// folder, or if the name is taken by a folder.
    pub fn add(&mut self, path: &str, digest: api::Digest, is_executable: bool) -> bool {
        let is_name = |part: &str| !matches!(part, "" | "." | "..");
        if !path.split('/').all(is_name) {
            return false;
        }
        let (folder, name) = match path.rsplit_once('/') {
            None => (&mut *self, path),
            Some((above, name)) => {
                let mut folder = &mut *self;
                for part in above.split('/') {
                    if folder.files.contains_key(part) {
                        return false;
                    }
                    folder = folder.folders.entry(part.to_owned()).or_default();
                }
                (folder, name)
            }
        };
        if folder.folders.contains_key(name) {
            return false;
        }
        folder.files.insert(name.to_owned(), (digest, is_executable));
        true
    }

    /// The digest of the folder. The encoded directories are added to `blobs`, with their digests.
    pub fn digest(&self, function: Function, blobs: &mut Vec<(api::Digest, Vec<u8>)>) -> api::Digest {
        // The protocol requires the order of the names, which the maps have.
        let files = self.files.iter().map(|(name, (digest, is_executable))| api::FileNode {
            name: name.clone(),
            digest: Some(digest.clone()),
            is_executable: *is_executable,
            ..api::FileNode::default()
        });
        let folders = self.folders.iter().map(|(name, folder)| api::DirectoryNode {
            name: name.clone(),
            digest: Some(folder.digest(function, blobs)),
        });
        let directory = api::Directory {
            files: files.collect(),
            directories: folders.collect(),
            ..api::Directory::default()
        };
        let bytes = directory.encode_to_vec();
        let digest = function.of_bytes(&bytes);
        blobs.push((digest.clone(), bytes));
        digest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn digest(text: &str) -> api::Digest {
        Function::Sha256.of_bytes(text.as_bytes())
    }

    #[test]
    fn a_folder_becomes_directories_in_order_of_the_names() {
        let mut folder = Folder::default();
        for path in ["b/2", "b/1", "a.txt", "b/c/3"] {
            assert!(folder.add(path, digest(path), path == "a.txt"));
        }
        for wrong in ["", "/x", "x/", "../x", "b/../x", "./x", "b", "a.txt/x", "b//x"] {
            assert!(!folder.add(wrong, digest(wrong), false), "{wrong}");
        }
        let mut blobs = Vec::new();
        let root = folder.digest(Function::Sha256, &mut blobs);
        assert_eq!(blobs.len(), 3);
        let read = |digest: &api::Digest| {
            let (_, bytes) = blobs.iter().find(|(known, _)| known == digest).expect("a blob");
            assert_eq!(Function::Sha256.of_bytes(bytes), *digest);
            api::Directory::decode(bytes.as_slice()).expect("a directory")
        };
        let root = read(&root);
        assert_eq!((root.files[0].name.as_str(), root.files[0].is_executable), ("a.txt", true));
        assert_eq!(root.directories.len(), 1);
        let b = read(root.directories[0].digest.as_ref().expect("a digest"));
        let names: Vec<&str> = b.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!((names, b.directories[0].name.as_str()), (vec!["1", "2"], "c"));
        assert_eq!(b.files[1].digest, Some(digest("b/2")));
        // The order in which files are added does not matter.
        let mut again = Folder::default();
        for path in ["b/c/3", "a.txt", "b/1", "b/2"] {
            again.add(path, digest(path), path == "a.txt");
        }
        assert_eq!(again.digest(Function::Sha256, &mut Vec::new()), blobs[2].0);
    }
}

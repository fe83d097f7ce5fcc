//! Unpacks a bundle into a folder, completely or not at all.

use std::collections::BTreeSet;
use std::fs;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::Path;

use cache::{Digest, Store, TempFolder};

use crate::record::record::Record;
use crate::share::bundle::container::{Bundle, BundleError};
use crate::share::bundle::names::{GRAPH, LOCK};
use crate::value::root::BUNDLE_MARK;

impl<R: Read + Seek> Bundle<R> {
    /// Creates the folder `target` with the graph, its lock and its source files. The files are written to a folder
    /// next to the target, verified, and then renamed; after an error no file remains. Links are never created.
    ///
    /// # Errors
    /// If the bundle is invalid, the target exists and is not empty, or the disk is full.
    pub fn unpack(&mut self, target: &Path) -> Result<(), BundleError> {
        let failed = |what: &str, path: &Path| {
            let what = format!("cannot {what} `{}`", path.display());
            move |source| BundleError::Io { what, source }
        };
        if fs::symlink_metadata(target).is_ok() && !is_empty_folder(target) {
            let what = format!("`{}` exists already; choose a new folder", target.display());
            return Err(BundleError::Refused(what));
        }
        for needed in [GRAPH, LOCK] {
            if self.content_of(needed).is_none() {
                return Err(BundleError::Damaged(format!("the bundle does not contain `{needed}`")));
            }
        }
        let parent =
            target.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(parent).map_err(failed("create", parent))?;
        let passing = TempFolder::create_in(parent).map_err(|error| BundleError::Refused(cause(error)))?;
        let files: Vec<String> = self.files().map(|(name, ..)| name.to_owned()).collect();
        for name in files {
            // The name was checked when the bundle was opened: it is relative and does not lead upwards.
            let path = passing.path().join(&name);
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder).map_err(failed("create", folder))?;
            }
            let mut file = OpenOptions::new()
                .write(true)
                .create_new(true)
                .open(&path)
                .map_err(failed("create", &path))?;
            let content = self.content_of(&name).unwrap_or_default();
            self.copy(content, &mut file).map_err(|error| match error {
                BundleError::Io { source, .. } => failed("write", &path)(source),
                other => other,
            })?;
        }
        let mark = passing.path().join(BUNDLE_MARK);
        let text = format!(
            "{}\nThis folder came from a bundle. Its graph may read only files in this folder and in the folders of `--inputs`.\n\
             Remove this file if you trust the graph.\n",
            self.digest()
        );
        File::create_new(&mark)
            .and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(failed("create", &mark))?;
        if is_empty_folder(target) {
            fs::remove_dir(target).map_err(failed("replace", target))?;
        }
        fs::rename(passing.path(), target).map_err(failed("rename to", target))?;
        Ok(())
    }

    /// Copies records and values into a store. Later runs with this store use them without a check. Only for
    /// temporary stores, or if the author of the bundle is trusted.
    ///
    /// # Errors
    /// If the bundle is invalid or the store cannot be written.
    pub fn fill(&mut self, store: &Store) -> Result<(), BundleError> {
        let failed = |error: cache::Error| BundleError::Refused(error.to_string());
        for (digest, content) in self.values() {
            let bytes = self.read(content)?;
            store.put_blob_as(&digest, &bytes).map_err(failed)?;
        }
        let kept = self.values().into_iter().map(|(digest, _)| digest).collect();
        for (key, content) in self.records() {
            self.put_record(store, &key, content, &kept)?;
        }
        Ok(())
    }

    /// Copies a record into a store. Values that are not in `kept` are marked as not stored, so that their absence
    /// does not count as damage.
    pub(super) fn put_record(
        &mut self,
        store: &Store,
        key: &Digest,
        content: usize,
        kept: &BTreeSet<Digest>,
    ) -> Result<(), BundleError> {
        let bytes = self.read(content)?;
        // An invalid record is rejected when it is looked up.
        let record = Record::keeping(&bytes, |digest| kept.contains(digest)).unwrap_or(bytes);
        store.put_record(key, &record).map_err(|error| BundleError::Refused(error.to_string()))
    }

    /// The text of the graph.
    ///
    /// # Errors
    /// If the graph is missing from the bundle or is not valid UTF-8.
    pub fn graph_text(&mut self) -> Result<String, BundleError> {
        self.text(GRAPH)
    }

    /// The text of the lock.
    ///
    /// # Errors
    /// If the lock is missing from the bundle or is not valid UTF-8.
    pub fn lock_text(&mut self) -> Result<String, BundleError> {
        self.text(LOCK)
    }

    fn text(&mut self, name: &str) -> Result<String, BundleError> {
        let content = self.content_of(name);
        let content =
            content.ok_or_else(|| BundleError::Damaged(format!("the bundle does not contain `{name}`")))?;
        String::from_utf8(self.read(content)?)
            .map_err(|_| BundleError::Damaged(format!("`{name}` is not UTF-8 text")))
    }
}

/// The text of an error in one line: operation, path and error of the system.
pub(super) fn cause(error: cache::Error) -> String {
    crate::value::error::NodeError::from(error).to_string()
}

fn is_empty_folder(path: &Path) -> bool {
    let is_folder = fs::symlink_metadata(path).is_ok_and(|found| found.is_dir());
    is_folder && fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

//! Pins: named lists of records that no collection removes.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use crate::digest::Digest;
use crate::error::{At, Result};
use crate::obstacle::clear_folder;
use crate::publish::publish_file;
use crate::regular;
use crate::store::Store;

impl Store {
    /// Keeps the records with these keys, and the blobs that the records name, until the pin called `name` is
    /// removed. An existing pin of the same name is replaced. A pin is stored as text: the name, then the keys, one
    /// per line.
    ///
    /// # Errors
    /// If the pin cannot be written.
    pub fn pin(&self, name: &str, keys: &[Digest]) -> Result<()> {
        let Some(path) = self.pin_path(name).filter(|_| !self.is_read_only()) else { return Ok(()) };
        let mut text = format!("{}\n", name.replace('\n', " "));
        keys.iter().for_each(|key| text.push_str(&format!("{key}\n")));
        self.folder().into_iter().for_each(|root| clear_folder(root, &path));
        publish_file(&path, text.as_bytes())
    }

    /// Removes a pin. Returns whether it existed.
    ///
    /// # Errors
    /// If the pin cannot be removed.
    pub fn unpin(&self, name: &str) -> Result<bool> {
        let Some(path) = self.pin_path(name).filter(|path| path.exists()) else { return Ok(false) };
        fs::remove_file(&path).at("remove", &path)?;
        Ok(true)
    }

    /// The name of each pin and the number of records that it keeps, sorted by name.
    pub fn pins(&self) -> Vec<(String, usize)> {
        let mut pins: Vec<_> = self
            .pin_texts()
            .iter()
            .map(|text| {
                let (name, keys) = text.split_once('\n').unwrap_or((text, ""));
                (name.to_owned(), keys.lines().count())
            })
            .collect();
        pins.sort();
        pins
    }

    /// Every pinned key.
    pub(crate) fn pinned(&self) -> BTreeSet<Digest> {
        self.pin_texts().iter().flat_map(|text| text.lines().skip(1).filter_map(Digest::from_hex)).collect()
    }

    fn pin_texts(&self) -> Vec<String> {
        let Some(folder) = self.folder() else { return Vec::new() };
        let files = fs::read_dir(folder.join("pins")).into_iter().flatten().flatten();
        files.filter_map(|file| String::from_utf8(regular::read(&file.path()).ok()?).ok()).collect()
    }

    fn pin_path(&self, name: &str) -> Option<PathBuf> {
        Some(self.folder()?.join("pins").join(Digest::of(name.as_bytes()).to_string()))
    }
}

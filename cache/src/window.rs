//! [`Window`]: the parts of a file that were read, so that neighbours cost one read.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// How much is read at once, in bytes.
const PAGE: usize = 16 << 10;

/// How many pages stay in memory.
const MOST: usize = 512;

/// Pages of a file of which no byte changes up to the `end` that reads state.
#[derive(Debug, Default)]
pub(crate) struct Window {
    pages: BTreeMap<u64, Vec<u8>>,
    /// What lies in several pages.
    joined: Vec<u8>,
}

impl Window {
    /// The bytes at `offset`; fewer at `end`, and where the file is shorter.
    pub fn read(&mut self, file: &File, end: u64, offset: u64, length: usize) -> io::Result<&[u8]> {
        let page = offset / PAGE as u64;
        let at = (offset % PAGE as u64) as usize;
        if at + length <= PAGE {
            let bytes = self.page(file, end, page, at + length)?;
            return Ok(&bytes[at.min(bytes.len())..(at + length).min(bytes.len())]);
        }
        self.joined.clear();
        let (mut file, joined) = (file, &mut self.joined);
        file.seek(SeekFrom::Start(offset))?;
        file.take(length as u64).read_to_end(joined)?;
        Ok(joined)
    }

    /// A page of which at least `needed` bytes are wanted.
    fn page(&mut self, mut file: &File, end: u64, page: u64, needed: usize) -> io::Result<&[u8]> {
        // The last page may have grown.
        if self.pages.get(&page).is_none_or(|bytes| bytes.len() < needed) {
            if self.pages.len() >= MOST {
                self.pages.clear();
            }
            let mut bytes = Vec::with_capacity(PAGE);
            let start = page * PAGE as u64;
            file.seek(SeekFrom::Start(start))?;
            file.take(end.saturating_sub(start).min(PAGE as u64)).read_to_end(&mut bytes)?;
            self.pages.insert(page, bytes);
        }
        Ok(self.pages.get(&page).map_or(&[], Vec::as_slice))
    }
}

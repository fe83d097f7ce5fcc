//! [`PageCache`]: recently read parts of a file, kept in memory. Each read fetches a whole page, so that
//! neighbouring entries are read together.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// Length of a page in bytes. Every read fetches whole pages.
const PAGE: usize = 16 << 10;

/// The maximum number of pages in memory.
const MAX_PAGES: usize = 512;

/// Pages of an append-only file. Bytes before the `end` that is passed to a read must never change.
#[derive(Debug, Default)]
pub(crate) struct PageCache {
    pages: BTreeMap<u64, Vec<u8>>,
    /// The bytes of the most recently read range that spans several pages.
    joined: Vec<u8>,
}

impl PageCache {
    /// Returns `length` bytes at `offset`, or fewer bytes if the file ends earlier. Bytes at or after `end` may be
    /// missing from the result.
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

    /// Returns a page. The page is read first if fewer than `needed` of its bytes are in memory.
    fn page(&mut self, mut file: &File, end: u64, page: u64, needed: usize) -> io::Result<&[u8]> {
        // The last page may have grown.
        if self.pages.get(&page).is_none_or(|bytes| bytes.len() < needed) {
            if self.pages.len() >= MAX_PAGES {
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

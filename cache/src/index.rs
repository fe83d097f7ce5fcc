//! [`Index`]: the locations of the entries of a log, sorted by key, so that a long log can be opened without
//! reading its entries.
//!
//! The file consists of a head, a directory, and pages of entries. The directory contains the first key of each
//! page. Pages are read on demand, and each ends with its own checksum. The layout is in the documentation of the
//! crate.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use crate::digest::Digest;
use crate::entry::checksum;
use crate::error::Result;
use crate::failpoint::INDEX;
use crate::location::{EntryId, Location, LogSizes};
use crate::regular;
use crate::temp::TempFile;

const MAGIC: &[u8; 8] = b"LHindex1";
const PAGE: usize = 4096;
/// Length of an entry in bytes. An entry consists of key, offset, length, kind, and three zero bytes.
pub(crate) const ENTRY: usize = 48;
const PER_PAGE: usize = (PAGE - 4) / ENTRY;
const RANKS_PER_PAGE: usize = (PAGE - 4) / 8;

/// The index of the first `covered` bytes of a log.
#[derive(Debug)]
pub(crate) struct Index {
    file: File,
    salt: u32,
    count: u64,
    /// The number of bytes of the log that are indexed.
    pub covered: u64,
    /// Sizes of the entries in the indexed part of the log.
    pub sizes: LogSizes,
    /// The first 8 bytes of the first key of each page, as numbers.
    directory: Vec<u64>,
    pages: Vec<Option<Box<[u8; PAGE]>>>,
}

/// Error for a page that cannot be read or has a wrong checksum.
pub(crate) struct Damaged;

impl From<io::Error> for Damaged {
    fn from(_: io::Error) -> Damaged {
        Damaged
    }
}

impl Index {
    /// Opens the index of the log with this salt and length in bytes. Returns `None` if the index is missing,
    /// damaged or belongs to another log.
    pub fn open(path: &Path, salt: u32, length: u64) -> Option<Index> {
        let mut file = regular::open(path, OpenOptions::new().read(true)).ok()?;
        let size = file.metadata().ok()?.len();
        let mut head = [0; PAGE];
        file.read_exact(&mut head).ok()?;
        if !is_whole(&head, salt, 0) || !head.starts_with(MAGIC) {
            return None;
        }
        let number = |at: usize| u64_at(&head, at);
        let (covered, count) = (number(8), number(16));
        let sizes = LogSizes { live: number(24), dead: number(32), damaged: number(40) };
        let pages = count.div_ceil(PER_PAGE as u64);
        let directories = pages.div_ceil(RANKS_PER_PAGE as u64);
        // The size of the file bounds the number of pages.
        if covered > length || size != (1 + directories + pages).checked_mul(PAGE as u64)? {
            return None;
        }
        let mut directory = Vec::with_capacity(pages as usize);
        for number in 1..=directories as usize {
            file.read_exact(&mut head).ok()?;
            if !is_whole(&head, salt, number) {
                return None;
            }
            directory
                .extend(head.as_chunks().0.iter().take(RANKS_PER_PAGE).map(|rank| u64::from_le_bytes(*rank)));
        }
        directory.truncate(pages as usize);
        let pages = (0..pages).map(|_| None).collect();
        Some(Index { file, salt, count, covered, sizes, directory, pages })
    }

    /// True if the index at `path` belongs to the log with this salt, but covers more than `length` bytes. The log
    /// was then shortened after it was indexed. Such an index must be discarded: once the log has grown again, the
    /// index would hide new entries.
    pub fn is_beyond(path: &Path, salt: u32, length: u64) -> bool {
        let mut head = [0; PAGE];
        let read = regular::open(path, OpenOptions::new().read(true))
            .and_then(|mut file| file.read_exact(&mut head));
        read.is_ok() && is_whole(&head, salt, 0) && head.starts_with(MAGIC) && u64_at(&head, 8) > length
    }

    /// Writes the index of the first `covered` bytes of a log. `entries` must be sorted by key and then by kind.
    pub fn write(
        path: &Path,
        temp: &Path,
        salt: u32,
        covered: u64,
        sizes: LogSizes,
        entries: &[(EntryId, Location)],
    ) -> Result<()> {
        let mut bytes = Vec::with_capacity((entries.len() / PER_PAGE + 2) * PAGE);
        bytes.extend_from_slice(MAGIC);
        for number in [covered, entries.len() as u64, sizes.live, sizes.dead, sizes.damaged] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        seal(&mut bytes, salt);
        let first = |page: &[(EntryId, Location)]| page.first().map_or(0, |((_, key), _)| key.rank());
        let directory: Vec<u64> = entries.chunks(PER_PAGE).map(first).collect();
        for page in directory.chunks(RANKS_PER_PAGE) {
            page.iter().for_each(|rank| bytes.extend_from_slice(&rank.to_le_bytes()));
            seal(&mut bytes, salt);
        }
        for page in entries.chunks(PER_PAGE) {
            for ((kind, key), location) in page {
                bytes.extend_from_slice(key.as_bytes());
                bytes.extend_from_slice(&location.offset.to_le_bytes());
                bytes.extend_from_slice(&location.length.to_le_bytes());
                bytes.extend_from_slice(&[*kind, 0, 0, 0]);
            }
            seal(&mut bytes, salt);
        }
        let mut file = TempFile::create(temp, &INDEX)?;
        file.write(&bytes)?;
        file.persist(path)
    }

    /// The location of an entry; `None` if the entry is not in the index.
    pub fn find(&mut self, id: &EntryId) -> Result<Option<Location>, Damaged> {
        let (kind, key) = id;
        let rank = key.rank();
        // Entries of equal rank, such as entries of different kinds with the same key, may begin on the page
        // before.
        let first = self.directory.partition_point(|start| *start < rank).saturating_sub(1);
        let after = self.directory.partition_point(|start| *start <= rank);
        for page in first..after {
            let entries = self.entries(page)?;
            let start = entries.partition_point(|entry| rank_of(entry) < rank);
            let near = entries[start..].iter().take_while(|entry| rank_of(entry) == rank);
            let mut same = near.filter(|entry| entry.starts_with(key.as_bytes()) && entry[44] == *kind);
            if let Some(entry) = same.next() {
                return Ok(Some(location_in(entry)));
            }
        }
        Ok(None)
    }

    /// The identity and location of every indexed entry, sorted by key and then by kind.
    pub fn all(&mut self) -> Result<Vec<(EntryId, Location)>, Damaged> {
        let mut all = Vec::new();
        for page in 0..self.pages.len() {
            let id = |entry: &[u8; ENTRY]| {
                (entry[44], Digest::from_bytes(*entry.first_chunk().unwrap_or(&[0; 32])))
            };
            all.extend(self.entries(page)?.iter().map(|entry| (id(entry), location_in(entry))));
            self.pages[page] = None;
        }
        Ok(all)
    }

    /// The entries of a page. The page is read if it is not in memory.
    fn entries(&mut self, page: usize) -> Result<&[[u8; ENTRY]], Damaged> {
        let left = self.count as usize - page * PER_PAGE;
        if self.pages[page].is_none() {
            let mut bytes = Box::new([0; PAGE]);
            let number = 1 + self.pages.len().div_ceil(RANKS_PER_PAGE) + page;
            self.file.seek(SeekFrom::Start((number * PAGE) as u64))?;
            self.file.read_exact(&mut bytes[..])?;
            if !is_whole(&bytes, self.salt, number) {
                return Err(Damaged);
            }
            self.pages[page] = Some(bytes);
        }
        let bytes = self.pages[page].as_deref().ok_or(Damaged)?;
        Ok(&bytes.as_chunks().0[..left.min(PER_PAGE)])
    }
}

/// Pads the last page with zeros and appends its checksum. The initial value of the checksum is the salt of the log
/// XOR the number of the page.
fn seal(bytes: &mut Vec<u8>, salt: u32) {
    let start = bytes.len().saturating_sub(1) / PAGE * PAGE;
    bytes.resize(start + PAGE - 4, 0);
    let sum = checksum(salt ^ (start / PAGE) as u32, &[&bytes[start..]]);
    bytes.extend_from_slice(&sum.to_le_bytes());
}

fn is_whole(page: &[u8; PAGE], salt: u32, number: usize) -> bool {
    let (body, sum) = page.split_at(PAGE - 4);
    checksum(salt ^ number as u32, &[body]).to_le_bytes() == *sum
}

fn rank_of(entry: &[u8; ENTRY]) -> u64 {
    u64_at(entry, 0).swap_bytes()
}

fn location_in(entry: &[u8; ENTRY]) -> Location {
    let length = u32::from_le_bytes([entry[40], entry[41], entry[42], entry[43]]);
    Location { offset: u64_at(entry, 32), length }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().map_or(0, u64::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(count: u32) -> Vec<(EntryId, Location)> {
        let entry = |n: u32| {
            let location = Location { offset: u64::from(n) * 1000, length: n };
            ((1 + (n % 2) as u8, Digest::of(&(n / 2).to_le_bytes())), location)
        };
        let mut all: Vec<_> = (0..count).map(entry).collect();
        all.sort_unstable_by_key(|((kind, key), _)| (*key, *kind));
        all
    }

    fn written(folder: &Path, entries: &[(EntryId, Location)]) -> std::path::PathBuf {
        let path = folder.join("index");
        Index::write(&path, folder, 7, 5000, LogSizes::default(), entries).unwrap();
        path
    }

    #[test]
    fn finds_what_it_was_given_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, 84, 85, 86, 170, 171, 3000, 50_000] {
            let all = entries(count);
            let mut index = Index::open(&written(folder.path(), &all), 7, 5000).unwrap();
            for (id, location) in &all {
                let found = index.find(id).ok().unwrap().unwrap();
                assert_eq!((found.offset, found.length), (location.offset, location.length));
            }
            for n in 0..2000_u32 {
                let unknown = (1, Digest::of(format!("unknown {n}").as_bytes()));
                assert!(index.find(&unknown).ok().unwrap().is_none());
            }
            let places: Vec<EntryId> = index.all().ok().unwrap().into_iter().map(|(id, _)| id).collect();
            assert_eq!(places, all.into_iter().map(|(id, _)| id).collect::<Vec<_>>());
        }
    }

    #[test]
    fn an_index_of_another_log_or_with_a_wrong_byte_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let all = entries(300);
        let path = written(folder.path(), &all);
        assert!(Index::open(&path, 8, 5000).is_none(), "another salt");
        assert!(Index::open(&path, 7, 4999).is_none(), "a log that was cut");
        let good = std::fs::read(&path).unwrap();
        for at in (0..good.len()).step_by(13) {
            let mut bad = good.clone();
            bad[at] ^= 4;
            std::fs::write(&path, bad).unwrap();
            let whole = Index::open(&path, 7, 5000).map(|mut index| index.all().is_ok());
            assert_ne!(whole, Some(true), "byte {at}");
        }
        std::fs::write(&path, &good[..good.len() - 1]).unwrap();
        assert!(Index::open(&path, 7, 5000).is_none(), "cut");
        let page = |n: usize| &good[n * PAGE..(n + 1) * PAGE];
        let swapped = [page(0), page(1), page(3), page(2), &good[4 * PAGE..]].concat();
        std::fs::write(&path, swapped).unwrap();
        assert!(Index::open(&path, 7, 5000).unwrap().all().is_err(), "pages in each other's id");
    }
}

//! [`Index`]: where the entries of a log lie, sorted by key, so that opening a long log reads almost nothing.
//!
//! The file is a head, a directory of the first key of each page, and pages of entries, which are read when
//! asked for. Each page carries its own checksum. The crate's documentation has the layout.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use crate::digest::Digest;
use crate::entry::checksum;
use crate::error::Result;
use crate::failpoint::INDEX;
use crate::slot::{Health, Place, Slot};
use crate::temp::TempFile;

const MAGIC: &[u8; 8] = b"LHindex1";
const PAGE: usize = 4096;
/// One entry: key, offset, length, kind, three zeros.
pub(crate) const ENTRY: usize = 48;
const PER_PAGE: usize = (PAGE - 4) / ENTRY;
const RANKS_PER_PAGE: usize = (PAGE - 4) / 8;

/// The index of the first so many bytes of a log.
#[derive(Debug)]
pub(crate) struct Index {
    file: File,
    salt: u32,
    count: u64,
    /// How many bytes of the log it tells of, and what they consist of.
    pub covered: u64,
    pub health: Health,
    /// Of the first key of each page, its first 8 bytes.
    directory: Vec<u64>,
    pages: Vec<Option<Box<[u8; PAGE]>>>,
}

/// A page that cannot be read or is not what was written.
pub(crate) struct Damaged;

impl From<io::Error> for Damaged {
    fn from(_: io::Error) -> Damaged {
        Damaged
    }
}

impl Index {
    /// Opens the index of the log with this salt and length; `None` where there is none that fits.
    pub fn open(path: &Path, salt: u32, length: u64) -> Option<Index> {
        let mut file = File::open(path).ok()?;
        let size = file.metadata().ok()?.len();
        let mut head = [0; PAGE];
        file.read_exact(&mut head).ok()?;
        if !is_whole(&head, salt, 0) || !head.starts_with(MAGIC) {
            return None;
        }
        let number = |at: usize| u64_at(&head, at);
        let (covered, count) = (number(8), number(16));
        let health = Health { live: number(24), dead: number(32), damaged: number(40) };
        let pages = count.div_ceil(PER_PAGE as u64);
        let directories = pages.div_ceil(RANKS_PER_PAGE as u64);
        // The file itself says how many pages there can be.
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
        Some(Index { file, salt, count, covered, health, directory, pages })
    }

    /// Writes the index of the first `covered` bytes of a log. `entries` are sorted by key, then kind.
    pub fn write(
        path: &Path,
        temp: &Path,
        salt: u32,
        covered: u64,
        health: Health,
        entries: &[(Place, Slot)],
    ) -> Result<()> {
        let mut bytes = Vec::with_capacity((entries.len() / PER_PAGE + 2) * PAGE);
        bytes.extend_from_slice(MAGIC);
        for number in [covered, entries.len() as u64, health.live, health.dead, health.damaged] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        seal(&mut bytes, salt);
        let first = |page: &[(Place, Slot)]| page.first().map_or(0, |((_, key), _)| key.rank());
        let directory: Vec<u64> = entries.chunks(PER_PAGE).map(first).collect();
        for page in directory.chunks(RANKS_PER_PAGE) {
            page.iter().for_each(|rank| bytes.extend_from_slice(&rank.to_le_bytes()));
            seal(&mut bytes, salt);
        }
        for page in entries.chunks(PER_PAGE) {
            for ((kind, key), slot) in page {
                bytes.extend_from_slice(key.as_bytes());
                bytes.extend_from_slice(&slot.offset.to_le_bytes());
                bytes.extend_from_slice(&slot.length.to_le_bytes());
                bytes.extend_from_slice(&[*kind, 0, 0, 0]);
            }
            seal(&mut bytes, salt);
        }
        let mut file = TempFile::create(temp, &INDEX)?;
        file.write(&bytes)?;
        file.persist(path)
    }

    /// Where an entry lies, if the index has it.
    pub fn find(&mut self, place: &Place) -> Result<Option<Slot>, Damaged> {
        let (kind, key) = place;
        let rank = key.rank();
        // Entries of one rank, such as the kinds of one key, may begin on the page before.
        let first = self.directory.partition_point(|start| *start < rank).saturating_sub(1);
        let after = self.directory.partition_point(|start| *start <= rank);
        for page in first..after {
            let entries = self.entries(page)?;
            let start = entries.partition_point(|entry| rank_of(entry) < rank);
            let near = entries[start..].iter().take_while(|entry| rank_of(entry) == rank);
            let mut same = near.filter(|entry| entry.starts_with(key.as_bytes()) && entry[44] == *kind);
            if let Some(entry) = same.next() {
                return Ok(Some(slot(entry)));
            }
        }
        Ok(None)
    }

    /// Every entry, by key and then kind.
    pub fn all(&mut self) -> Result<Vec<(Place, Slot)>, Damaged> {
        let mut all = Vec::new();
        for page in 0..self.pages.len() {
            let place = |entry: &[u8; ENTRY]| {
                (entry[44], Digest::from_bytes(*entry.first_chunk().unwrap_or(&[0; 32])))
            };
            all.extend(self.entries(page)?.iter().map(|entry| (place(entry), slot(entry))));
            self.pages[page] = None;
        }
        Ok(all)
    }

    /// The entries of a page, which is read if need be.
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

/// Fills the last page up and ends it with its checksum, which knows the page's place and the log.
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

fn slot(entry: &[u8; ENTRY]) -> Slot {
    let length = u32::from_le_bytes([entry[40], entry[41], entry[42], entry[43]]);
    Slot { offset: u64_at(entry, 32), length }
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).copied().map_or(0, u64::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(count: u32) -> Vec<(Place, Slot)> {
        let entry = |n: u32| {
            let slot = Slot { offset: u64::from(n) * 1000, length: n };
            ((1 + (n % 2) as u8, Digest::of(&(n / 2).to_le_bytes())), slot)
        };
        let mut all: Vec<_> = (0..count).map(entry).collect();
        all.sort_unstable_by_key(|((kind, key), _)| (*key, *kind));
        all
    }

    fn written(folder: &Path, entries: &[(Place, Slot)]) -> std::path::PathBuf {
        let path = folder.join("index");
        Index::write(&path, folder, 7, 5000, Health::default(), entries).unwrap();
        path
    }

    #[test]
    fn finds_what_it_was_given_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        for count in [0, 1, 84, 85, 86, 170, 171, 3000, 50_000] {
            let all = entries(count);
            let mut index = Index::open(&written(folder.path(), &all), 7, 5000).unwrap();
            for (place, slot) in &all {
                let found = index.find(place).ok().unwrap().unwrap();
                assert_eq!((found.offset, found.length), (slot.offset, slot.length));
            }
            for n in 0..2000_u32 {
                let stranger = (1, Digest::of(format!("stranger {n}").as_bytes()));
                assert!(index.find(&stranger).ok().unwrap().is_none());
            }
            let places: Vec<Place> = index.all().ok().unwrap().into_iter().map(|(place, _)| place).collect();
            assert_eq!(places, all.into_iter().map(|(place, _)| place).collect::<Vec<_>>());
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
        assert!(Index::open(&path, 7, 5000).unwrap().all().is_err(), "pages in each other's place");
    }
}

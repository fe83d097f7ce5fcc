//! ZIP archives in memory, for SOG bundles: stored and deflated entries (PKWARE APPNOTE 6.3.10, sections 4.3.7,
//! 4.3.12 and 4.3.16). Encryption and ZIP64 are not supported. No crate is used, so that memory is bounded by the
//! length that an entry declares.

use super::bytes::{range, u16_at, u32_at};
use super::inflate::{DEFLATE_RATIO, inflate};
use crate::error::Error;

struct Entry {
    name: String,
    method: u16,
    checksum: u32,
    packed: usize,
    length: usize,
    at: usize,
}

/// The table of contents of an archive.
pub struct Archive<'a> {
    file: &'a str,
    bytes: &'a [u8],
    entries: Vec<Entry>,
}

const CENTRAL: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;
const END: [u8; 4] = [b'P', b'K', 5, 6];

impl<'a> Archive<'a> {
    /// Reads the table of contents.
    pub fn read(file: &'a str, bytes: &'a [u8]) -> Result<Self, Error> {
        // The end record has 22 bytes and a comment of at most 65535.
        let tail = bytes.len().saturating_sub(22 + 65_535);
        let end = bytes[tail..].windows(4).rposition(|four| four == END);
        let end = end.ok_or_else(|| Error::format(file, "the ZIP archive has no table of contents"))? + tail;
        range(file, bytes, end, 22, "the end of the ZIP archive")?;
        let count = u16_at(bytes, end + 10);
        let mut at = u32_at(bytes, end + 16) as usize;
        if count == u16::MAX || at == u32::MAX as usize {
            return Err(Error::unsupported(file, "ZIP64"));
        }
        let mut entries = Vec::new();
        for _ in 0..count {
            let head = range(file, bytes, at, 46, "the table of contents of the ZIP archive")?;
            if u32_at(head, 0) != CENTRAL {
                return Err(Error::format(file, "the table of contents of the ZIP archive is corrupt"));
            }
            let length = u16_at(head, 28) as usize;
            let name = range(file, bytes, at + 46, length, "a name in the ZIP archive")?;
            if u16_at(head, 8) & 1 == 1 {
                return Err(Error::unsupported(file, "an encrypted ZIP archive"));
            }
            entries.push(Entry {
                name: String::from_utf8_lossy(name).into_owned(),
                method: u16_at(head, 10),
                checksum: u32_at(head, 16),
                packed: u32_at(head, 20) as usize,
                length: u32_at(head, 24) as usize,
                at: u32_at(head, 42) as usize,
            });
            at += 46 + length + u16_at(head, 30) as usize + u16_at(head, 32) as usize;
        }
        Ok(Self { file, bytes, entries })
    }

    /// The full name of the only entry whose file name is `name`, in any folder; `None` if there is no such entry,
    /// or several.
    pub fn find(&self, name: &str) -> Option<&str> {
        let mut found = self.entries.iter().filter(|entry| entry.name.rsplit('/').next() == Some(name));
        let first = found.next()?;
        found.next().is_none().then_some(&first.name)
    }

    /// Length of an entry after decompression, in bytes, as the archive declares it; 0 if the entry does not exist.
    pub fn length(&self, name: &str) -> usize {
        self.entries.iter().find(|entry| entry.name == name).map_or(0, |entry| entry.length)
    }

    /// Reads an entry and verifies its checksum.
    pub fn get(&self, name: &str) -> Result<Vec<u8>, Error> {
        let wrong = |what: &str| Error::format(self.file, format!("the ZIP entry `{name}` {what}"));
        let entry = self.entries.iter().find(|entry| entry.name == name);
        let entry = entry.ok_or_else(|| wrong("is missing"))?;
        let head = range(self.file, self.bytes, entry.at, 30, "an entry of the ZIP archive")?;
        if u32_at(head, 0) != LOCAL {
            return Err(wrong("does not begin where the table of contents says"));
        }
        // Names and extra fields may differ from those in the table of contents.
        let start = entry.at + 30 + u16_at(head, 26) as usize + u16_at(head, 28) as usize;
        let packed = range(self.file, self.bytes, start, entry.packed, "an entry of the ZIP archive")?;
        let bytes = match entry.method {
            0 if entry.packed == entry.length => packed.to_vec(),
            8 if entry.length / DEFLATE_RATIO <= entry.packed => inflate(self.file, packed, entry.length)?,
            0 | 8 => return Err(wrong("has an impossible length")),
            other => {
                let feature = format!("ZIP compression method {other} of entry `{name}`");
                return Err(Error::unsupported(self.file, feature));
            }
        };
        let mut checksum = flate2::Crc::new();
        checksum.update(&bytes);
        if checksum.sum() != entry.checksum {
            return Err(wrong("is damaged: its checksum differs"));
        }
        Ok(bytes)
    }
}

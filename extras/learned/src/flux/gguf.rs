//! The header of a GGUF file (versions 2 and 3), as `ggml` specifies it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use candle_core::DType;
use candle_core::quantized::GgmlDType;

use super::entry::{Entry, Format};
use super::error::{Error, Result};

/// Maximum length in bytes of a name or another text. The file format itself limits tensor names to 64 bytes.
const MAX_TEXT: u64 = 1 << 20;
/// Maximum number of tensors, and maximum number of metadata values. The published model has 780 tensors.
const MAX_TENSORS: u64 = 1 << 20;

/// Reads the entries of all tensors from the header. `file` must be positioned at its start.
pub(crate) fn header(file: &mut File, path: &Path, index: usize) -> Result<BTreeMap<String, Entry>> {
    let length = file.metadata().map_err(Error::io(path))?.len();
    let mut header = Header { file: BufReader::new(file), path };
    header.take::<4>()?;
    let version = header.u32()?;
    if !(2..=3).contains(&version) {
        return Err(header.wrong(format!("the GGUF version is {version}; versions 2 and 3 are supported")));
    }
    let (tensors, values) = (header.u64()?, header.u64()?);
    if tensors > MAX_TENSORS || values > MAX_TENSORS {
        return Err(header.wrong(format!("the header claims {tensors} tensors and {values} metadata values; at most {MAX_TENSORS} of each are supported")));
    }
    let mut alignment = 32;
    for _ in 0..values {
        let key = header.text()?;
        let kind = header.u32()?;
        if key == "general.alignment" && kind == 4 {
            alignment = u64::from(header.u32()?);
        } else {
            header.skip(kind)?;
        }
    }
    if !alignment.is_power_of_two() {
        return Err(header.wrong(format!("the alignment is {alignment}, which is not a power of two")));
    }
    let mut entries = BTreeMap::new();
    for _ in 0..tensors {
        let name = header.text()?;
        let entry = header.tensor(&name, index)?;
        if entries.contains_key(&name) {
            return Err(header.wrong(format!("the tensor `{name}` occurs twice")));
        }
        entries.insert(name, entry);
    }
    let first = header.file.stream_position().map_err(Error::io(path))?.next_multiple_of(alignment);
    for (name, entry) in &mut entries {
        entry.start = entry.start.saturating_add(first);
        if entry.start.saturating_add(entry.bytes) > length {
            return Err(header
                .wrong(format!("tensor `{name}` extends beyond the end of the file; copy the file again")));
        }
    }
    Ok(entries)
}

struct Header<'a> {
    file: BufReader<&'a mut File>,
    path: &'a Path,
}

impl Header<'_> {
    fn wrong(&self, what: String) -> Error {
        Error::file(self.path, format!("the file is not a valid GGUF file: {what}"))
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|_| self.wrong("the file ends too early".to_owned()))?;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn text(&mut self) -> Result<String> {
        let length = self.u64()?;
        if length > MAX_TEXT {
            return Err(self
                .wrong(format!("a text claims to be {length} bytes long; the maximum is {MAX_TEXT} bytes")));
        }
        let mut bytes = vec![0; length as usize];
        self.file.read_exact(&mut bytes).map_err(|_| self.wrong("the file ends too early".to_owned()))?;
        String::from_utf8(bytes).map_err(|_| self.wrong("a text is not valid UTF-8".to_owned()))
    }

    /// Skips a value. Arrays of arrays are an error, since files for this model do not contain them.
    fn skip(&mut self, kind: u32) -> Result<()> {
        const TEXT: u32 = 8;
        const ARRAY: u32 = 9;
        if kind == TEXT {
            return self.text().map(|_| ());
        }
        if let Some(width) = width(kind) {
            return self.pass(width);
        }
        if kind != ARRAY {
            return Err(self.wrong(format!("a value has the unknown type {kind}")));
        }
        let (kind, count) = (self.u32()?, self.u64()?);
        match width(kind) {
            Some(width) => self.pass(count.saturating_mul(width)),
            None if kind == TEXT && count <= MAX_TENSORS => {
                (0..count).try_for_each(|_| self.text().map(|_| ()))
            }
            None => Err(self.wrong(format!(
                "an array claims to hold {count} values of type {kind}, which is not supported"
            ))),
        }
    }

    fn pass(&mut self, bytes: u64) -> Result<()> {
        let passed = std::io::copy(&mut self.file.by_ref().take(bytes), &mut std::io::sink());
        match passed {
            Ok(n) if n == bytes => Ok(()),
            _ => Err(self.wrong("the file ends too early".to_owned())),
        }
    }

    /// Reads the entry of one tensor. Its `start` is an offset from the start of the tensor data.
    fn tensor(&mut self, name: &str, file: usize) -> Result<Entry> {
        let axes = self.u32()?;
        if !(1..=4).contains(&axes) {
            return Err(self.wrong(format!("tensor `{name}` has {axes} axes; it must have 1 to 4")));
        }
        let mut shape = Vec::new();
        for _ in 0..axes {
            shape.push(usize::try_from(self.u64()?).unwrap_or(usize::MAX));
        }
        // In the file, the innermost axis comes first, unlike everywhere else.
        shape.reverse();
        let (code, start) = (self.u32()?, self.u64()?);
        let Some((format, block, block_bytes)) = format(code) else {
            return Err(self.wrong(format!("tensor `{name}` has type {code}, which is not supported")));
        };
        let count = shape.iter().try_fold(1_usize, |product, n| product.checked_mul(*n));
        let row = shape.last().copied().unwrap_or(0);
        let bytes = count.filter(|_| row % block == 0).and_then(|n| (n / block).checked_mul(block_bytes));
        let Some(bytes) = bytes else {
            return Err(self.wrong(format!(
                "tensor `{name}` has the shape {shape:?}, which is not possible for its type"
            )));
        };
        Ok(Entry { shape, format, file, start, bytes: bytes as u64 })
    }
}

/// Size in bytes of a value of type `kind`; `None` if the type has no fixed size or is unknown.
fn width(kind: u32) -> Option<u64> {
    match kind {
        0 | 1 | 7 => Some(1),
        2 | 3 => Some(2),
        4..=6 => Some(4),
        10..=12 => Some(8),
        _ => None,
    }
}

/// The format with this type code, and the numbers of weights and of bytes per block. `None` if the type is not
/// supported.
fn format(code: u32) -> Option<(Format, usize, usize)> {
    let plain = |dtype: DType| (Format::Plain(dtype), 1, dtype.size_in_bytes());
    let blocks = |dtype: GgmlDType| (Format::Blocks(dtype), dtype.block_size(), dtype.type_size());
    Some(match code {
        0 => plain(DType::F32),
        1 => plain(DType::F16),
        30 => plain(DType::BF16),
        2 => blocks(GgmlDType::Q4_0),
        3 => blocks(GgmlDType::Q4_1),
        6 => blocks(GgmlDType::Q5_0),
        7 => blocks(GgmlDType::Q5_1),
        8 => blocks(GgmlDType::Q8_0),
        10 => blocks(GgmlDType::Q2K),
        11 => blocks(GgmlDType::Q3K),
        12 => blocks(GgmlDType::Q4K),
        13 => blocks(GgmlDType::Q5K),
        14 => blocks(GgmlDType::Q6K),
        _ => return None,
    })
}

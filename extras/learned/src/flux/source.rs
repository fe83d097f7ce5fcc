//! Tensors in files. The location of each tensor is read from the header of its file. Tensors are read one at a
//! time.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use candle_core::quantized::{QTensor, ggml_file::qtensor_from_ggml};
use candle_core::{DType, Device, Tensor};

use super::entry::{Entry, Format};
use super::error::{Error, Result};
use super::gguf;

/// A tensor that was read from a file.
#[derive(Debug)]
pub enum Stored {
    /// Plain numbers, in the type that they have in the file.
    Plain(Tensor),
    /// Quantised numbers.
    Blocks(QTensor),
}

/// The tensors of a safetensors file, of all shards of a safetensors file, or of a GGUF file. Opening reads only
/// the headers, which takes a few milliseconds for a file of 24 GB.
#[derive(Debug)]
pub struct Source {
    files: Vec<PathBuf>,
    entries: BTreeMap<String, Entry>,
    metadata: BTreeMap<String, String>,
}

/// Maximum length of a header in bytes; a longer header is treated as damaged. The header of the published model
/// has 130 kB.
const MAX_HEADER: u64 = 1 << 26;

impl Source {
    /// Reads the headers. If `path` is the first of several shards (`..-00001-of-00003.safetensors`), the headers
    /// of all shards are read.
    pub fn open(path: &Path) -> Result<Self> {
        let mut source = Self { files: shards(path), entries: BTreeMap::new(), metadata: BTreeMap::new() };
        for index in 0..source.files.len() {
            let path = source.files[index].clone();
            let mut file = File::open(&path).map_err(Error::io(&path))?;
            let mut magic = [0; 4];
            file.read_exact(&mut magic).map_err(|_| Error::file(&path, "the file is empty or truncated"))?;
            file.seek(SeekFrom::Start(0)).map_err(Error::io(&path))?;
            let (entries, metadata) = if &magic == b"GGUF" {
                (gguf::header(&mut file, &path, index)?, BTreeMap::new())
            } else {
                safetensors_header(&mut file, &path, index)?
            };
            for (name, entry) in entries {
                if source.entries.contains_key(&name) {
                    return Err(Error::file(&path, format!("tensor `{name}` is also in another shard")));
                }
                source.entries.insert(name, entry);
            }
            source.metadata.extend(metadata);
        }
        Ok(source)
    }

    /// The path of the first file. Error messages about any of the files name this path.
    pub fn path(&self) -> &Path {
        &self.files[0]
    }

    /// All tensors, by name.
    pub fn entries(&self) -> &BTreeMap<String, Entry> {
        &self.entries
    }

    /// The key-value metadata of the safetensors headers.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// The shape of the tensor with this name; `None` if there is no such tensor.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.entries.get(name).map(|entry| entry.shape.as_slice())
    }

    /// Creates an [`Error::File`] that names the first of these files.
    pub fn wrong(&self, what: impl Into<String>) -> Error {
        Error::file(self.path(), what)
    }

    /// Reads the tensor called `name` and places it on `device`.
    pub fn read(&self, name: &str, device: &Device) -> Result<Stored> {
        let entry =
            self.entries.get(name).ok_or_else(|| self.wrong(format!("tensor `{name}` is missing")))?;
        let path = &self.files[entry.file];
        let mut file = File::open(path).map_err(Error::io(path))?;
        file.seek(SeekFrom::Start(entry.start)).map_err(Error::io(path))?;
        // The header was checked against the length of the file, so this much is there.
        let mut bytes = vec![0; entry.bytes as usize];
        file.read_exact(&mut bytes).map_err(Error::io(path))?;
        Ok(match entry.format {
            Format::Plain(dtype) => {
                Stored::Plain(Tensor::from_raw_buffer(&bytes, dtype, &entry.shape, device)?)
            }
            Format::Blocks(dtype) => {
                Stored::Blocks(qtensor_from_ggml(dtype, &bytes, entry.shape.clone(), device)?)
            }
        })
    }

    /// Like [`read`](Self::read), but converts the tensor to f32.
    pub fn read_f32(&self, name: &str, device: &Device) -> Result<Tensor> {
        Ok(match self.read(name, device)? {
            Stored::Plain(tensor) => tensor.to_dtype(DType::F32)?,
            Stored::Blocks(tensor) => tensor.dequantize(device)?,
        })
    }
}

/// Returns the paths of all shards if `path` is the first of several shards. Otherwise, returns only `path`.
pub fn shards(path: &Path) -> Vec<PathBuf> {
    let alone = || vec![path.to_owned()];
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let Some((stem, rest)) = name.split_once("-00001-of-") else { return alone() };
    let Some((count, ending)) = rest.split_once('.') else { return alone() };
    match count.parse::<u32>() {
        Ok(n) if (1..=999).contains(&n) => {
            (1..=n).map(|i| path.with_file_name(format!("{stem}-{i:05}-of-{count}.{ending}"))).collect()
        }
        _ => alone(),
    }
}

type Header = (BTreeMap<String, Entry>, BTreeMap<String, String>);

fn safetensors_header(file: &mut File, path: &Path, index: usize) -> Result<Header> {
    let wrong = |what: String| Error::file(path, format!("the file is not a valid safetensors file: {what}"));
    let length = file.metadata().map_err(Error::io(path))?.len();
    let mut size = [0; 8];
    file.read_exact(&mut size).map_err(|_| wrong("the file ends too early".to_owned()))?;
    let size = u64::from_le_bytes(size);
    if size > MAX_HEADER || size.saturating_add(8) > length {
        return Err(wrong(format!(
            "the header claims to be {size} bytes long, which is longer than the file or than the limit of {MAX_HEADER} bytes"
        )));
    }
    let mut text = vec![0; size as usize];
    file.read_exact(&mut text).map_err(Error::io(path))?;
    // Parsing checks that tensors follow each other without a gap, and that shapes agree with lengths.
    let header: safetensors::tensor::Metadata =
        serde_json::from_slice(&text).map_err(|error| wrong(error.to_string()))?;
    let mut entries = BTreeMap::new();
    let first = 8 + size;
    let mut end = first;
    for (name, info) in header.tensors().into_iter().collect::<BTreeMap<_, _>>() {
        let dtype = match DType::try_from(info.dtype) {
            Ok(dtype @ (DType::F32 | DType::F16 | DType::BF16 | DType::F8E4M3)) => dtype,
            _ => {
                return Err(wrong(format!(
                    "tensor `{name}` has type {:?}, which is not supported",
                    info.dtype
                )));
            }
        };
        let (start, stop) = info.data_offsets;
        end = end.max(first + stop as u64);
        let entry = Entry {
            shape: info.shape.clone(),
            format: Format::Plain(dtype),
            file: index,
            start: first + start as u64,
            bytes: (stop - start) as u64,
        };
        entries.insert(name, entry);
    }
    if end != length {
        return Err(wrong(format!(
            "the tensors end at byte {end}, but the length of the file is {length} bytes; copy the file again"
        )));
    }
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    Ok((entries, metadata))
}

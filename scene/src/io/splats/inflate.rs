//! Decompression with limits.
//!
//! The output grows as data arrives and stops at a limit, so that a small hostile file cannot allocate much memory.

use std::io::Read;

use crate::error::Error;

/// Maximum compression ratio of deflate: 258 bytes from 2 bits, about 1032 to 1 (RFC 1951, section 3.2.5).
pub const DEFLATE_RATIO: usize = 1032;

/// Unpacks a whole gzip stream and verifies its checksum. `limit` computes the maximum length of the output from
/// its first 16 bytes. Also returns the number of bytes after the stream.
pub fn gunzip(
    file: &str,
    packed: &[u8],
    limit: impl FnOnce(&[u8; 16]) -> Result<usize, Error>,
) -> Result<(Vec<u8>, usize), Error> {
    let broken = |e: std::io::Error| Error::format(file, format!("the gzip stream is corrupt: {e}"));
    let mut stream = flate2::bufread::GzDecoder::new(packed);
    let mut head = [0; 16];
    stream.read_exact(&mut head).map_err(broken)?;
    let limit = limit(&head)?;
    let mut out = head.to_vec();
    let mut stream = stream.take((limit.saturating_sub(15)) as u64);
    stream.read_to_end(&mut out).map_err(broken)?;
    if out.len() > limit {
        return Err(Error::format(
            file,
            format!("the stream holds more than the {limit} bytes that its header promises"),
        ));
    }
    let behind = stream.into_inner().into_inner().len();
    Ok((out, behind))
}

/// Unpacks a raw deflate stream of exactly `length` bytes.
pub fn inflate(file: &str, packed: &[u8], length: usize) -> Result<Vec<u8>, Error> {
    exactly(file, flate2::bufread::DeflateDecoder::new(packed), length, "deflate")
}

/// Unpacks a Zstandard frame of exactly `length` bytes.
pub fn unzstd(file: &str, packed: &[u8], length: usize) -> Result<Vec<u8>, Error> {
    let stream = ruzstd::decoding::StreamingDecoder::new(packed)
        .map_err(|e| Error::format(file, format!("the zstd stream is corrupt: {e}")))?;
    exactly(file, stream, length, "zstd")
}

fn exactly(file: &str, stream: impl Read, length: usize, name: &str) -> Result<Vec<u8>, Error> {
    let mut out = Vec::new();
    stream
        .take(length as u64 + 1)
        .read_to_end(&mut out)
        .map_err(|e| Error::format(file, format!("the {name} stream is corrupt: {e}")))?;
    if out.len() != length {
        let what =
            format!("a {name} stream decompresses to at least {} bytes instead of {length} bytes", out.len());
        return Err(Error::format(file, what));
    }
    Ok(out)
}

//! Functions that read files that a user names: regular files only, with a bound.

use std::fs::{File, FileType};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// The maximum length in bytes of a graph file, of a file that it includes or uses as a subgraph, and of an
/// overlay.
pub const MAX_GRAPH_BYTES: u64 = 64 << 20;

/// Opens a regular file. Pipes and devices are not opened, since they may block forever or have no end.
///
/// # Errors
/// Any I/O error, and [`ErrorKind::InvalidInput`] with the type of the file if it is not a regular file.
pub fn open_regular(path: &Path) -> Result<File> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() {
        let what = format!("the path is {}, not a regular file", type_name(metadata.file_type()));
        return Err(Error::new(ErrorKind::InvalidInput, what));
    }
    File::open(path)
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// Those of [`open_regular`], and [`ErrorKind::FileTooLarge`] if the file is longer than `limit`; it is not read then.
pub fn read_at_most(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let file = open_regular(path)?;
    let too_long = || {
        let what = format!("the file is longer than {} MiB, the limit for a file of this kind", limit >> 20);
        Error::new(ErrorKind::FileTooLarge, what)
    };
    if file.metadata()?.len() > limit {
        return Err(too_long());
    }
    let mut bytes = Vec::new();
    // A file that grows meanwhile is not read beyond the limit either.
    file.take(limit + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > limit { Err(too_long()) } else { Ok(bytes) }
}

/// Reads a regular file of at most `limit` bytes of UTF-8.
///
/// # Errors
/// Any I/O error, [`ErrorKind::InvalidInput`] with the type of the file if it is not a regular file,
/// [`ErrorKind::FileTooLarge`] if it is longer than `limit`, and [`ErrorKind::InvalidData`] if the file is not
/// UTF-8.
pub fn read_text(path: &Path, limit: u64) -> Result<String> {
    let bytes = read_at_most(path, limit)?;
    String::from_utf8(bytes)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "stream did not contain valid UTF-8"))
}

fn type_name(found: FileType) -> &'static str {
    // The standard library distinguishes these only on Unix.
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if found.is_fifo() {
            return "a pipe";
        } else if found.is_socket() {
            return "a socket";
        } else if found.is_char_device() || found.is_block_device() {
            return "a device";
        }
    }
    if found.is_dir() { "a folder" } else { "a special file" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regular_files_up_to_the_limit_are_read_and_nothing_else() {
        let folder = tempfile::tempdir().expect("works");
        let path = folder.path().join("text");
        std::fs::write(&path, "ä234").expect("works");
        assert_eq!(read_text(&path, 5).expect("works"), "ä234");
        assert_eq!(read_text(&path, 4).expect_err("is refused").kind(), ErrorKind::FileTooLarge);
        std::fs::write(&path, [0xff]).expect("works");
        assert_eq!(read_text(&path, 5).expect_err("is refused").kind(), ErrorKind::InvalidData);
        let of = |path: &Path| read_text(path, 5).expect_err("is refused").to_string();
        assert_eq!(of(folder.path()), "the path is a folder, not a regular file");
        if cfg!(unix) {
            assert_eq!(of(Path::new("/dev/zero")), "the path is a device, not a regular file");
            let pipe = folder.path().join("pipe");
            assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("works").success());
            assert_eq!(of(&pipe), "the path is a pipe, not a regular file");
        }
        // Sparse: nothing of it is read.
        File::create(&path).expect("works").set_len(1 << 40).expect("works");
        assert_eq!(
            read_text(&path, MAX_GRAPH_BYTES).expect_err("is refused").to_string(),
            "the file is longer than 64 MiB, the limit for a file of this kind"
        );
    }
}

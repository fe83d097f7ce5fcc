//! Search for the library Open Image Denoise.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Name of the file that programs load. The file depends on the core library, which contains the code and the
/// weights. The name of the core library contains the full version.
const FILE: &str = "libOpenImageDenoise.so.2";
const CORE: &[u8] = b"libOpenImageDenoise_core.so.";
/// Environment variable that contains the folder of the library, for libraries outside the default folders.
const FOLDER: &str = "LIGHTHARMONY_OIDN";
/// Folders searched by default: the folder for locally built libraries, and the library folders of Debian, Fedora
/// and Arch.
const USUAL: [&str; 5] =
    ["/usr/local/lib", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"];

/// An installed library.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Installation {
    /// Path of the library file. Its content differs between versions, since it contains the version number.
    pub path: PathBuf,
    /// Version, such as `2.3.3`.
    pub version: String,
}

/// The error if no searched folder contains version 2 of the library.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("Open Image Denoise 2 is not installed: `{FILE}` was not found in {}{}", listed(.looked), but(.others))]
pub struct Missing {
    /// The searched folders, in order.
    pub looked: Vec<PathBuf>,
    /// Files with the name of the library that are not version 2 of the library.
    pub others: Vec<PathBuf>,
}

impl Missing {
    /// Advice for the user, shown together with the error.
    pub const HINT: &str = "install it (https://www.openimagedenoise.org), or set `LIGHTHARMONY_OIDN` to the folder that contains it";
}

fn listed(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| format!("`{}`", folder.display())).collect::<Vec<_>>().join(", ")
}

fn but(others: &[PathBuf]) -> String {
    if others.is_empty() {
        String::new()
    } else {
        format!("; files of this name that are not version 2 of the library: {}", listed(others))
    }
}

/// Looks for the library in the folder given by the environment variable `LIGHTHARMONY_OIDN`. If the variable is
/// not set, searches the folders in `LD_LIBRARY_PATH` and then the default folders. A graph cannot specify the
/// path, because loading a library runs its code.
///
/// # Errors
/// If no searched folder contains version 2 of the library.
pub fn find() -> Result<Installation, Missing> {
    find_in(folders(std::env::var_os(FOLDER), std::env::var_os("LD_LIBRARY_PATH")))
}

fn folders(named: Option<OsString>, linked: Option<OsString>) -> Vec<PathBuf> {
    if let Some(folder) = named.filter(|folder| !folder.is_empty()) {
        return vec![folder.into()];
    }
    let linked = linked.unwrap_or_default();
    // An empty entry means the current folder, where no library is expected.
    let linked = std::env::split_paths(&linked).filter(|folder| folder.is_absolute());
    linked.chain(USUAL.map(PathBuf::from)).collect()
}

fn find_in(looked: Vec<PathBuf>) -> Result<Installation, Missing> {
    let found = |folder: &PathBuf| {
        let path = folder.join(FILE);
        version_of(&path).map(|version| Installation { path, version })
    };
    looked.iter().find_map(found).ok_or_else(|| {
        let others = looked.iter().map(|folder| folder.join(FILE)).filter(|path| path.exists()).collect();
        Missing { looked, others }
    })
}

/// Returns the version of the core library on which the file at `path` depends.
fn version_of(path: &Path) -> Option<String> {
    let bytes = std::fs::read(path).ok()?;
    let start = bytes.windows(CORE.len()).position(|window| window == CORE)? + CORE.len();
    let digits = bytes[start..].iter().take_while(|byte| byte.is_ascii_digit() || **byte == b'.');
    let version: String = digits.map(|byte| char::from(*byte)).collect();
    version.starts_with("2.").then_some(version)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(name: &str, bytes: &[u8]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join(name), bytes).expect("is written");
        folder
    }

    // This test fails if `version_of` accepts versions that do not start with `2.`.
    #[test]
    fn the_first_folder_that_holds_version_2_is_taken() {
        let empty = tempfile::tempdir().expect("a folder");
        let old = place(FILE, b"\x7fELF\0libOpenImageDenoise_core.so.1.4.3\0");
        let other = place(FILE, b"something else");
        let good = place(FILE, b"\x7fELF\0libOpenImageDenoise_core.so.2.3.3\0libm.so.6\0");
        let paths = |of: &[&tempfile::TempDir]| of.iter().map(|d| d.path().to_owned()).collect::<Vec<_>>();
        let found = find_in(paths(&[&empty, &old, &other, &good])).expect("is there");
        assert_eq!(found, Installation { path: good.path().join(FILE), version: "2.3.3".to_owned() });
        let missing = find_in(paths(&[&empty, &old])).expect_err("is not there");
        assert_eq!(missing.looked, paths(&[&empty, &old]));
        let text = missing.to_string();
        assert!(text.contains(FILE) && text.contains(&empty.path().display().to_string()), "{text}");
        assert!(
            text.ends_with(&format!(
                "; files of this name that are not version 2 of the library: `{}`",
                old.path().join(FILE).display()
            )),
            "{text}"
        );
    }

    #[test]
    fn a_folder_that_is_named_is_the_only_one() {
        let os = |text: &str| Some(OsString::from(text));
        assert_eq!(folders(os("/opt/oidn/lib"), os("/a:/b")), [PathBuf::from("/opt/oidn/lib")]);
        let usual = USUAL.map(PathBuf::from).to_vec();
        assert_eq!(
            folders(None, os("/a::here:/b")),
            [vec!["/a".into(), "/b".into()], usual.clone()].concat()
        );
        assert_eq!(folders(os(""), None), usual);
    }
}

//! Finding installed programs.

use std::path::{Path, PathBuf};

use super::error::ProgramError;

/// Returns the path of a program. A name with a `/` is a path relative to `folder`, the folder of the graph. Another
/// name is searched in the folders of the environment variable `PATH`.
///
/// # Errors
/// [`ProgramError::Missing`] if there is no such program, or if the file cannot be executed.
pub fn find(name: &str, folder: &Path) -> Result<PathBuf, ProgramError> {
    let missing = |place: String| ProgramError::Missing { program: name.to_owned(), place };
    if name.contains('/') || (cfg!(windows) && name.contains('\\')) {
        let path = folder.join(name);
        let here = || format!("at `{}`, or it is not an executable file", path.display());
        return if is_executable(&path) { Ok(path) } else { Err(missing(here())) };
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let endings: &[&str] = if cfg!(windows) { &[".exe", ""] } else { &[""] };
    let mut paths = std::env::split_paths(&folders)
        .filter(|folder| folder.is_absolute())
        .flat_map(|folder| endings.iter().map(move |ending| folder.join(format!("{name}{ending}"))));
    paths.find(|path| is_executable(path)).ok_or_else(|| missing("in the folders of `PATH`".to_owned()))
}

// Only Unix has a permission to execute files.
#[cfg(unix)]
fn is_executable(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    path.metadata().is_ok_and(|data| data.is_file() && data.permissions().mode() & 0o111 != 0)
}

// On Windows, the extension of a file states whether it is a program; `find` tries `.exe`.
#[cfg(not(unix))]
fn is_executable(path: &Path) -> bool {
    path.is_file()
}

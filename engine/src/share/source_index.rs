//! An index of the files in the folders of `--inputs`, to find the source files of a recipe.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use cache::{Digest, Store};

use crate::record::recipe::{ANY_FOLDER, one_line_name};
use crate::share::recipe_error::RecipeError;

/// Maximum number of files in the index.
const MOST_FILES: usize = 200_000;

/// Name and digest of a source file.
type Read = (String, Digest);

/// The folders given by the user, and all files in these folders, which can be looked up by file name.
#[derive(Default)]
pub(crate) struct SourceIndex {
    roots: Vec<PathBuf>,
    files: BTreeMap<String, Vec<PathBuf>>,
    digests: RefCell<HashMap<PathBuf, Option<Digest>>>,
    cut: bool,
}

impl SourceIndex {
    /// Indexes the files in `folders`. The entries of a folder are visited in order of name. Links are not
    /// followed.
    ///
    /// # Errors
    /// If a folder cannot be read.
    pub fn of(folders: &[PathBuf]) -> Result<Self, RecipeError> {
        let mut index = Self::default();
        let mut count = 0;
        for folder in folders {
            let failed = |folder: &Path| {
                let folder = folder.to_owned();
                move |source| RecipeError::Folder { folder, source }
            };
            let first = folder.canonicalize().map_err(failed(folder))?;
            index.roots.push(first.clone());
            let mut open = vec![first];
            while let Some(folder) = open.pop() {
                let entries = std::fs::read_dir(&folder).map_err(failed(&folder))?;
                let mut entries: Vec<_> = entries.flatten().collect();
                entries.sort_by_key(std::fs::DirEntry::file_name);
                for entry in entries {
                    count += 1;
                    let Ok(kind) = entry.file_type() else { continue };
                    let Ok(name) = entry.file_name().into_string() else { continue };
                    if count > MOST_FILES {
                        index.cut = true;
                        return Ok(index);
                    }
                    if kind.is_dir() {
                        open.push(entry.path());
                    } else if kind.is_file() {
                        index.files.entry(one_line_name(&name)).or_default().push(entry.path());
                    }
                }
            }
        }
        Ok(index)
    }

    /// True if there are more files than the index can hold.
    pub fn is_cut(&self) -> bool {
        self.cut
    }

    /// The paths of the files and folders that a node names, in order. `wanted` contains these names, and `sources`
    /// contains all files that the node read, in order. Each name corresponds to a contiguous group in `sources`:
    /// the named file followed by the files that it refers to, or the files in the named folder. The node may still
    /// read further files, which [`Recipe::other_sources`](crate::Recipe::other_sources) finds.
    ///
    /// # Errors
    /// A line for each file that is not found or is ambiguous.
    pub fn settle(
        &self,
        wanted: &[String],
        sources: &[Read],
        store: &Store,
    ) -> Result<Vec<String>, Vec<String>> {
        let named = |name: &String| sources.iter().any(|(source, _)| source == name);
        // The last possible start of each run, such that the following runs still fit.
        let mut latest = vec![sources.len(); wanted.len() + 1];
        for (which, name) in wanted.iter().enumerate().rev() {
            let before = &sources[..latest[which + 1]];
            let place = match named(name) {
                true => before.iter().rposition(|(source, _)| source == name),
                false => before.len().checked_sub(1),
            };
            let Some(place) = place else { return Err(vec![ambiguous(name, wanted, sources)]) };
            latest[which] = place;
        }
        let (mut paths, mut missing, mut at) = (Vec::new(), Vec::new(), 0);
        // The preceding folder, which must contain all files before the next start.
        let mut folder: Option<&String> = None;
        for (which, name) in wanted.iter().enumerate() {
            let is_file = named(name);
            // Files in between belong to the preceding file, which may name files anywhere.
            let begin = match is_file {
                true => sources[at..].iter().position(|(source, _)| source == name).map(|n| at + n),
                false => Some(at),
            };
            let Some(begin) = begin.filter(|begin| *begin <= latest[which]) else {
                missing.push(ambiguous(name, wanted, sources));
                break;
            };
            missing.extend(folder.take().filter(|_| begin != at).map(|folder| absent(folder, None)));
            let mut end = latest[which + 1];
            // Each named file starts at the next occurrence of its name.
            if let (true, Some(next)) = (is_file, wanted.get(which + 1).filter(|next| named(next))) {
                let place = sources[begin + 1..end].iter().position(|(source, _)| source == next);
                end = place.map_or(end, |n| begin + 1 + n);
            }
            let found = if is_file {
                self.file(&sources[begin..end], store)
            } else {
                self.folder(name, &sources[begin..end], store)
            };
            match found {
                Some((path, count)) => {
                    at = begin + count;
                    folder = (!is_file).then_some(name);
                    // A folder without a name of its own keeps none, so that the recipe stays the same.
                    paths.push(if name == ANY_FOLDER { format!("{path}/{ANY_FOLDER}") } else { path });
                }
                None => {
                    missing.push(absent(name, is_file.then(|| &sources[begin].1)));
                    at = if is_file { begin + 1 } else { end };
                }
            }
        }
        missing.extend(folder.filter(|_| at < sources.len()).map(|folder| absent(folder, None)));
        if missing.is_empty() { Ok(paths) } else { Err(missing) }
    }

    /// Finds the first file of `run`, a group of source files. Returns its path, and the length of the longest
    /// prefix of `run` whose files are all in the folder of that file.
    fn file(&self, run: &[Read], store: &Store) -> Option<(String, usize)> {
        self.best(run.len(), self.first_of(run, store), |path| {
            path.parent().map_or(1, |folder| 1 + self.held(folder, &run[1..], store))
        })
    }

    /// Finds the folder of this name that contains the longest prefix of `run`, a group of source files. Returns
    /// its path and the length of the prefix. If several folders contain equally many files, the innermost is
    /// returned.
    fn folder(&self, name: &str, run: &[Read], store: &Store) -> Option<(String, usize)> {
        let inside = |path: &&Path| self.roots.iter().any(|root| path.starts_with(root));
        let is_meant = |path: &&Path| {
            let own = || path.file_name().and_then(|own| own.to_str()).map(one_line_name);
            name == ANY_FOLDER || own().as_deref() == Some(name)
        };
        let around = self.first_of(run, store).flat_map(|path| path.ancestors().skip(1));
        let all = around.filter(inside).filter(is_meant);
        self.best(run.len(), all, |folder| self.held(folder, run, store))
    }

    /// The paths of the files that have the name and the digest of the first file of `run`.
    fn first_of<'s>(&'s self, run: &'s [Read], store: &'s Store) -> impl Iterator<Item = &'s Path> {
        let all = run.first().and_then(|(name, digest)| Some((self.files.get(name)?, digest)));
        let all = all.into_iter().flat_map(|(paths, digest)| paths.iter().map(move |path| (path, digest)));
        all.filter(|(path, digest)| self.has(path, digest, store)).map(|(path, _)| path.as_path())
    }

    /// The candidate for which `held` returns the largest count, with that count. Of several such candidates, the
    /// first is returned. The search ends early when a count reaches `all`.
    fn best<'s>(
        &self,
        all: usize,
        candidates: impl Iterator<Item = &'s Path>,
        held: impl Fn(&Path) -> usize,
    ) -> Option<(String, usize)> {
        let mut best: Option<(String, usize)> = None;
        for path in candidates {
            let Some(text) = path.to_str() else { continue };
            let count = held(path);
            if best.as_ref().is_none_or(|(_, most)| count > *most) {
                best = Some((text.to_owned(), count));
            }
            if count == all {
                break;
            }
        }
        best
    }

    /// Length of the longest prefix of `run` whose files are all inside a folder.
    fn held(&self, folder: &Path, run: &[Read], store: &Store) -> usize {
        let lies = |(name, digest): &&Read| {
            let mut all = self.files.get(name).into_iter().flatten();
            all.any(|path| path.starts_with(folder) && self.has(path, digest, store))
        };
        run.iter().take_while(lies).count()
    }

    fn has(&self, path: &Path, digest: &Digest, store: &Store) -> bool {
        let mut digests = self.digests.borrow_mut();
        let read = || store.digest_file(path).ok().map(|(digest, _)| digest);
        let found = digests.entry(path.to_owned()).or_insert_with(read);
        found.as_ref() == Some(digest)
    }
}

fn absent(name: &str, digest: Option<&Digest>) -> String {
    match digest {
        Some(digest) => {
            format!("no folder of `--inputs` contains `{name}` with the digest {}", digest.short())
        }
        None if name == ANY_FOLDER => {
            "no folder of `--inputs` contains the files that the node read".to_owned()
        }
        None => format!(
            "the folders of `--inputs` and their subfolders do not include a folder `{name}` with the files this picture was made from"
        ),
    }
}

/// The error message for a name in a recipe that could refer to several of the files that the node read.
fn ambiguous(name: &str, wanted: &[String], sources: &[Read]) -> String {
    let times = wanted.iter().filter(|other| *other == name).count();
    let read = sources.iter().filter(|(source, _)| source == name).count();
    format!(
        "the recipe does not identify the file `{name}` (fields of the node that contain this name: {times}; files that the node read: {}, of these with this name: {read}); use the graph itself, or a bundle of it",
        sources.len()
    )
}

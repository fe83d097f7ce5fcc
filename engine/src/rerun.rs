//! From the recipe in a picture back to a graph that can run.
//!
//! A recipe names the files that were read without their folders, each with its digest. They are looked for by
//! name and digest in folders that the user names, so that what runs is what ran, or nothing does.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cache::{Digest, Store};

use crate::action::read_sources;
use crate::diag::{Diagnostics, Source};
use crate::diff::{NodeDifference, changes};
use crate::document::{Document, RawField};
use crate::edit::replace_strings;
use crate::error::NodeError;
use crate::graph::Graph;
use crate::kind::{Registry, camel};
use crate::param::Role;
use crate::recipe::{HEAD, READS, last};
use crate::syntax::{Sort, parse_part};

/// Most files that are looked at in the folders of the user.
const MOST_FILES: usize = 200_000;

/// What a picture says about how it was made.
#[derive(Debug, Clone)]
pub struct Recipe {
    text: String,
    /// Kind, version and profile.
    kinds: Vec<(String, u32, String)>,
    /// Files by node: name and digest.
    sources: BTreeMap<String, Vec<(String, Digest)>>,
}

/// A node, and its (field, value).
type Said = (String, Vec<(String, String)>);

/// Why a recipe cannot run.
#[derive(Debug, thiserror::Error)]
pub enum RecipeError {
    /// It is none, or none of this format.
    #[error("the picture carries no recipe that this program reads")]
    NoRecipe,
    /// Its graph does not parse.
    #[error(transparent)]
    Graph(#[from] Diagnostics),
    /// Files that it reads were not found.
    #[error("{}", .0.join("\n"))]
    Missing(Vec<String>),
    /// A folder cannot be read.
    #[error("cannot look into `{}`: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

impl Recipe {
    /// Reads the text that a picture carries.
    ///
    /// # Errors
    /// [`RecipeError::NoRecipe`] for any other text.
    pub fn parse(text: &str) -> Result<Self, RecipeError> {
        let rest = text.strip_prefix(HEAD).ok_or(RecipeError::NoRecipe)?;
        let (head, _) = rest.split_once('\n').ok_or(RecipeError::NoRecipe)?;
        let kind = |entry: &str| {
            let mut words = entry.split(' ');
            let (name, version) = (words.next()?.to_owned(), words.next()?.parse().ok()?);
            Some((name, version, words.next()?.to_owned()))
        };
        let kinds = head.split(", ").map(|entry| kind(entry.trim())).collect::<Option<_>>();
        let mut sources: BTreeMap<String, Vec<(String, Digest)>> = BTreeMap::new();
        for line in text.lines().filter_map(|line| line.strip_prefix("// ")) {
            let Some((node, rest)) = line.split_once(READS) else { continue };
            let Some((name, digest)) = rest.rsplit_once(' ') else { continue };
            let digest = Digest::from_hex(digest).ok_or(RecipeError::NoRecipe)?;
            sources.entry(node.to_owned()).or_default().push((name.to_owned(), digest));
        }
        Ok(Self { text: text.to_owned(), kinds: kinds.ok_or(RecipeError::NoRecipe)?, sources })
    }

    /// The text as it was given.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Kinds that this program has not, or has in another version: what it made would be another picture.
    pub fn other_kinds(&self, registry: &Registry) -> Vec<String> {
        let other = |(name, version, profile): &(String, u32, String)| match registry.get(name) {
            None => Some(format!("there is no kind `{name}` here")),
            Some(kind) if kind.version != *version || kind.profile != profile => Some(format!(
                "the picture was made by `{name}` {version} ({profile}), and this is {} ({})",
                kind.version, kind.profile
            )),
            Some(_) => None,
        };
        self.kinds.iter().filter_map(other).collect()
    }

    /// What two recipes say otherwise, node by node of one name: kinds with their versions, fields, and the content of
    /// the files that were read. What the picture was called is in neither.
    ///
    /// # Errors
    /// When one of the graphs cannot be read.
    pub fn differences(&self, other: &Recipe) -> Result<Vec<(String, NodeDifference)>, RecipeError> {
        let (a, b) = (self.nodes()?, other.nodes()?);
        let changed = a.iter().filter_map(|(name, fields)| match b.iter().find(|(known, _)| known == name) {
            None => Some((name.clone(), NodeDifference::Gone)),
            Some((_, now)) => match changes(fields.clone(), now.clone()) {
                changes if changes.is_empty() => None,
                changes => Some((name.clone(), NodeDifference::Changed(changes))),
            },
        });
        let new = b.iter().filter(|(name, _)| !a.iter().any(|(known, _)| known == name));
        Ok(changed.chain(new.map(|(name, _)| (name.clone(), NodeDifference::New))).collect())
    }

    /// What it says of the scene and of each node: (field, value).
    fn nodes(&self) -> Result<Vec<Said>, RecipeError> {
        let document = self.document("recipe")?;
        let field = |field: &RawField<'_>| (field.name.to_owned(), field.text.to_owned());
        let scene = document.scene.iter().flat_map(|scene| &scene.fields).map(field).collect();
        let mut nodes = vec![("scene".to_owned(), scene)];
        for node in &document.nodes {
            let kind = self.kinds.iter().find(|(name, ..)| camel(name) == node.kind);
            let kind =
                kind.map_or_else(|| node.kind.to_owned(), |(name, n, how)| format!("{name} {n} {how}"));
            let mut fields = vec![("kind".to_owned(), kind)];
            fields.extend(node.fields.iter().map(field));
            let read = self.sources.get(&*node.id).into_iter().flatten();
            fields.extend(read.map(|(file, digest)| (format!("the content of {file}"), digest.short())));
            nodes.push((node.id.to_string(), fields));
        }
        Ok(nodes)
    }

    fn document(&self, name: &str) -> Result<Document<'_>, RecipeError> {
        let mut diagnostics = Vec::new();
        let document = parse_part(&self.text, 0..self.text.len(), Sort::Graph, &mut diagnostics);
        if diagnostics.is_empty() {
            return Ok(document);
        }
        Err(Diagnostics::new(Source::new(name, self.text.as_str()), diagnostics).into())
    }

    /// The graph with the path of each file as it lies in one of `folders`. `file` becomes the name of what
    /// it writes, where that is one file. `store` remembers digests.
    ///
    /// # Errors
    /// When the graph cannot be read, or a file is not found: all that are not, at once.
    pub fn settle(
        &self,
        name: &str,
        file: &str,
        registry: &Registry,
        folders: &[PathBuf],
        store: &Store,
    ) -> Result<Source, RecipeError> {
        let document = self.document(name)?;
        let shelf = if self.sources.is_empty() { Shelf::default() } else { Shelf::of(folders)? };
        let mut missing = Vec::new();
        let mut edits = Vec::new();
        for node in &document.nodes {
            let Some(kind) = registry.get(node.kind) else { continue };
            let none = Vec::new();
            let sources = self.sources.get(&*node.id).unwrap_or(&none);
            for field in &node.fields {
                let role = kind.params.iter().find(|spec| spec.name == field.name).map(|spec| spec.role);
                let with = match role {
                    Some(Role::Input) => replace_strings(field.text, |wanted| {
                        shelf.find(wanted, sources, store).unwrap_or_else(|| {
                            let named = sources.iter().find(|(name, _)| name == wanted);
                            let digest = named.map_or_else(String::new, |(_, d)| {
                                format!(" with the content {}", d.short())
                            });
                            missing
                                .push(format!("`{wanted}`{digest} is in none of the folders of `--inputs`"));
                            wanted.to_owned()
                        })
                    }),
                    Some(Role::Output) if !field.text.contains("{view}") => format!("{file:?}"),
                    _ => continue,
                };
                edits.push((field.span.clone(), with));
            }
        }
        if !missing.is_empty() {
            return Err(RecipeError::Missing(missing));
        }
        let mut text = self.text.clone();
        for (span, with) in edits.into_iter().rev() {
            text.replace_range(span, &with);
        }
        Ok(Source::new(name, text))
    }

    /// Files that a graph made from this recipe reads and that are not those of the recipe, such as a texture
    /// beside a model.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn other_sources(&self, graph: &Graph, store: &Store) -> Result<Vec<String>, NodeError> {
        let mut other = Vec::new();
        for (index, node) in graph.nodes.iter().enumerate() {
            let known = self.sources.get(&node.id);
            for source in read_sources(graph, index, store)? {
                let name = last(&source.file.name);
                if !known.is_some_and(|known| known.iter().any(|(n, d)| n == name && *d == source.digest)) {
                    let path = source.file.path.display();
                    other.push(format!("`{path}` is not the file that the picture was made from"));
                }
            }
        }
        Ok(other)
    }
}

/// The files and folders below the folders of the user, by their last name.
#[derive(Default)]
struct Shelf {
    files: BTreeMap<String, Vec<PathBuf>>,
    folders: BTreeMap<String, Vec<PathBuf>>,
}

impl Shelf {
    /// Looks through folders in order of their names. Links are not followed.
    fn of(folders: &[PathBuf]) -> Result<Self, RecipeError> {
        let mut shelf = Self::default();
        let mut count = 0;
        for folder in folders {
            let failed = |folder: &Path| {
                let folder = folder.to_owned();
                move |source| RecipeError::Folder { folder, source }
            };
            let mut open = vec![folder.canonicalize().map_err(failed(folder))?];
            while let Some(folder) = open.pop() {
                let entries = std::fs::read_dir(&folder).map_err(failed(&folder))?;
                let mut entries: Vec<_> = entries.flatten().collect();
                entries.sort_by_key(std::fs::DirEntry::file_name);
                for entry in entries {
                    count += 1;
                    let Ok(kind) = entry.file_type() else { continue };
                    let Ok(name) = entry.file_name().into_string() else { continue };
                    if count > MOST_FILES {
                        return Ok(shelf);
                    }
                    if kind.is_dir() {
                        shelf.folders.entry(name).or_default().push(entry.path());
                        open.push(entry.path());
                    } else if kind.is_file() {
                        shelf.files.entry(name).or_default().push(entry.path());
                    }
                }
            }
        }
        Ok(shelf)
    }

    /// Where a file of this name and content lies, or a folder of this name that holds all the sources.
    fn find(&self, wanted: &str, sources: &[(String, Digest)], store: &Store) -> Option<String> {
        let below = |name: &str, digest: &Digest, folder: &Path| {
            let mut candidates = self.files.get(name).into_iter().flatten();
            candidates.find(|path| {
                path.starts_with(folder) && store.digest_file(path).is_ok_and(|(found, _)| found == *digest)
            })
        };
        let own: Vec<&Digest> = sources.iter().filter(|(name, _)| name == wanted).map(|(_, d)| d).collect();
        let file = own.iter().find_map(|digest| below(wanted, digest, Path::new("")));
        let holds = |folder: &&PathBuf| {
            sources.iter().all(|(name, digest)| below(name, digest, folder.as_path()).is_some())
        };
        let folder = || self.folders.get(wanted).into_iter().flatten().find(holds);
        let found = match (file, own.is_empty() && !sources.is_empty()) {
            (None, true) => folder(),
            (file, _) => file,
        };
        Some(found?.to_str()?.to_owned())
    }
}

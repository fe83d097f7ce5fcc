//! Turns the recipe in a picture back into a graph that can run.
//!
//! A recipe contains the names of its source files, without folders, and their digests. The files are searched for
//! by name and digest in folders given by the user, so that only a graph with the same inputs can run.

use std::collections::BTreeMap;
use std::path::PathBuf;

use cache::{Digest, Store};

use crate::graph::graph::Graph;
use crate::kind::param_type::Role;
use crate::kind::registry::{Registry, camel};
use crate::plan::diff::NodeDifference;
use crate::record::action::read_sources;
use crate::record::recipe::{HEAD, READS, one_line_name};
use crate::share::pairing::{Described, recipe_differences};
use crate::share::recipe_error::RecipeError;
use crate::share::source_index::SourceIndex;
use crate::text::diag::Diagnostics;
use crate::text::document::{Document, RawField, RawNode};
use crate::text::edit::replace_strings;
use crate::text::source::Source;
use crate::text::syntax::{FileKind, parse_part};
use crate::value::error::NodeError;

/// The recipe of a picture.
#[derive(Debug, Clone)]
pub struct Recipe {
    text: String,
    /// Name, version and profile of each kind.
    kinds: Vec<(String, u32, String)>,
    /// Source files of each node, as pairs of name and digest.
    sources: BTreeMap<String, Vec<(String, Digest)>>,
}

impl Recipe {
    /// Parses the text of a recipe that was stored in a picture.
    ///
    /// # Errors
    /// [`RecipeError::NoRecipe`] if `text` is not a recipe.
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

    /// The text of the recipe.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Descriptions of the kinds in the recipe that this version of lightharmony does not have, or has in another
    /// version. If there are any, a new picture may differ from the original picture.
    pub fn other_kinds(&self, registry: &Registry) -> Vec<String> {
        let other = |(name, version, profile): &(String, u32, String)| match registry.get(name) {
            None => Some(format!("this version of lightharmony has no kind `{name}`")),
            Some(kind) if kind.version != *version || kind.profile != profile => Some(format!(
                "the picture was made with version {version} of `{name}` ({profile}), but this version of lightharmony has version {} ({})",
                kind.version, kind.profile
            )),
            Some(_) => None,
        };
        self.kinds.iter().filter_map(other).collect()
    }

    /// Differences between two recipes by node: kinds with versions, fields, and the content of source files. Node
    /// numbers are not compared; see the module `pairing`. Nodes have the names of the first recipe; nodes that
    /// only the second has are named like `b.n3`. The file name of the picture is not part of a recipe.
    ///
    /// # Errors
    /// If one of the graphs cannot be parsed.
    pub fn differences(&self, other: &Recipe) -> Result<Vec<(String, NodeDifference)>, RecipeError> {
        let (a, b) = (self.nodes()?, other.nodes()?);
        Ok(recipe_differences(&a, &b))
    }

    /// The scene and the nodes in topological order.
    fn nodes(&self) -> Result<Vec<Described>, RecipeError> {
        let document = self.document("recipe")?;
        let field = |field: &RawField<'_>| (field.name.to_owned(), field.text.to_owned());
        let scene = document.scene.iter().flat_map(|scene| &scene.fields).map(field).collect();
        let mut nodes = vec![Described::new("scene".to_owned(), String::new(), scene)];
        for node in &document.nodes {
            let kind = self.kinds.iter().find(|(name, ..)| camel(name) == node.kind);
            let version =
                kind.map_or_else(|| node.kind.to_owned(), |(name, n, how)| format!("{name} {n} {how}"));
            let mut fields = vec![("kind".to_owned(), version)];
            fields.extend(node.fields.iter().map(field));
            // Files of the same name are numbered.
            let mut count: BTreeMap<&str, usize> = BTreeMap::new();
            for (file, digest) in self.sources.get(&*node.id).into_iter().flatten() {
                let n = count.entry(file).or_default();
                *n += 1;
                let which = if *n > 1 { format!(" ({n})") } else { String::new() };
                fields.push((format!("the content of {file}{which}"), digest.short()));
            }
            let kind = kind.map_or(node.kind, |(name, ..)| name).to_owned();
            nodes.push(Described::new(node.id.to_string(), kind, fields));
        }
        Ok(nodes)
    }

    fn document(&self, name: &str) -> Result<Document<'_>, RecipeError> {
        let mut diagnostics = Vec::new();
        let document = parse_part(&self.text, 0..self.text.len(), FileKind::Graph, &mut diagnostics);
        if diagnostics.is_empty() {
            return Ok(document);
        }
        Err(Diagnostics::new(Source::new(name, self.text.as_str()), diagnostics).into())
    }

    /// The graph of the recipe, in which the name of each source file is replaced by the path of that file in one
    /// of `folders`. If a node reads several files of the same name, they are matched in order. `file` becomes the
    /// output path, unless the sink writes one file per view. `store` remembers digests.
    ///
    /// # Errors
    /// If the graph cannot be parsed, or if files are missing or ambiguous. All such files are reported.
    pub fn settle(
        &self,
        name: &str,
        file: &str,
        registry: &Registry,
        folders: &[PathBuf],
        store: &Store,
    ) -> Result<Source, RecipeError> {
        let document = self.document(name)?;
        let runs_program =
            |node: &&RawNode<'_>| registry.get(node.kind).is_some_and(|kind| kind.runs_programs);
        if let Some(node) = document.nodes.iter().find(runs_program) {
            return Err(RecipeError::Program(node.kind.to_owned()));
        }
        let index = if self.sources.is_empty() { SourceIndex::default() } else { SourceIndex::of(folders)? };
        let mut missing = Vec::new();
        let mut edits = Vec::new();
        for node in &document.nodes {
            let Some(kind) = registry.get(node.kind) else { continue };
            let role = |field: &RawField<'_>| {
                kind.params.iter().find(|spec| spec.name == field.name).map(|spec| spec.role)
            };
            let inputs = || node.fields.iter().filter(|field| role(field) == Some(Role::Input));
            let mut wanted = Vec::new();
            for field in inputs() {
                replace_strings(field.text, |path| {
                    wanted.push(one_line_name(path));
                    String::new()
                });
            }
            let sources = self.sources.get(&*node.id).map_or(&[][..], Vec::as_slice);
            match index.settle(&wanted, sources, store) {
                Ok(paths) => {
                    let mut paths = paths.into_iter();
                    for field in inputs() {
                        let with = replace_strings(field.text, |_| paths.next().unwrap_or_default());
                        edits.push((field.span.clone(), with));
                    }
                }
                Err(lines) => missing.extend(lines.into_iter().map(|line| format!("`{}`: {line}", node.id))),
            }
            let outputs = node.fields.iter().filter(|field| role(field) == Some(Role::Output));
            let one = outputs.filter(|field| !field.text.contains("{view}"));
            edits.extend(one.map(|field| (field.span.clone(), format!("{file:?}"))));
        }
        if !missing.is_empty() {
            missing.extend(index.is_cut().then(|| CUT.to_owned()));
            return Err(RecipeError::Missing(missing));
        }
        let mut text = self.text.clone();
        edits.sort_by_key(|(span, _)| span.start);
        for (span, with) in edits.into_iter().rev() {
            text.replace_range(span, &with);
        }
        Ok(Source::new(name, text))
    }

    /// Compares the source files of a graph made from this recipe with those in the recipe, and describes the
    /// differences. The content of a file may differ, for example of a texture next to a model, and a node may read
    /// more files, fewer files, or files in another order.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn other_sources(&self, graph: &Graph, store: &Store) -> Result<Vec<String>, NodeError> {
        let mut other = Vec::new();
        for (index, node) in graph.nodes.iter().enumerate() {
            let known = self.sources.get(&node.id).map_or(&[][..], Vec::as_slice);
            let found = read_sources(graph, index, store)?;
            for (place, source) in found.iter().enumerate() {
                let now = (one_line_name(&source.file.name), source.digest);
                if known.get(place) != Some(&now) {
                    let path = source.file.path.display();
                    let what = if known.contains(&now) {
                        format!(
                            "when the picture was made, `{path}` was at a different position in the list of files that `{}` reads",
                            node.id
                        )
                    } else {
                        format!("`{path}` is not the file from which the picture was made")
                    };
                    other.push(what);
                }
            }
            for (name, digest) in known.iter().skip(found.len()) {
                let digest = digest.short();
                other.push(format!("`{}` no longer reads `{name}` with the digest {digest}", node.id));
            }
        }
        Ok(other)
    }
}

/// Text appended to an error message if there were too many files to inspect.
const CUT: &str = "(the folders of `--inputs` contain too many files to search; choose smaller folders)";

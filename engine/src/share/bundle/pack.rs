//! Packs a graph, its source files, its lock and selected results into a bundle.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use crate::graph::graph::Graph;
use crate::kind::context::ReadSource;
use crate::kind::param_type::Role;
use crate::plan::plan::{Fate, Outlook};
use crate::record::action::prepare;
use crate::record::record::{Record, Spent};
use crate::run::engine::Engine;
use crate::share::bundle::container::{BundleError, BundleParts};
use crate::share::bundle::names::{GRAPH, LOCK, wrong_name};
use crate::text::edit::replace_strings;
use crate::text::source::folder_of;
use crate::value::error::NodeError;
use crate::value::root::is_program;

/// Selects the nodes whose values become part of a bundle. Digests of all known results are always included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Results {
    /// Includes no values, only digests.
    Digests,
    /// Includes the values of the targets, which are the sinks by default.
    Targets,
    /// Includes all stored values.
    All,
}

/// Summary of a packed bundle.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Packed {
    /// Number of source files.
    pub inputs: usize,
    /// Number of nodes that have a result.
    pub known: usize,
    /// Number of nodes whose values are in the bundle.
    pub values: usize,
    /// Names of the nodes that have no result.
    pub unknown: Vec<String>,
    /// Names of the nodes whose values were requested but are not stored.
    pub gone: Vec<String>,
}

impl Engine {
    /// Writes a graph, its source files and the selected results as one bundle. Equal content gives equal bytes,
    /// since the bundle contains no times and nothing about the machine or its folders.
    ///
    /// # Errors
    /// If a file cannot be read, or if its path is not permitted in a bundle.
    pub fn pack(
        &self,
        graph: &Graph,
        only: &[usize],
        results: Results,
        to: &mut impl std::io::Write,
    ) -> Result<Packed, BundleError> {
        let refused = |error: NodeError| BundleError::Refused(error.to_string());
        let targets = if only.is_empty() { graph.targets() } else { only.to_vec() };
        let wanted = graph.above(&targets);
        let mut outlook = Outlook::new(self, graph);
        let places = Places::new(graph);
        let mut parts = BundleParts::default();
        let mut packed = Packed::default();
        // With their names in the bundle, since names are part of keys.
        let mut sources: Vec<Vec<ReadSource>> = vec![Vec::new(); graph.nodes.len()];
        let mut lock = self.lock(graph, &(0..graph.nodes.len()).collect::<Vec<_>>()).map_err(refused)?;
        lock.inputs.clear();
        for &index in graph.order() {
            let node = &graph.nodes[index];
            let fate = outlook.fate(index);
            let own = crate::record::action::read_sources(graph, index, self.store()).map_err(refused)?;
            for source in own {
                if source.file.is_program() {
                    lock.inputs.insert(source.file.name.clone(), source.digest.to_string());
                    sources[index].push(source);
                    continue;
                }
                let mut moved = source.clone();
                moved.file.name = places.name(index, &source.file.name);
                // A folder written as `.` stays one, so that recipes do not change; the files in it lose the dot.
                let plain = moved.file.name.replace("/./", "/");
                if let Some(why) = wrong_name(&plain) {
                    let (file, node) = (&source.file.name, &node.id);
                    let what = format!(
                        "`{file}`, which `{node}` reads, cannot be part of a bundle: {why}; rename it"
                    );
                    return Err(BundleError::Refused(what));
                }
                parts.source(&plain, source.file.path, source.digest, source.bytes);
                lock.inputs.insert(moved.file.name.clone(), source.digest.to_string());
                sources[index].push(moved);
            }
            let (Fate::Known | Fate::Lost, Some(record)) = (&fate, &outlook.records[index]) else {
                if wanted[index] {
                    packed.unknown.push(node.id.clone());
                }
                continue;
            };
            let output = |wire: crate::graph::node::Wire| {
                let above = outlook.records[wire.node].as_ref().expect("a known node has known inputs");
                &above.outputs[wire.port]
            };
            let above = |above: usize| sources[above].as_slice();
            let action =
                prepare(graph, index, sources[index].clone(), output, above, Vec::new()).map_err(refused)?;
            let manifest = action.key.as_ref().map(|key| &key.manifest).expect("a prepared action has a key");
            // Times are left out.
            let timeless = Record { spent: Spent::default(), ..record.clone() };
            parts.record(action.digest(), timeless.encode(manifest));
            packed.known += 1;
            let chosen = match results {
                Results::Digests => false,
                Results::Targets => targets.contains(&index),
                Results::All => true,
            };
            let stored = record.outputs.iter().filter(|output| output.stored);
            let values: Option<Vec<Vec<u8>>> =
                stored.map(|output| self.store().get_blob(&output.digest).ok().flatten()).collect();
            match values.filter(|_| chosen) {
                Some(values) if !values.is_empty() => {
                    values.into_iter().for_each(|value| parts.value(value));
                    packed.values += 1;
                }
                None if chosen => packed.gone.push(node.id.clone()),
                _ => {}
            }
        }
        packed.inputs = lock.inputs.keys().filter(|name| !is_program(name)).count();
        parts.file(GRAPH, places.text(graph)?.into_bytes());
        parts.file(LOCK, lock.text().into_bytes());
        parts.write(to)?;
        Ok(packed)
    }
}

/// The paths of source files in the bundle. Files in the folder of the graph keep their paths. Other files are
/// placed in folders `inputs/N/`, one for each folder that the graph names.
struct Places {
    /// For each node, the folders that are renamed in the bundle: a map from the path in the graph to the path in
    /// the bundle.
    moved: Vec<BTreeMap<String, String>>,
}

impl Places {
    fn new(graph: &Graph) -> Self {
        let named = |index: usize| -> Vec<String> {
            let mut paths = Vec::new();
            let mut params = graph.nodes[index].kind.params.iter();
            graph.nodes[index].step.visit(&mut |_, value| {
                if params.next().is_some_and(|spec| spec.role == Role::Input) {
                    paths.extend(value.paths().into_iter().map(str::to_owned));
                }
            });
            paths
        };
        let all: Vec<Vec<String>> = (0..graph.nodes.len()).map(named).collect();
        let stays = |path: &str| {
            wrong_name(path).is_none() && !path.starts_with("inputs/") && ![GRAPH, LOCK].contains(&path)
        };
        let away: BTreeSet<&str> =
            all.iter().flatten().filter(|path| !stays(path)).map(|path| folder(path)).collect();
        let number: BTreeMap<&str, usize> = away.into_iter().zip(0..).collect();
        let moved = all.iter().map(|paths| {
            let away = paths.iter().map(|path| folder(path));
            let target = |from: &str| {
                let here =
                    if paths.iter().any(|path| is_dots(path) && folder(path) == from) { "/." } else { "" };
                number.get(from).map(|n| (from.to_owned(), format!("inputs/{n}{here}")))
            };
            away.filter_map(target).collect()
        });
        Self { moved: moved.collect() }
    }

    /// The path in the bundle of a source file of a node. Equal to `name` if the file is not in a folder that gets
    /// another name.
    fn name(&self, node: usize, name: &str) -> String {
        let moved = self.moved[node].iter().filter_map(|(from, to)| {
            if is_dots(name) && folder(name) == from {
                return Some((from.len(), to.clone()));
            }
            let rest = match from.as_str() {
                "" => name,
                "/" => name.strip_prefix('/')?,
                from => name.strip_prefix(from)?.strip_prefix('/')?,
            };
            Some((from.len(), format!("{to}/{rest}")))
        });
        // The innermost folder applies.
        moved.max().map_or_else(|| name.to_owned(), |(_, name)| name)
    }

    /// The text of the graph for the bundle, in which the new paths replace the old ones.
    fn text(&self, graph: &Graph) -> Result<String, BundleError> {
        let mut edits = Vec::new();
        for (index, node) in
            graph.nodes.iter().enumerate().filter(|(index, _)| !self.moved[*index].is_empty())
        {
            let mut params = node.kind.params.iter();
            node.step.visit(&mut |name, value| {
                let is_input = params.next().is_some_and(|spec| spec.role == Role::Input);
                let span = node.field_place(name);
                if let (true, Some(span), Ok(text)) = (is_input, span, value.text()) {
                    edits.push((span, replace_strings(&text, |path| self.name(index, path))));
                }
            });
        }
        // Paths in an included file are relative to its folder, from which `inputs` may be unreachable.
        let below = |span: &Range<usize>| !folder_of(graph.source.piece(span.start)).is_empty();
        if let Some((span, _)) = edits.iter().find(|(span, _)| below(span)) {
            let (field, file) = (&graph.source.text[span.clone()], &graph.source.piece(span.start).name);
            let what = format!(
                "`{field}` in `{file}` names a path that must change in the bundle, but `{file}` is not in \
                 the folder of the graph; move `{file}` there"
            );
            return Err(BundleError::Refused(what));
        }
        // A field occurs once in the text, however many instances the node has.
        edits.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
        edits.dedup();
        if let Some(pair) = edits.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let field = &graph.source.text[pair[0].0.clone()];
            let what = format!(
                "`{field}` names files that would get several different paths in the bundle; move them into the \
                 folder of the graph"
            );
            return Err(BundleError::Refused(what));
        }
        Ok(graph.source.pack(&edits))
    }
}

/// True if the last component of a path is `.` or `..`.
fn is_dots(path: &str) -> bool {
    matches!(path.trim_end_matches('/').rsplit('/').next(), Some("." | ".."))
}

/// The parent folder of a path, as written but without a trailing slash; `/` for a file in the root. A path whose
/// last component is `.` or `..` is returned unchanged, since the real name of that folder is unknown.
fn folder(path: &str) -> &str {
    let path = path.trim_end_matches('/');
    match path.rsplit_once('/') {
        _ if is_dots(path) => path,
        Some(("", _)) => "/",
        Some((folder, _)) => folder,
        None => "",
    }
}

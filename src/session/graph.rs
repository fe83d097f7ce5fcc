//! The graph that a command works on, with presets, overlays and settings.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use cache::{Store, TempFolder};
use clap::Args;
use engine::{EditError, Engine, Graph, ReadFiles, Registry, Setting, Source, SourceRoot};

use super::engine::EngineArgs;
use super::error::Error;
use super::names::wanted;
use super::origin::{Origin, OriginArgs, is_picture};
use crate::terminal;

/// The graph, and the values that override it.
#[derive(Debug, Args)]
pub struct GraphArgs {
    /// The graph file (RON), a bundle, or a picture that carries its recipe; `-` reads standard input
    pub graph: PathBuf,
    /// Set one field for this run: node.field=value; may be repeated
    #[arg(long = "set", value_name = "NODE.FIELD=VALUE")]
    pub set: Vec<String>,
    /// Do all work, even where a check shows that it would not change a byte; for measuring what these checks save
    #[arg(long)]
    pub exhaustive: bool,
    /// Apply a preset of the graph, or one of draft, preview, final and reference, which set the knobs of the
    /// graph; may be repeated. `--overlay` and `--set` override presets
    #[arg(long, value_name = "NAME")]
    pub preset: Vec<String>,
    /// Apply the values of a file, such as Overlay(nodes: (trace: (samples: 4))); may be repeated
    #[arg(long, value_name = "FILE")]
    pub overlay: Vec<PathBuf>,
    /// Compute only these nodes, separated by commas, and the nodes that they need; default: every sink.
    /// `each/frame=5..7` names a range of an axis
    #[arg(long, value_name = "NODES", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Compute the nodes of `--only`, or the sinks that write a file per frame, only at these values of the axis
    /// `frame`, such as 1001-1050 or 7
    #[arg(long, value_name = "FIRST-LAST")]
    pub frames: Option<String>,
    // Not flattened from `OriginArgs`: clap makes an optional `GraphArgs` only if it has an argument of its own.
    /// For a bundle or a picture: a folder whose files the graph may read; may be repeated
    #[arg(long, value_name = "DIR")]
    pub inputs: Vec<PathBuf>,
    /// For a picture: run its recipe even if kinds have other versions here, which may give a different picture
    #[arg(long)]
    pub other_versions: bool,
}

/// A checked graph and the wanted nodes.
pub struct Loaded {
    pub graph: Arc<Graph>,
    pub only: Vec<usize>,
    /// The files from which the graph was read: the graph file, its includes and its overlays.
    pub texts: Vec<PathBuf>,
    /// Path of the lock file of the graph, whether or not the file exists.
    pub lock: Option<PathBuf>,
    /// Temporary folder of an unpacked bundle.
    pub unpacked: Option<TempFolder>,
}

impl Loaded {
    /// Rejects sinks that would overwrite the graph or a file that it reads.
    pub fn check_outputs(&self, out: &Path) -> Result<(), Error> {
        self.graph.check_outputs(&self.only, out, &self.texts).map_err(Error::Graph)
    }

    /// Rejects an output path that is the graph or a file that it reads.
    pub fn check_output(&self, path: &Path) -> Result<(), Error> {
        let read = ReadFiles::new(self.texts.iter().cloned().chain(self.graph.files()));
        if read.has(path) {
            let why = "is the graph or a file that it reads; choose another output file";
            return Err(Error::usage(format!("`{}` {why}", path.display())));
        }
        Ok(())
    }
}

impl GraphArgs {
    /// Reads and checks the graph.
    pub fn load(&self) -> Result<Loaded, Error> {
        let mut texts = Vec::new();
        let origin = self.read(&mut texts)?;
        self.check(origin, &texts, |source, registry, root| {
            Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph)
        })
    }

    /// Like [`load`](Self::load), for commands about knobs. Prints a remark if the graph comes from a picture,
    /// since its recipe has neither the presets nor the node names of the original graph.
    pub fn load_to_turn(&self) -> Result<Loaded, Error> {
        if is_picture(&self.graph) {
            terminal::remark(
                "the recipe of a picture lacks the presets and the node names of the original graph, so the settings below apply to the picture, not to that graph",
            );
        }
        self.load()
    }

    /// Like [`load`](Self::load), for `watch`. `known` is the previous graph; pass `None` if a file that its nodes
    /// read has changed. If the text of the graph is unchanged, `known` is returned without parsing it again. The
    /// files from which the graph itself was read are added to `texts`, whether or not they exist.
    pub fn load_again(
        &self,
        known: Option<&(Arc<Graph>, Vec<usize>)>,
        texts: &mut Vec<PathBuf>,
    ) -> Result<Loaded, Error> {
        if let Some((known, only)) = known
            && let Some(graph) = self.edited(known)
        {
            texts.push(self.graph.clone());
            return Ok(Loaded {
                graph,
                only: only.clone(),
                texts: texts.clone(),
                lock: None,
                unpacked: None,
            });
        }
        let origin = self.read(texts)?;
        self.check(origin, texts, |source, registry, root| match known {
            Some((known, _)) if known.source == source => Ok(known.clone()),
            _ => Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph),
        })
    }

    /// Updates `known` to the current text of its file. Returns `None` if the current text differs from the text of
    /// `known` by more than a small edit.
    fn edited(&self, known: &Arc<Graph>) -> Option<Arc<Graph>> {
        let path = self.graph.canonicalize().ok()?;
        let text = engine::read_text(&path, engine::MAX_GRAPH_BYTES).ok()?;
        if path.parent() != Some(known.root.folder()) {
            return None;
        }
        known.reparse(text, nodes::registry)
    }

    /// Checks a graph and opens an engine. The graph is checked first, so that no cache is created for a graph with
    /// mistakes.
    pub fn check_with(
        &self,
        origin: Origin,
        texts: &[PathBuf],
        engine: &EngineArgs,
    ) -> Result<(Loaded, Engine), Error> {
        let loaded = self.check(origin, texts, |source, registry, root| {
            Graph::parse(source, registry, root).map(Arc::new).map_err(Error::Graph)
        })?;
        Ok((loaded, engine.open()?))
    }

    /// Reads the graph with its includes, presets, overlays and settings. Their files are added to `texts`, whether
    /// or not they exist.
    pub fn read(&self, texts: &mut Vec<PathBuf>) -> Result<Origin, Error> {
        texts.push(self.graph.clone());
        texts.extend(self.overlay.iter().cloned());
        let origin = OriginArgs { inputs: self.inputs.clone(), other_versions: self.other_versions };
        let Origin { mut source, root, lock, recipe, unpacked } = Origin::open(&self.graph, &origin)?;
        if !self.preset.is_empty() {
            // Presets may set nodes of included files.
            let (joined, included) = source.including(&root);
            texts.extend(included);
            source = joined;
        }
        for preset in &self.preset {
            source = source.with_preset(preset, &nodes::registry());
        }
        for path in &self.overlay {
            if root.is_untrusted(path) {
                return Err(Error::usage(format!(
                    "`{}` belongs to an unpacked bundle and could make this graph read any file; remove \
                     `.lightharmony-bundle` from its folder if you trust it",
                    path.display()
                )));
            }
            let text = engine::read_text(path, engine::MAX_GRAPH_BYTES);
            let text = text.map_err(|error| Error::unreadable("overlay", path, &error))?;
            source = source.overlaid(&path.display().to_string(), &text);
        }
        let (mut settings, mut wrong) = (Vec::<Setting>::new(), Vec::new());
        for text in &self.set {
            match text.parse() {
                Ok(setting) => settings.push(setting),
                Err(EditError::Form(_)) => {
                    wrong.push(format!("`--set {text}` is not a setting; write `--set node.field=value`"));
                }
            }
        }
        if !wrong.is_empty() {
            return Err(Error::usage(wrong.join("\n")));
        }
        if self.exhaustive {
            settings.extend("scene.exhaustive=true".parse::<Setting>());
        }
        // Last, since settings may name other files.
        let (source, included) = engine::apply(&source, &settings).including(&root);
        texts.extend(included);
        Ok(Origin { source, root, lock, recipe, unpacked })
    }

    /// Adds a hint to mistakes in `--set` that explains how to write a list of numbers in a shell.
    fn with_shell_forms(&self, error: Error) -> Error {
        let Error::Graph(mut mistakes) = error else { return error };
        for setting in &self.set {
            let Some((place, value)) = setting.split_once('=') else { continue };
            let field = place.rsplit('.').next().unwrap_or_default().trim();
            let numbers: Vec<&str> = value.split(',').map(str::trim).collect();
            if numbers.len() < 2 || numbers.iter().any(|number| number.parse::<f64>().is_err()) {
                continue;
            }
            for mistake in &mut mistakes.list {
                if mistake.message.starts_with(&format!("`{field}` takes")) {
                    let (open, close) =
                        if mistake.message.contains("in ( )") { ('(', ')') } else { ('[', ']') };
                    let value = numbers.join(", ");
                    mistake.hints.push(format!("in a shell: --set '{}={open}{value}{close}'", place.trim()));
                }
            }
        }
        Error::Graph(mistakes)
    }

    fn check(
        &self,
        origin: Origin,
        texts: &[PathBuf],
        parse: impl FnOnce(Source, &Registry, SourceRoot) -> Result<Arc<Graph>, Error>,
    ) -> Result<Loaded, Error> {
        let Origin { source, root, lock, recipe, unpacked } = origin;
        let graph = parse(source, &nodes::registry(), root).map_err(|error| self.with_shell_forms(error))?;
        let as_it_was =
            self.set.is_empty() && !self.exhaustive && self.preset.is_empty() && self.overlay.is_empty();
        if let Some(recipe) = recipe.filter(|_| as_it_was) {
            let other = recipe.other_sources(&graph, &Store::in_memory())?;
            if !other.is_empty() {
                let (path, other) = (self.graph.display(), other.join("\n"));
                return Err(Error::usage(format!(
                    "the source files differ from those that `{path}` was made from:\n{other}"
                )));
            }
        }
        let only = wanted(&graph, &self.only, self.frames.as_deref())?;
        Ok(Loaded { graph, only, texts: texts.to_vec(), lock, unpacked })
    }
}

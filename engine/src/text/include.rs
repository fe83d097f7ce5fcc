//! Reads the files of a graph (includes, subgraphs) and parses all of its text as one document.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::text::diag::{Code, Diagnostic, shown};
use crate::text::document::{Document, RawField};
use crate::text::overlay::{Overlays, PRESETS};
use crate::text::source::{Piece, PieceRole, Source, folder_of, plain};
use crate::text::subgraph::{FILE, SUBGRAPH, SubgraphFiles, expand};
use crate::text::syntax::{FileKind, parse_part, parse_preset, parse_setting};
use crate::text::values::parse_value;
use crate::value::root::{InputFile, SourceRoot};
use crate::value::text_file::{MAX_GRAPH_BYTES, read_text};

/// Maximum number of included files.
const MOST_FILES: usize = 1000;
/// Maximum total size of the included files in bytes.
const MOST_BYTES: u64 = 256 << 20;

impl Source {
    /// Reads all files that the graph includes or uses as subgraphs, directly or through other files, and appends
    /// each of them once to the text. If the graph comes from a bundle, the files in its text are not read again. A
    /// file that cannot or may not be read is reported when the graph is parsed. Also returns the paths of all
    /// files, whether they exist or not.
    pub fn including(mut self, root: &SourceRoot) -> (Self, Vec<PathBuf>) {
        let mut paths = Vec::new();
        let known = |piece: &Piece| {
            matches!(piece.role, PieceRole::Include | PieceRole::Subgraph)
                .then(|| (piece.role, piece.name.clone()))
        };
        let mut seen: BTreeSet<(PieceRole, String)> = self.pieces().iter().filter_map(known).collect();
        let own = Path::new(&self.name).canonicalize().ok();
        let mut bytes = 0;
        loop {
            let wanted: Vec<(PieceRole, String)> =
                named(&self).into_iter().filter(|name| seen.insert(name.clone())).collect();
            if wanted.is_empty() || seen.len() > MOST_FILES {
                return (self, paths);
            }
            for (role, name) in wanted {
                let file = root.file(&InputFile(name));
                // An include cycle back to the graph itself, whose nodes are present already.
                if role == PieceRole::Include && own.is_some() && file.path.canonicalize().ok() == own {
                    self = self.joined(role, &file.name, "Graph()");
                    continue;
                }
                let may = !root.is_outside(&file) && !root.is_untrusted(&file.path);
                // No more than what is left of the limit of all files, so that nothing beyond it is read.
                let left = (MOST_BYTES - bytes).min(MAX_GRAPH_BYTES);
                if may && let Ok(text) = read_text(&file.path, left) {
                    bytes += text.len() as u64;
                    self = self.joined(role, &file.name, &text);
                }
                paths.push(file.path);
            }
        }
    }
}

/// The names of the files that the pieces include or use, relative to the folder of the graph.
fn named(source: &Source) -> BTreeSet<(PieceRole, String)> {
    let mut names = BTreeSet::new();
    // Most graphs are one file, and searching a large one takes long.
    if !["include", SUBGRAPH, FILE].iter().any(|word| source.text.contains(word)) {
        return names;
    }
    for piece in source.pieces() {
        let document = read(source, piece, &mut Vec::new());
        names.extend(
            document
                .include
                .iter()
                .flat_map(|field| files(field, piece))
                .map(|(name, _)| (PieceRole::Include, name)),
        );
        let laid_over = matches!(piece.role, PieceRole::Overlay | PieceRole::Setting);
        let uses = document.nodes.iter().filter(|node| node.kind == SUBGRAPH || laid_over);
        let fields = uses.flat_map(|node| &node.fields).filter(|field| field.name == FILE);
        let paths = fields.filter_map(|field| parse_value::<String>(field.text).ok());
        names.extend(paths.map(|path| (PieceRole::Subgraph, plain(folder_of(piece), &path))));
    }
    names
}

/// Parses one piece of the text. The piece of a preset is only a name and gives an empty document.
fn read<'t>(source: &'t Source, piece: &Piece, diagnostics: &mut Vec<Diagnostic>) -> Document<'t> {
    match piece.role {
        PieceRole::Graph | PieceRole::Include | PieceRole::Subgraph => {
            parse_part(&source.text, piece.span.clone(), FileKind::Graph, diagnostics)
        }
        PieceRole::Overlay => parse_part(&source.text, piece.span.clone(), FileKind::Overlay, diagnostics),
        PieceRole::Setting => parse_setting(&source.text, piece.span.clone(), diagnostics),
        PieceRole::Preset => Document::default(),
    }
}

/// The file names in an `include` field, relative to the folder of the graph. Each has its byte range.
fn files(field: &RawField<'_>, piece: &Piece) -> Vec<(String, Range<usize>)> {
    let list =
        parse_value::<Vec<String>>(field.text).or_else(|_| parse_value(field.text).map(|one| vec![one]));
    let folder = folder_of(piece);
    let place = |name: &str| {
        let quoted = format!("\"{name}\"");
        let found = field.text.find(&quoted).map(|at| field.span.start + at);
        found.map_or(field.span.clone(), |start| start..start + quoted.len())
    };
    list.unwrap_or_default().into_iter().map(|name| (plain(folder, &name), place(&name))).collect()
}

/// Parses all pieces as one document.
pub(crate) fn parse_all<'t>(
    source: &'t Source,
    root: &SourceRoot,
    diagnostics: &mut Vec<Diagnostic>,
) -> Document<'t> {
    let pieces = source.pieces();
    let mut documents: Vec<Document<'t>> =
        pieces.iter().map(|piece| read(source, piece, diagnostics)).collect();
    for (piece, document) in pieces.iter().zip(&documents) {
        let Some(field) = &document.include else { continue };
        let names = files(field, piece);
        if names.is_empty() && field.text.trim() != "[]" {
            diagnostics.push(
                Diagnostic::new(field.span.clone(), "`include` takes paths of graph files")
                    .label("write [\"light.ron\"]"),
            );
        }
        for (name, place) in names {
            if !pieces.iter().any(|known| known.role == PieceRole::Include && known.name == name) {
                diagnostics.push(not_joined(root, &name, place));
            }
        }
    }
    let others = pieces
        .iter()
        .zip(&documents)
        .filter(|(piece, _)| matches!(piece.role, PieceRole::Include | PieceRole::Subgraph));
    let others = others.map(|(_, other)| (other.version.clone(), other.scene.clone())).collect();
    let included = |role| pieces.iter().enumerate().filter(move |(_, piece)| piece.role == role);
    let includes: BTreeMap<&str, usize> =
        included(PieceRole::Include).map(|(at, piece)| (piece.name.as_str(), at)).collect();
    let subgraphs: SubgraphFiles<'t> = included(PieceRole::Subgraph)
        .map(|(at, piece)| (piece.name.as_str(), with_includes(at, pieces, &includes, &mut documents)))
        .collect();
    let mut document = with_includes(0, pieces, &includes, &mut documents);
    document.others = others;
    document.whole &= subgraphs.values().all(|subgraph| subgraph.whole);
    let mut overlays = Overlays::default();
    for (piece, other) in pieces.iter().zip(documents) {
        match piece.role {
            PieceRole::Preset => {
                for over in preset(&document, source, piece, diagnostics) {
                    overlays.push(over, diagnostics);
                }
            }
            PieceRole::Overlay | PieceRole::Setting => overlays.push(other, diagnostics),
            PieceRole::Graph | PieceRole::Include | PieceRole::Subgraph => {}
        }
    }
    let folder_at = |offset: usize| folder_of(source.piece(offset));
    let lost = |name: &str, place| not_joined(root, name, place);
    expand(&mut document, &subgraphs, overlays, &folder_at, &lost, diagnostics);
    document
}

/// The diagnostic for a file of the graph that was not read.
fn not_joined(root: &SourceRoot, name: &str, place: Range<usize>) -> Diagnostic {
    let file = root.file(&InputFile(name.to_owned()));
    if root.is_outside(&file) {
        outside(name, place)
    } else if root.is_untrusted(&file.path) {
        Diagnostic::new(place, format!("`{}` belongs to an unpacked bundle", shown(name)))
            .label("an included graph may read every file that this graph may read")
            .hint(
                "if you trust it, remove `.lightharmony-bundle` from its folder; otherwise run it on its own",
            )
    } else {
        let why = match read_text(&file.path, MAX_GRAPH_BYTES) {
            Err(error) => error.to_string(),
            Ok(_) => format!(
                "the graph has more than {MOST_FILES} files, or they are longer than {} MiB in total",
                MOST_BYTES >> 20
            ),
        };
        Diagnostic::of(Code::MissingFile, place, format!("`{}` cannot be read: {why}", shown(name)))
            .hint("paths are relative to the folder of the file that names them")
    }
}

/// The diagnostic for a file that an untrusted graph may not read.
pub(crate) fn outside(name: &str, place: Range<usize>) -> Diagnostic {
    Diagnostic::new(place, format!("`{}` may not be read", shown(name)))
        .label("outside the bundle")
        .hint("a graph from a bundle or a picture may read only files in the bundle and in the folders of `--inputs`")
}

/// Merges a document with the files that it includes, directly or through other files. If the document has no
/// scene, the scene of the first included file that has one is used.
fn with_includes<'t>(
    at: usize,
    pieces: &[Piece],
    includes: &BTreeMap<&str, usize>,
    documents: &mut [Document<'t>],
) -> Document<'t> {
    let mut seen = BTreeSet::from([at]);
    let mut open = vec![at];
    let mut whole = Document::default();
    // In order of discovery, which is the order of the pieces.
    let mut found = Vec::new();
    while let Some(index) = open.pop() {
        let names = documents[index].include.iter().flat_map(|field| files(field, &pieces[index]));
        let above = names.filter_map(|(name, _)| includes.get(name.as_str()).copied());
        open.extend(above.filter(|&above| seen.insert(above)).collect::<Vec<_>>());
        found.push(index);
    }
    found.sort_unstable_by_key(|&index| (index != at, index));
    for index in found {
        if index == at {
            whole = std::mem::take(&mut documents[index]);
            continue;
        }
        let other = documents[index].clone();
        whole.nodes.extend(other.nodes);
        whole.broken.extend(other.broken);
        whole.axes.extend(other.axes);
        whole.parameters.extend(other.parameters);
        whole.presets.extend(other.presets);
        whole.scene = whole.scene.take().or(other.scene);
        whole.whole &= other.whole;
    }
    whole
}

/// Returns the definitions of the chosen preset, one from each file that defines it. The definition in the graph
/// file comes last, so that it overrides the definitions in included files.
fn preset<'t>(
    document: &Document<'t>,
    source: &'t Source,
    piece: &Piece,
    diagnostics: &mut Vec<Diagnostic>,
) -> Vec<Document<'t>> {
    let name = &source.text[piece.span.clone()];
    let of_name = document.presets.iter().rev().filter(|field| field.name == name);
    let laid: Vec<_> =
        of_name.map(|field| parse_preset(&source.text, field.span.clone(), diagnostics)).collect();
    if !laid.is_empty() {
        return laid;
    }
    let known = || document.presets.iter().map(|field| field.name);
    let mistake = Diagnostic::new(piece.span.clone(), format!("the graph has no preset `{}`", shown(name)));
    diagnostics.push(match known().next() {
        None => mistake.suggest(name, PRESETS).hint(format!(
            "the built-in presets are {}; further presets are declared next to `nodes`: `presets: (dark: (trace: (samples: 4)))`",
            PRESETS.join(", ")
        )),
        Some(_) => {
            let list: Vec<&str> = known().collect();
            mistake.suggest(name, known().chain(PRESETS)).hint(format!(
                "the presets of the graph are {}; the built-in presets are {}",
                list.join(", "),
                PRESETS.join(", ")
            ))
        }
    });
    Vec::new()
}

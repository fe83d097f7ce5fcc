//! The origin of a graph: a graph file, a bundle, or a picture with a recipe.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use cache::{Store, TempFolder};
use engine::{Bundle, Recipe, Source, SourceRoot, bundle_around};

use super::error::Error;

/// The text of a graph and the folder of its files.
pub struct Origin {
    pub source: Source,
    pub root: SourceRoot,
    /// Path of the lock file, if the graph comes from a graph file or a bundle.
    pub lock: Option<PathBuf>,
    /// The recipe, if the graph comes from a picture.
    pub recipe: Option<Recipe>,
    /// Temporary folder of an unpacked bundle.
    pub unpacked: Option<TempFolder>,
}

/// True if a file is a bundle or a picture, which do not change after they are written.
pub fn is_written_once(path: &Path) -> bool {
    head(path) == BUNDLE || is_picture(path)
}

/// True if a file is a picture of a format that can contain a recipe.
pub fn is_picture(path: &Path) -> bool {
    scene::io::recipe::is_picture(&head(path))
}

/// The first bytes of a file; empty if it cannot be read.
fn head(path: &Path) -> Vec<u8> {
    let mut head = Vec::new();
    let _ = File::open(path).and_then(|file| file.take(8).read_to_end(&mut head));
    head
}

/// Folders that an untrusted graph may read, and how strictly versions of a recipe are checked.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct OriginArgs {
    /// For a bundle or a picture: a folder whose files the graph may read; may be repeated
    #[arg(long, value_name = "DIR")]
    pub inputs: Vec<PathBuf>,
    /// For a picture: run its recipe even if kinds have other versions here, which may give a different picture
    #[arg(long)]
    pub other_versions: bool,
}

/// First bytes of a bundle.
const BUNDLE: &[u8] = b"LHbundle";

/// Maximum size in bytes of a picture or graph, which is read into memory. Bundles are streamed.
const LARGEST_PICTURE: u64 = 4 << 30;
const LARGEST_GRAPH: u64 = engine::MAX_GRAPH_BYTES;
const MOST_AT_ONCE: u64 = 16 << 20;

impl Origin {
    /// Detects the type of a file and opens it.
    pub fn open(path: &Path, args: &OriginArgs) -> Result<Self, Error> {
        let failed = |error| Error::unreadable("graph", path, &error);
        if path == Path::new("-") {
            let text = graph_text(Vec::new(), std::io::stdin().lock()).map_err(failed)?;
            let folder = std::env::current_dir().map_err(failed)?;
            return Self::own(Source::new("standard input", text), folder, None, args);
        }
        let mut file = File::open(path).map_err(failed)?;
        let mut head = Vec::new();
        file.by_ref().take(8).read_to_end(&mut head).map_err(failed)?;
        if head == BUNDLE {
            return Self::bundle(path, file, args);
        }
        // Allocates the length of the file at once, up to a bound.
        let metadata = file.metadata().map_err(failed)?;
        let mut bytes = Vec::with_capacity(metadata.len().min(MOST_AT_ONCE) as usize + 1);
        bytes.extend(head);
        if scene::io::recipe::is_picture(&bytes) {
            file.take(LARGEST_PICTURE).read_to_end(&mut bytes).map_err(failed)?;
            return Self::picture(path, &bytes, args);
        }
        let text = graph_text(bytes, file).map_err(failed)?;
        if !metadata.is_file() {
            // A pipe has no folder.
            let folder = std::env::current_dir().map_err(failed)?;
            return Self::own(Source::new(path.display().to_string(), text), folder, None, args);
        }
        let folder = path.canonicalize().map_err(failed)?;
        let folder = folder.parent().unwrap_or(Path::new("/")).to_owned();
        Self::own(
            Source::new(path.display().to_string(), text),
            folder,
            Some(path.with_extension("lock")),
            args,
        )
    }

    /// Opens a graph file. The graph file is untrusted if its folder, or a parent of that folder, contains the
    /// marker file of an unpacked bundle.
    fn own(
        mut source: Source,
        folder: PathBuf,
        lock: Option<PathBuf>,
        args: &OriginArgs,
    ) -> Result<Self, Error> {
        let root = if let Some(bundle) = bundle_around(&folder) {
            source = Source::packed(source.name, source.text);
            confined(&bundle, &args.inputs)?.at(folder)
        } else if args.inputs.is_empty() {
            SourceRoot::new(folder)
        } else {
            return Err(Error::usage(
                "`--inputs` is for bundles and pictures; the paths in a graph file are relative to its folder",
            ));
        };
        Ok(Self { source, root, lock, recipe: None, unpacked: None })
    }

    fn bundle(path: &Path, file: File, args: &OriginArgs) -> Result<Self, Error> {
        let named = |error: engine::BundleError| Error::of_file(path, &error);
        let mut bundle = Bundle::open(file).map_err(named)?;
        let place = TempFolder::private()?;
        let folder = place.path().join("bundle");
        bundle.unpack(&folder).map_err(named)?;
        let source = Source::packed(path.display().to_string(), bundle.graph_text().map_err(named)?);
        let root = confined(&folder, &args.inputs)?;
        let lock = Some(folder.join("graph.lock"));
        Ok(Self { source, root, lock, recipe: None, unpacked: Some(place) })
    }

    fn picture(path: &Path, bytes: &[u8], args: &OriginArgs) -> Result<Self, Error> {
        let named = |error: engine::RecipeError| Error::of_file(path, &error);
        let text = scene::io::recipe::recipe(bytes).ok_or(engine::RecipeError::NoRecipe).map_err(named)?;
        let recipe = Recipe::parse(&text).map_err(named)?;
        let registry = nodes::registry();
        let other = recipe.other_kinds(&registry);
        if !other.is_empty() && !args.other_versions {
            return Err(Error::usage(format!(
                "`{}` cannot be reproduced here:\n{}\n`--other-versions` runs it anyway; the picture may differ",
                path.display(),
                other.join("\n")
            )));
        }
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let shown = format!("recipe of {}", path.display());
        // The store of the engine, which remembers digests, is not open yet.
        let store = Store::in_memory();
        let source = recipe.settle(&shown, &file, &registry, &args.inputs, &store).map_err(named)?;
        let place = TempFolder::private()?;
        let root = confined(place.path(), &args.inputs)?;
        Ok(Self { source, root, lock: None, recipe: Some(recipe), unpacked: Some(place) })
    }
}

/// Reads the rest of the text of a graph from `from`, up to the maximum length, and returns the whole text. `bytes`
/// is the part that has already been read.
fn graph_text(mut bytes: Vec<u8>, from: impl Read) -> std::io::Result<String> {
    let wrong = |what: &str| std::io::Error::new(std::io::ErrorKind::InvalidData, what);
    from.take(LARGEST_GRAPH + 1 - bytes.len() as u64).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST_GRAPH {
        return Err(wrong("the text is longer than the maximum of 64 MiB"));
    }
    String::from_utf8(bytes).map_err(|_| wrong("the text is not UTF-8"))
}

fn confined(folder: &Path, inputs: &[PathBuf]) -> Result<SourceRoot, Error> {
    if let Some(missing) = inputs.iter().find(|folder| !folder.is_dir()) {
        return Err(Error::usage(format!(
            "there is no folder `{}`, which `--inputs` names",
            missing.display()
        )));
    }
    Ok(SourceRoot::confined(folder, inputs)?)
}

//! `diff`: the differences between two graphs, bundles, pictures or runs.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use cache::{Store, TempFolder};
use clap::Args;
use engine::{
    Artifact, Bundle, Context, Difference, Engine, FileBytes, Files, InputFile, Kind, NodeDifference, Recipe,
    ResultDifferences, Scene, Up, graph_differences, result_differences,
};
use nodes::kinds::load_image::{self, FileEncoding, LoadImage, Orientation};
use scene::io::exr::{self, Channel, Planes};
use scene::types::{Data, Image, Images, NamedImage};

use crate::session::origin::{OriginArgs, is_picture};
use crate::session::splats;
use crate::session::{EngineArgs, Error, GraphArgs, Loaded};
use crate::terminal;

/// Shows how two graphs differ, in their text and in their results.
///
/// Each side is a graph file, a bundle or a picture that carries its recipe. The results of a graph are looked up
/// in the cache, and the results of a bundle in the bundle. Two pictures are compared by their recipes and their
/// pixels; with `--inputs`, their intermediate results are compared as well. `--set-b` or `--cache-b` compare two
/// runs of one graph.
#[derive(Debug, Args)]
pub struct Diff {
    /// The first graph, bundle or picture
    a: PathBuf,
    /// The second graph, bundle or picture
    b: PathBuf,
    /// Set one field of the second graph: node.field=value
    #[arg(long, value_name = "NODE.FIELD=VALUE")]
    set_b: Vec<String>,
    /// The cache of the second graph, if it is not the cache of the first
    #[arg(long, value_name = "DIR")]
    cache_b: Option<PathBuf>,
    #[command(flatten)]
    origin: OriginArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

/// The pixels of a picture, or the channels of an OpenEXR file that has no colour picture. The error states why the
/// file cannot be read.
fn pixels(path: &Path) -> Result<Arc<Images>, String> {
    // Two pictures are in memory at once.
    splats::check_memory(path, engine::default_memory() / 2).map_err(|error| error.message().to_owned())?;
    let whole = path.canonicalize().map_err(|error| error.to_string())?;
    let file = InputFile(whole.to_str().ok_or("the path is not UTF-8")?.to_owned());
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
    let encoding = FileEncoding::Auto;
    let (more, layer, names) = (Vec::new(), String::new(), vec!["picture".to_owned()]);
    let orientation = Orientation::Upright;
    let load = LoadImage { path: file, more, encoding, orientation, layer, names };
    match LoadImage::run(&load, load_image::In {}, &Context::detached(scene, "/")) {
        Ok((out, _)) => Ok(out.image),
        Err(error) => {
            let layers = std::fs::read(path).ok().and_then(|bytes| layers("picture", &bytes));
            layers.map(Arc::new).ok_or_else(|| error.message().to_owned())
        }
    }
}

/// The channels of an OpenEXR file without a colour picture. Each channel becomes a picture with the encoding
/// `data` and the name of the channel. `None` for files that are not OpenEXR.
fn layers(name: &str, bytes: &[u8]) -> Option<Images> {
    let Planes { width, height, channels, .. } = exr::read(name, bytes).ok()?;
    let view = |Channel { name, samples }| {
        let picture = Image::<Data>::from_samples(width, height, 1, samples).into();
        NamedImage { name, picture }
    };
    Some(Images(channels.into_iter().map(view).collect()))
}

/// The difference between the files of two sinks. Pictures are compared by their pixels. If the pixels are equal
/// but the files are not, the recipes are reported as different.
fn files_difference(a: &Files, b: &Files) -> Difference {
    let views = |files: &Files| files.0.iter().map(|file| file.view.clone()).collect::<Vec<_>>();
    if views(a) != views(b) {
        return a.difference(b);
    }
    let shown = |file: &FileBytes| match scene::io::picture::of_bytes(&file.view, &file.bytes) {
        Ok(picture) => Some(Images::single(file.view.clone(), picture)),
        Err(_) => layers(&file.view, &file.bytes),
    };
    let mut only_recipes = 0;
    for (a, b) in a.0.iter().zip(&b.0).filter(|(a, b)| a.bytes != b.bytes) {
        let Some((a, b)) = shown(a).zip(shown(b)) else {
            let (a, b) = (a.bytes.len(), b.bytes.len());
            return Difference::of(format!("different content (lengths in bytes: {a} and {b})"));
        };
        let difference = a.difference(&b);
        if !difference.equal {
            return difference;
        }
        only_recipes += 1;
    }
    match only_recipes {
        0 => Difference::none(),
        1 => Difference::of("the pixels are equal, but the recipes in the files differ"),
        n => {
            Difference::of(format!("{n} pictures have the same pixels on both sides, but different recipes"))
        }
    }
}

/// The recipe of a picture; `None` for other files and for a picture without a recipe.
fn recipe(path: &Path) -> Result<Option<Recipe>, Error> {
    if !is_picture(path) {
        return Ok(None);
    }
    let bytes = std::fs::read(path).map_err(|error| Error::unreadable("picture", path, &error))?;
    let text = scene::io::recipe::recipe(&bytes);
    let named = |error: engine::RecipeError| Error::of_file(path, &error);
    text.map(|text| Recipe::parse(&text)).transpose().map_err(named)
}

/// Collects lines of text about nodes. If there are more than [`Self::MOST`] lines about the instances of one node,
/// the further lines are only counted.
#[derive(Default)]
struct Lines {
    text: String,
    /// Name of the node to which the most recent lines refer.
    node: String,
    count: usize,
}

impl Lines {
    const MOST: usize = 8;

    fn add(&mut self, id: &str, line: String) {
        let node = id.split('/').next().unwrap_or(id);
        if node != self.node || !id.contains('/') {
            self.end();
            (self.node, self.count) = (node.to_owned(), 0);
        }
        self.count += 1;
        if self.count <= Self::MOST {
            self.text.push_str(&line);
            self.text.push('\n');
        }
    }

    fn end(&mut self) {
        if let Some(more @ 1..) = self.count.checked_sub(Self::MOST) {
            self.text.push_str(&format!("      .. further lines about `{}`: {more}\n", self.node));
        }
    }

    fn finish(mut self) -> String {
        self.end();
        self.text
    }
}

/// Shortens a value or a list of names to fit a line.
fn cut(text: &str) -> String {
    const LONGEST: usize = 160;
    match text.char_indices().nth(LONGEST) {
        None => text.to_owned(),
        Some((end, _)) => format!("{}..", &text[..end]),
    }
}

struct Side {
    loaded: Loaded,
    engine: Engine,
    /// Temporary folder of the store that contains the results of a bundle.
    _place: Option<TempFolder>,
}

impl Diff {
    /// Prints the differences. Returns exit code 1 if there are any.
    pub fn run(self) -> Result<u8, Error> {
        let pictures = is_picture(&self.a) && is_picture(&self.b);
        let (a, b) = (recipe(&self.a)?, recipe(&self.b)?);
        let bare: Vec<&Path> = [(&self.a, &a), (&self.b, &b)]
            .into_iter()
            .filter(|(_, recipe)| pictures && recipe.is_none())
            .map(|(path, _)| path.as_path())
            .collect();
        let recipes = a.zip(b);
        // Recipes and pixels are in the pictures; the input files are needed only for intermediate results.
        let sides = if pictures && (self.origin.inputs.is_empty() || !bare.is_empty()) {
            None
        } else {
            let a = self.side(&self.a, &[], None)?;
            Some((a, self.side(&self.b, &self.set_b, self.cache_b.as_deref())?))
        };
        let said = match (&recipes, &sides) {
            (Some((a, b)), _) => {
                // A recipe that cannot be compared with itself is the invalid one.
                let at_fault = || if a.differences(a).is_err() { &self.a } else { &self.b };
                a.differences(b).map_err(|error| Error::of_file(at_fault(), &error))?
            }
            (None, Some((a, b))) => graph_differences(&a.loaded.graph, &b.loaded.graph),
            (None, None) => Vec::new(),
        };
        let mut lines = Lines::default();
        for (id, difference) in &said {
            match difference {
                NodeDifference::Gone => lines.add(id, format!("- {id}")),
                NodeDifference::New => lines.add(id, format!("+ {id}")),
                NodeDifference::Changed(changes) => {
                    for change in changes {
                        let value = |value: &Option<String>| {
                            value.as_deref().map_or_else(|| "nothing".to_owned(), cut)
                        };
                        let (old, new) = (value(&change.old), value(&change.new));
                        lines.add(id, format!("~ {id}.{} {old} -> {new}", change.path));
                    }
                }
            }
        }
        let mut text = lines.finish();
        for path in &bare {
            text.push_str(&format!("`{}` contains no recipe\n", path.display()));
        }
        if said.is_empty() && bare.is_empty() {
            text.push_str("the graphs are equal\n");
        }
        let mut equal = said.is_empty();
        match (pixels(&self.a), pixels(&self.b)) {
            (Ok(a), Ok(b)) => {
                let shown = a.difference(&b);
                equal &= shown.equal;
                text.push_str(&format!("pictures: {}\n", shown.summary));
            }
            (a, b) if pictures => {
                equal = false;
                for (path, why) in [(&self.a, a.err()), (&self.b, b.err())] {
                    if let Some(why) = why {
                        text.push_str(&format!("the picture `{}` cannot be read ({why})\n", path.display()));
                    }
                }
            }
            _ => {}
        }
        if let Some((a, b)) = &sides {
            let came = result_differences(
                (&a.engine, &a.loaded.graph),
                (&b.engine, &b.loaded.graph),
                files_difference,
            );
            equal &= came.unequal.is_empty();
            text.push_str(&self.differences(&came));
        }
        terminal::print(&text)?;
        Ok(u8::from(!equal))
    }

    /// Describes the results that differ, and the nodes without a known result.
    fn differences(&self, came: &ResultDifferences) -> String {
        let mut lines = Lines::default();
        for node in &came.unequal {
            let word = if node.first { "first" } else { "then" };
            for (output, difference) in &node.outputs {
                let how = difference.as_ref().map_or(
                    "different content (at least one of the values is no longer in the cache)",
                    |d| &d.summary,
                );
                lines.add(&node.id, format!("{word:<5} {}.{output}: {how}", node.id));
            }
        }
        let mut text = lines.finish();
        text.push_str(&match (came.compared, came.unequal.len()) {
            (0, _) => "no node has a known result on both sides; run both graphs first\n".to_owned(),
            (n, 0) => format!("results compared: {n}, all equal\n"),
            (n, unequal) => format!("results compared: {n}, different: {unequal}\n"),
        });
        for (unknown, side) in came.unknown.iter().zip(["first", "second"]) {
            if !unknown.is_empty() && came.compared > 0 {
                let names = cut(&unknown.join(", "));
                text.push_str(&format!(
                    "no result is known for these nodes of the {side} graph: {names}; run this graph first\n"
                ));
            }
        }
        text
    }

    fn side(&self, path: &Path, set: &[String], cache: Option<&Path>) -> Result<Side, Error> {
        let graph = GraphArgs {
            graph: path.to_owned(),
            set: set.to_vec(),
            exhaustive: false,
            preset: Vec::new(),
            overlay: Vec::new(),
            only: Vec::new(),
            frames: None,
            inputs: self.origin.inputs.clone(),
            other_versions: self.origin.other_versions,
        };
        let loaded = graph.load()?;
        let bundle = File::open(path).ok().and_then(|file| Bundle::open(file).ok());
        let Some(mut bundle) = bundle else {
            let cache = cache.map(Path::to_owned).or(self.engine.cache.clone());
            let engine = EngineArgs { cache, ..self.engine.clone() }.open()?;
            return Ok(Side { loaded, engine, _place: None });
        };
        // Results of an untrusted bundle stay out of the cache.
        let place = TempFolder::private()?;
        let store = Store::open(place.path(), cache::Options::default())?;
        bundle.fill(&store).map_err(|error| Error::of_file(path, &error))?;
        let engine = Engine::new(store, self.engine.jobs(), self.engine.memory()?);
        Ok(Side { loaded, engine, _place: Some(place) })
    }
}

//! `diff`: how two graphs, bundles, pictures or runs differ.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use cache::Store;
use clap::Args;
use engine::{
    Artifact, Bundle, Context, Engine, InputFile, Kind, NodeDifference, Scene, Up, graph_differences,
    result_differences,
};
use nodes::load_image::{self, FileEncoding, LoadImage};
use nodes::types::Images;

use crate::origin::{OriginArgs, TempFolder};
use crate::session::{EngineArgs, Error, GraphArgs, Loaded};

/// Tells how two graphs differ, in what they say and in what came of them.
///
/// Each side is a graph file, a bundle or a picture that carries its recipe. What came of a graph is looked up
/// in the cache, what came of a bundle in the bundle. Two runs of one graph are told apart by `--set-b` or by
/// `--cache-b`.
#[derive(Debug, Args)]
pub struct Diff {
    /// The first
    a: PathBuf,
    /// The second
    b: PathBuf,
    /// Sets one field of the second: node.field=value
    #[arg(long, value_name = "NODE.FIELD=VALUE")]
    set_b: Vec<String>,
    /// The cache of the second, if it ran elsewhere
    #[arg(long, value_name = "DIR")]
    cache_b: Option<PathBuf>,
    #[command(flatten)]
    origin: OriginArgs,
    #[command(flatten)]
    engine: EngineArgs,
}

/// What a picture shows, where the path names one.
fn pixels(path: &Path) -> Option<Arc<Images>> {
    let file = InputFile(path.canonicalize().ok()?.to_str()?.to_owned());
    let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0 };
    let encoding = FileEncoding::Auto;
    let (more, layer, names) = (Vec::new(), String::new(), vec!["picture".to_owned()]);
    let load = LoadImage { path: file, more, encoding, layer, names };
    let (out, _) = LoadImage::run(&load, load_image::In {}, &Context::detached(scene, "/")).ok()?;
    Some(out.image)
}

struct Side {
    loaded: Loaded,
    engine: Engine,
    /// Where what a bundle tells is kept meanwhile.
    _place: Option<TempFolder>,
}

impl Diff {
    /// Prints what differs; exit code 1 where anything does.
    pub fn run(self) -> Result<u8, Error> {
        let a = self.side(&self.a, &[], None)?;
        let b = self.side(&self.b, &self.set_b, self.cache_b.as_deref())?;
        let mut text = String::new();
        let said = graph_differences(&a.loaded.graph, &b.loaded.graph);
        for (id, difference) in &said {
            match difference {
                NodeDifference::Gone => text.push_str(&format!("- {id}\n")),
                NodeDifference::New => text.push_str(&format!("+ {id}\n")),
                NodeDifference::Changed(changes) => {
                    for change in changes {
                        let value =
                            |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
                        let (old, new) = (value(&change.old), value(&change.new));
                        text.push_str(&format!("~ {id}.{} {old} -> {new}\n", change.path));
                    }
                }
            }
        }
        if said.is_empty() {
            text.push_str("the graphs say the same\n");
        }
        if let Some((a, b)) = pixels(&self.a).zip(pixels(&self.b)) {
            text.push_str(&format!("pictures: {}\n", a.difference(&b).summary));
        }
        let came = result_differences((&a.engine, &a.loaded.graph), (&b.engine, &b.loaded.graph));
        for node in &came.unequal {
            let word = if node.first { "first" } else { "then" };
            for (output, difference) in &node.outputs {
                let how =
                    difference.as_ref().map_or("other content (not kept on both sides)", |d| &d.summary);
                text.push_str(&format!("{word:<5} {}.{output}: {how}\n", node.id));
            }
        }
        let (unequal, compared) = (came.unequal.len(), came.compared);
        text.push_str(&match (compared, unequal) {
            (0, _) => "no node has a known result on both sides; run both first\n".to_owned(),
            (n, 0) => format!("{n} results compared, all equal\n"),
            (n, unequal) => format!("{n} results compared, {unequal} differ\n"),
        });
        super::print(&text)?;
        Ok(u8::from(!said.is_empty() || unequal > 0))
    }

    fn side(&self, path: &Path, set: &[String], cache: Option<&Path>) -> Result<Side, Error> {
        let graph = GraphArgs {
            graph: path.to_owned(),
            set: set.to_vec(),
            preset: Vec::new(),
            overlay: Vec::new(),
            only: Vec::new(),
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
        // What a stranger's bundle claims stays out of the cache.
        let place = TempFolder::create()?;
        let store = Store::open(&place.0, cache::Options::default())?;
        bundle.fill(&store).map_err(|source| Error::Bundle { path: path.to_owned(), source })?;
        let engine = Engine::new(store, self.engine.jobs(), self.engine.memory()?);
        Ok(Side { loaded, engine, _place: Some(place) })
    }
}

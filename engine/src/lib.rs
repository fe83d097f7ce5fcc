//! Declarative dataflow: graph files, typed ports, content keys, a caching scheduler.
//!
//! The engine handles graphs, ports, keys and scheduling, and knows nothing about images. Other crates define the
//! kinds of nodes: they implement [`Kind`] for each kind and provide a [`Registry`]. The nodes *upstream* of a node
//! are the nodes that it depends on, directly or through others; the nodes *downstream* of it depend on it.
//!
//! - A graph file is RON text. [`Graph::parse`] parses and checks it against the registry and reports all mistakes
//!   together as [`Diagnostics`], with their positions in the text, and hints. [`apply`] adds settings (`--set
//!   node.field=value`).
//! - [`Engine::run`] computes the targets of a graph. Each node has a [key](crate#keys). A node whose key is in the
//!   store does not run again; the others run on several threads within a memory budget. Progress is reported as
//!   [`Event`]s. [`Engine::plan`] shows what a run would do, and why.
//! - Values are [`Artifact`]s. Their encoded bytes are stored, compared and digested.
//!
//! ```
//! use std::sync::Arc;
//! use engine::{Artifact, Context, Corrupt, Decoder, Difference, Encoder, Engine, Graph, Kind, KindEntry};
//! use engine::{NodeError, Notes, Registry, RunOptions, Source, SourceRoot, Store};
//!
//! // A type that ports can carry.
//! struct Num(f64);
//! impl Artifact for Num {
//!     const TYPE: &'static str = "number";
//!     const FORMAT: u32 = 1;
//!     fn encode(&self, to: &mut Encoder) { to.f64(self.0) }
//!     fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> { from.f64().map(Num) }
//!     fn bytes(&self) -> usize { 8 }
//!     fn difference(&self, other: &Self) -> Difference {
//!         if self.0 == other.0 { Difference::none() } else { Difference::of("another number") }
//!     }
//! }
//!
//! // A kind: parameters, ports, code.
//! engine::params! {
//!     /// Adds numbers.
//!     pub struct Add {
//!         /// Added to the sum.
//!         bias: f64 = 0.0, range(-1e6, 1e6), other("1.0");
//!     }
//! }
//! engine::inputs! { pub struct In { /** The terms. */ terms: Vec<Arc<Num>>, } }
//! engine::outputs! { pub struct Out { /** The sum. */ sum: Arc<Num>, } }
//! impl Kind for Add {
//!     const NAME: &'static str = "add";
//!     const VERSION: u32 = 1;
//!     type Params = Self;
//!     type In = In;
//!     type Out = Out;
//!     fn run(params: &Self, inputs: In, _cx: &Context) -> Result<(Out, Notes), NodeError> {
//!         let sum = inputs.terms.iter().map(|term| term.0).sum::<f64>() + params.bias;
//!         Ok((Out { sum: Arc::new(Num(sum)) }, Notes::none()))
//!     }
//! }
//!
//! let registry = Registry::new(vec![KindEntry::of::<Add>()]);
//! let text = r#"Graph(version: 1, scene: (up: "+z"), nodes: (
//!     one: Add(terms: [], bias: 1.0),
//!     three: Add(terms: ["one", "one.sum"], bias: 1.0),
//! ))"#;
//! let graph = Graph::parse(Source::new("sums.ron", text), &registry, SourceRoot::new("."))?;
//! let engine = Engine::new(Store::in_memory(), 2, 1 << 30);
//! let cold = engine.run(&graph, &RunOptions::default(), |_event| {});
//! assert_eq!((cold.totals.ran, cold.totals.cached), (2, 0));
//! let warm = engine.run(&graph, &RunOptions::default(), |_event| {});
//! assert_eq!((warm.totals.ran, warm.totals.cached), (0, 2));
//!
//! let wrong = Graph::parse(Source::new("sums.ron", text.replace("bias", "bais")), &registry, SourceRoot::new("."));
//! assert!(wrong.is_err_and(|mistakes| mistakes.render(false).contains("did you mean `bias`?")));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Keys
//! The key of a node is a digest of its kind and version, all parameters including defaults, the content of its
//! inputs and of the files it reads, its numeric profile, and the context fields that the kind declares. Names,
//! layout, folders, times and threads are not part of it. Since inputs enter by content, the nodes downstream of a
//! node with an unchanged result do not run again. A key is written together with its [`Manifest`], the readable
//! form that explanations compare.
//!
//! # Guarantees
//! - Results do not depend on the number of threads, the order in which nodes run, or the content of the cache.
//! - A node that fails affects only the nodes that depend on it. A panic in its code is a failure of the node.
//! - Damage to the cache costs only time, and is reported by one warning. If a run is cancelled or killed, its
//!   finished results are kept.
//! - No code recurses over the graph: a chain may be as long as memory allows.
//!
//! # Modules
//! The folders of `src` are layers: `value`, `text`, `kind`, `graph`, `record`, `remote`, `run`, `plan`, `watch`, `share`. A
//! module uses only its own layer and the layers before it.

#![allow(
    clippy::module_inception,
    reason = "the main type of a module is in a file with the name of the module"
)]

extern crate self as engine;

mod graph;
mod kind;
mod plan;
mod record;
mod remote;
mod run;
mod share;
mod text;
mod value;
mod watch;

pub use cache::{Change, Digest, DigestWriter, Error as CacheError, Manifest, Store, TempFolder};
pub use graph::columns::{ColumnEntry, Columns};
pub use graph::graph::Graph;
pub use graph::knobs::GraphKnob;
pub use graph::node::{Node, Wire};
pub use graph::reads::ReadFiles;
pub use kind::context::{Context, ContextField};
pub use kind::contract::{Cost, Former, Keep, Kind, Preview, Sizes, ViewCount};
pub use kind::fields::Fields;
pub use kind::knob::{Knob, KnobKind};
pub use kind::param_type::{NotCanonical, OutputFile, ParamType, ParamValue, Role, canonical};
pub use kind::params::{ParamSpec, Params};
pub use kind::part::Part;
pub use kind::port::{Arity, InPort, Inputs, Outputs, PortSpec, Wired};
pub use kind::registry::{KindEntry, Registry};
pub use kind::scene::{Point, Scene, Up};
pub use plan::diff::{
    NodeDifference, ResultDifference, ResultDifferences, graph_differences, result_differences,
};
pub use plan::last_values::StoredOutput;
pub use plan::lock::{Lock, LockDifferences, LockError};
pub use plan::plan::{Fate, Past, Planned, Why};
pub use record::record::{Spent, blobs_of};
pub use remote::entry::Entry;
pub use remote::error::ActionError;
pub use remote::placement::Placement;
pub use remote::shared::SharedResults;
pub use remote::workers::{Stage, Work, WorkContent, WorkFile, WorkRequest, WorkerTerms, Workers};
pub use run::action::ActionDone;
pub use run::engine::Engine;
pub use run::event::{Event, Forecast, State, Totals};
pub use run::options::{Outcome, RunOptions};
pub use run::unchanged::run_unchanged;
pub use run::value_cache::default_memory;
pub use serde;
pub use share::bundle::container::{Bundle, BundleError};
pub use share::bundle::pack::{Packed, Results};
pub use share::bundle::verify::{Verdict, Verified, VerifyOptions, verify};
pub use share::canary::Canary;
pub use share::recipe_error::RecipeError;
pub use share::rerun::Recipe;
pub use text::diag::{Code, Diagnostic, Diagnostics, Mistake, nearest};
pub use text::edit::{EditError, Setting, apply};
pub use text::graph_text::{GraphText, Step, TextEdit, TextEditError};
pub use text::overlay::{PRESETS, overlay_text};
pub use text::source::Source;
pub use value::artifact::{AnyArtifact, Artifact, ArtifactType, Difference, decode_all, encode_to_vec};
pub use value::codec::{Corrupt, Decoder, Encoder};
pub use value::counts::Counts;
pub use value::error::NodeError;
pub use value::files::{FileBytes, Files};
pub use value::note::{Level, Note, Notes};
pub use value::root::{FileHead, InputFile, SourceFile, SourceRoot, bundle_around};
pub use value::text_file::{MAX_GRAPH_BYTES, open_regular, read_at_most, read_text};
pub use value::units::{bytes_text, parse_bytes};
pub use watch::handle::Handle;
pub use watch::options::Load;
pub use watch::options::Refusal;
pub use watch::options::WatchOptions;
pub use watch::watch::Watch;

//! Tests of every kind of node in a table, every parameter and every output.
//!
//! The tests use a *fixture*: a graph with at least one small node of each kind. They contain no list of names, so a
//! new kind is tested as soon as the fixture has a node of this kind. Each method of [`Table`] is one test. It returns
//! the problems that it found, one line each:
//!
//! ```
//! use std::sync::Arc;
//! use engine::{Context, Kind, KindEntry, NodeError, Notes, Registry};
//! use kind_tests::Table;
//! # struct Number(f64);
//! # impl engine::Artifact for Number {
//! #     const TYPE: &'static str = "number";
//! #     const FORMAT: u32 = 1;
//! #     fn encode(&self, to: &mut engine::Encoder) { to.f64(self.0) }
//! #     fn decode(from: &mut engine::Decoder<'_>) -> Result<Self, engine::Corrupt> { from.f64().map(Number) }
//! #     fn bytes(&self) -> usize { 8 }
//! #     fn difference(&self, _: &Self) -> engine::Difference { engine::Difference::of("another number") }
//! # }
//!
//! engine::params! {
//!     /// Returns a number that the graph states.
//!     pub struct Constant {
//!         /// The number.
//!         value: f64 = 0.0, range(-10.0, 10.0), other("3.0");
//!     }
//! }
//! engine::inputs! { pub struct In {} }
//! engine::outputs! { pub struct Out { /** The number. */ number: Arc<Number>, } }
//! impl Kind for Constant {
//!     const NAME: &'static str = "constant";
//!     const VERSION: u32 = 1;
//!     type Params = Self;
//!     type In = In;
//!     type Out = Out;
//!     fn run(params: &Self, _: In, _: &Context) -> Result<(Out, Notes), NodeError> {
//!         Ok((Out { number: Arc::new(Number(params.value)) }, Notes::none()))
//!     }
//! }
//!
//! let registry = Registry::new(vec![KindEntry::of::<Constant>()]);
//! let fixture = r#"Graph(version: 1, scene: (up: "+z"), nodes: (one: Constant(value: 2.0)))"#;
//! let folder = tempfile::tempdir()?;
//! let table = Table::new(registry, fixture, folder.path());
//! assert_eq!(table.problems(), [""; 0]);
//! # Ok::<(), std::io::Error>(())
//! ```

mod golden;
mod table;

pub use table::Table;

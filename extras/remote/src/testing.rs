//! A small graph for tests that share results.

use std::sync::Arc;

use engine::{
    Artifact, Context, Corrupt, Decoder, Difference, Encoder, Engine, Entry, Event, FileBytes, Files, Graph,
    Kind, KindEntry, NodeError, Notes, OutputFile, Registry, RunOptions, Source, SourceRoot, Store,
};

/// A list of numbers.
pub struct Numbers(pub Vec<u32>);

impl Artifact for Numbers {
    const TYPE: &'static str = "numbers";
    const FORMAT: u32 = 1;
    fn encode(&self, to: &mut Encoder) {
        to.u32s(&self.0);
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        from.u32s().map(Numbers)
    }
    fn bytes(&self) -> usize {
        4 * self.0.len()
    }
    fn difference(&self, other: &Self) -> Difference {
        if self.0 == other.0 { Difference::none() } else { Difference::of("other numbers") }
    }
}

engine::params! {
    /// Outputs the numbers from 0 to `to`.
    pub struct Count {
        /// How many numbers to output.
        to: u32 = 4, range(0, 1e8), other("5");
    }
}
engine::inputs! { /** Nothing. */ pub struct In {} }
engine::outputs! { /** Numbers. */ pub struct Out { /** The numbers. */ numbers: Arc<Numbers>, /** The last of them. */ last: Arc<Numbers>, } }

impl Kind for Count {
    const NAME: &'static str = "count";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;
    fn run(params: &Self, _inputs: In, _cx: &Context) -> Result<(Out, Notes), NodeError> {
        let last = params.to.checked_sub(1).into_iter().collect();
        Ok((
            Out { numbers: Arc::new(Numbers((0..params.to).collect())), last: Arc::new(Numbers(last)) },
            Notes::none(),
        ))
    }
}

engine::params! {
    /// Doubles numbers.
    pub struct Double {}
}
engine::inputs! { /** Numbers. */ pub struct One { /** The numbers. */ of: Arc<Numbers>, } }
engine::outputs! { /** Numbers. */ pub struct Doubled { /** The numbers. */ numbers: Arc<Numbers>, } }

impl Kind for Double {
    const NAME: &'static str = "double";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = Doubled;
    fn run(_params: &Self, inputs: One, _cx: &Context) -> Result<(Doubled, Notes), NodeError> {
        Ok(multiplied(&inputs, 2))
    }
}

/// The result of [`Double`], with any factor.
fn multiplied(inputs: &One, by: u32) -> (Doubled, Notes) {
    let numbers = inputs.of.0.iter().map(|number| number * by).collect();
    let mut notes = Notes::none();
    notes.warning("doubled", "twice as large");
    (Doubled { numbers: Arc::new(Numbers(numbers)) }, notes)
}

engine::params! {
    /// Writes numbers as text.
    pub struct WriteNumbers {
        /// The file.
        path: OutputFile, other("\"b.txt\"");
    }
}
engine::outputs! { /** Files. */ pub struct Written { /** The file. */ file: Arc<Files>, } }

impl Kind for WriteNumbers {
    const NAME: &'static str = "write-numbers";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = Written;
    fn run(_params: &Self, inputs: One, _cx: &Context) -> Result<(Written, Notes), NodeError> {
        let text: String = inputs.of.0.iter().map(|number| format!("{number}\n")).collect();
        let file = FileBytes { view: String::new(), bytes: text.into_bytes() };
        Ok((Written { file: Arc::new(Files(vec![file])) }, Notes::none()))
    }
}

engine::params! {
    /// Outputs wrong numbers under the name of [`Double`].
    pub struct Triple {}
}

impl Kind for Triple {
    const NAME: &'static str = "double";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = Doubled;
    fn run(_params: &Self, inputs: One, _cx: &Context) -> Result<(Doubled, Notes), NodeError> {
        Ok(multiplied(&inputs, 3))
    }
}

engine::params! {
    /// Outputs too many numbers under the name of [`Count`].
    pub struct Miscount {
        /// How many numbers to output.
        to: u32 = 4, range(0, 1e8), other("5");
    }
}

impl Kind for Miscount {
    const NAME: &'static str = "count";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;
    fn run(params: &Self, _inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Count::run(&Count { to: params.to + 1 }, In {}, cx)
    }
}

/// The table of kinds of a worker that computes wrong values.
pub fn lying_registry() -> Registry {
    Registry::new(vec![
        KindEntry::of::<Miscount>(),
        KindEntry::of::<Triple>(),
        KindEntry::of::<WriteNumbers>(),
    ])
}

/// The table of kinds.
pub fn registry() -> Registry {
    Registry::new(vec![KindEntry::of::<Count>(), KindEntry::of::<Double>(), KindEntry::of::<WriteNumbers>()])
}

/// An engine that has computed `Count(to)`, and the entry of the result.
pub fn counted(to: u32) -> (Engine, Entry) {
    let text = format!("Graph(version: 1, scene: (up: \"+z\"), nodes: (\n n: Count(to: {to}),\n))");
    let graph = Graph::parse(Source::new("graph.ron", text), &registry(), SourceRoot::new("."))
        .unwrap_or_else(|error| panic!("{error}"));
    let engine = Engine::new(Store::in_memory(), 1, 1 << 30);
    let mut key = None;
    engine.run(&graph, &RunOptions::default(), |event| {
        if let Event::Node { key: Some(found), .. } = event {
            key = Some(found);
        }
    });
    let entry = Entry::stored(engine.store(), &key.expect("the node ran")).expect("the result is stored");
    (engine, entry)
}

/// The entry of `Count(to)`.
pub fn entry(to: u32) -> Entry {
    counted(to).1
}

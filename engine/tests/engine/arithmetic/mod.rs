//! Small arithmetic kinds whose results are easy to check. The tests of the engine run these kinds and do not
//! render.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use engine::{
    Artifact, Context, ContextField, Corrupt, Cost, Decoder, Difference, Encoder, FileBytes, Files,
    InputFile, Keep, Kind, KindEntry, NodeError, Notes, OutputFile, Part, Registry, Sizes, SourceFile,
    SourceRoot, ViewCount,
};

/// The table of all kinds of this module.
pub fn registry() -> Registry {
    Registry::new(entries())
}

/// The table of all kinds in this file, with `entry` in place of the kind of the same name.
pub fn registry_with(entry: KindEntry) -> Registry {
    let others = entries().into_iter().filter(|other| other.name != entry.name);
    Registry::new(others.collect()).with(entry)
}

/// The table of all kinds in this file, except that `scale` returns a different result under the same name and
/// version.
pub fn registry_of_a_cheat() -> Registry {
    registry_with(KindEntry::of::<Cheat>())
}

/// A `scale` that returns a different result; see [`registry_of_a_cheat`].
pub struct Cheat;
impl Kind for Cheat {
    const NAME: &'static str = "scale";
    const VERSION: u32 = 1;
    const INSTANT: bool = true;
    type Params = Scale;
    type In = One;
    type Out = Gives;
    fn run(params: &Scale, inputs: One, _cx: &Context) -> Ran {
        give(inputs.value.0 * params.by + 0.5)
    }
}

/// The table of all kinds in this file, except that `add` returns a different result under the same name and version.
pub fn registry_of_a_liar() -> Registry {
    registry_with(KindEntry::of::<Lie>())
}

/// An `add` that returns a different result; see [`registry_of_a_liar`].
pub struct Lie;
impl Kind for Lie {
    const NAME: &'static str = "add";
    const VERSION: u32 = 1;
    type Params = Add;
    type In = Terms;
    type Out = Gives;
    fn run(params: &Add, inputs: Terms, _cx: &Context) -> Ran {
        give(inputs.terms.iter().map(|term| term.0).sum::<f64>() + params.bias + 0.5)
    }
}

fn entries() -> Vec<KindEntry> {
    vec![
        KindEntry::of::<LoadNumber>(),
        KindEntry::of::<LoadDigits>(),
        KindEntry::of::<Number>(),
        KindEntry::of::<Add>(),
        KindEntry::of::<Scale>(),
        KindEntry::of::<Round>(),
        KindEntry::of::<Split>(),
        KindEntry::of::<Seeded>(),
        KindEntry::of::<UpAxis>(),
        KindEntry::of::<Series>(),
        KindEntry::of::<Ramp>(),
        KindEntry::of::<Prepared>(),
        KindEntry::of::<Sum>(),
        KindEntry::of::<Refuse>(),
        KindEntry::of::<Remark>(),
        KindEntry::of::<Slow>(),
        KindEntry::of::<Tiled>(),
        KindEntry::of::<Heavy>(),
        KindEntry::of::<Panic>(),
        KindEntry::of::<Drift>(),
        KindEntry::of::<WriteNumber>(),
        KindEntry::of::<WriteRecipe>(),
    ]
}

/// A number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Num(pub f64);

impl Artifact for Num {
    const TYPE: &'static str = "number";
    const FORMAT: u32 = 1;
    fn encode(&self, to: &mut Encoder) {
        to.f64(self.0);
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        Ok(Self(from.f64()?))
    }
    fn bytes(&self) -> usize {
        8
    }
    fn difference(&self, other: &Self) -> Difference {
        if self == other {
            Difference::none()
        } else {
            Difference::of(format!("{} apart", (self.0 - other.0).abs()))
        }
    }
}

/// A list of numbers. A long list is stored as a separate file in the cache.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers(pub Vec<f64>);

impl Artifact for Numbers {
    const TYPE: &'static str = "numbers";
    const FORMAT: u32 = 1;
    fn encode(&self, to: &mut Encoder) {
        to.f64s(&self.0);
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> {
        Ok(Self(from.f64s()?))
    }
    fn bytes(&self) -> usize {
        self.0.len() * 8
    }
    fn difference(&self, other: &Self) -> Difference {
        if self == other { Difference::none() } else { Difference::of("unequal") }
    }
}

engine::inputs! { /** Nothing. */ pub struct Nothing {} }
engine::inputs! { /** One number. */ pub struct One { /** The number. */ value: Arc<Num>, } }
engine::inputs! { /** Any number of numbers. */ pub struct Terms { /** The numbers. */ terms: Vec<Arc<Num>>, } }
engine::outputs! { /** One number. */ pub struct Gives { /** The result. */ number: Arc<Num>, } }

type Ran<T = Gives> = Result<(T, Notes), NodeError>;

fn give(value: f64) -> Ran {
    Ok((Gives { number: Arc::new(Num(value)) }, Notes::none()))
}

/// Declares a kind that outputs one number.
macro_rules! simple {
    ($name:ident = $kebab:literal, $in:ty, |$params:ident, $inputs:ident, $cx:ident| $run:expr $(, $item:item)*) => {
        impl Kind for $name {
            const NAME: &'static str = $kebab;
            const VERSION: u32 = 1;
            type Params = Self;
            type In = $in;
            type Out = Gives;
            $($item)*
            fn run($params: &Self, $inputs: $in, $cx: &Context) -> Ran { $run }
        }
    };
}

mod conduct;

pub use conduct::*;

engine::params! {
    /// Reads a number from a text file.
    pub struct LoadNumber {
        /// The file.
        path: InputFile, other("\"b.txt\"");
    }
}
simple!(
    LoadNumber = "load-number",
    Nothing,
    |params, _inputs, cx| {
        let bytes = cx.read(&params.path)?;
        let text = String::from_utf8_lossy(&bytes);
        let parsed = text.trim().parse();
        give(parsed.map_err(|_| NodeError::new(format!("`{}` is not a number", text.trim())).at("path"))?)
    },
    const STORE: Keep = Keep::Cheap;,
    const SUPPLIED: Option<&'static str> = Some("ask whoever counted");,
    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(vec![root.file(&params.path)])
    }
);

engine::params! {
    /// Reads digits from several files, one after the other. A folder stands for the `.txt` files in it.
    pub struct LoadDigits {
        /// A file or folder.
        path: InputFile, other("\"b.txt\"");
        /// More files or folders.
        more: Vec<InputFile> = Vec::new(), other("[\"b.txt\"]");
    }
}
impl LoadDigits {
    fn files(&self, at: impl Fn(&InputFile) -> std::path::PathBuf) -> Vec<InputFile> {
        let inside = |named: &InputFile| match std::fs::read_dir(at(named)) {
            Err(_) => vec![named.clone()],
            Ok(entries) => {
                let names = entries.flatten().filter_map(|entry| entry.file_name().into_string().ok());
                let mut names: Vec<_> = names.filter(|name| name.ends_with(".txt")).collect();
                names.sort();
                names
                    .iter()
                    .map(|name| InputFile(format!("{}/{name}", named.0.trim_end_matches('/'))))
                    .collect()
            }
        };
        std::iter::once(&self.path).chain(&self.more).flat_map(inside).collect()
    }
}
simple!(
    LoadDigits = "load-digits",
    Nothing,
    |params, _inputs, cx| {
        let mut digits = 0.0;
        for file in params.files(|file| cx.source(file).path) {
            digits = 10.0 * digits + f64::from(cx.read(&file)?[0] - b'0');
        }
        give(digits)
    },
    const STORE: Keep = Keep::Cheap;,
    const FOLDERS: bool = true;,
    fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(params.files(|file| root.file(file).path).iter().map(|file| root.file(file)).collect())
    },
    fn views(params: &Self, root: &SourceRoot) -> ViewCount {
        let files = params.files(|file| root.file(file).path);
        let path = |file: &InputFile| root.file(file).path;
        match files.iter().find(|file| std::fs::read(path(file)).is_ok_and(|text| text == b"no digit")) {
            Some(file) => ViewCount::Uncounted {
                why: format!("`{}` holds no digit", file.0),
                hint: Some("write a digit".to_owned()),
            },
            None => ViewCount::Known(files.len()),
        }
    }
);

engine::params! {
    /// Outputs a constant.
    pub struct Number {
        /// The number.
        value: f64 = 1.0, range(-1e6, 1e6), other("2.0");
    }
}
simple!(Number = "number", Nothing, |params, _inputs, _cx| give(params.value), const INSTANT: bool = true;);

engine::params! {
    /// Adds its inputs, in order.
    pub struct Add {
        /// Number to add to the sum.
        bias: f64 = 0.0, other("1.0");
    }
}
simple!(Add = "add", Terms, |params, inputs, cx| {
    cx.count("terms", inputs.terms.len() as u64);
    give(inputs.terms.iter().map(|term| term.0).sum::<f64>() + params.bias)
});

engine::params! {
    /// Multiplies its input by a factor.
    pub struct Scale {
        /// The factor.
        by: f64 = 2.0, range(-100.0, 100.0), other("3.0");
    }
}
simple!(
    Scale = "scale",
    One,
    |params, inputs, _cx| give(inputs.value.0 * params.by),
    const INSTANT: bool = true;,
    fn views(_: &Self, _: &SourceRoot) -> ViewCount {
        ViewCount::As(&["value"])
    }
);

engine::choices! {
    /// Direction of rounding.
    pub enum Towards {
        /** To the nearest integer. */ Nearest,
        /** To the next integer below. */ Down,
        /** To the next integer above. */ Upwards,
    }
}
engine::params! {
    /// Rounds its input to an integer, so that many inputs give the same output.
    pub struct Round {
        /// Direction of rounding.
        towards: Towards = Towards::Nearest, other("Down");
    }
}
simple!(
    Round = "round",
    One,
    |params, inputs, _cx| give(match params.towards {
        Towards::Nearest => inputs.value.0.round(),
        Towards::Down => inputs.value.0.floor(),
        Towards::Upwards => inputs.value.0.ceil(),
    }),
    const INSTANT: bool = true;
);

engine::params! {
    /// Splits a number into its integral and fractional part.
    pub struct Split {}
}
engine::outputs! {
    /// Outputs of [`Split`].
    pub struct Parts {
        /// The integral part.
        whole: Arc<Num>,
        /// The fractional part.
        rest: Arc<Num>,
        /// Both parts.
        both: Arc<Numbers>,
    }
}
impl Kind for Split {
    const NAME: &'static str = "split";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = Parts;
    fn run(_params: &Self, inputs: One, _cx: &Context) -> Ran<Parts> {
        let (whole, rest) = (inputs.value.0.trunc(), inputs.value.0.fract());
        let both = Arc::new(Numbers(vec![whole, rest]));
        Ok((Parts { whole: Arc::new(Num(whole)), rest: Arc::new(Num(rest)), both }, Notes::none()))
    }
}

engine::params! {
    /// Outputs the seed of the graph.
    pub struct Seeded {}
}
simple!(
    Seeded = "seeded",
    Nothing,
    |_params, _inputs, cx| give(cx.seed() as f64),
    const READS: &'static [ContextField] = &[ContextField::Seed];
);

engine::params! {
    /// Outputs a number that depends on the axis that points up.
    pub struct UpAxis {}
}
simple!(
    UpAxis = "up-axis",
    Nothing,
    |_params, _inputs, cx| give(cx.up().name().len() as f64 + cx.up() as u8 as f64),
    const READS: &'static [ContextField] = &[ContextField::Up];
);

engine::params! {
    /// Computes the mean of `samples` numbers that are close to the input. Each part of the work covers 16 numbers.
    pub struct Series {
        /// The number of samples.
        samples: u32 = 32, range(1, 4096), other("48");
        /// The result contains `coarse - 1` as an additional term, so that a test can recognise a preview.
        coarse: u32 = 1, range(1, 64), other("2");
        /// Factor applied to the mean. The keys of the parts do not contain it.
        gain: f64 = 1.0, other("2.0");
        /// Duration of the computation of a part. The keys of the parts do not contain it.
        millis: u64 = 0, inert("time is not part of the result");
    }
}
simple!(
    Series = "series",
    One,
    |params, inputs, cx| {
        let mut sum = 0.0;
        for first in (0..params.samples).step_by(16) {
            let last = params.samples.min(first + 16);
            let part = Part { name: "chunk", version: 1, inputs: &["value"] };
            let chunk = cx.part(part, &(first, last), || {
                std::thread::sleep(Duration::from_millis(params.millis));
                cx.count("samples", u64::from(last - first));
                Ok(Num((first..last).map(|n| inputs.value.0 + f64::from(n)).sum()))
            })?;
            sum += chunk.0;
            cx.progress(last as f32 / params.samples as f32);
        }
        give(sum / f64::from(params.samples) * params.gain + f64::from(params.coarse - 1))
    },
    const PREVIEW: engine::Preview =
        engine::Preview { refines: Some("samples"), coarse: Some("coarse"), ..engine::Preview::NONE };
);

engine::params! {
    /// Adds a number to its input. The input is taken from a part that is kept in memory for other nodes.
    pub struct Prepared {
        /// The number to add.
        plus: f64 = 0.0, other("1.0");
    }
}
/// The inputs for which `prepared` computed its part.
pub static MADE: Mutex<Vec<f64>> = Mutex::new(Vec::new());
simple!(Prepared = "prepared", One, |params, inputs, cx| {
    let part = Part { name: "table", version: 1, inputs: &["value"] };
    let table = cx.in_memory(
        part,
        &(),
        |_| 8,
        || {
            MADE.lock().expect("no test panics with it").push(inputs.value.0);
            Ok(inputs.value.0)
        },
    )?;
    give(*table + params.plus)
});

engine::params! {
    /// Outputs consecutive numbers, starting with the input.
    pub struct Ramp {
        /// Length of the list.
        count: u32 = 2000, range(1, 100000000), other("3000");
    }
}
engine::outputs! { /** A list. */ pub struct List { /** The numbers. */ numbers: Arc<Numbers>, } }
impl Kind for Ramp {
    const NAME: &'static str = "ramp";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = List;
    fn estimate(params: &Self, _inputs: &One) -> Cost {
        Cost { bytes: u64::from(params.count) * 8 }
    }
    fn run(params: &Self, inputs: One, cx: &Context) -> Ran<List> {
        let numbers = cx.for_each_tile(params.count as usize, |n| inputs.value.0 + n as f64)?;
        Ok((List { numbers: Arc::new(Numbers(numbers)) }, Notes::none()))
    }
}

engine::params! {
    /// Sums a list.
    pub struct Sum {
        /// Factor applied to the sum.
        times: u32 = 1, range(1, 10), other("2");
    }
}
engine::inputs! { /** A list. */ pub struct Listed { /** The numbers. */ numbers: Arc<Numbers>, } }
simple!(
    Sum = "sum",
    Listed,
    |params, inputs, _cx| give(inputs.numbers.0.iter().sum::<f64>() * f64::from(params.times)),
    const PREVIEW: engine::Preview = engine::Preview { rough: &[("times", "1")], ..engine::Preview::NONE };
);

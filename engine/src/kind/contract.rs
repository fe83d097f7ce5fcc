//! The trait of a kind of node: name, parameters, ports and code.

use crate::kind::context::{Context, ContextField};
use crate::kind::params::Params;
use crate::kind::port::{Inputs, Outputs, Wired};
use crate::value::error::NodeError;
use crate::value::note::Notes;
use crate::value::root::{FileHead, SourceFile, SourceRoot};

/// Memory that a node needs, which determines when the node may start. Zero means a negligible amount.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cost {
    /// Peak memory in addition to the inputs, in bytes.
    pub bytes: u64,
}

impl Cost {
    /// The memory for `items`, given as pairs of count and bytes per item. The sum saturates: if it wrapped around,
    /// a node that needs too much memory would appear to need little.
    pub fn of(items: impl IntoIterator<Item = (u64, u64)>) -> Self {
        let add = |sum: u64, (count, each): (u64, u64)| sum.saturating_add(count.saturating_mul(each));
        Self { bytes: items.into_iter().fold(0, add) }
    }
}

/// Sizes of the inputs of a node, as returned by [`crate::Artifact::size`]. They come from records, so that the
/// values themselves are not needed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sizes {
    pub(crate) ports: Vec<(&'static str, u64)>,
    pub(crate) files: u64,
}

impl Sizes {
    /// Total size of the values at an input port; 0 if the port is not wired.
    pub fn of(&self, port: &str) -> f64 {
        self.ports.iter().find(|(name, _)| *name == port).map_or(0.0, |(_, size)| *size as f64)
    }

    /// Total size of all inputs, plus the bytes of the source files.
    pub fn total(&self) -> f64 {
        self.ports.iter().map(|(_, size)| *size as f64).sum::<f64>() + self.files as f64
    }
}

/// Policy for storing the outputs of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keep {
    /// Outputs are stored.
    Always,
    /// Only digests of outputs are stored. This is for loaders, whose outputs are as cheap to compute as to read
    /// from the store.
    Cheap,
}

/// Parameters that a kind no longer has, with advice on how to replace them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Former {
    /// The former parameters. If a node has several of them, they are reported as one mistake.
    pub fields: &'static [&'static str],
    /// The last version of the kind that had these parameters.
    pub last: u32,
    /// Advice for the user, such as ``write `surroundings: Open` ``.
    pub instead: String,
}

impl Former {
    /// Describes removed parameters that forced optional work, which never changes the output. The advice names the
    /// option `--exhaustive`, which forces all such work in a run.
    pub fn exhaustive(fields: &'static [&'static str], last: u32) -> Self {
        let instead = "to be removed; the option `--exhaustive` forces all optional work in a run".to_owned();
        Self { fields, last, instead }
    }
}

/// Number of views that a node outputs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ViewCount {
    /// Unknown before the node runs.
    Unknown,
    /// The node usually counts its views before it runs, but these parameters or files prevent this.
    Uncounted {
        /// The reason, such as the error with which the node would fail.
        why: String,
        /// Advice for the user, if there is any.
        hint: Option<String>,
    },
    /// Fixed number of views.
    Known(usize),
    /// The number of views of the first of these inputs that is connected and has a known number of views.
    As(&'static [&'static str]),
}

/// Ways to reduce the work of a kind, for previews in `watch`, for presets and for forecasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preview {
    /// A parameter (such as `samples`) whose work is cached in chunks. If it is raised, only the added chunks are
    /// computed, and forecasts count only these.
    pub refines: Option<&'static str>,
    /// A parameter that reduces the resolution: if its value is n, the node computes one pixel in each block of n
    /// by n pixels. It is raised above 1 for the first preview.
    pub coarse: Option<&'static str>,
    /// Parameters that previews reduce, each with its value for previews. If this value is a whole number, it is an
    /// upper limit; otherwise it replaces the parameter's value.
    pub rough: &'static [(&'static str, &'static str)],
    /// Inputs used only to choose a resolution; presets do not raise knobs that affect only such inputs.
    pub looks: &'static [&'static str],
}

impl Preview {
    /// The preview of a kind whose work cannot be reduced.
    pub const NONE: Self = Self { refines: None, coarse: None, rough: &[], looks: &[] };
}

/// A kind of node: its name, parameters, ports and code.
///
/// The example is a kind that reads a file. `sources` names the file, so that its content enters the key; `run` reads
/// it from the context. The sums of its lines are computed on several threads, and are one part of the work with a
/// result of its own: another node that reads the same file, whatever its `power`, takes this part from the cache.
///
/// ```
/// use std::sync::Arc;
/// use engine::{Artifact, Context, InputFile, Kind, NodeError, Notes, Part, Scene, SourceFile, SourceRoot, Up};
/// # use engine::{Corrupt, Decoder, Difference, Encoder};
/// # struct Numbers(Vec<f64>);
/// # impl Artifact for Numbers {
/// #     const TYPE: &'static str = "numbers";
/// #     const FORMAT: u32 = 1;
/// #     fn encode(&self, to: &mut Encoder) { to.f64s(&self.0) }
/// #     fn decode(from: &mut Decoder<'_>) -> Result<Self, Corrupt> { from.f64s().map(Numbers) }
/// #     fn bytes(&self) -> usize { 8 * self.0.len() }
/// #     fn difference(&self, _: &Self) -> Difference { Difference::of("other numbers") }
/// # }
///
/// engine::params! {
///     /// Computes a power of the sum of each line of a text file.
///     pub struct SumLines {
///         /// The file: numbers separated by white space.
///         path: InputFile, other("\"other.txt\"");
///         /// Exponent.
///         power: i32 = 1, range(1, 4), other("2");
///     }
/// }
/// engine::inputs! { pub struct In {} }
/// engine::outputs! { pub struct Out { /** One number per line. */ sums: Arc<Numbers>, } }
///
/// fn sum(line: &str) -> Result<f64, NodeError> {
///     line.split_whitespace().try_fold(0.0, |sum, word| Ok(sum + word.parse::<f64>()?))
/// }
///
/// impl Kind for SumLines {
///     const NAME: &'static str = "sum-lines";
///     const VERSION: u32 = 1;
///     type Params = Self;
///     type In = In;
///     type Out = Out;
///
///     fn sources(params: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
///         Ok(vec![root.file(&params.path)])
///     }
///
///     fn run(params: &Self, _: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
///         let text = String::from_utf8(cx.read(&params.path)?)?;
///         let lines: Vec<&str> = text.lines().collect();
///         // The part depends on no input and on no parameter except the file, whose text is in its key.
///         let part = Part { name: "sums", version: 1, inputs: &[] };
///         let sums: Arc<Numbers> = cx.part(part, &text, || {
///             let sums = cx.for_each_tile(lines.len(), |index| sum(lines[index]))?;
///             cx.count("lines", lines.len() as u64);
///             sums.into_iter().collect::<Result<_, _>>().map(Numbers)
///         })?;
///         let mut powers = Vec::new();
///         for (index, sum) in sums.0.iter().enumerate() {
///             cx.check()?; // Ends the loop if the user cancels the run.
///             cx.progress(index as f32 / lines.len() as f32);
///             powers.push((0..params.power).fold(1.0, |product, _| product * sum));
///         }
///         Ok((Out { sums: Arc::new(Numbers(powers)) }, Notes::none()))
///     }
/// }
///
/// // A test of the kind without a graph.
/// # let folder = tempfile::tempdir()?;
/// # let folder = folder.path();
/// std::fs::write(folder.join("n.txt"), "1 2 3\n0.5 0.5\n")?;
/// let scene = Scene { up: Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false };
/// let cx = Context::detached(scene, folder);
/// let params = SumLines { path: InputFile("n.txt".to_owned()), power: 2 };
/// let (out, notes) = SumLines::run(&params, In {}, &cx).map_err(|error| error.to_string())?;
/// assert_eq!((out.sums.0.as_slice(), notes), (&[36.0, 1.0][..], Notes::none()));
/// assert_eq!(cx.counts()["lines"], 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Kind: 'static {
    /// Kebab-case name: `splat-render` is written `SplatRender` in graph files.
    const NAME: &'static str;
    /// Version of the code. It is raised whenever outputs change for the same inputs.
    const VERSION: u32;
    /// The context fields that `run` reads; only these enter the key.
    const READS: &'static [ContextField] = &[];
    /// Storage policy for outputs.
    const STORE: Keep = Keep::Always;
    /// True if source paths may be folders.
    const FOLDERS: bool = false;
    /// Hint on where to download the source files, for kinds that need files from elsewhere. It is shown if a file
    /// is missing.
    const SUPPLIED: Option<&'static str> = None;
    /// Profile of the arithmetic: `portable` if results are equal on all machines, or else the name of a library
    /// whose results may differ slightly between machines.
    const PROFILE: &'static str = "portable";

    /// True if `run` starts a program that is installed on this machine, so that no other machine is expected to give
    /// the same result. Such a node never runs in a graph from others or on another machine, its results are not
    /// shared, and a verification does not run it again. `sources` must contain the program; see
    /// [`SourceRoot::program`].
    const RUNS_PROGRAMS: bool = false;

    /// Compiled-in data that may change without a new version, such as weights. Its digest enters the key.
    const DATA: &'static [u8] = &[];
    /// True if `run` takes microseconds for any input. A plan then runs the node to determine which nodes
    /// downstream of it would run.
    const INSTANT: bool = false;

    /// Ways to reduce the work of the kind, for `watch`, presets and forecasts.
    const PREVIEW: Preview = Preview::NONE;

    /// Parameters, declared with [`params!`](crate::params).
    type Params: Params;
    /// Inputs, declared with [`inputs!`](crate::inputs).
    type In: Inputs;
    /// Outputs, declared with [`outputs!`](crate::outputs).
    type Out: Outputs;

    /// Estimates the memory that `run` needs. Called with the actual inputs, before `run`.
    fn estimate(_params: &Self::Params, _inputs: &Self::In) -> Cost {
        Cost::default()
    }

    /// Estimates the additional memory for `files` from their headers. These are the files that `sources` listed,
    /// in the same order. Errors in the files are reported by `run`.
    fn estimate_files(_params: &Self::Params, files: &[FileHead<'_>]) -> Cost {
        Cost { bytes: files.iter().fold(0, |sum, file| sum.saturating_add(file.bytes)) }
    }

    /// Amount of work in a run, in arbitrary units proportional to its time. The seconds per unit are learnt from
    /// earlier runs of the kind, so that forecasts take sample counts and sizes into account.
    fn work(_params: &Self::Params, sizes: &Sizes) -> f64 {
        sizes.total()
    }

    /// The files that `run` reads. To find them, an implementation must not read more of a file than its header.
    fn sources(_params: &Self::Params, _root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(Vec::new())
    }

    /// Advice for a node that still has the field `name`. Returns `None` unless a former version of the kind had a
    /// parameter with this name. `fields` contains the names and texts of all fields of the node.
    fn former(_name: &str, _fields: &[(&str, &str)]) -> Option<Former> {
        None
    }

    /// Checks combinations of parameters. Ranges are declared with the parameters.
    fn check(_params: &Self::Params) -> Result<(), NodeError> {
        Ok(())
    }

    /// Checks which inputs are wired, before anything runs.
    fn check_wires(_params: &Self::Params, _wired: &Wired) -> Result<(), NodeError> {
        Ok(())
    }

    /// Checks that a node with these parameters has a value for `output`, which is wired to another node.
    fn check_output(_params: &Self::Params, _output: &'static str) -> Result<(), NodeError> {
        Ok(())
    }

    /// The number of views in the outputs, if it is known before anything runs. A sink that writes more than one
    /// view needs `{view}` in its path.
    fn views(_params: &Self::Params, _root: &SourceRoot) -> ViewCount {
        ViewCount::Unknown
    }

    /// Computes the outputs.
    fn run(params: &Self::Params, inputs: Self::In, cx: &Context) -> Result<(Self::Out, Notes), NodeError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn costs_add_up_and_do_not_wrap() {
        assert_eq!(Cost::of([(3, 4), (5, 6)]).bytes, 42);
        assert_eq!(Cost::of([(u64::MAX / 2, 4), (1, 1)]).bytes, u64::MAX);
        assert_eq!(Cost::of([(u64::MAX, 1), (1, 1)]).bytes, u64::MAX);
    }
}

//! What a kind of node is: its name, parameters, ports and code.

use crate::kind::context::{Context, ContextField};
use crate::kind::params::Params;
use crate::kind::port::{Inputs, Outputs, Wired};
use crate::value::error::NodeError;
use crate::value::note::Notes;
use crate::value::root::{FileHead, SourceFile, SourceRoot};

/// Memory of a node, for admission. Zero means negligible.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cost {
    /// Peak memory beyond the inputs, in bytes.
    pub bytes: u64,
}

/// How large the inputs of a node are, by [`crate::Artifact::size`]: known from records, without the values.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sizes {
    pub(crate) ports: Vec<(&'static str, u64)>,
    pub(crate) files: u64,
}

impl Sizes {
    /// Size of what comes in by a port, all its wires together; 0 where nothing does.
    pub fn of(&self, port: &str) -> f64 {
        self.ports.iter().find(|(name, _)| *name == port).map_or(0.0, |(_, size)| *size as f64)
    }

    /// Everything that comes in, and the bytes of the files that are read.
    pub fn total(&self) -> f64 {
        self.ports.iter().map(|(_, size)| *size as f64).sum::<f64>() + self.files as f64
    }
}

/// Whether the outputs of a kind are worth keeping on disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keep {
    /// Outputs are stored.
    Always,
    /// Only their digests are: remaking them is as cheap as reading them (loaders).
    Cheap,
}

/// What to write instead of a parameter of a former version.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Former {
    /// The parameters that went together, reported as one.
    pub fields: &'static [&'static str],
    /// The last version of the kind that had them.
    pub last: u32,
    /// What to do, as in ``write `surroundings: Open` ``.
    pub instead: String,
}

impl Former {
    /// Parameters that forced work which changes no byte: `--exhaustive` does so for a whole run.
    pub fn exhaustive(fields: &'static [&'static str], last: u32) -> Self {
        let instead = "remove it; `--exhaustive` forces all such work in a run".to_owned();
        Self { fields, last, instead }
    }
}

/// How many views a node makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewCount {
    /// Only its run tells.
    Unknown,
    /// So many.
    Known(usize),
    /// As many as the first of these inputs that is wired and known has.
    As(&'static [&'static str]),
}

/// One kind of node: its name, parameters, ports and code.
pub trait Kind: 'static {
    /// Kebab-case name: `splat-render` is written `SplatRender` in graph files.
    const NAME: &'static str;
    /// Raised whenever the same inputs give other outputs.
    const VERSION: u32;
    /// The context fields that `run` reads; only these enter the key.
    const READS: &'static [ContextField] = &[];
    /// Whether outputs are stored.
    const STORE: Keep = Keep::Always;
    /// Whether the paths it reads may be folders.
    const FOLDERS: bool = false;
    /// Where files that users must get from elsewhere are to be had: told of one that is missing.
    const SUPPLIED: Option<&'static str> = None;
    /// What may change the bits: `portable`, or the profile of a library that promises none.
    const PROFILE: &'static str = "portable";

    /// What is compiled into the program and may be exchanged without a new version, such as weights; its
    /// digest is in the key.
    const DATA: &'static [u8] = &[];
    /// Whether `run` takes microseconds whatever its inputs are. A plan then runs it, so that it can tell
    /// exactly what follows.
    const INSTANT: bool = false;

    /// What a preview while watching sets, of what costs much and shows little: a whole number to at most so much,
    /// anything else as it stands here.
    const ROUGH: &'static [(&'static str, &'static str)] = &[];

    /// The parameter by which a first preview computes one pixel for each block of so many by so many; 1 is each.
    const COARSE: Option<&'static str> = None;

    /// Inputs that only tell how fine others need be, such as a coarse look at the light. Knobs of what nothing else reads
    /// stay as the graph has them: turned up they would cost what the look is to save.
    const LOOKS: &'static [&'static str] = &[];

    /// The parameter in whose steps the work is kept in parts: raising it pays only for what is new. A forecast
    /// counts no more than that.
    const REFINES: Option<&'static str> = None;

    /// Parameters, by [`params!`](crate::params).
    type Params: Params;
    /// Inputs, by [`inputs!`](crate::inputs).
    type In: Inputs;
    /// Outputs, by [`outputs!`](crate::outputs).
    type Out: Outputs;

    /// The memory that a run will take. Called with the real inputs, before `run`.
    fn estimate(_params: &Self::Params, _inputs: &Self::In) -> Cost {
        Cost::default()
    }

    /// What it takes besides for the files of `sources`, in their order: the files, and what becomes of them, by what
    /// their heads say. What is wrong with a file is for `run` to say.
    fn estimate_files(_params: &Self::Params, files: &[FileHead<'_>]) -> Cost {
        Cost { bytes: files.iter().fold(0, |sum, file| sum.saturating_add(file.bytes)) }
    }

    /// The work of a run, in units of the kind's own that grow in proportion with the time. What a unit
    /// takes is learnt from earlier runs of the kind, so forecasts follow samples and sizes.
    fn work(_params: &Self::Params, sizes: &Sizes) -> f64 {
        sizes.total()
    }

    /// The files that `run` reads, found cheaply (headers only).
    fn sources(_params: &Self::Params, _root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(Vec::new())
    }

    /// What to write instead of the field `name`, if a former version had it. `fields` are all fields of the node as
    /// written, by name and text.
    fn former(_name: &str, _fields: &[(&str, &str)]) -> Option<Former> {
        None
    }

    /// Checks that need several parameters at once; ranges are declared with the parameters.
    fn check(_params: &Self::Params) -> Result<(), NodeError> {
        Ok(())
    }

    /// Checks that need to know what is wired, before anything runs.
    fn check_wires(_params: &Self::Params, _wired: &Wired) -> Result<(), NodeError> {
        Ok(())
    }

    /// How many views its pictures or cameras hold, as far as that is known before anything runs. A sink of
    /// more than one needs `{view}` in its path.
    fn views(_params: &Self::Params, _root: &SourceRoot) -> ViewCount {
        ViewCount::Unknown
    }

    /// Computes the outputs.
    fn run(params: &Self::Params, inputs: Self::In, cx: &Context) -> Result<(Self::Out, Notes), NodeError>;
}

//! The table of kinds.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::kind::context::{Context, ContextField};
use crate::kind::contract::{Cost, Former, Keep, Kind, Preview, Sizes, ViewCount};
use crate::kind::fields::Fields;
use crate::kind::param_type::{ParamValue, Role};
use crate::kind::params::{ParamSpec, Params};
use crate::kind::port::{Inputs, Outputs, PortSpec, Wired};
use crate::text::diag::{Code, Diagnostic};
use crate::value::artifact::AnyArtifact;
use crate::value::error::{NodeError, guarded};
use crate::value::note::Notes;
use crate::value::root::{FileHead, SourceFile, SourceRoot};

/// The parameters and code of a kind whose type is known only at run time. Every method turns a panic in the code
/// of the kind into an error, so that callers need not catch panics.
pub(crate) trait Step: Send + Sync {
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue));
    fn check(&self) -> Result<(), NodeError>;
    fn check_wires(&self, wired: &Wired) -> Result<(), NodeError>;
    fn check_output(&self, output: &'static str) -> Result<(), NodeError>;
    fn views(&self, root: &SourceRoot) -> Result<ViewCount, NodeError>;
    fn sources(&self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError>;
    fn estimate(&self, inputs: Vec<Vec<AnyArtifact>>) -> Result<Cost, NodeError>;
    fn estimate_files(&self, files: &[FileHead<'_>]) -> Result<Cost, NodeError>;
    fn work(&self, sizes: &Sizes) -> Result<f64, NodeError>;
    fn run(
        &self,
        inputs: Vec<Vec<AnyArtifact>>,
        cx: &Context,
    ) -> Result<(Vec<AnyArtifact>, Notes), NodeError>;
}

struct StepOf<K: Kind>(K::Params);

impl<K: Kind> Step for StepOf<K> {
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue)) {
        self.0.visit(visit);
    }
    fn check(&self) -> Result<(), NodeError> {
        guarded(|| K::check(&self.0))
    }
    fn check_wires(&self, wired: &Wired) -> Result<(), NodeError> {
        guarded(|| K::check_wires(&self.0, wired))
    }
    fn check_output(&self, output: &'static str) -> Result<(), NodeError> {
        guarded(|| K::check_output(&self.0, output))
    }
    fn views(&self, root: &SourceRoot) -> Result<ViewCount, NodeError> {
        guarded(|| Ok(K::views(&self.0, root)))
    }
    fn sources(&self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        guarded(|| K::sources(&self.0, root))
    }
    fn estimate(&self, inputs: Vec<Vec<AnyArtifact>>) -> Result<Cost, NodeError> {
        guarded(|| Ok(K::estimate(&self.0, &K::In::take(inputs))))
    }
    fn estimate_files(&self, files: &[FileHead<'_>]) -> Result<Cost, NodeError> {
        guarded(|| Ok(K::estimate_files(&self.0, files)))
    }
    fn work(&self, sizes: &Sizes) -> Result<f64, NodeError> {
        guarded(|| Ok(K::work(&self.0, sizes)))
    }
    fn run(
        &self,
        inputs: Vec<Vec<AnyArtifact>>,
        cx: &Context,
    ) -> Result<(Vec<AnyArtifact>, Notes), NodeError> {
        guarded(|| {
            let (out, notes) = K::run(&self.0, K::In::take(inputs), cx)?;
            Ok((out.give(), notes))
        })
    }
}

/// [`Kind::former`], with a panic as an error. The arguments are the name of a field, and the names and texts of
/// all fields of the node.
type FormerField = fn(&str, &[(&str, &str)]) -> Result<Option<Former>, NodeError>;

/// Reads the parameters of a kind. A panic in the code that reads them is reported as a mistake.
pub(crate) fn read_params<P: Params>(fields: &mut Fields<'_, '_>) -> Option<P> {
    guarded(|| Ok(P::read(fields))).unwrap_or_else(|error| {
        let mistake = Diagnostic::caused_by(Code::Parameters, fields.node_span.clone(), error);
        fields.diagnostics.push(mistake);
        None
    })
}

/// A registered kind: its description, and functions that call its code.
pub struct KindEntry {
    /// Kebab-case name.
    pub name: &'static str,
    /// [`Kind::VERSION`].
    pub version: u32,
    /// The documentation; its first line is a summary.
    pub doc: &'static str,
    /// Parameters in order of declaration.
    pub params: Vec<ParamSpec>,
    /// Input ports in order of declaration.
    pub inputs: Vec<PortSpec>,
    /// Output ports; the first is the default.
    pub outputs: Vec<PortSpec>,
    /// [`Kind::READS`].
    pub reads: &'static [ContextField],
    /// [`Kind::STORE`].
    pub store: Keep,
    /// [`Kind::PROFILE`].
    pub profile: &'static str,
    /// [`Kind::RUNS_PROGRAMS`].
    pub runs_programs: bool,
    /// [`Kind::DATA`].
    pub data: &'static [u8],
    /// [`Kind::INSTANT`].
    pub instant: bool,
    /// [`Kind::PREVIEW`].
    pub preview: Preview,
    /// [`Kind::FOLDERS`].
    pub(crate) folders: bool,
    /// [`Kind::SUPPLIED`].
    pub(crate) supplied: Option<&'static str>,
    /// True if a parameter names a source file, or if the kind runs programs, which are sources as well.
    pub(crate) reads_files: bool,
    /// [`Kind::former`].
    pub(crate) former: FormerField,
    pub(crate) read: fn(&mut Fields<'_, '_>) -> Option<Arc<dyn Step>>,
}

impl KindEntry {
    /// The entry of `K`.
    pub fn of<K: Kind>() -> Self {
        let params = K::Params::specs();
        Self {
            name: K::NAME,
            version: K::VERSION,
            doc: K::Params::DOC,
            reads_files: K::RUNS_PROGRAMS || params.iter().any(|param| param.role == Role::Input),
            params,
            inputs: K::In::ports(),
            outputs: K::Out::ports(),
            reads: K::READS,
            store: K::STORE,
            profile: K::PROFILE,
            runs_programs: K::RUNS_PROGRAMS,
            data: K::DATA,
            instant: K::INSTANT,
            preview: K::PREVIEW,
            folders: K::FOLDERS,
            supplied: K::SUPPLIED,
            former: |name, fields| guarded(|| Ok(K::former(name, fields))),
            read: |fields| {
                let step: Arc<dyn Step> = Arc::new(StepOf::<K>(read_params::<K::Params>(fields)?));
                Some(step)
            },
        }
    }

    /// The spelling in graph files: `SplatRender`.
    pub fn camel_name(&self) -> String {
        camel(self.name)
    }

    /// The first parameter that names a source file.
    pub(crate) fn source_param(&self) -> Option<&'static str> {
        self.params.iter().find(|param| param.role == Role::Input).map(|param| param.name)
    }

    /// The parameter that names the output file of a sink.
    pub fn sink_param(&self) -> Option<&ParamSpec> {
        self.params.iter().find(|param| param.role == Role::Output)
    }
}

/// Converts `splat-render` to `SplatRender`.
pub(crate) fn camel(kebab: &str) -> String {
    let mut out = String::with_capacity(kebab.len());
    for word in kebab.split('-') {
        let mut letters = word.chars();
        out.extend(letters.next().map(|c| c.to_ascii_uppercase()));
        out.extend(letters);
    }
    out
}

/// Hint for a kind that no build has.
const LISTED: &str = "`lightharmony nodes` lists the kinds";

/// The table of kinds. A crate adds its kinds with [`Registry::with`].
#[derive(Default)]
pub struct Registry {
    kinds: BTreeMap<String, Arc<KindEntry>>,
    lacking: BTreeMap<String, &'static str>,
}

impl Registry {
    /// A table of the given kinds.
    ///
    /// # Panics
    /// If two kinds have the same name.
    pub fn new(entries: Vec<KindEntry>) -> Self {
        entries.into_iter().fold(Self::default(), Self::with)
    }

    /// Adds a kind.
    pub fn with(mut self, entry: KindEntry) -> Self {
        let name = entry.camel_name();
        let earlier = self.kinds.insert(name.clone(), Arc::new(entry));
        assert!(earlier.is_none(), "two kinds are named `{name}`");
        self
    }

    /// States that this build lacks a kind, and where it is: the hint of the error for graphs with this kind. Has no
    /// effect if the table has the kind.
    pub fn lacking(mut self, name: &str, hint: &'static str) -> Self {
        self.lacking.insert(camel(name), hint);
        self
    }

    /// The hint for a kind that the table does not have.
    pub(crate) fn hint(&self, name: &str) -> &'static str {
        self.lacking.get(name).or_else(|| self.lacking.get(&camel(name))).copied().unwrap_or(LISTED)
    }

    /// The kind with this name, which may be spelled `splat-render` or `SplatRender`.
    pub fn get(&self, name: &str) -> Option<&Arc<KindEntry>> {
        self.kinds.get(name).or_else(|| self.kinds.get(&camel(name)))
    }

    /// All kinds, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = &Arc<KindEntry>> {
        self.kinds.values()
    }
}

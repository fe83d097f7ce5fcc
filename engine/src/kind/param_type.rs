//! Types of parameters and their canonical text.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::value::root::InputFile;

/// A type of parameter. Its RON form is canonical: equal values have equal text.
pub trait ParamType:
    Serialize + DeserializeOwned + Clone + PartialEq + std::fmt::Debug + Send + Sync
{
    /// Description of the values, such as `number` or `Hard | Ramp`.
    fn describe() -> String;
    /// Names of the choices, each with its documentation; empty if the type has no choices.
    fn choices() -> Vec<(&'static str, &'static str)> {
        Vec::new()
    }
    /// The role of the parameter.
    const ROLE: Role = Role::Value;
    /// True if every number in the value lies between `low` and `high`, both inclusive.
    fn within(&self, _low: f64, _high: f64) -> bool {
        true
    }
    /// The text that enters the key; `None` if the key contains the digest of a file instead.
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        canonical(self).map(Some)
    }
    /// The paths in the value, if it names files.
    fn paths(&self) -> Vec<&str> {
        Vec::new()
    }
}

/// Role of a parameter: a plain value, or a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// A plain value.
    Value,
    /// A file to read, relative to the graph file.
    Input,
    /// A file to write, relative to the output folder. A kind with such a parameter is a sink.
    Output,
}

/// Error for a number that is not finite and therefore cannot be part of a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a finite number")]
pub struct NotCanonical(pub String);

/// The canonical RON text of a value: floats in their shortest form, no white space, and `-0` written as `0`.
pub fn canonical<T: Serialize>(value: &T) -> Result<String, NotCanonical> {
    let text = ron::to_string(value).map_err(|e| NotCanonical(e.to_string()))?;
    // The texts that are replaced or refused below, `-0.0`, `NaN` and `inf`, contain one of these bytes.
    if !text.bytes().any(|byte| matches!(byte, b'-' | b'N' | b'i')) {
        return Ok(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut token = String::new();
    let mut quoted = false;
    let mut escaped = false;
    let flush = |token: &mut String, out: &mut String| -> Result<(), NotCanonical> {
        match token.as_str() {
            "-0.0" => out.push_str("0.0"),
            "NaN" | "-NaN" | "inf" | "-inf" => return Err(NotCanonical(std::mem::take(token))),
            other => out.push_str(other),
        }
        token.clear();
        Ok(())
    };
    for c in text.chars() {
        if quoted {
            out.push(c);
            quoted = escaped || c != '"';
            escaped = !escaped && c == '\\';
        } else if c == '"' {
            flush(&mut token, &mut out)?;
            out.push(c);
            quoted = true;
        } else if c.is_alphanumeric() || matches!(c, '-' | '+' | '.' | '_') {
            token.push(c);
        } else {
            flush(&mut token, &mut out)?;
            out.push(c);
        }
    }
    flush(&mut token, &mut out)?;
    Ok(out)
}

macro_rules! number_params {
    ($($type:ty => $name:literal),*) => { $(
        impl ParamType for $type {
            fn describe() -> String { $name.to_owned() }
            fn within(&self, low: f64, high: f64) -> bool { (low as Self..=high as Self).contains(self) }
        }
    )* };
}

number_params!(u32 => "whole number", u64 => "whole number", i32 => "integer", f32 => "number", f64 => "number");

impl ParamType for bool {
    fn describe() -> String {
        "true | false".to_owned()
    }
}

impl ParamType for String {
    fn describe() -> String {
        "text".to_owned()
    }
}

macro_rules! array_params {
    ($($n:literal),*) => { $(
        impl ParamType for [f64; $n] {
            fn describe() -> String { concat!($n, " numbers in ( )").to_owned() }
            fn within(&self, low: f64, high: f64) -> bool { self.iter().all(|v| v.within(low, high)) }
        }
    )* };
}

array_params!(2, 3, 4, 16);

impl<T: ParamType> ParamType for Vec<T> {
    const ROLE: Role = T::ROLE;
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        let texts = self.iter().map(T::key_text).collect::<Result<Vec<_>, _>>()?;
        // A list of source files enters the key as the list of their digests.
        Ok((T::ROLE != Role::Input)
            .then(|| format!("[{}]", texts.into_iter().flatten().collect::<Vec<_>>().join(","))))
    }
    fn paths(&self) -> Vec<&str> {
        self.iter().flat_map(T::paths).collect()
    }
    fn describe() -> String {
        format!("[{}, ..]", T::describe())
    }
    fn choices() -> Vec<(&'static str, &'static str)> {
        T::choices()
    }
    fn within(&self, low: f64, high: f64) -> bool {
        self.iter().all(|v| v.within(low, high))
    }
}

impl<T: ParamType> ParamType for Option<T> {
    const ROLE: Role = T::ROLE;
    fn describe() -> String {
        format!("{} (optional)", T::describe())
    }
    fn choices() -> Vec<(&'static str, &'static str)> {
        T::choices()
    }
    fn within(&self, low: f64, high: f64) -> bool {
        self.as_ref().is_none_or(|v| v.within(low, high))
    }
    fn paths(&self) -> Vec<&str> {
        self.iter().flat_map(T::paths).collect()
    }
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        match self {
            Some(value) => value.key_text(),
            None => Ok(Some("None".to_owned())),
        }
    }
}

impl ParamType for InputFile {
    const ROLE: Role = Role::Input;
    fn describe() -> String {
        "path of a file to read".to_owned()
    }
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        Ok(None)
    }
    fn paths(&self) -> Vec<&str> {
        vec![&self.0]
    }
}

/// A file that a sink writes: a path relative to the output folder, where `{view}` is replaced by the name of each
/// view. Only the extension, which determines the format, enters the key.
///
/// A kind with a parameter of this type is a *sink*. Its first output is [`Files`](crate::Files); the engine puts the
/// files in place, and writes nothing if they are there already.
///
/// ```
/// use std::sync::Arc;
/// use engine::{Context, FileBytes, Files, Kind, NodeError, Notes, OutputFile};
/// # use engine::{Engine, Graph, KindEntry, Registry, RunOptions, Source, SourceRoot, Store};
///
/// engine::params! {
///     /// Writes a text file.
///     pub struct WriteText {
///         /// Path of the file, relative to the output folder.
///         path: OutputFile, other("\"other.txt\"");
///         /// The text.
///         text: String = String::new(), other("\"b\"");
///     }
/// }
/// engine::inputs! { pub struct In {} }
/// engine::outputs! { pub struct Out { /** The file. */ files: Arc<Files>, } }
///
/// impl Kind for WriteText {
///     const NAME: &'static str = "write-text";
///     const VERSION: u32 = 1;
///     type Params = Self;
///     type In = In;
///     type Out = Out;
///
///     fn check(params: &Self) -> Result<(), NodeError> {
///         match params.path.extension().as_str() {
///             "txt" => Ok(()),
///             other => Err(NodeError::new(format!("`.{other}` is not a text file")).at("path").hint("use `.txt`")),
///         }
///     }
///
///     fn run(params: &Self, _: In, _: &Context) -> Result<(Out, Notes), NodeError> {
///         // The file does not belong to a view, so its path needs no `{view}`.
///         let file = FileBytes { view: String::new(), bytes: params.text.clone().into_bytes() };
///         Ok((Out { files: Arc::new(Files(vec![file])) }, Notes::none()))
///     }
/// }
///
/// # let folder = tempfile::tempdir()?;
/// # let out = folder.path().to_owned();
/// # let registry = Registry::new(vec![KindEntry::of::<WriteText>()]);
/// let text = r#"Graph(version: 1, scene: (up: "+z"), nodes: (save: WriteText(path: "a.txt", text: "hello")))"#;
/// let graph = Graph::parse(Source::new("text.ron", text), &registry, SourceRoot::new("."))?;
/// let engine = Engine::new(Store::in_memory(), 1, 1 << 30);
/// engine.run(&graph, &RunOptions { out: out.clone(), ..RunOptions::default() }, |_event| {});
/// assert_eq!(std::fs::read_to_string(out.join("a.txt"))?, "hello");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct OutputFile(pub String);

impl OutputFile {
    /// The extension in lower case, without the dot.
    pub fn extension(&self) -> String {
        std::path::Path::new(&self.0).extension().unwrap_or_default().to_string_lossy().to_lowercase()
    }
}

impl ParamType for OutputFile {
    const ROLE: Role = Role::Output;
    fn describe() -> String {
        "path of a file to write".to_owned()
    }
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        Ok(Some(format!("*.{}", self.extension())))
    }
    fn paths(&self) -> Vec<&str> {
        vec![&self.0]
    }
}

/// A parameter whose type is known only at run time.
pub trait ParamValue {
    /// See [`ParamType::key_text`].
    fn key_text(&self) -> Result<Option<String>, NotCanonical>;
    /// The canonical text of the whole value.
    fn text(&self) -> Result<String, NotCanonical>;
    /// [`ParamType::paths`].
    fn paths(&self) -> Vec<&str>;
}

impl<T: ParamType> ParamValue for T {
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        ParamType::key_text(self)
    }
    fn text(&self) -> Result<String, NotCanonical> {
        canonical(self)
    }
    fn paths(&self) -> Vec<&str> {
        ParamType::paths(self)
    }
}

#[cfg(test)]
mod tests {
    use super::ParamType;

    // This test fails if the bounds of an `f32` are compared as `f64`.
    #[test]
    fn the_ends_of_a_range_are_in_it() {
        assert!(0.999_f32.within(0.05, 0.999) && 0.05_f32.within(0.05, 0.999));
        assert!(!0.9991_f32.within(0.05, 0.999) && !f32::NAN.within(0.05, 0.999));
        assert!(3_u32.within(3.0, 4.0) && !5_u32.within(3.0, 4.0) && !(-1_i32).within(0.0, 4.0));
    }
}

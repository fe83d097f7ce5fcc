//! Parameters: typed values of a node, declared once with default, range, unit and doc.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::fields::Fields;
use crate::knob::Knob;

/// A type that a parameter may have. Its RON form is its canonical form: equal values, equal text.
pub trait ParamType:
    Serialize + DeserializeOwned + Clone + PartialEq + std::fmt::Debug + Send + Sync
{
    /// What a person writes, as in `number` or `Hard | Ramp`.
    fn describe() -> String;
    /// What the parameter names outside of the graph.
    const ROLE: Role = Role::Value;
    /// True when every number in the value lies in the closed range.
    fn within(&self, _low: f64, _high: f64) -> bool {
        true
    }
    /// The text that enters the key; `None` when something else stands for it there.
    fn key_text(&self) -> Result<Option<String>, NotCanonical> {
        canonical(self).map(Some)
    }
    /// The paths, for those that name files.
    fn paths(&self) -> Vec<&str> {
        Vec::new()
    }
}

/// What a parameter names outside of the graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Nothing: a plain value.
    Value,
    /// A file to read, relative to the graph file.
    Input,
    /// A file to write, relative to the output folder. A kind with such a parameter is a sink.
    Output,
}

/// A number that has no place in a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a finite number")]
pub struct NotCanonical(pub String);

/// RON text that is equal for equal values: shortest floats, no layout, `-0` written `0`.
pub fn canonical<T: Serialize>(value: &T) -> Result<String, NotCanonical> {
    let text = ron::to_string(value).map_err(|e| NotCanonical(e.to_string()))?;
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
        // A list of files to read stands in the key as the list of their contents.
        Ok((T::ROLE != Role::Input)
            .then(|| format!("[{}]", texts.into_iter().flatten().collect::<Vec<_>>().join(","))))
    }
    fn paths(&self) -> Vec<&str> {
        self.iter().flat_map(T::paths).collect()
    }
    fn describe() -> String {
        format!("[{}, ..]", T::describe())
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

/// A file that a node reads: a path relative to the graph file, or absolute. In keys the digest of its
/// content stands for it, so the kind must list it in its sources.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct InputFile(pub String);

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

/// A file that a sink writes: a path relative to the output folder. `{view}` stands for the name of
/// each view. Only the ending, which names the format, is part of the key.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct OutputFile(pub String);

impl OutputFile {
    /// The ending in lower case, without the dot.
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

/// A parameter as the reference page and the table-driven tests see it.
#[derive(Debug, Clone)]
pub struct ParamSpec {
    /// Name in the graph file.
    pub name: &'static str,
    /// What it does.
    pub doc: &'static str,
    /// What a person writes.
    pub describe: fn() -> String,
    /// Canonical text of the default, made when asked for; `None` where the parameter must be given.
    pub default: fn() -> Option<String>,
    /// Closed range of every number in it.
    pub range: Option<(f64, f64)>,
    /// Unit, empty where there is none.
    pub unit: &'static str,
    /// Another valid value in RON, which the tests set in place of the default.
    pub other: Option<&'static str>,
    /// Why another value may leave the output as it is (a speed setting, say).
    pub inert: Option<&'static str>,
    /// How it trades work for accuracy, where it does.
    pub knob: Option<Knob>,
    /// What it names outside of the graph.
    pub role: Role,
}

/// The parameters of a kind; written by [`params!`](crate::params).
pub trait Params: Sized + std::fmt::Debug + Clone + PartialEq + Send + Sync + 'static {
    /// The doc comment of the struct, which is the doc of the kind.
    const DOC: &'static str;
    /// One entry a parameter, in the order of declaration.
    fn specs() -> Vec<ParamSpec>;
    /// Reads the fields of a node; every mistake is reported to `fields`, and then there is no value.
    fn read(fields: &mut Fields<'_, '_>) -> Option<Self>;
    /// Visits (name, value) in the order of declaration.
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue));
}

/// A kind's own parameters, and those that it shares with others; the doc is that of its own.
impl<Own: Params, Shared: Params> Params for (Own, Shared) {
    const DOC: &'static str = Own::DOC;
    fn specs() -> Vec<ParamSpec> {
        [Own::specs(), Shared::specs()].concat()
    }
    fn read(fields: &mut Fields<'_, '_>) -> Option<Self> {
        // Both, so that all mistakes are told.
        let (own, shared) = (Own::read(fields), Shared::read(fields));
        Some((own?, shared?))
    }
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue)) {
        self.0.visit(visit);
        self.1.visit(visit);
    }
}

/// A parameter of unknown type.
pub trait ParamValue {
    /// [`ParamType::key_text`].
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

/// Declares the parameters of a kind. Where every one has a default, so has the struct, for code that has no graph.
///
/// ```
/// engine::params! {
///     /// Resamples cube faces into a panorama.
///     pub struct Stitch {
///         /// Width of the panorama; the height is half of it.
///         width_px: u32 = 2048, range(16, 16384), unit("px"), other("64"),
///             knob(Resolution, "256", "512", "1024", "4096");
///         /// Where to read from; has no default, so it must be given.
///         path: engine::InputFile, other("\"b.ply\"");
///     }
/// }
/// let specs = <Stitch as engine::Params>::specs();
/// assert_eq!((specs[0].default)().as_deref(), Some("2048"));
/// assert_eq!(specs[0].range, Some((16.0, 16384.0)));
///
/// engine::params! {
///     /// Softens a shadow.
///     pub struct Soften { /** Exponent. */ gamma: f64 = 0.8; /** Strength. */ lambda: f64 = 1.0; }
/// }
/// let half = Soften { lambda: 0.5, ..Soften::default() };
/// assert_eq!(half, Soften { gamma: 0.8, lambda: 0.5 });
/// ```
#[macro_export]
macro_rules! params {
    ($(#[doc = $sdoc:literal])* $vis:vis struct $name:ident {
        $($(#[doc = $doc:literal])* $field:ident: $type:ty $(= $default:expr)? $(, $attr:ident($($arg:tt)*))*;)*
    }) => {
        $(#[doc = $sdoc])*
        #[derive(Debug, Clone, PartialEq)]
        $vis struct $name { $($(#[doc = $doc])* pub $field: $type,)* }
        $crate::params!(@defaults $name { $($field $(= $default)?;)* });
        impl $crate::Params for $name {
            const DOC: &'static str = concat!($($sdoc, "\n"),*);
            fn specs() -> Vec<$crate::ParamSpec> {
                vec![$({
                    #[allow(unused_mut, reason = "not every parameter has attributes")]
                    let mut spec = $crate::ParamSpec {
                        name: stringify!($field), doc: concat!($($doc, "\n"),*).trim_ascii(),
                        describe: <$type as $crate::ParamType>::describe,
                        default: || $crate::params!(@default $type $(= $default)?)
                            .map(|v| $crate::canonical(&v).expect("a default is a finite value")),
                        range: None, unit: "", other: None, inert: None, knob: None,
                        role: <$type as $crate::ParamType>::ROLE,
                    };
                    $($crate::params!(@attr spec $attr($($arg)*));)*
                    spec
                }),*]
            }
            #[allow(unused_variables, reason = "a kind may have no parameters")]
            fn read(fields: &mut $crate::Fields<'_, '_>) -> Option<Self> {
                $(let $field: Option<$type> = fields.parameter(
                    stringify!($field),
                    $crate::params!(@default $type $(= $default)?),
                    $crate::params!(@range $($attr($($arg)*))*),
                );)*
                Some(Self { $($field: $field?,)* })
            }
            #[allow(unused_variables, reason = "a kind may have no parameters")]
            fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn $crate::ParamValue)) {
                $(visit(stringify!($field), &self.$field);)*
            }
        }
    };
    (@defaults $name:ident { $($field:ident = $default:expr;)* }) => {
        impl Default for $name {
            fn default() -> Self { Self { $($field: $default,)* } }
        }
    };
    (@defaults $name:ident { $($rest:tt)* }) => {};
    (@default $type:ty) => { None::<$type> };
    (@default $type:ty = $default:expr) => { Some::<$type>($default) };
    (@attr $spec:ident range($low:expr, $high:expr)) => { $spec.range = Some(($low as f64, $high as f64)); };
    (@attr $spec:ident unit($unit:expr)) => { $spec.unit = $unit; };
    (@attr $spec:ident other($other:expr)) => { $spec.other = Some($other); };
    (@attr $spec:ident inert($why:expr)) => { $spec.inert = Some($why); };
    (@attr $spec:ident knob($kind:ident, $draft:expr, $preview:expr, $final:expr, $reference:expr)) => {
        $spec.knob = Some($crate::Knob {
            kind: $crate::KnobKind::$kind,
            ladder: [$draft, $preview, $final, $reference],
        });
    };
    (@range) => { None };
    (@range range($low:expr, $high:expr) $($rest:tt)*) => { Some(($low as f64, $high as f64)) };
    (@range $attr:ident($($arg:tt)*) $($rest:tt)*) => { $crate::params!(@range $($rest)*) };
}

/// Declares a parameter type that is one of several words, each documented.
///
/// ```
/// engine::choices! {
///     /// How the darker exposure replaces the brighter one.
///     pub enum Blend { /** At the threshold, as the paper. */ Hard, /** Over a ramp. */ Ramp }
/// }
/// assert_eq!(<Blend as engine::ParamType>::describe(), "Hard | Ramp");
/// ```
#[macro_export]
macro_rules! choices {
    ($(#[doc = $sdoc:literal])* $vis:vis enum $name:ident { $($(#[doc = $doc:literal])* $variant:ident),* $(,)? }) => {
        $(#[doc = $sdoc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, $crate::serde::Serialize, $crate::serde::Deserialize)]
        #[serde(crate = "engine::serde")]
        $vis enum $name { $($(#[doc = $doc])* $variant,)* }
        impl $crate::ParamType for $name {
            fn describe() -> String { [$(stringify!($variant)),*].join(" | ") }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::ParamType;

    // Mutation: the bounds of f32 compared in f64.
    #[test]
    fn the_ends_of_a_range_are_in_it() {
        assert!(0.999_f32.within(0.05, 0.999) && 0.05_f32.within(0.05, 0.999));
        assert!(!0.9991_f32.within(0.05, 0.999) && !f32::NAN.within(0.05, 0.999));
        assert!(3_u32.within(3.0, 4.0) && !5_u32.within(3.0, 4.0) && !(-1_i32).within(0.0, 4.0));
    }
}

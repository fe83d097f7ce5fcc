//! Parameters: typed values of a node, declared with default, range, unit and documentation.

use crate::kind::fields::Fields;
use crate::kind::knob::Knob;
use crate::kind::param_type::{ParamValue, Role};

/// Description of a parameter, for reference pages and tests.
#[derive(Debug, Clone)]
pub struct ParamSpec {
    /// Name in the graph file.
    pub name: &'static str,
    /// Documentation.
    pub doc: &'static str,
    /// Description of the values.
    pub describe: fn() -> String,
    /// Names of the choices, each with its documentation; empty if the type has no choices.
    pub choices: fn() -> Vec<(&'static str, &'static str)>,
    /// Canonical text of the default; `None` if the parameter is required.
    pub default: fn() -> Option<String>,
    /// Closed interval in which every number in the value must lie; `None` if there is no limit.
    pub range: Option<(f64, f64)>,
    /// Unit, or an empty string.
    pub unit: &'static str,
    /// Another valid value in RON, for tests.
    pub other: Option<&'static str>,
    /// The reason why another value may give the same output, for example because the parameter affects only speed.
    pub inert: Option<&'static str>,
    /// The knob, if the parameter trades work for accuracy.
    pub knob: Option<Knob>,
    /// Role: a plain value, or a file.
    pub role: Role,
}

/// The parameters of a kind; implemented by [`params!`](crate::params).
pub trait Params: Sized + std::fmt::Debug + Clone + PartialEq + Send + Sync + 'static {
    /// The documentation of the kind.
    const DOC: &'static str;
    /// The parameters in the order of declaration.
    fn specs() -> Vec<ParamSpec>;
    /// Reads the fields of a node. Mistakes are reported to `fields`, and the result is then `None`.
    fn read(fields: &mut Fields<'_, '_>) -> Option<Self>;
    /// Visits (name, value) in the order of declaration.
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue));
}

/// The parameters of one kind, followed by parameters that several kinds share. The documentation comes from `Own`.
impl<Own: Params, Shared: Params> Params for (Own, Shared) {
    const DOC: &'static str = Own::DOC;
    fn specs() -> Vec<ParamSpec> {
        [Own::specs(), Shared::specs()].concat()
    }
    fn read(fields: &mut Fields<'_, '_>) -> Option<Self> {
        // Both are read before `?`, so that all mistakes are reported.
        let (own, shared) = (Own::read(fields), Shared::read(fields));
        Some((own?, shared?))
    }
    fn visit(&self, visit: &mut dyn FnMut(&'static str, &dyn ParamValue)) {
        self.0.visit(visit);
        self.1.visit(visit);
    }
}

/// Declares the parameters of a kind. If every parameter has a default, the struct implements `Default`, for code
/// that does not read a graph.
///
/// ```
/// engine::params! {
///     /// Resamples cube faces into a panorama.
///     pub struct Stitch {
///         /// Width of the panorama; the height is half of it.
///         width_px: u32 = 2048, range(16, 16384), unit("px"), other("64"),
///             knob(Resolution, "256", "512", "1024", "4096");
///         /// The file to read. It has no default, so it must be given.
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
                        choices: <$type as $crate::ParamType>::choices,
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

/// Declares a parameter type whose values are a fixed set of words, each with documentation.
///
/// ```
/// engine::choices! {
///     /// How the darker exposure replaces the brighter one.
///     pub enum Blend { /** At the threshold, as in the paper. */ Hard, /** Over a ramp. */ Ramp }
/// }
/// assert_eq!(<Blend as engine::ParamType>::describe(), "Hard | Ramp");
/// assert_eq!(<Blend as engine::ParamType>::choices()[1], ("Ramp", "Over a ramp."));
/// ```
#[macro_export]
macro_rules! choices {
    ($(#[doc = $sdoc:literal])* $vis:vis enum $name:ident { $($(#[doc = $doc:literal])+ $variant:ident),* $(,)? }) => {
        $(#[doc = $sdoc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, $crate::serde::Serialize, $crate::serde::Deserialize)]
        #[serde(crate = "engine::serde")]
        $vis enum $name { $($(#[doc = $doc])* $variant,)* }
        impl $crate::ParamType for $name {
            fn describe() -> String { [$(stringify!($variant)),*].join(" | ") }
            fn choices() -> Vec<(&'static str, &'static str)> {
                vec![$((stringify!($variant), concat!($($doc, "\n"),*).trim_ascii())),*]
            }
        }
    };
}

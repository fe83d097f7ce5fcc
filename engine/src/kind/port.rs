//! Ports: the named, typed ends of wires.

use std::sync::Arc;

use crate::value::artifact::{AnyArtifact, Artifact, ArtifactType};

/// Number of wires of an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arity {
    /// Exactly one.
    One,
    /// Zero or one.
    Optional,
    /// Any number. The order of the wires matters.
    Many,
}

/// Description of a port, for the graph check and reference pages.
#[derive(Debug, Clone, Copy)]
pub struct PortSpec {
    /// Name in the graph file.
    pub name: &'static str,
    /// Documentation.
    pub doc: &'static str,
    /// Number of wires; [`Arity::One`] for outputs.
    pub arity: Arity,
    /// Type of the values.
    pub artifact: ArtifactType,
}

/// The wiring of a node: for each port, the names of the outputs that its wires come from.
#[derive(Debug, Clone, Default)]
pub struct Wired(pub(crate) Vec<(&'static str, Vec<&'static str>)>);

impl Wired {
    /// The names of the outputs wired to `input`, one per wire: `["colour", "depth"]`.
    pub fn of(&self, input: &str) -> &[&'static str] {
        self.0.iter().find(|(port, _)| *port == input).map_or(&[], |(_, names)| names)
    }
}

/// A field of an input struct: `Arc<T>`, `Option<Arc<T>>` or `Vec<Arc<T>>`.
pub trait InPort: Sized {
    /// Number of wires.
    const ARITY: Arity;
    /// Type of the values.
    fn artifact() -> ArtifactType;
    /// Converts the values of the wires to the type of the field. Their number and types must have been checked, as
    /// the graph check does.
    fn take(values: Vec<AnyArtifact>) -> Self;
}

fn typed<T: Artifact>(value: AnyArtifact) -> Arc<T> {
    value.downcast().expect("the graph check matched port types")
}

impl<T: Artifact> InPort for Arc<T> {
    const ARITY: Arity = Arity::One;
    fn artifact() -> ArtifactType {
        ArtifactType::of::<T>()
    }
    fn take(values: Vec<AnyArtifact>) -> Self {
        typed(values.into_iter().next().expect("the graph check requires this wire"))
    }
}

impl<T: Artifact> InPort for Option<Arc<T>> {
    const ARITY: Arity = Arity::Optional;
    fn artifact() -> ArtifactType {
        ArtifactType::of::<T>()
    }
    fn take(values: Vec<AnyArtifact>) -> Self {
        values.into_iter().next().map(typed)
    }
}

impl<T: Artifact> InPort for Vec<Arc<T>> {
    const ARITY: Arity = Arity::Many;
    fn artifact() -> ArtifactType {
        ArtifactType::of::<T>()
    }
    fn take(values: Vec<AnyArtifact>) -> Self {
        values.into_iter().map(typed).collect()
    }
}

/// The inputs of a kind; implemented by [`inputs!`](crate::inputs).
pub trait Inputs: Sized {
    /// The ports in the order of declaration, which is also the order in keys.
    fn ports() -> Vec<PortSpec>;
    /// Builds the inputs from one list of values per port.
    fn take(values: Vec<Vec<AnyArtifact>>) -> Self;
}

/// The outputs of a kind; implemented by [`outputs!`](crate::outputs). The first port is the default.
pub trait Outputs: Sized {
    /// The ports, in the order of declaration.
    fn ports() -> Vec<PortSpec>;
    /// Returns one value per port, in the order of the ports.
    fn give(self) -> Vec<AnyArtifact>;
}

/// Declares the inputs of a kind: `inputs! { pub struct In { /** doc */ views: Arc<Views>, } }`.
#[macro_export]
macro_rules! inputs {
    ($(#[doc = $sdoc:literal])* $vis:vis struct $name:ident { $($(#[doc = $doc:literal])* $field:ident: $type:ty),* $(,)? }) => {
        $(#[doc = $sdoc])*
        $vis struct $name { $($(#[doc = $doc])* pub $field: $type,)* }
        impl $crate::Inputs for $name {
            fn ports() -> Vec<$crate::PortSpec> {
                vec![$($crate::PortSpec {
                    name: stringify!($field), doc: concat!($($doc, "\n"),*).trim_ascii(),
                    arity: <$type as $crate::InPort>::ARITY, artifact: <$type as $crate::InPort>::artifact(),
                }),*]
            }
            #[allow(unused_mut, unused_variables, reason = "a kind may have no inputs")]
            fn take(values: Vec<Vec<$crate::AnyArtifact>>) -> Self {
                let mut values = values.into_iter();
                Self { $($field: <$type as $crate::InPort>::take(values.next().unwrap_or_default()),)* }
            }
        }
    };
}

/// Declares the outputs of a kind: `outputs! { pub struct Out { /** doc */ pano: Arc<Panorama>, } }`.
#[macro_export]
macro_rules! outputs {
    ($(#[doc = $sdoc:literal])* $vis:vis struct $name:ident { $($(#[doc = $doc:literal])* $field:ident: $type:ty),* $(,)? }) => {
        $(#[doc = $sdoc])*
        $vis struct $name { $($(#[doc = $doc])* pub $field: $type,)* }
        impl $crate::Outputs for $name {
            fn ports() -> Vec<$crate::PortSpec> {
                vec![$($crate::PortSpec {
                    name: stringify!($field), doc: concat!($($doc, "\n"),*).trim_ascii(),
                    arity: $crate::Arity::One, artifact: <$type as $crate::InPort>::artifact(),
                }),*]
            }
            fn give(self) -> Vec<$crate::AnyArtifact> {
                vec![$(self.$field),*]
            }
        }
    };
}

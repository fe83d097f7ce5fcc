//! Reads the fields of a node as the parameters of its kind.

use std::ops::Range;

use crate::kind::param_type::ParamType;
use crate::text::diag::{Code, Diagnostic, shown};
use crate::text::document::RawField;
use crate::text::values::{parse_value, value_mistake, with_article};

/// Reads a value. A choice whose fields all have defaults may be written without parentheses: `Room` for `Room()`.
fn read_value<T: ParamType>(text: &str) -> Result<T, ron::Error> {
    parse_value::<T>(text).or_else(|error| {
        let is_word = text.starts_with(|c: char| c.is_ascii_uppercase())
            && text.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        if is_word && !matches!(error, ron::Error::NoSuchEnumVariant { .. }) {
            parse_value::<T>(&format!("{text}()")).map_err(|_| error)
        } else {
            Err(error)
        }
    })
}

/// The fields of a node while its parameters are read. Collects all mistakes.
pub struct Fields<'t, 'a> {
    pub(crate) fields: &'a [RawField<'t>],
    pub(crate) node_span: Range<usize>,
    pub(crate) kind: &'a str,
    pub(crate) diagnostics: &'a mut Vec<Diagnostic>,
}

impl Fields<'_, '_> {
    /// Reads a parameter. Returns its value or its default, or reports a mistake and returns `None`.
    pub fn parameter<T: ParamType>(
        &mut self,
        name: &'static str,
        default: Option<T>,
        range: Option<(f64, f64)>,
    ) -> Option<T> {
        let Some(field) = self.fields.iter().find(|field| field.name == name) else {
            if default.is_none() {
                self.diagnostics.push(
                    Diagnostic::of(
                        Code::Missing,
                        self.node_span.clone(),
                        format!("`{}` needs `{name}`", self.kind),
                    )
                    .label(format!("expected {}", with_article(&T::describe()))),
                );
            }
            return default;
        };
        let between = |(low, high): (f64, f64)| format!("must lie between {low} and {high}");
        let value = match read_value::<T>(field.text) {
            Ok(value) => value,
            Err(error) => {
                let (span, range) = (field.span.clone(), range.map(between));
                self.diagnostics.push(value_mistake(name, &T::describe(), field.text, &error, span, range));
                return None;
            }
        };
        if let Err(error) = value.key_text() {
            let message = format!("`{name}`: {error}");
            self.diagnostics.push(Diagnostic::of(Code::WrongValue, field.span.clone(), message));
            return None;
        }
        match range {
            Some((low, high)) if !value.within(low, high) => {
                let message = format!("`{name}` is out of range: {}", shown(field.text));
                self.diagnostics.push(
                    Diagnostic::of(Code::OutOfRange, field.span.clone(), message).label(between((low, high))),
                );
                None
            }
            _ => Some(value),
        }
    }
}

//! placeholder: replaced below
use std::ops::Range;

use crate::diag::Diagnostic;
use crate::param::ParamType;

/// A field of a node as it stands in the text.
#[derive(Debug, Clone)]
pub(crate) struct RawField<'t> {
    pub name: &'t str,
    pub name_span: Range<usize>,
    pub text: &'t str,
    pub span: Range<usize>,
}

/// The fields of one node while its parameters are read.
pub struct Fields<'t, 'a> {
    pub(crate) fields: &'a [RawField<'t>],
    pub(crate) node_span: Range<usize>,
    pub(crate) kind: &'a str,
    pub(crate) diagnostics: &'a mut Vec<Diagnostic>,
}

impl Fields<'_, '_> {
    /// Reads one parameter; every mistake is reported.
    pub fn parameter<T: ParamType>(
        &mut self,
        name: &'static str,
        default: Option<T>,
        range: Option<(f64, f64)>,
    ) -> Option<T> {
        let Some(field) = self.fields.iter().find(|f| f.name == name) else {
            if default.is_none() {
                self.diagnostics.push(
                    Diagnostic::new(self.node_span.clone(), format!("`{}` needs `{name}`", self.kind))
                        .label(format!("`{name}` is missing: {}", T::describe())),
                );
            }
            return default;
        };
        match parse_value::<T>(field.text) {
            Ok(value) => {
                if let Err(error) = value.key_text() {
                    self.diagnostics
                        .push(Diagnostic::new(field.span.clone(), error.to_string()).label("must be finite"));
                    return None;
                }
                if let Some((low, high)) = range
                    && !value.within(low, high)
                {
                    self.diagnostics.push(
                        Diagnostic::new(field.span.clone(), format!("`{name}` is out of range"))
                            .label(format!("must lie in {low} ..= {high}")),
                    );
                    return None;
                }
                Some(value)
            }
            Err(mut diagnostic) => {
                diagnostic.span =
                    field.span.start + diagnostic.span.start..field.span.start + diagnostic.span.end;
                diagnostic.message = format!("`{name}`: {}", diagnostic.message);
                self.diagnostics.push(diagnostic);
                None
            }
        }
    }
}

fn parse_value<T: ParamType>(text: &str) -> Result<T, Diagnostic> {
    let options = ron::Options::default().with_default_extension(ron::extensions::Extensions::IMPLICIT_SOME);
    options.from_str(text).map_err(|e| Diagnostic::new(0..text.len(), e.to_string()))
}

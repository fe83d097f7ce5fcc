//! The check of the parameters of nodes: their values, source files and output paths.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use crate::graph::axis::{Axis, axes_read};
use crate::graph::axis_names::{is_held, with_value};
use crate::graph::checker::{Check, Field, Template};
use crate::graph::node::{FieldPlaces, Node};
use crate::kind::fields::Fields;
use crate::kind::param_type::Role;
use crate::kind::registry::{KindEntry, Step};
use crate::text::diag::{Code, Diagnostic};
use crate::text::document::{RawField, RawNode};
use crate::text::include::outside;
use crate::text::source::folder_of;
use crate::text::subgraph::{in_place, strings};
use crate::value::root::InputFile;

impl<'t, 'a> Check<'t, 'a> {
    /// Checks the parameters of a single node in a graph without axes. Returns its parameters, its output path and
    /// the byte ranges of its fields. Wires are not checked.
    pub fn alone(
        &mut self,
        raw: &RawNode<'t>,
        kind: &Arc<KindEntry>,
    ) -> Option<(Arc<dyn Step>, Option<String>, FieldPlaces)> {
        let mut fields = Vec::with_capacity(raw.fields.len());
        for field in &raw.fields {
            if let Some(param) = kind.params.iter().find(|param| param.name == field.name) {
                fields.push(self.field(field, param.role == Role::Input).ok()?.0);
            }
        }
        let (step, sink_path) = self.step(raw, kind, &fields)?;
        Some((step, sink_path, places(raw, kind, &fields)))
    }

    /// Returns a field with each `Param` call replaced by its value, and the indices of the axes that the field
    /// reads, by calls or by placeholders in the paths of files to read.
    pub(super) fn field(
        &self,
        raw: &RawField<'t>,
        is_path: bool,
    ) -> Result<(Field<'t>, Vec<usize>), Diagnostic> {
        let source = self.source;
        let folder_at = |offset: usize| folder_of(source.piece(offset));
        let folders: Option<&dyn Fn(usize) -> &'t str> = if is_path { Some(&folder_at) } else { None };
        let (text, span) = in_place(raw, self.scopes, folders)?;
        let mut axes = axes_read(&text, &span, &self.axes)?;
        if is_path {
            let held = |(index, axis): (usize, &Axis<'_>)| is_held(&text, axis.name).then_some(index);
            axes.extend(self.axes.iter().enumerate().filter_map(held));
        }
        Ok((Field { name: raw.name, text, span, is_path }, axes))
    }

    /// Reads the parameters of a node from fields in which axis calls are already replaced by values. Returns the
    /// parameters and the output path.
    pub fn step(
        &mut self,
        raw: &RawNode<'t>,
        kind: &Arc<KindEntry>,
        fields: &[Field<'_>],
    ) -> Option<(Arc<dyn Step>, Option<String>)> {
        let texts: Vec<RawField<'_>> = fields
            .iter()
            .map(|field| RawField { span: field.span.clone(), ..RawField::plain(field.name, &field.text) })
            .collect();
        let before = self.diagnostics.len();
        let step = (kind.read)(&mut Fields {
            fields: &texts,
            node_span: raw.kind_span.clone(),
            kind: raw.kind,
            diagnostics: self.diagnostics,
        });
        let mistaken: Vec<Range<usize>> =
            self.diagnostics[before..].iter().map(|one| one.span.clone()).collect();
        for param in kind.params.iter().filter(|param| param.role == Role::Input) {
            // A field with an invalid value does not name a file.
            let sound = |field: &&Field<'_>| {
                field.name == param.name && !mistaken.iter().any(|span| field.span.contains(&span.start))
            };
            if let Some(field) = fields.iter().find(sound) {
                // The download hint is given once per node.
                let mut supplied = kind.supplied;
                for (path, _) in strings(&field.text) {
                    self.source(kind, field, path, &mut supplied);
                }
            }
        }
        let step = step?;
        let mut sink_path = None;
        if let Some(param) = kind.sink_param() {
            step.visit(&mut |name, value| {
                if name == param.name {
                    sink_path = value.paths().first().map(|path| (*path).to_owned());
                }
            });
        }
        if let Err(error) = step.check() {
            let place =
                |name: &str| fields.iter().find(|field| field.name == name).map(|field| field.span.clone());
            let span = error.field.and_then(place).unwrap_or(raw.kind_span.clone());
            self.report(Diagnostic::caused_by(Code::Parameters, span, error));
        }
        Some((step, sink_path))
    }

    /// Checks that a source file exists. It must not be a folder unless the kind reads folders. If the file is
    /// missing, the download hint is moved from `supplied` to the diagnostic, so that it is shown only once.
    fn source(&mut self, kind: &KindEntry, field: &Field<'_>, path: String, supplied: &mut Option<&str>) {
        let file = self.root.file(&InputFile(path.clone()));
        let place = field.span.clone();
        if self.root.is_outside(&file) {
            self.report(outside(&path, place));
        } else if !file.path.exists() {
            let mut diagnostic = Diagnostic::of(Code::MissingFile, place, format!("`{path}` does not exist"))
                .label(format!("looked for {}", file.path.display()))
                .hint("paths are relative to the folder of the file that names them");
            diagnostic.hints.extend(supplied.take().map(str::to_owned));
            self.report(diagnostic);
        } else if !kind.folders && file.path.is_dir() {
            let what = format!("`{path}` is a folder; `{}` reads a file", kind.camel_name());
            self.report(Diagnostic::of(Code::MissingFile, place, what));
        }
        self.files.push(file.path);
    }

    pub(super) fn sink_paths(&mut self, templates: &[Option<Template<'_, 't>>]) {
        let mut seen: BTreeMap<String, &Node> = BTreeMap::new();
        for Template { node, .. } in templates.iter().flatten() {
            let Some(path) = &node.sink_path else { continue };
            if let Err(why) = check_sink_path(path, &self.axes) {
                self.report(Diagnostic::of(
                    Code::OutputPath,
                    node.place(Some("path")),
                    format!("cannot write to `{path}`: {why}"),
                ));
                continue;
            }
            let plain =
                path.split('/').filter(|part| !matches!(*part, "" | ".")).collect::<Vec<_>>().join("/");
            if let Some(first) = seen.get(&plain) {
                self.report(
                    Diagnostic::of(
                        Code::OutputPath,
                        node.place(Some("path")),
                        format!("two sinks write to `{path}`"),
                    )
                    .label(format!("`{}`", node.id))
                    .related(first.place(Some("path")), format!("`{}`", first.id)),
                );
            } else {
                seen.insert(plain, node);
            }
        }
    }
}

/// The byte ranges of the fields of a node. If a field consists of a single `Param` call, its range is the byte
/// range of the parameter's value.
pub(crate) fn places(raw: &RawNode<'_>, kind: &KindEntry, fields: &[Field<'_>]) -> FieldPlaces {
    let place = |name: &'static str| {
        let param = fields.iter().find(|field| field.name == name).map(|field| field.span.clone());
        let wire = || raw.fields.iter().find(|field| field.name == name).map(|field| field.span.clone());
        Some((name, param.or_else(wire)?))
    };
    let names = kind.params.iter().map(|p| p.name).chain(kind.inputs.iter().map(|p| p.name));
    names.filter_map(place).collect()
}

/// Checks that the path of a sink names a file inside the output folder and contains only known placeholders.
/// Otherwise returns the reason why the path is not permitted.
fn check_sink_path(path: &str, axes: &[Axis<'_>]) -> Result<(), &'static str> {
    use std::path::Component;
    if path.is_empty() || path.ends_with('/') {
        return Err("the path does not name a file");
    }
    let mut plain = path.replace("{view}", "");
    for axis in axes {
        plain = with_value(&plain, axis.name, |_| String::new());
    }
    if plain.contains(['{', '}']) {
        return Err(
            "a placeholder must be `{view}`, which stands for the name of the view, or the name of an axis",
        );
    }
    // These characters have other meanings on other systems.
    if plain.contains(['\\', ':']) || path.chars().any(char::is_control) {
        return Err("`\\` and `:` are not permitted; write `/` between folders");
    }
    for part in std::path::Path::new(path).components() {
        match part {
            Component::Normal(_) | Component::CurDir => {}
            Component::ParentDir => return Err("`..` could lead out of the output folder"),
            Component::RootDir | Component::Prefix(_) => {
                return Err("the path must be relative to the output folder");
            }
        }
    }
    Ok(())
}

//! Number of cameras of a node, determined before the graph runs. It is needed for the axis `Cameras("rig")`.

use crate::graph::axis::reads_axis;
use crate::graph::checker::{Check, GATHER};
use crate::graph::wires::wire_names;
use crate::kind::contract::ViewCount;
use crate::kind::registry::Registry;
use crate::text::diag::{Code, Diagnostic, nearest, shown};
use crate::text::document::{Document, RawField, RawNode};
use crate::text::source::Source;
use crate::value::root::SourceRoot;

/// Maximum number of nodes to visit upstream of a node in the search for a node whose number of cameras is known.
const MOST_STEPS: usize = 1000;

/// Returns the number of cameras of the node `name`, to which the axis `axis` refers. Returns `None` if that node
/// has a mistake, which the check of the nodes reports.
///
/// # Errors
/// If there is no such node, if the node varies along an axis, or if its number of cameras is not known before the
/// node runs.
pub(crate) fn cameras_of<'t>(
    name: &str,
    axis: &RawField<'t>,
    (source, registry, root): (&'t Source, &Registry, &SourceRoot),
    document: &Document<'t>,
) -> Result<Option<usize>, Diagnostic> {
    let wrong = |code: Code, message: String| Diagnostic::of(code, axis.span.clone(), message);
    let prefix = document.scopes.get(axis.scope).map_or("", |scope| scope.prefix.as_str());
    let mut wanted = format!("{prefix}{name}");
    for _ in 0..MOST_STEPS {
        let Some(node) = node_of(&wanted, document) else {
            if document.broken.iter().any(|broken| wanted == **broken) {
                return Ok(None);
            }
            let mistake = wrong(Code::UnknownNode, format!("no node is named `{}`", shown(name)));
            let names = document.nodes.iter().filter_map(|node| node.id.strip_prefix(prefix));
            return Err(match nearest(name, names) {
                Some(near) => mistake.hint(format!("did you mean `{near}`?")),
                None => mistake,
            });
        };
        let unknown = |why: &str| {
            wrong(Code::WrongValue, format!("the number of cameras of `{}` {why}", shown(&node.id)))
                .hint(format!("write the number instead: `{}: Range(0, 300)`", axis.name))
        };
        let Some(kind) = registry.get(node.kind) else {
            // An unknown kind is reported by the check of the nodes.
            return if node.kind == GATHER { Err(unknown("varies along an axis")) } else { Ok(None) };
        };
        if node.fields.iter().any(|field| reads_axis(field.text)) {
            let how = "load all cameras in one node without an axis, and pick one of them in another node: \
                       `PickCameras(rig: \"rig\", pick: [Axis(\"frame\")])`";
            return Err(unknown("varies along an axis").hint(how));
        }
        let mut mistakes = Vec::new();
        let mut check = Check::new(source, registry, root, document, &mut mistakes);
        let Some((step, ..)) = check.alone(node, kind).filter(|_| check.mistakes() == 0) else {
            // A mistake in the node is reported by the check of the nodes.
            return if mistakes.is_empty() {
                Err(unknown("is not known before the node runs"))
            } else {
                Ok(None)
            };
        };
        let inputs = match step.views(root) {
            Ok(ViewCount::Known(count)) => return Ok(Some(count)),
            Ok(ViewCount::As(inputs)) => inputs,
            Ok(ViewCount::Unknown) => return Err(unknown("is not known before the node runs")),
            Ok(ViewCount::Uncounted { why, hint }) => {
                let what = format!("the cameras of `{}` cannot be counted: {why}", shown(&node.id));
                let mistake = wrong(Code::WrongValue, what);
                return Err(match hint {
                    Some(hint) => mistake.hint(hint),
                    None => mistake,
                });
            }
            Err(error) => return Err(wrong(Code::WrongValue, error.message().to_owned())),
        };
        let above = inputs.iter().find_map(|input| above(node, input, document));
        let Some(above) = above else { return Err(unknown("is not known before the node runs")) };
        wanted = above;
    }
    Err(wrong(
        Code::WrongValue,
        format!("the number of cameras of `{}` is not known before the node runs", shown(name)),
    ))
}

/// The node to which `name` refers. `name` may end with a dot and the name of an output.
fn node_of<'d, 't>(name: &str, document: &'d Document<'t>) -> Option<&'d RawNode<'t>> {
    let find = |name: &str| document.nodes.iter().find(|node| node.id == name);
    find(name).or_else(|| find(name.rsplit_once('.')?.0))
}

/// The start of the first wire of an input, as written in the graph: `node` or `node.port`, with the full name of
/// the node. `None` if the input has no valid wire.
fn above(node: &RawNode<'_>, input: &str, document: &Document<'_>) -> Option<String> {
    let field = node.fields.iter().find(|field| field.name == input)?;
    let named = wire_names(field, &document.scopes).ok()?.into_iter().next()?;
    Some(format!("{}{}", document.scopes.get(named.scope)?.prefix, named.name))
}

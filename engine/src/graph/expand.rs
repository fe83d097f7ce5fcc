//! Expands nodes along axes. A node gets one instance for each point, that is, for each combination of values of
//! the axes that it or its inputs read.
//!
//! `Gather(input: "final", over: "frame")` is not a node but a name for many wires: one to each instance of `final`
//! along the axis `frame`. A node that reads this gather therefore does not depend on `frame`.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::graph::axis::Axis;
use crate::graph::axis_names::{file_text, is_held, with_value};
use crate::graph::checker::{Check, GATHER, Gather, Template, at_each};
use crate::graph::node::{Node, Wire};
use crate::graph::wires::{End, wire_names};
use crate::text::diag::{Code, Diagnostic, shown};
use crate::text::document::RawNode;
use crate::text::include::parse_all;
use crate::text::source::Source;
use crate::text::values::parse_value;
use crate::value::root::SourceRoot;

/// Maximum number of values of its axes at which missing files of a node are reported one by one.
const MOST_MISSING: usize = 8;
/// Maximum total number of instances in a graph.
const MOST_INSTANCES: usize = 1_000_000;

/// All combinations of the values of a set of axes. In the order of the points, the last axis varies fastest.
#[derive(Debug, Clone, Default, PartialEq)]
struct Grid {
    /// Pairs of axis index and number of values, in ascending order.
    axes: Vec<(usize, usize)>,
}

impl Grid {
    fn new(mut wanted: Vec<usize>, axes: &[Axis<'_>]) -> Self {
        wanted.sort_unstable();
        wanted.dedup();
        Self { axes: wanted.into_iter().map(|axis| (axis, axes[axis].values.len())).collect() }
    }

    fn has(&self, axis: usize) -> bool {
        self.axes.iter().any(|(known, _)| *known == axis)
    }

    /// Number of points; `None` on overflow.
    fn len(&self) -> Option<usize> {
        self.axes.iter().try_fold(1_usize, |product, (_, size)| product.checked_mul(*size))
    }

    /// The point with this index, as pairs of axis index and index of the value.
    fn point(&self, mut index: usize) -> Vec<(usize, usize)> {
        let mut point: Vec<(usize, usize)> = self.axes.clone();
        for (_, value) in point.iter_mut().rev() {
            let size = *value;
            *value = index % size;
            index /= size;
        }
        point
    }

    /// Index of the point at which each axis has the value with index `at(axis)`.
    fn index(&self, at: impl Fn(usize) -> usize) -> usize {
        self.axes.iter().fold(0, |index, (axis, size)| index * size + at(*axis))
    }
}

fn value_at(point: &[(usize, usize)], axis: usize) -> usize {
    point.iter().find(|(known, _)| *known == axis).map_or(0, |(_, value)| *value)
}

impl Source {
    /// Value of the `input` field of the `Gather` with this name; `None` if there is no such `Gather`.
    pub fn gathered(&self, name: &str) -> Option<String> {
        let document = parse_all(self, &SourceRoot::new(""), &mut Vec::new());
        let gather = document.nodes.iter().find(|node| node.kind == GATHER && node.id == name)?;
        let input = gather.fields.iter().find(|field| field.name == "input")?;
        parse_value(input.text).ok()
    }
}

impl<'t> Check<'t, '_> {
    /// Checks a `Gather`. Returns `None` if it has a mistake.
    pub fn gather(&mut self, raw: &RawNode<'t>, all: &[RawNode<'t>]) -> Option<Gather> {
        let before = self.mistakes();
        for field in raw.fields.iter().filter(|field| !["input", "over"].contains(&field.name)) {
            let what = format!("`{GATHER}` has no field `{}`", shown(field.name));
            self.report(
                Diagnostic::new(field.name_span.clone(), what).suggest(field.name, ["input", "over"]),
            );
        }
        let mut named = |name: &str| match raw.fields.iter().find(|field| field.name == name) {
            Some(field) => match wire_names(field, self.scopes) {
                Ok(names) => names,
                Err(mistake) => {
                    self.report(mistake);
                    Vec::new()
                }
            },
            None => {
                let what = format!("`{GATHER}` needs `{name}`");
                let how = "write `Gather(input: \"final\", over: \"frame\")`";
                self.report(Diagnostic::new(raw.kind_span.clone(), what).label(how));
                Vec::new()
            }
        };
        let (inputs, names) = (named("input"), named("over"));
        let mut over = Vec::with_capacity(names.len());
        for named in names {
            let (name, span) = (named.name, named.span);
            match self.axes.iter().position(|axis| axis.name == name) {
                Some(axis) if !over.contains(&axis) => over.push(axis),
                Some(_) => {
                    self.report(Diagnostic::new(span, format!("`over` names the axis `{name}` twice")));
                }
                None => {
                    let mistake = Diagnostic::new(span, format!("the graph has no axis `{}`", shown(&name)));
                    let axes = self.axes.clone();
                    self.report(mistake.suggest(&name, axes.iter().map(|axis| axis.name)));
                }
            }
        }
        if over.is_empty() && self.mistakes() == before {
            let what = "`over` names no axis, so there is nothing to gather";
            self.report(
                Diagnostic::new(raw.kind_span.clone(), what)
                    .hint("connect the node directly, without a `Gather`"),
            );
        }
        if inputs.len() > 1 {
            let what = format!("`input` takes one wire, not {}", inputs.len());
            self.report(
                Diagnostic::new(raw.kind_span.clone(), what).hint("write one `Gather` for each wire"),
            );
        }
        let named = inputs.into_iter().next()?;
        let End { node, output } = self.end(&named)?;
        if all[node].kind == GATHER {
            let what = format!("`{}` is itself a `Gather`", shown(&named.name));
            self.report(
                Diagnostic::new(named.span.clone(), what)
                    .hint("gather along both axes at once: `over: [\"yaw\", \"frame\"]`"),
            );
        }
        (self.mistakes() == before).then(|| Gather { node, output: output.map(str::to_owned), over })
    }

    /// The instances of all nodes, or an empty list after a mistake. The nodes are in the order of the file;
    /// `order` is a topological order of the templates.
    pub fn instances(&mut self, templates: &[Option<Template<'_, 't>>], order: &[usize]) -> Vec<Node> {
        let before = self.mistakes();
        let grids = self.grids(templates, order);
        let counts = || templates.iter().zip(&grids).filter(|(template, _)| template.is_some());
        let total = counts().try_fold(0_usize, |sum, (_, grid)| sum.checked_add(grid.len()?));
        if total.is_none_or(|total| total > MOST_INSTANCES) {
            let widest = counts().max_by_key(|(_, grid)| grid.len().unwrap_or(usize::MAX));
            let span = widest.and_then(|(template, _)| template.as_ref()).map(|t| t.raw.id_span.clone());
            let what = format!("the axes expand the graph to more than {MOST_INSTANCES} nodes");
            self.report(
                Diagnostic::new(span.unwrap_or_default(), what)
                    .label("most of these nodes are instances of this one"),
            );
        }
        if self.mistakes() > before {
            return Vec::new();
        }
        let mut first = Vec::with_capacity(grids.len());
        let mut next = 0;
        for (template, grid) in templates.iter().zip(&grids) {
            first.push(next);
            next += if template.is_some() { grid.len().unwrap_or_default() } else { 0 };
        }
        let mut nodes = Vec::with_capacity(next);
        for (template, grid) in templates.iter().zip(&grids) {
            let Some(template) = template else { continue };
            let mut missing = 0;
            for index in 0..grid.len().unwrap_or_default() {
                let (point, before_this) = (grid.point(index), self.mistakes());
                let node = self.instance(template, &point);
                let found = &self.diagnostics[before_this..];
                let is_sound = found.is_empty();
                if !is_sound && found.iter().all(|one| one.code == Code::MissingFile) {
                    missing += 1;
                    if missing > MOST_MISSING {
                        self.diagnostics.truncate(before_this);
                    }
                    continue;
                }
                // Other mistakes at one value are not repeated for the others.
                let Some(mut node) = node.filter(|_| is_sound) else { break };
                node.inputs = wires(template, &point, &grids, &first);
                nodes.push(node);
            }
            if missing > MOST_MISSING {
                let what =
                    format!("files of {} other values of its axes do not exist", missing - MOST_MISSING);
                self.report(Diagnostic::of(Code::MissingFile, template.raw.id_span.clone(), what));
            }
        }
        // Wires need all instances.
        if self.mistakes() > before { Vec::new() } else { nodes }
    }

    /// For each node, the grid of the axes that its fields read and of the axes of its inputs, except the axes that
    /// its wires gather.
    fn grids(&mut self, templates: &[Option<Template<'_, 't>>], order: &[usize]) -> Vec<Grid> {
        let mut grids: Vec<Grid> = vec![Grid::default(); templates.len()];
        for &index in order {
            let Some(template) = &templates[index] else { continue };
            let mut wanted = template.own.clone();
            for (port, wires) in template.node.inputs.iter().enumerate() {
                for (place, wire) in wires.iter().enumerate() {
                    let gathered = template.gathers.get(&(port, place)).map_or(&[][..], Vec::as_slice);
                    let above = &grids[wire.node];
                    wanted.extend(
                        above.axes.iter().map(|(axis, _)| *axis).filter(|axis| !gathered.contains(axis)),
                    );
                    if let Some(&axis) = gathered.iter().find(|axis| !above.has(**axis)) {
                        let name = templates[wire.node].as_ref().map_or("", |t| &*t.raw.id);
                        let what =
                            format!("`{}` does not vary along `{}`", shown(name), self.axes[axis].name);
                        let span = template.node.place(Some(template.node.kind.inputs[port].name));
                        self.report(Diagnostic::new(span, what).label("there is nothing to gather"));
                    }
                }
            }
            grids[index] = Grid::new(wanted, &self.axes);
            self.sink_axes(template, &grids[index]);
        }
        grids
    }

    /// Checks that a sink has a different path at each point, since it writes one file per point.
    fn sink_axes(&mut self, template: &Template<'_, 't>, grid: &Grid) {
        let Some(path) = &template.node.sink_path else { return };
        let span = || template.node.place(Some("path"));
        for (index, axis) in self.axes.clone().iter().enumerate() {
            let holder = format!("{{{}}}", axis.name);
            let named = is_held(path, axis.name) || template.own.contains(&index);
            if grid.has(index) && is_held(path, axis.name) {
                self.file_names(axis, &span());
            }
            if grid.has(index) && !named {
                let what = format!(
                    "`{path}` names one file, but the sink writes one file for each value of `{}`",
                    axis.name
                );
                self.report(Diagnostic::new(span(), what).hint(format!("put `{holder}` into the path")));
            } else if !grid.has(index) && is_held(path, axis.name) {
                let what = format!("`{}` does not vary along `{}`", template.node.id, axis.name);
                self.report(Diagnostic::new(span(), what).hint(format!("leave `{holder}` out of the path")));
            }
        }
    }

    /// Reports a mistake if two values of an axis give the same file name.
    fn file_names(&mut self, axis: &Axis<'_>, span: &Range<usize>) {
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        for value in 0..axis.values.len() {
            if let Some(first) = seen.insert(file_text(&axis.values[value], axis.padding, None), value) {
                let (a, b) = (shown(&axis.values[first]), shown(&axis.values[value]));
                let what = format!("the values {a} and {b} of `{}` give the same file name", axis.name);
                return self.report(Diagnostic::new(span.clone(), what).hint("change one of the values"));
            }
        }
    }

    /// The instance of a node at a point. Its wires still refer to templates, not to instances.
    fn instance(&mut self, template: &Template<'_, 't>, point: &[(usize, usize)]) -> Option<Node> {
        let mut node = template.node.clone();
        if point.is_empty() {
            return Some(node);
        }
        let axes = self.axes.clone();
        if !template.own.is_empty() {
            let fields = at_each(&template.fields, &axes, |axis| value_at(point, axis));
            let (step, sink_path) = self.step(template.raw, &template.node.kind, &fields)?;
            (node.step, node.sink_path) = (step, sink_path);
        }
        for &(axis, value) in point {
            let (name, text) = (axes[axis].name, axes[axis].values[value].trim_matches('"'));
            node.id.push_str(&format!("/{name}={text}"));
            let text_of = |width| file_text(&axes[axis].values[value], axes[axis].padding, width);
            node.sink_path = node.sink_path.take().map(|path| with_value(&path, name, text_of));
            node.point.push((name.to_owned(), text.to_owned()));
        }
        Some(node)
    }
}

/// The wires of a node at a point. Each wire of the template leads to the instance of its input at the same point
/// or, if it gathers axes, to all instances along these axes.
fn wires(
    template: &Template<'_, '_>,
    point: &[(usize, usize)],
    grids: &[Grid],
    first: &[usize],
) -> Vec<Vec<Wire>> {
    let mut inputs = Vec::with_capacity(template.node.inputs.len());
    for (port, wires) in template.node.inputs.iter().enumerate() {
        let mut ends = Vec::with_capacity(wires.len());
        for (place, wire) in wires.iter().enumerate() {
            let above = &grids[wire.node];
            let gathered = template.gathers.get(&(port, place)).map_or(&[][..], Vec::as_slice);
            // In the order of the axes in the gather, the last varying fastest.
            let size = |axis: &usize| above.axes.iter().find(|(known, _)| known == axis).copied();
            let along = Grid { axes: gathered.iter().filter_map(size).collect() };
            for step in 0..along.len().unwrap_or_default() {
                let here = along.point(step);
                let at = |axis| if along.has(axis) { value_at(&here, axis) } else { value_at(point, axis) };
                ends.push(Wire { node: first[wire.node] + above.index(at), port: wire.port });
            }
        }
        inputs.push(ends);
    }
    inputs
}

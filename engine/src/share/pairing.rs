//! Pairs the nodes of two recipes and lists their differences.
//!
//! A recipe numbers its nodes in reading order, so an additional node shifts all later numbers. Nodes are therefore
//! paired from the sinks upstream: if two paired nodes have inputs of the same name that come from nodes of the
//! same kind, these nodes are paired too. If the kinds differ, one of the nodes was inserted or removed.

use std::collections::{BTreeMap, HashMap, VecDeque};

use cache::Digest;

use crate::plan::diff::{NodeDifference, changes};
use crate::text::edit::replace_strings;

/// A node of a recipe, or its scene, for comparison.
#[derive(Debug, Clone)]
pub(crate) struct Described {
    /// Name of the node, such as `n3`.
    pub id: String,
    /// Name of the kind without its version; empty for the scene.
    pub kind: String,
    /// Kind with version, parameters, wires and digests of files, as pairs of name and text.
    pub fields: Vec<(String, String)>,
}

impl Described {
    pub fn new(id: String, kind: String, fields: Vec<(String, String)>) -> Self {
        Self { id, kind, fields }
    }
}

/// A node of a recipe and its inputs.
struct Node<'s> {
    described: &'s Described,
    /// For each field that contains wires: its name, and the node index and output name of each wire.
    wires: Vec<(&'s str, Vec<(usize, String)>)>,
    /// Digest of the node and everything upstream of it, not including node names.
    digest: Digest,
}

/// Parses a text such as `n3.image` as a wire to an upstream node. Only this form distinguishes wires from strings,
/// since the kind may be unknown to this version of lightharmony.
fn wire<'t>(text: &'t str, above: &HashMap<&str, usize>) -> Option<(usize, &'t str)> {
    let (id, output) = text.split_once('.')?;
    Some((*above.get(id)?, output))
}

fn read(all: &[Described]) -> Vec<Node<'_>> {
    let mut above: HashMap<&str, usize> = HashMap::new();
    let mut nodes: Vec<Node<'_>> = Vec::with_capacity(all.len());
    for (index, described) in all.iter().enumerate() {
        let (mut wires, mut whole) = (Vec::new(), String::new());
        for (name, text) in &described.fields {
            let mut own = Vec::new();
            let text = replace_strings(text, |text| match wire(text, &above) {
                Some((node, output)) => {
                    own.push((node, output.to_owned()));
                    format!("{}.{output}", nodes[node].digest)
                }
                None => text.to_owned(),
            });
            // One line each: line breaks in strings are escaped.
            whole.push_str(&format!("{name}\n{text}\n"));
            if !own.is_empty() {
                wires.push((name.as_str(), own));
            }
        }
        nodes.push(Node { described, wires, digest: Digest::of(whole.as_bytes()) });
        above.insert(&described.id, index);
    }
    nodes
}

/// The pairs found so far: for each node of the first recipe its counterpart in the second, and vice versa.
struct Pairs<'s> {
    a: Vec<Node<'s>>,
    b: Vec<Node<'s>>,
    of_a: Vec<Option<usize>>,
    of_b: Vec<Option<usize>>,
    /// Pairs whose inputs are not compared yet.
    open: VecDeque<(usize, usize)>,
}

impl<'s> Pairs<'s> {
    fn new(a: &'s [Described], b: &'s [Described]) -> Self {
        let (of_a, of_b) = (vec![None; a.len()], vec![None; b.len()]);
        let mut pairs = Self { a: read(a), b: read(b), of_a, of_b, open: VecDeque::new() };
        // The scenes and the sinks, which are last.
        pairs.join(0, 0);
        pairs.meet(a.len() - 1, b.len() - 1);
        pairs.follow();
        // The remaining nodes: first equal ones, then those of the same kind, in order.
        pairs.rest(|node| node.digest.to_string());
        pairs.rest(|node| node.described.kind.clone());
        pairs
    }

    fn is_free(&self, a: usize, b: usize) -> bool {
        self.of_a[a].is_none() && self.of_b[b].is_none()
    }

    fn join(&mut self, a: usize, b: usize) {
        (self.of_a[a], self.of_b[b]) = (Some(b), Some(a));
        self.open.push_back((a, b));
    }

    /// Compares two nodes that are inputs of paired nodes at the same position. They are paired if they have the
    /// same kind. Otherwise one of them may have been inserted; the other is then paired with an input of the
    /// inserted node.
    fn meet(&mut self, a: usize, b: usize) {
        let kind = |node: &Node<'s>| node.described.kind.as_str();
        let above = |nodes: &[Node<'s>], node: usize, wanted: &str| {
            let all = nodes[node].wires.iter().flat_map(|(_, wires)| wires);
            all.map(|(above, _)| *above).find(|above| nodes[*above].described.kind == wanted)
        };
        let (kind_a, kind_b) = (kind(&self.a[a]), kind(&self.b[b]));
        let pair = if kind_a == kind_b {
            Some((a, b))
        } else {
            let put_in = above(&self.b, b, kind_a).map(|b| (a, b));
            put_in.or_else(|| above(&self.a, a, kind_b).map(|a| (a, b)))
        };
        if let Some((a, b)) = pair.filter(|(a, b)| self.is_free(*a, *b)) {
            self.join(a, b);
        }
    }

    /// Pairs the inputs of all paired nodes, starting at the sinks.
    fn follow(&mut self) {
        while let Some((a, b)) = self.open.pop_front() {
            let in_b: BTreeMap<&str, Vec<usize>> = inputs(&self.b[b]).into_iter().collect();
            for (name, all) in inputs(&self.a[a]) {
                let Some(others) = in_b.get(name) else { continue };
                let mut others = others.clone();
                let left = self.alike(all, &mut others, |node| node.digest.to_string());
                let left = self.alike(left, &mut others, |node| node.described.kind.clone());
                for (a, b) in left.into_iter().zip(others) {
                    self.meet(a, b);
                }
            }
        }
    }

    /// Pairs nodes of `a` with nodes of `b` for which `of` returns the same text, in order. Returns the unpaired
    /// nodes of `a`; only the unpaired nodes of `b` remain in `b`.
    fn alike(&mut self, a: Vec<usize>, b: &mut Vec<usize>, of: impl Fn(&Node<'s>) -> String) -> Vec<usize> {
        let mut known: HashMap<String, VecDeque<usize>> = HashMap::new();
        for &b in b.iter().filter(|b| self.of_b[**b].is_none()) {
            known.entry(of(&self.b[b])).or_default().push_back(b);
        }
        let mut left = Vec::new();
        for a in a.into_iter().filter(|a| self.of_a[*a].is_none()).collect::<Vec<_>>() {
            let other = known.get_mut(&of(&self.a[a])).and_then(VecDeque::pop_front);
            match other {
                Some(b) if self.is_free(a, b) => self.join(a, b),
                _ => left.push(a),
            }
        }
        b.retain(|b| self.of_b[*b].is_none());
        left.retain(|a| self.of_a[*a].is_none());
        left
    }

    fn rest(&mut self, of: impl Fn(&Node<'s>) -> String) {
        let (a, mut b) = ((0..self.a.len()).collect(), (0..self.b.len()).collect());
        self.alike(a, &mut b, of);
        self.follow();
    }
}

fn inputs<'s>(node: &Node<'s>) -> Vec<(&'s str, Vec<usize>)> {
    let above = |wires: &[(usize, String)]| wires.iter().map(|(node, _)| *node).collect();
    node.wires.iter().map(|(name, wires)| (*name, above(wires))).collect()
}

/// The differences between two recipes, each given as its scene and then its nodes. Nodes have the names of the
/// first recipe; nodes that only the second has are named like `b.n3`. For nodes without a counterpart, the name is
/// followed by the kind.
pub(crate) fn recipe_differences(a: &[Described], b: &[Described]) -> Vec<(String, NodeDifference)> {
    let pairs = Pairs::new(a, b);
    let own: HashMap<&str, usize> =
        b.iter().enumerate().map(|(index, described)| (&*described.id, index)).collect();
    let name = |index: usize| match pairs.of_b[index] {
        Some(first) => a[first].id.clone(),
        None => format!("b.{}", b[index].id),
    };
    // With the node names of the first recipe.
    let fields_of = |index: usize| {
        let above = |text: &str| match wire(text, &own).filter(|(above, _)| *above < index) {
            Some((node, output)) => format!("{}.{output}", name(node)),
            None => text.to_owned(),
        };
        let fields = b[index].fields.iter();
        fields.map(|(field, text)| (field.clone(), replace_strings(text, above))).collect::<Vec<_>>()
    };
    let mut found = Vec::new();
    for (index, node) in a.iter().enumerate() {
        let Some(other) = pairs.of_a[index] else {
            found.push((format!("{} {}", node.id, node.kind), NodeDifference::Gone));
            continue;
        };
        // In the same form on both sides, since a string can be written in several ways.
        let then = node.fields.iter();
        let then = then.map(|(field, text)| (field.clone(), replace_strings(text, str::to_owned))).collect();
        let changes = changes(then, fields_of(other));
        if !changes.is_empty() {
            found.push((node.id.clone(), NodeDifference::Changed(changes)));
        }
    }
    for (index, node) in b.iter().enumerate().filter(|(index, _)| pairs.of_b[*index].is_none()) {
        found.push((format!("{} {}", name(index), node.kind), NodeDifference::New));
    }
    found
}

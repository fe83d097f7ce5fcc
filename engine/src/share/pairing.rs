//! Which nodes of two recipes are each other's, and what they say otherwise.
//!
//! A recipe numbers its nodes as they are read, so one node more shifts all behind it. Nodes are paired from the sinks
//! upward instead: inputs of one name and kind are each other's, and where the kinds differ, a node between them is
//! one that was put in or taken out.

use std::collections::{BTreeMap, HashMap, VecDeque};

use cache::Digest;

use crate::plan::diff::{NodeDifference, changes};
use crate::text::edit::replace_strings;

/// A node of a recipe as it is compared, or its scene.
#[derive(Debug, Clone)]
pub(crate) struct Said {
    /// Its name, which is a number.
    pub id: String,
    /// Its kind without the version; empty for the scene.
    pub kind: String,
    /// Kind with its version, parameters, wires and contents: name and text.
    pub fields: Vec<(String, String)>,
}

impl Said {
    pub fn new(id: String, kind: String, fields: Vec<(String, String)>) -> Self {
        Self { id, kind, fields }
    }
}

/// A node of a recipe with what it reads.
struct Node<'s> {
    said: &'s Said,
    /// By field: node and output.
    wires: Vec<(&'s str, Vec<(usize, String)>)>,
    /// Of all that it says and all above it, whatever they are called.
    digest: Digest,
}

/// The node and the output of a text such as `n3.image`, where the node stands above. Wires are told from texts by
/// that alone, since the kind may be one that this program has not.
fn wire<'t>(text: &'t str, above: &HashMap<&str, usize>) -> Option<(usize, &'t str)> {
    let (id, output) = text.split_once('.')?;
    Some((*above.get(id)?, output))
}

fn read(all: &[Said]) -> Vec<Node<'_>> {
    let mut above: HashMap<&str, usize> = HashMap::new();
    let mut nodes: Vec<Node<'_>> = Vec::with_capacity(all.len());
    for (index, said) in all.iter().enumerate() {
        let (mut wires, mut whole) = (Vec::new(), String::new());
        for (name, text) in &said.fields {
            let mut own = Vec::new();
            let text = replace_strings(text, |text| match wire(text, &above) {
                Some((node, output)) => {
                    own.push((node, output.to_owned()));
                    format!("{}.{output}", nodes[node].digest)
                }
                None => text.to_owned(),
            });
            // A text of its own line each: neither holds a line break that is not escaped.
            whole.push_str(&format!("{name}\n{text}\n"));
            if !own.is_empty() {
                wires.push((name.as_str(), own));
            }
        }
        nodes.push(Node { said, wires, digest: Digest::of(whole.as_bytes()) });
        above.insert(&said.id, index);
    }
    nodes
}

/// For each node of the first the one of the second that is the same node, perhaps changed, and the other way round.
struct Pairs<'s> {
    a: Vec<Node<'s>>,
    b: Vec<Node<'s>>,
    of_a: Vec<Option<usize>>,
    of_b: Vec<Option<usize>>,
    /// Pairs whose inputs are to be looked at.
    open: VecDeque<(usize, usize)>,
}

impl<'s> Pairs<'s> {
    fn new(a: &'s [Said], b: &'s [Said]) -> Self {
        let (of_a, of_b) = (vec![None; a.len()], vec![None; b.len()]);
        let mut pairs = Self { a: read(a), b: read(b), of_a, of_b, open: VecDeque::new() };
        // The scenes, and the sinks: what stands last.
        pairs.join(0, 0);
        pairs.meet(a.len() - 1, b.len() - 1);
        pairs.follow();
        // Below a node that became another one: what says the same, then what is of one kind, in order.
        pairs.rest(|node| node.digest.to_string());
        pairs.rest(|node| node.said.kind.clone());
        pairs
    }

    fn is_free(&self, a: usize, b: usize) -> bool {
        self.of_a[a].is_none() && self.of_b[b].is_none()
    }

    fn join(&mut self, a: usize, b: usize) {
        (self.of_a[a], self.of_b[b]) = (Some(b), Some(a));
        self.open.push_back((a, b));
    }

    /// Two nodes that are read in one place: each other's where their kinds are one, else perhaps one of them was put
    /// in between, and the other is what that reads.
    fn meet(&mut self, a: usize, b: usize) {
        let kind = |node: &Node<'s>| node.said.kind.as_str();
        let above = |nodes: &[Node<'s>], node: usize, wanted: &str| {
            let all = nodes[node].wires.iter().flat_map(|(_, wires)| wires);
            all.map(|(above, _)| *above).find(|above| nodes[*above].said.kind == wanted)
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

    /// Pairs what pairs read, the nearest to the sinks first.
    fn follow(&mut self) {
        while let Some((a, b)) = self.open.pop_front() {
            let in_b: BTreeMap<&str, Vec<usize>> = inputs(&self.b[b]).into_iter().collect();
            for (name, all) in inputs(&self.a[a]) {
                let Some(others) = in_b.get(name) else { continue };
                let mut others = others.clone();
                let left = self.alike(all, &mut others, |node| node.digest.to_string());
                let left = self.alike(left, &mut others, |node| node.said.kind.clone());
                for (a, b) in left.into_iter().zip(others) {
                    self.meet(a, b);
                }
            }
        }
    }

    /// Pairs those of two lists that are alike, in order; what is left of the first, and of the second in its place.
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

/// What two recipes say otherwise, each as the scene and then its nodes. Nodes are called as in the first, and those
/// that only the second has `b.n3`; both with their kinds where they have no other.
pub(crate) fn said_otherwise(a: &[Said], b: &[Said]) -> Vec<(String, NodeDifference)> {
    let pairs = Pairs::new(a, b);
    let own: HashMap<&str, usize> = b.iter().enumerate().map(|(index, said)| (&*said.id, index)).collect();
    let name = |index: usize| match pairs.of_b[index] {
        Some(first) => a[first].id.clone(),
        None => format!("b.{}", b[index].id),
    };
    // As the first would say it.
    let said = |index: usize| {
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
        // Written alike on both sides: strings may stand in more than one way.
        let then = node.fields.iter();
        let then = then.map(|(field, text)| (field.clone(), replace_strings(text, str::to_owned))).collect();
        let changes = changes(then, said(other));
        if !changes.is_empty() {
            found.push((node.id.clone(), NodeDifference::Changed(changes)));
        }
    }
    for (index, node) in b.iter().enumerate().filter(|(index, _)| pairs.of_b[*index].is_none()) {
        found.push((format!("{} {}", name(index), node.kind), NodeDifference::New));
    }
    found
}

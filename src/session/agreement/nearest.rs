//! The nearest nodes of some kinds upstream of the nodes of a graph.

use std::rc::Rc;

use engine::{Graph, Wire};

/// For each node of a graph, the nearest nodes of some kinds: those from which a path of wires leads to the node without
/// another node of these kinds on it. A node of one of the kinds is its own nearest node.
///
/// All are found in one pass, since a search for each node would take time in proportion to the square of the number of
/// nodes. Nodes with equal results share them.
pub(super) struct Nearest(Vec<Rc<[usize]>>);

impl Nearest {
    /// Finds the nearest nodes of the kinds `kinds`. Paths through nodes of the kinds `ends` are ignored.
    pub(super) fn new(graph: &Graph, kinds: &[&str], ends: &[&str]) -> Self {
        let mut nearest: Vec<Rc<[usize]>> = vec![Rc::default(); graph.nodes.len()];
        for &node in graph.order() {
            let kind = graph.nodes[node].kind.name;
            if kinds.contains(&kind) {
                nearest[node] = Rc::new([node]);
            } else if !ends.contains(&kind) {
                nearest[node] = union(graph.reads(node).iter().map(|&read| &nearest[read]));
            }
        }
        Self(nearest)
    }

    /// The nearest nodes of the nodes at the start of some wires, in the order of the graph.
    pub(super) fn of(&self, wires: &[Wire]) -> Rc<[usize]> {
        union(wires.iter().map(|wire| &self.0[wire.node]))
    }
}

/// Union of lists in ascending order. If one of the lists has all others, it is shared.
fn union<'a>(lists: impl Iterator<Item = &'a Rc<[usize]>>) -> Rc<[usize]> {
    let has = |all: &[usize], some: &[usize]| some.iter().all(|node| all.binary_search(node).is_ok());
    let mut all: Rc<[usize]> = Rc::default();
    for list in lists {
        if Rc::ptr_eq(&all, list) || has(&all, list) {
            continue;
        }
        all = if has(list, &all) {
            Rc::clone(list)
        } else {
            let mut both = [&*all, &**list].concat();
            both.sort_unstable();
            both.dedup();
            both.into()
        };
    }
    all
}

#[cfg(test)]
mod tests {
    use engine::{Source, SourceRoot};

    use super::*;

    /// A chain of composites on one picture of splats. The last composite also has another picture.
    fn chain(length: usize) -> Graph {
        let mut nodes = String::new();
        for number in 0..length {
            let below = number.checked_sub(1).map_or("a".to_owned(), |below| format!("n{below}"));
            nodes += &format!("n{number}: Composite(background: \"{below}\", object: \"trace.object\"),");
        }
        let text = format!(
            r#"Graph(version: 1, scene: (up: "+z"), nodes: (
                demo:  DemoScene(place: Courtyard),
                a:     SplatRender(splats: "demo.splats", rig: "demo.rig"),
                b:     SplatRender(splats: "demo.splats", rig: "demo.rig"),
                trace: PathTrace(receiver: "demo.proxy", objects: [], rig: "demo.rig", env: "light", samples: 1),
                pano:  Stitch(views: "b"),
                dark:  PredictExposure(pano: "pano", evs: [-6.0, -3.0]),
                light: FuseHdr(base: "pano", brackets: "dark"),
                {nodes}
                last:  Composite(background: "n{}", object: "trace.object", front: "b"),
            ))"#,
            length - 1
        );
        Graph::parse(Source::new("graph.ron", text), &nodes::registry(), SourceRoot::new("."))
            .unwrap_or_else(|e| panic!("{e:?}"))
    }

    fn node(graph: &Graph, name: &str) -> usize {
        graph.nodes.iter().position(|node| node.id == name).unwrap_or_else(|| panic!("{name}"))
    }

    #[test]
    fn a_chain_has_the_nearest_nodes_of_its_start() {
        let graph = chain(40);
        let at = |name: &str| node(&graph, name);
        let found = |kinds: &[&str], ends: &[&str], name: &str| -> Vec<String> {
            let Nearest(all) = Nearest::new(&graph, kinds, ends);
            all[at(name)].iter().map(|&node| graph.nodes[node].id.clone()).collect()
        };
        let renders = ["splat-render"];
        assert_eq!(found(&renders, &["path-trace"], "n39"), ["a"]);
        assert_eq!(found(&renders, &["path-trace"], "last"), ["a", "b"]);
        assert_eq!(found(&renders, &["path-trace"], "trace"), [""; 0]);
        // Through the light of the trace.
        assert_eq!(found(&renders, &[], "trace"), ["b"]);
        assert_eq!(found(&renders, &[], "n0"), ["a", "b"]);
        assert_eq!(found(&["path-trace"], &[], "last"), ["trace"]);
        assert_eq!(found(&["path-trace"], &[], "a"), [""; 0]);
    }

    /// The nodes of a chain share one list, so that a chain of any length takes one step per node. This test fails if
    /// `union` copies a list that has all others.
    #[test]
    fn equal_results_are_shared() {
        let graph = chain(40);
        let Nearest(all) = Nearest::new(&graph, &["splat-render", "path-trace"], &[]);
        let [first, last] = ["n0", "n39"].map(|name| &all[node(&graph, name)]);
        assert_eq!(first.len(), 2);
        assert!(Rc::ptr_eq(first, last));
    }
}

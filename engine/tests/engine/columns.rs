//! Tests of the layout of drawings of graphs.

use engine::Columns;

use crate::lab::{Lab, graph_text};

/// The names of the nodes in each column.
fn columns(nodes: &str) -> Vec<Vec<String>> {
    let graph = Lab::in_memory().parse(&graph_text(nodes)).unwrap();
    let Columns(columns) = Columns::of(&graph).unwrap();
    let names = |entries: &Vec<engine::ColumnEntry>| {
        let own = entries.iter().filter(|entry| !entry.passes);
        let mut names: Vec<String> = own.map(|entry| graph.nodes[entry.node].id.clone()).collect();
        names.sort();
        names
    };
    columns.iter().map(names).collect()
}

/// Nodes stand before their readers, as near to them as no further wire passes a column. This test fails if nodes keep
/// the first column that they could have.
#[test]
fn nodes_are_drawn_near_their_readers() {
    let chain =
        "a: Number(value: 1.0), b: Scale(value: \"a\"), c: Scale(value: \"b\"), d: Scale(value: \"c\")";
    assert_eq!(columns(chain), [["a"], ["b"], ["c"], ["d"]]);
    // `far` is only read at the end.
    let late = format!("{chain}, far: Number(value: 2.0), sum: Add(terms: [\"d\", \"far\"])");
    assert_eq!(columns(&late), [vec!["a"], vec!["b"], vec!["c"], vec!["d", "far"], vec!["sum"]]);
    // The wire of `a` ends at `b`, so that `twice` is drawn next to `b`.
    let early = format!("{chain}, twice: Scale(value: \"a\"), sum: Add(terms: [\"d\", \"twice\"])");
    assert_eq!(columns(&early), [vec!["a"], vec!["b", "twice"], vec!["c"], vec!["d"], vec!["sum"]]);
    // If the wire of `a` goes on, `twice` goes with it.
    let along = format!("{chain}, twice: Scale(value: \"a\"), sum: Add(terms: [\"d\", \"twice\", \"a\"])");
    assert_eq!(columns(&along), [vec!["a"], vec!["b"], vec!["c"], vec!["d", "twice"], vec!["sum"]]);
    // Every node is after its inputs.
    assert_eq!(columns("a: Number(value: 1.0), b: Number(value: 2.0)"), [["a", "b"]]);
}

//! Work that a run skips if a check finds that the scene does not need it, and the results of these checks.

use std::collections::BTreeSet;

use scene::types::{Cell, Report};

use crate::bench::NodeCost;
use crate::plot::tick_text;

/// Work that is done only if a check finds that the scene needs it.
struct Skip {
    what: &'static str,
    check: &'static str,
    /// How the user can force the work to be done, in words.
    force: &'static str,
    /// Names of the kinds that perform the check.
    kinds: &'static [&'static str],
    /// Function that returns true if the work was skipped, and the result of the check in words. It returns `None`
    /// if the node did not perform the check.
    judge: fn(&Evidence<'_>) -> Option<(bool, String)>,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOut {
    /// Description of the work that is skipped if the check finds it unnecessary.
    pub what: &'static str,
    /// Names of the nodes with this result.
    pub nodes: Vec<String>,
    /// True if the work was skipped, false if the work was done, `None` if there was nothing to check.
    pub left_out: Option<bool>,
    /// The result of the check, in words.
    pub found: String,
    /// Description of the check.
    pub check: &'static str,
    /// How the user can force the work to be done, in words.
    pub force: &'static str,
}

/// Notes and reports of a node.
struct Evidence<'s> {
    node: &'s NodeCost,
    reports: &'s [(String, Report)],
}

impl Evidence<'_> {
    fn note(&self, id: &str) -> Option<&str> {
        self.node.notes.iter().find(|note| note.id == id).map(|note| note.text.as_str())
    }

    fn count(&self, name: &str) -> u64 {
        self.node.counts.get(name).copied().unwrap_or_default()
    }

    /// The cells of the column `column` of the table `table` in the reports of this node.
    fn column(&self, table: &str, column: &str) -> Vec<&Cell> {
        let own = |(name, _): &&(String, Report)| {
            name.strip_prefix(&self.node.id).is_some_and(|rest| rest.starts_with('.'))
        };
        let tables = self.reports.iter().filter(own).flat_map(|(_, report)| &report.tables);
        let cells = tables.filter(|of| of.name == table).flat_map(|of| {
            let at = of.columns.iter().position(|name| name == column);
            at.into_iter().flat_map(|at| of.rows.iter().filter_map(move |row| row.get(at)))
        });
        cells.collect()
    }

    /// The value in the row `name` of the table `table`, whose columns are `item` and `value`.
    fn value(&self, table: &str, name: &str) -> Option<String> {
        let names = self.column(table, "item").into_iter().zip(self.column(table, "value"));
        names.into_iter().find_map(|(item, value)| match (item, value) {
            (Cell::Text(item), Cell::Text(value)) if item == name => Some(value.clone()),
            _ => None,
        })
    }
}

const SPLATS: &[&str] = &["splat-render", "splat-panorama"];
const TRACE: &[&str] = &["path-trace"];

const SKIPS: [Skip; 8] = [
    Skip {
        what: "the prediction of clipped light",
        check: "no visible pixel of the panorama is clipped",
        force: "`--exhaustive`",
        kinds: &["predict-exposure"],
        judge: |seen| {
            let text = match seen.column("prediction", "clipped pixels").first() {
                Some(Cell::Count(n)) => format!("clipped pixels: {n}"),
                _ => return None,
            };
            Some((seen.note("nothing-clipped").is_some(), text))
        },
    },
    Skip {
        what: "removal of the receiver's own emission from the light",
        check: "the light has no capture point, or the receiver covers less than a quarter of the view from that point; otherwise `surroundings` decides",
        force: "`surroundings: Projected`, or any other value except `Open`",
        kinds: TRACE,
        judge: |seen| {
            let decided = seen.value("decisions", "surroundings")?;
            let text = seen
                .note("surroundings")
                .map_or_else(|| format!("{decided}, as set in the graph"), str::to_owned);
            // With `Open`, the light is infinitely distant: the receiver is neither a light, nor does it block any.
            Some((decided == "Open", text))
        },
    },
    Skip {
        what: "the second render, in regions where objects have almost no effect on the light",
        check: "an upper bound on the light that objects block, emit and reflect is below a threshold",
        force: "`crop: 0`",
        kinds: TRACE,
        judge: |seen| match seen.note("cropped") {
            Some(text) => Some((true, text.to_owned())),
            None => Some((false, seen.value("decisions", "crop")?)),
        },
    },
    Skip {
        what: "rays in regions where objects change nothing",
        check: "none of the light paths traced for a chunk of pixels hits an object",
        force: "cannot be forced; these rays do not change the expected value of the picture",
        kinds: TRACE,
        judge: |seen| {
            let shares =
                seen.column("views", "share of chunks of samples that no object changes").into_iter();
            let shares = shares.filter_map(|cell| if let Cell::Number(n) = cell { Some(*n) } else { None });
            let shares: Vec<f64> = shares.collect();
            let texts: Vec<String> = shares.iter().map(|share| format!("{:.0} %", 100.0 * share)).collect();
            let text = format!("share of chunks of samples in each view: {}", texts.join(", "));
            (!shares.is_empty()).then(|| (shares.iter().any(|share| *share > 0.0), text))
        },
    },
    Skip {
        what: "evaluation of spherical harmonics above degree 0",
        check: "the degree of the scene or `sh_degree` is 0",
        force: "`--exhaustive`",
        kinds: SPLATS,
        judge: |seen| {
            let [directed, projected] = ["splats_directed", "splats_projected"].map(|name| seen.count(name));
            let text = format!(
                "splats whose harmonics above degree 0 were evaluated: {} of {}",
                directed, projected
            );
            (projected > 0).then_some((directed == 0, text))
        },
    },
    Skip {
        what: "material lobes that no material uses",
        check: "the strength of the lobe is 0 in every material, after its texture is applied",
        force: "`--exhaustive`",
        kinds: TRACE,
        judge: |seen| {
            let absent = seen.value("decisions", "lobes that no material has")?;
            let text = match absent.as_str() {
                "" => "every lobe is used by some material".to_owned(),
                _ => absent.clone(),
            };
            Some((!absent.is_empty(), text))
        },
    },
    Skip {
        what: "blocks of splats that no picture can show",
        check: "a box around the splats of the block is outside every view",
        force: "`--exhaustive`",
        kinds: SPLATS,
        judge: |seen| {
            let [skipped, visited] = ["splats_skipped", "splats_visited"].map(|name| seen.count(name));
            let all = (skipped + visited) as f64;
            let text = format!(
                "skipped splats: {:.0} % of {}",
                100.0 * skipped as f64 / all.max(1.0),
                tick_text(all)
            );
            (all > 0.0).then_some((skipped > 0, text))
        },
    },
    Skip {
        what: "pixels of the panorama that do not affect the picture",
        check: "the widths of the narrowest reflection lobe and of the smallest light, in texels",
        force: "`skip_fine: false` of `fit-probe`; without a `fit-probe`, `width_px` and `size_px` decide",
        kinds: &["fit-probe", "path-trace"],
        judge: |seen| match seen.note("probe-size") {
            Some(text) => Some((text.contains("instead of"), text.to_owned())),
            None => {
                let text = seen.note("finer-than-needed").unwrap_or("all pixels are needed");
                Some((false, text.to_owned()))
            }
        },
    },
];

/// Lists the results of all checks, in the order of `docs/trade.md`. A check that no node performed is listed, too.
pub fn left_out(nodes: &[NodeCost], reports: &[(String, Report)]) -> Vec<LeftOut> {
    let mut all: Vec<LeftOut> = Vec::new();
    for Skip { what, check, force, kinds, judge } in SKIPS {
        let start = all.len();
        let row = |nodes, left_out, found| LeftOut { what, nodes, left_out, found, check, force };
        for node in nodes.iter().filter(|node| kinds.contains(&node.kind)) {
            let Some((left_out, found)) = judge(&Evidence { node, reports }) else { continue };
            let same = all[start..].iter_mut().find(|row| row.found == found);
            match same {
                Some(same) => same.nodes.push(node.id.clone()),
                None => all.push(row(vec![node.id.clone()], Some(left_out), found)),
            }
        }
        if all.len() == start {
            all.push(row(
                Vec::new(),
                None,
                format!("no node of the kind {} performed the check", kinds.join(" or ")),
            ));
        }
    }
    all.push(frames(nodes));
    all
}

/// Reports how many results are shared by several values of an axis. The report has the form of the result of a
/// check.
fn frames(nodes: &[NodeCost]) -> LeftOut {
    let varying = || nodes.iter().filter(|node| node.varies);
    let keys: BTreeSet<_> = varying().filter_map(|node| node.key).collect();
    let (all, fixed) = (varying().count(), nodes.len() - varying().count());
    let equal = varying().filter(|node| node.key.is_some()).count() - keys.len();
    let found = if all == 0 {
        "the graph has no axis, so there is only one frame".to_owned()
    } else {
        format!(
            "nodes that do not vary along an axis: {fixed}; other nodes: {all}; repeated keys among the other nodes: {equal}"
        )
    };
    LeftOut {
        what: "repeated computation of light and pictures that several frames share",
        nodes: Vec::new(),
        left_out: (all > 0).then_some(fixed + equal > 0),
        found,
        check: "equal keys",
        force: "a run of a single frame with its own cache (`--cache`)",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Digest, Level, Note};
    use scene::types::Table;

    fn node(id: &str, kind: &'static str) -> NodeCost {
        NodeCost {
            id: id.to_owned(),
            kind,
            work: 0.0,
            seconds: 0.0,
            cpu_seconds: 0.0,
            counts: engine::Counts::new(),
            notes: Vec::new(),
            varies: false,
            key: None,
        }
    }

    fn note(id: &str, text: &str) -> Note {
        Note { level: Level::Decision, id: id.to_owned(), text: text.to_owned() }
    }

    fn table(name: &str, columns: &[&str], row: Vec<Cell>) -> Report {
        Report { title: String::new(), tables: vec![Table::new(name, columns.iter().copied(), vec![row])] }
    }

    fn judged(nodes: &[NodeCost], reports: &[(String, Report)]) -> Vec<(Option<bool>, String)> {
        left_out(nodes, reports).into_iter().map(|row| (row.left_out, row.found)).collect()
    }

    #[test]
    fn every_check_has_its_line_whether_it_was_asked_or_not() {
        let rows = left_out(&[], &[]);
        assert_eq!(rows.len(), SKIPS.len() + 1);
        assert!(rows.iter().all(|row| row.left_out.is_none() && !row.force.is_empty()));
        assert_eq!(rows[0].found, "no node of the kind predict-exposure performed the check");
    }

    #[test]
    fn checks_are_read_from_notes_counts_and_the_nodes_own_report() {
        let mut dark = node("dark", "predict-exposure");
        let clipped =
            |n| table("prediction", &["method", "clipped pixels"], vec![Cell::Missing, Cell::Count(n)]);
        let reports = |n| [("darker.report".to_owned(), clipped(9)), ("dark.report".to_owned(), clipped(n))];
        assert_eq!(judged(&[dark.clone()], &reports(7))[0], (Some(false), "clipped pixels: 7".to_owned()));
        dark.notes.push(note("nothing-clipped", "no pixel"));
        assert_eq!(judged(&[dark], &reports(0))[0].0, Some(true));

        let mut faces = node("faces", "splat-render");
        let counts = [
            ("splats_projected", 10),
            ("splats_directed", 0),
            ("splats_visited", 30),
            ("splats_skipped", 70),
        ];
        faces.counts = counts.map(|(name, n)| (name.to_owned(), n)).into();
        let view = NodeCost { id: "view".to_owned(), ..faces.clone() };
        let rows = left_out(&[faces, view], &[]);
        assert_eq!(rows[4].nodes, ["faces", "view"], "what found the same stands together");
        assert_eq!(
            (rows[4].left_out, rows[4].found.as_str()),
            (Some(true), "splats whose harmonics above degree 0 were evaluated: 0 of 10")
        );
        assert_eq!((rows[6].left_out, rows[6].found.as_str()), (Some(true), "skipped splats: 70 % of 100"));

        let trace = node("trace", "path-trace");
        let lobes =
            vec![Cell::Text("lobes that no material has".to_owned()), Cell::Text("sheen, brush".to_owned())];
        let reports = [("trace.report".to_owned(), table("decisions", &["item", "value"], lobes))];
        assert_eq!(judged(&[trace], &reports)[5], (Some(true), "sheen, brush".to_owned()));
    }

    // An open scene under distant light needs no near light, whether `Open` was chosen by the node or set by the
    // user. This test fails if every choice counts as `Open`.
    #[test]
    fn an_open_scene_needs_no_near_light() {
        let row = |decided: &str, why: Option<&str>| {
            let mut trace = node("trace", "path-trace");
            trace.notes.extend(why.map(|why| note("surroundings", why)));
            let mut report = table("decisions", &["item", "value"], Vec::new());
            report.tables[0].rows =
                vec![["surroundings", decided].map(|text| Cell::Text(text.to_owned())).to_vec()];
            judged(&[trace], &[("trace.report".to_owned(), report)]).swap_remove(1)
        };
        let why = "Open: 60.0 % of 256 probe rays miss the mesh";
        assert_eq!(row("Open", Some(why)), (Some(true), why.to_owned()));
        assert_eq!(row("Open", None), (Some(true), "Open, as set in the graph".to_owned()));
        assert_eq!(
            row("Room(layers: 3)", None),
            (Some(false), "Room(layers: 3), as set in the graph".to_owned())
        );
        assert_eq!(row("Projected", Some("Projected: ..")).0, Some(false));
    }

    #[test]
    fn a_probe_that_was_fitted_is_reported_beside_advice() {
        let (mut fit, trace) = (node("fit", "fit-probe"), node("trace", "path-trace"));
        let text = "views of 64 px are enough, instead of 512: the objects are matte";
        fit.notes.push(note("probe-size", text));
        let rows = judged(&[fit.clone(), trace], &[]);
        assert_eq!(rows[rows.len() - 3], (Some(true), text.to_owned()));
        assert_eq!(rows[rows.len() - 2], (Some(false), "all pixels are needed".to_owned()));
        fit.notes[0].text =
            "views of 64 px would be enough (the objects are matte), but they keep 512 px because of `skip_fine: false`"
                .to_owned();
        let rows = judged(&[fit], &[]);
        assert_eq!(rows[rows.len() - 2].0, Some(false));
    }

    #[test]
    fn frames_share_what_reads_no_axis_and_what_has_the_key_of_another() {
        let frame = |id: &str, key: &[u8]| NodeCost {
            varies: true,
            key: Some(Digest::of(key)),
            ..node(id, "stitch")
        };
        let nodes =
            [node("env", "fuse-hdr"), frame("a/f=1", b"a"), frame("a/f=2", b"a"), frame("a/f=3", b"b")];
        let found = frames(&nodes);
        assert_eq!(found.left_out, Some(true));
        assert_eq!(
            found.found,
            "nodes that do not vary along an axis: 1; other nodes: 3; repeated keys among the other nodes: 1"
        );
    }
}

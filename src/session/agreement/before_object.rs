//! Finds splats in front of an inserted object, from the pictures of a run.

use std::collections::{BTreeMap, BTreeSet};

use engine::{Digest, Engine, Graph, Wire};
use render::geometry::before_object::{Depths, share};
use scene::types::{Camera, Images, NamedImage, Picture, Rig};

use super::memory::{Done, Key, Memory};
use super::pair::{Composites, DigestOf, Finding, at_one_point, of_kind, spread, written};
use crate::session::wires;

/// Maximum number of pictures of splats and traces that a run compares, in addition to those that it remembers.
/// This bounds the time of the check.
const MOST_PAIRS: usize = 256;
/// Maximum number of views of a rig that are compared.
const MOST_VIEWS: usize = 16;
/// Splats in front of an object are reported if they cover at least this share of its pixels. A smaller share is
/// normal, because splats extend beyond the surface that they represent. For example, the splats of a post in front
/// of an object covered 11 % of the object along the edge of the post.
const LEAST: f64 = 0.2;
/// Id of the finding.
const ID: &str = "splats-before-object";

/// A composite without `front`, and the nodes that make its background and its object. All are indices of nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Drawn {
    composite: usize,
    splats: usize,
    trace: usize,
}

/// The view of a pair that has the largest share of the object's pixels with splats in front of the object.
#[derive(Debug, Clone, PartialEq)]
struct Worst {
    share: f64,
    view: String,
}

impl Worst {
    /// Text for the memory.
    fn text(&self) -> String {
        format!("{} {}", self.share, self.view)
    }

    /// Reads the text of [`text`](Self::text).
    fn of_text(text: &str) -> Option<Self> {
        let (share, view) = text.split_once(' ')?;
        Some(Self { share: share.parse().ok()?, view: view.to_owned() })
    }
}

/// The findings about one composite of the graph file at all values of the axes.
struct HiddenObject {
    /// The pair with the largest share.
    drawn: Drawn,
    worst: Worst,
    /// Number of pictures with a finding.
    pictures: usize,
}

/// Compares the pictures of splats with the traces of which this run has results, for each `Composite` of the run
/// without `front`. Traces of the meshes in `wrong` are left out. The measured shares are remembered with the keys
/// of the nodes.
pub fn findings(
    (engine, graph): (&Engine, &Graph),
    done: &Done,
    (digest, wrong): (DigestOf<'_>, &BTreeSet<Digest>),
    memory: &mut Memory,
) -> Vec<Finding> {
    let is_wrong = |drawn: &Drawn| {
        let mesh = wires(graph, drawn.trace, "receiver").first().and_then(|&wire| digest(wire));
        mesh.is_some_and(|mesh| wrong.contains(&mesh))
    };
    let mut seen = BTreeSet::new();
    let mut all: Vec<(Digest, Drawn)> = Vec::new();
    for drawn in drawn(graph).into_iter().filter(|drawn| !is_wrong(drawn)) {
        let key = key(graph, drawn, done);
        // Composites at several values of an axis may draw the same pictures.
        all.extend(
            key.filter(|key| seen.insert((*key, written(graph, drawn.composite)))).map(|key| (key, drawn)),
        );
    }
    let keys: Vec<Digest> = all.iter().map(|(key, _)| *key).collect();
    let measured = memory.each(&keys, MOST_PAIRS, |index| {
        let worst = of_pair(engine, graph, done, all[index].1)?;
        let reported = worst.filter(|worst| worst.share >= LEAST);
        Some(reported.iter().map(|worst| (ID, worst.text())).collect())
    });
    let left = measured.iter().filter(|found| found.is_none()).count();
    let mut by_name: BTreeMap<&str, HiddenObject> = BTreeMap::new();
    for ((_, drawn), found) in all.iter().zip(measured) {
        for worst in found.iter().flatten().filter_map(|(_, text)| Worst::of_text(text)) {
            let name = written(graph, drawn.composite);
            let of_name = by_name.entry(name).or_insert(HiddenObject {
                drawn: *drawn,
                worst: worst.clone(),
                pictures: 0,
            });
            of_name.pictures += 1;
            if worst.share > of_name.worst.share {
                (of_name.drawn, of_name.worst) = (*drawn, worst);
            }
        }
    }
    let mut texts: Vec<Finding> = by_name.values().map(|found| (ID, text(graph, found))).collect();
    if left > 0 {
        texts.push((
            "agreement-unchecked",
            format!(
                "{left} of {} pictures were not searched for splats in front of objects, since a run searches at most \
                 {MOST_PAIRS} new pictures. Run a part of the graph with `--frames` or `--only` to search others",
                all.len()
            ),
        ));
    }
    texts
}

/// Describes what was found, and what to change in the graph file.
fn text(graph: &Graph, found: &HiddenObject) -> String {
    let HiddenObject { drawn, worst, pictures } = found;
    let [composite, splats, trace] =
        [drawn.composite, drawn.splats, drawn.trace].map(|node| written(graph, node));
    let at = graph.nodes[drawn.composite].id.split_once('/').map(|(_, values)| format!(" at `{values}`"));
    let others = match pictures {
        1 => String::new(),
        pictures => format!(" (the largest share of {pictures} pictures with such splats)"),
    };
    let is_front = |&node: &usize| {
        let limits = wires(graph, node, "limit").iter().any(|wire| written(graph, wire.node) == trace);
        limits && wires(graph, node, "splats") == wires(graph, drawn.splats, "splats")
    };
    let advice = match of_kind(graph, "splat-render").find(is_front) {
        Some(front) => format!("wire `{}` to `front` of `{composite}`", written(graph, front)),
        None => format!(
            "wire `{trace}.nearest` to `limit` of a second `SplatRender`, and its picture to `front` of `{composite}`"
        ),
    };
    format!(
        "`{splats}` and `{trace}`: in the view `{}`{}, splats are in front of the object at {:.0} % of its \
         pixels{others}, but `{composite}` draws the object over them, because the mesh of the place has no surface there. \
         To draw these splats over the object, {advice}",
        worst.view,
        at.unwrap_or_default(),
        100.0 * worst.share
    )
}

/// The composites without `front`, each with a `splat-render` without `limit` that makes its background, and a
/// `path-trace` that makes its object.
fn drawn(graph: &Graph) -> Vec<Drawn> {
    let (composites, mut all) = (Composites::new(graph), Vec::new());
    for composite in of_kind(graph, "composite").filter(|&node| wires(graph, node, "front").is_empty()) {
        let is_whole = |node: &usize| {
            graph.nodes[*node].kind.name == "splat-render" && wires(graph, *node, "limit").is_empty()
        };
        let behind = composites.backgrounds(graph, composite);
        let renders: Vec<usize> = behind.iter().copied().filter(is_whole).collect();
        for &trace in &*composites.traces(graph, composite) {
            let belong = renders.iter().filter(|&&splats| at_one_point(graph, splats, trace));
            all.extend(belong.map(|&splats| Drawn { composite, splats, trace }));
        }
    }
    all
}

/// Digest of everything that the comparison depends on. `None` if the run has no result for one of the nodes.
fn key(graph: &Graph, drawn: Drawn, done: &Done) -> Option<Digest> {
    done.key(graph, drawn.composite)?;
    let mut key = Key::new("before object");
    // The keys of nodes cover their cameras.
    [drawn.splats, drawn.trace].into_iter().try_for_each(|node| {
        key.bytes(done.key(graph, node)?.as_bytes());
        Some(())
    })?;
    Some(key.digest())
}

/// The worst of the views that a pair has in common. `None` if a value is not in the cache, and `Some(None)` if the
/// pair has no view in common.
fn of_pair(engine: &Engine, graph: &Graph, done: &Done, drawn: Drawn) -> Option<Option<Worst>> {
    let keys = |node: usize| done.key(graph, node).copied();
    let rig = |node: usize| engine.value_at_hand::<Rig>(graph, &keys, *wires(graph, node, "rig").first()?);
    let views = common(&rig(drawn.splats)?, &rig(drawn.trace)?);
    let views: Vec<[usize; 2]> =
        spread(views.len(), MOST_VIEWS).into_iter().map(|index| views[index]).collect();
    // The pictures of one output at a time, since those of a rig may be large. A trace may lack outputs.
    let pictures = |node: usize, output: &str, side: usize| -> Option<Vec<Option<NamedImage>>> {
        let port = graph.nodes[node].kind.outputs.iter().position(|port| port.name == output)?;
        let images = engine.value_at_hand::<Images>(graph, &keys, Wire { node, port })?;
        let mut images: Vec<_> = images.0.into_iter().map(Some).collect();
        Some(views.iter().map(|view| images.get_mut(view[side])?.take()).collect())
    };
    let all = [
        pictures(drawn.splats, "depth", 0)?,
        pictures(drawn.splats, "alpha", 0)?,
        pictures(drawn.trace, "depth", 1)?,
        pictures(drawn.trace, "object", 1)?,
    ];
    let measured = (0..views.len()).filter_map(|index| {
        let [Some(depth), Some(alpha), Some(surface), Some(object)] =
            all.each_ref().map(|list| list[index].as_ref())
        else {
            return None;
        };
        let share = of_view([&depth.picture, &alpha.picture, &surface.picture], &object.picture)?;
        Some(Worst { share, view: object.name.clone() })
    });
    Some(measured.reduce(|most, other| if other.share > most.share { other } else { most }))
}

/// Indices of equal cameras in two rigs, without regard to names. Each camera is listed at most once.
fn common(a: &Rig, b: &Rig) -> Vec<[usize; 2]> {
    if a == b {
        return (0..a.cameras.len()).map(|index| [index; 2]).collect();
    }
    let seen = |camera: &Camera| {
        let Camera { width_px, height_px, fx, fy, cx, cy, lens: _, world_from_camera, name: _ } = camera;
        let lens = [*fx, *fy, *cx, *cy].map(f64::to_bits);
        (*width_px, *height_px, lens, world_from_camera.map(f64::to_bits))
    };
    // In reverse order, so that the first of equal cameras is used.
    let mut left: BTreeMap<_, usize> =
        a.cameras.iter().enumerate().rev().map(|(index, camera)| (seen(camera), index)).collect();
    let of = |(index, camera): (usize, &Camera)| Some([left.remove(&seen(camera))?, index]);
    b.cameras.iter().enumerate().filter_map(of).collect()
}

/// Share of the object's pixels that have splats in front of the object. `None` if the pictures do not have the
/// same size, or the picture of the object has no alpha.
fn of_view([depth, alpha, surface]: [&Picture; 3], object: &Picture) -> Option<f64> {
    if object.size().2 != 4 {
        return None;
    }
    let objects: Vec<f32> = object.samples().iter().skip(3).step_by(4).copied().collect();
    let same = [depth, alpha, surface].iter().all(|picture| picture.samples().len() == objects.len());
    same.then(|| {
        share(&Depths {
            splats: depth.samples(),
            coverage: alpha.samples(),
            surface: surface.samples(),
            objects: &objects,
        })
    })
}

#[cfg(test)]
mod tests {
    use engine::{Source, SourceRoot};
    use glam::DVec3;

    use super::*;

    fn rig(places: &[f64]) -> Rig {
        let camera = |(index, x): (usize, &f64)| {
            let axes = [DVec3::X, DVec3::NEG_Z, DVec3::Y];
            Camera::centred(&format!("view_{index}"), [4, 3], 5.0, axes, DVec3::X * *x)
        };
        Rig { cameras: places.iter().enumerate().map(camera).collect() }
    }

    /// A rig may have a part of the cameras of the other one, under other names and in another order.
    #[test]
    fn equal_cameras_are_found() {
        let all = rig(&[0.0, 1.0, 2.0, 3.0]);
        assert_eq!(common(&all, &all), [[0, 0], [1, 1], [2, 2], [3, 3]]);
        assert_eq!(common(&all, &rig(&[3.0, 1.0, 7.0])), [[3, 0], [1, 1]]);
        assert_eq!(common(&rig(&[1.0, 1.0]), &rig(&[1.0, 5.0])), [[0, 0]]);
    }

    #[test]
    fn shares_are_remembered_as_text() {
        let worst = Worst { share: 0.1 + 0.2, view: "a view".to_owned() };
        assert_eq!(Worst::of_text(&worst.text()), Some(worst));
        assert_eq!(Worst::of_text("0.5"), None);
    }

    fn graph(nodes: &str) -> Graph {
        let text = format!(
            r#"Graph(version: 1, scene: (up: "+z", seed: 1), nodes: (
                demo:   DemoScene(place: Courtyard),
                pose:   Pose(),
                placed: Place(object: "demo.object", pose: "pose"),
                cam:    Camera(eye: (2.0, -2.5, 1.2), target: (0.0, 0.0, 0.2), width_px: 16, height_px: 9, fov_y_deg: 40.0),
                view:   SplatRender(splats: "demo.splats", rig: "cam"),
                trace:  PathTrace(receiver: "demo.proxy", objects: ["placed"], rig: "cam", env: "demo.truth_env", samples: 1),
                layer:  SplatRender(splats: "demo.splats", rig: "cam", limit: "trace.nearest"),
                {nodes}
            ))"#
        );
        let source = Source::new("graph.ron", text);
        Graph::parse(source, &nodes::registry(), SourceRoot::new(".")).unwrap_or_else(|e| panic!("{e:?}"))
    }

    /// A render with `limit` only counts for the composites to which it is wired. This test fails if any render
    /// with `limit` counts.
    #[test]
    fn each_composite_without_front_is_checked() {
        let front = r#"final: Composite(background: "view", object: "trace.object", front: "layer"),"#;
        assert_eq!(drawn(&graph(front)), []);
        let both = format!(r#"{front} bare: Composite(background: "view", object: "trace.object"),"#);
        let graph = graph(&both);
        let names =
            |drawn: &Drawn| [drawn.composite, drawn.splats, drawn.trace].map(|node| written(&graph, node));
        let found = drawn(&graph);
        assert_eq!(found.iter().map(names).collect::<Vec<_>>(), [["bare", "view", "trace"]]);
        let worst = Worst { share: 0.36, view: "camera".to_owned() };
        let text = text(&graph, &HiddenObject { drawn: found[0], worst, pictures: 1 });
        assert!(text.contains("at 36 % of its pixels, but `bare` draws"), "{text}");
        assert!(text.ends_with("wire `layer` to `front` of `bare`"), "{text}");
    }
}

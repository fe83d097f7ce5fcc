//! Comparison of pictures with the reference. Errors are computed for the whole picture and for the regions that
//! inserted objects cover or change.

use std::sync::Arc;

use engine::{Artifact, Context, Graph, Kind, NodeError, Notes, Wire};
use nodes::kinds::compare::{Compare, In, Space};
use nodes::kinds::composite::{self, Composite};
use nodes::kinds::write_exr::WriteExr;
use scene::math::metrics::PIXELS_PER_DEGREE;
use scene::types::layers::linear;
use scene::types::{Cell, Data, Image, Images, Linear, NamedImage, Picture, Report};

use crate::metric::Metric;
use crate::off::Off;

/// A picture whose error is to be measured.
pub struct Output {
    /// Name of the picture: the name of the node, such as `final`, or of node and output, such as `trace.object`.
    pub name: String,
    /// The output of a node from which the picture comes.
    pub wire: Wire,
    /// The space in which the picture is scored: linear light if the picture is only written to OpenEXR files;
    /// otherwise, the values of an 8-bit display.
    pub space: Space,
    inserted: Option<Insertion>,
    /// The reason why the requested metric cannot be computed for the picture; `None` if the metric can be
    /// computed. Other metrics are reported in either case.
    pub uncomputed: Option<String>,
}

/// The inputs from which one `composite` node, or several stacked `composite` nodes, made a picture.
struct Insertion {
    /// The background of the first `composite` node.
    background: Wire,
    /// The inserted objects, in the order of insertion.
    layers: Vec<Layer>,
}

/// The inputs and parameters with which one `composite` node inserts an object.
struct Layer {
    object: Wire,
    front: Option<Wire>,
    params: Composite,
}

impl Insertion {
    /// The insertion from which the picture of a node was made; `None` if the node is not a `composite` node.
    fn of(graph: &Graph, node: usize) -> Option<Self> {
        let (mut layers, mut at) = (Vec::new(), node);
        loop {
            let node = &graph.nodes[at];
            let read = |name: &str| {
                let mut ports = node.kind.inputs.iter().zip(&node.inputs);
                ports.find(|(port, _)| port.name == name).and_then(|(_, wires)| wires.first().copied())
            };
            let (background, object) = (read("background")?, read("object")?);
            layers.push(Layer { object, front: read("front"), params: node.params()? });
            // If the background is the picture of another `composite`, it already contains an object, and the loop
            // continues with it.
            if graph.nodes[background.node].kind.name != Composite::NAME || background.port != 0 {
                layers.reverse();
                return Some(Self { background, layers });
            }
            at = background.node;
        }
    }
}

/// The pictures of the reference. Pictures with inserted objects also have regions and baselines.
pub struct Truth {
    pictures: Vec<Arc<Images>>,
    inserted: Vec<Option<Inserted>>,
}

/// The regions that inserted objects change in a picture, with their names, and two baselines: the picture without
/// the objects, and the picture without the objects' shadows.
#[derive(Clone)]
struct Inserted {
    regions: Vec<(&'static str, Arc<Images>)>,
    nothing: Arc<Images>,
    no_shadow: Option<Arc<Images>>,
}

impl Truth {
    /// Creates the truth from the pictures of the reference. Pictures made by `composite` get regions and
    /// baselines; for these, `value` returns the values of the node's inputs. If several `composite` nodes are
    /// stacked, all inserted objects are considered.
    pub fn of(
        outputs: &[Output],
        pictures: &[Arc<Images>],
        value: impl Fn(Wire) -> Option<Arc<Images>>,
    ) -> Self {
        let inserted = |(output, picture): (&Output, &Arc<Images>)| {
            let Insertion { background, layers } = output.inserted.as_ref()?;
            let background = value(*background)?;
            let values = |Layer { object, front, params }: &Layer| {
                let front = front.map(&value).map_or(Some(None), |front| front.map(Some))?;
                Some((value(*object)?, front, params.clone()))
            };
            let layers: Vec<_> = layers.iter().map(values).collect::<Option<_>>()?;
            let built = |shows_objects: bool| {
                let put = |background: Arc<Images>, (object, front, params): &_| {
                    let absent = || Arc::new(absent(&background));
                    // Splats in front of an object also appear in the baseline without its shadow.
                    let (object, front) = if shows_objects {
                        (Arc::clone(object), Option::clone(front))
                    } else {
                        (absent(), None)
                    };
                    let (shadow, added, variance) = (None, None, None);
                    let layers = composite::In { background, object, shadow, added, front, variance };
                    Some(Composite::run(params, layers, &detached()).ok()?.0.image)
                };
                layers.iter().try_fold(Arc::clone(&background), put)
            };
            let nothing = built(false)?;
            let objects: Vec<&Images> = layers.iter().map(|(object, ..)| &**object).collect();
            let regions = regions(picture, &nothing, &objects)?;
            Some(Inserted { regions, nothing, no_shadow: built(true) })
        };
        let inserted = outputs.iter().zip(pictures).map(inserted).collect();
        Self { pictures: pictures.to_vec(), inserted }
    }

    /// True if each view of `images` has the same size as the same view of the reference. `at` is the index of the
    /// picture.
    pub fn fits(&self, at: usize, images: &Images) -> bool {
        let sizes = |images: &Images| -> Vec<(usize, usize)> {
            let size = |view: &NamedImage| {
                let (width, height, _) = view.picture.size();
                (width, height)
            };
            images.0.iter().map(size).collect()
        };
        self.pictures.get(at).is_some_and(|picture| sizes(picture) == sizes(images))
    }

    /// Removes the picture with the index `at`.
    pub fn remove(&mut self, at: usize) {
        self.pictures.remove(at);
        self.inserted.remove(at);
    }

    /// Computes the errors of the pictures and of their baselines, in each view and region.
    pub fn off(&self, outputs: &[Output], pictures: &[Arc<Images>]) -> Result<Vec<Off>, NodeError> {
        let mut all = Vec::new();
        for (index, (output, picture)) in outputs.iter().zip(pictures).enumerate() {
            let inserted = self.inserted[index].clone();
            let (out, ..) = compare(picture, &self.pictures[index], inserted, output.space)?;
            for table in &out.tables {
                let rows = table.rows.iter().filter_map(|row| off_of(&output.name, &table.columns, row));
                all.extend(rows.map(|row| Off { counts: output.uncomputed.is_none(), ..row }));
            }
        }
        Ok(all)
    }

    /// For each output, the reason why `metric` cannot be computed, taken from the notes of `compare`; `None` if
    /// the metric can be computed.
    pub fn uncomputed(&self, outputs: &[Output], metric: &Metric) -> Result<Vec<Option<String>>, NodeError> {
        let why = |(output, picture): (&Output, &Arc<Images>)| {
            // Every metric can be computed for display values.
            let Some(id) = metric.missing_note().filter(|_| output.space == Space::Linear) else {
                return Ok(None);
            };
            let (.., notes) = compare(picture, picture, None, output.space)?;
            Ok(notes.iter().find(|note| note.id == id).map(|note| note.text.clone()))
        };
        outputs.iter().zip(&self.pictures).map(why).collect()
    }

    /// For each output, computes the FLIP difference of each pixel. If FLIP cannot be computed for some views of an
    /// output, its result contains the reasons. If the comparison fails, the result of the output is the error.
    pub fn flip_maps(
        &self,
        outputs: &[Output],
        pictures: &[(String, Arc<Images>)],
    ) -> Vec<Result<FlipMaps, NodeError>> {
        let all = outputs.iter().zip(pictures).zip(&self.pictures);
        all.map(|((output, (_, picture)), truth)| {
            let (_, maps, notes) = compare(picture, truth, None, output.space)?;
            let reported = notes.iter().filter(|note| note.id == "no-flip");
            Ok(FlipMaps { maps, missing: reported.map(|note| note.text.clone()).collect() })
        })
        .collect()
    }
}

/// The FLIP difference of each pixel, for each view of a picture.
pub struct FlipMaps {
    /// The maps of all views for which FLIP was computed.
    pub maps: Arc<Images>,
    /// Descriptions of the views without a map, with the reasons.
    pub missing: Vec<String>,
}

/// True if a picture contains data other than colours.
pub fn holds_data(images: &Images) -> bool {
    images.0.iter().any(|view| matches!(view.picture, Picture::Data(_)))
}

/// True if a picture contains light more than two stops above white. Most environments do.
pub fn is_bright(images: &Images) -> bool {
    images.0.iter().any(|view| view.picture.samples().iter().any(|v| *v > 4.0))
}

/// Compares a picture with the reference by running the kind `compare`. Returns its report, its FLIP maps and its
/// notes.
fn compare(
    image: &Arc<Images>,
    reference: &Arc<Images>,
    inserted: Option<Inserted>,
    space: Space,
) -> Result<(Report, Arc<Images>, Notes), NodeError> {
    let (regions, background, no_shadow) = match inserted {
        Some(Inserted { regions, nothing, no_shadow }) => (regions, Some(nothing), no_shadow),
        None => (Vec::new(), None, None),
    };
    let (names, regions) = regions.into_iter().map(|(name, mask)| (name.to_owned(), mask)).unzip();
    let params = Compare {
        space,
        quantise: true,
        names,
        gain: 1.0,
        pixels_per_degree: PIXELS_PER_DEGREE,
        lpips: None,
        scores: Vec::new(),
        lpips_scaled: true,
    };
    let inputs =
        In { image: image.clone(), reference: reference.clone(), mask: None, regions, background, no_shadow };
    let (out, notes) = Compare::run(&params, inputs, &detached())?;
    Ok((Arc::unwrap_or_clone(out.report), out.flip, notes))
}

fn detached() -> Context {
    Context::detached(
        engine::Scene { up: engine::Up::PlusZ, metres_per_unit: 1.0, seed: 0, exhaustive: false },
        ".",
    )
}

/// A transparent picture for each view of the background, for use in place of the picture of an object.
fn absent(background: &Images) -> Images {
    let empty = |view: &NamedImage| {
        let (width, height, _) = view.picture.size();
        NamedImage { name: view.name.clone(), picture: Image::<Linear>::new(width, height, 4).into() }
    };
    Images(background.0.iter().map(empty).collect())
}

fn off_of(output: &str, columns: &[String], row: &[Cell]) -> Option<Off> {
    let [Cell::Text(view), Cell::Text(judged), Cell::Text(region), Cell::Count(pixels), ..] = row else {
        return None;
    };
    let number = |(column, cell): (&String, &Cell)| match cell {
        Cell::Number(value) => Some((column.clone(), *value)),
        Cell::Text(text) if text == "inf" => Some((column.clone(), f64::INFINITY)),
        Cell::Text(text) if text == "-inf" => Some((column.clone(), f64::NEG_INFINITY)),
        _ => None,
    };
    let values = columns.iter().zip(row).skip(4).filter_map(number).collect();
    let [output, view, judged, region] = [output, view, judged, region].map(str::to_owned);
    Some(Off { output, view, region, judged, pixels: *pixels, values, counts: true })
}

/// The regions that objects change. `touched` contains all pixels that objects cover, shade or light. `object`
/// contains the touched pixels that objects cover by more than half, and `shadow` all other touched pixels.
fn regions(
    picture: &Images,
    nothing: &Images,
    objects: &[&Images],
) -> Option<Vec<(&'static str, Arc<Images>)>> {
    let touched = touched(picture, nothing)?;
    let part = |is_object: bool| -> Option<Images> {
        let one = |view: &NamedImage| {
            let (width, height, _) = view.picture.size();
            let mut covered = vec![false; width * height];
            for object in objects {
                let picture = object.view(&view.name)?;
                let (.., channels) = picture.size();
                let covers = picture.samples().chunks_exact(channels);
                let covers = covers.map(|pixel| channels < 4 || pixel[3] > 0.5);
                covered.iter_mut().zip(covers).for_each(|(covered, covers)| *covered |= covers);
            }
            let samples = view.picture.samples().iter().zip(covered);
            let samples = samples.map(|(touched, covers)| if covers == is_object { *touched } else { 0.0 });
            let mask = Image::<Data>::from_samples(width, height, 1, samples.collect());
            Some(NamedImage { name: view.name.clone(), picture: Picture::Data(mask) })
        };
        touched.0.iter().map(one).collect::<Option<Vec<_>>>().map(Images)
    };
    let (object, shadow) = (part(true)?, part(false)?);
    Some(vec![("touched", Arc::new(touched)), ("object", Arc::new(object)), ("shadow", Arc::new(shadow))])
}

/// Masks that are 1 at the pixels that an inserted object covers, shades or lights, and 0 elsewhere. These are the
/// pixels at which, in linear light, the picture differs from the background by more than 0.002 plus 1 % of the
/// background.
fn touched(picture: &Images, background: &Images) -> Option<Images> {
    let mut masks = Vec::new();
    for view in &picture.0 {
        let behind = if background.0.len() == 1 {
            background.0.first().map(|b| &b.picture)
        } else {
            background.view(&view.name)
        };
        let (a, b) = (linear(&view.picture, "image").ok()?, linear(behind?, "background").ok()?);
        if (a.width, a.height) != (b.width, b.height) {
            return None;
        }
        let differs = |(p, q): (&[f32], &[f32])| {
            let far = |(p, q): (&f32, &f32)| (p - q).abs() > 0.002 + 0.01 * q.abs();
            f32::from(p.iter().zip(q).take(3).any(far))
        };
        let pixels = a.samples.chunks_exact(a.channels).zip(b.samples.chunks_exact(b.channels));
        let mask = Image::<Data>::from_samples(a.width, a.height, 1, pixels.map(differs).collect());
        masks.push(NamedImage { name: view.name.clone(), picture: Picture::Data(mask) });
    }
    Some(Images(masks))
}

/// The pictures that the nodes `asked` write or output, each picture once, and remarks on pictures that are left
/// out. Layers of an EXR file are scored only if there are no other pictures, since layers have different units.
pub fn outputs(graph: &Graph, asked: &[usize]) -> (Vec<Output>, Vec<String>) {
    let is_picture =
        |wire: &Wire| graph.nodes[wire.node].kind.outputs[wire.port].artifact.name == Images::TYPE;
    let (mut wires, mut layers, mut shown): (Vec<Wire>, Vec<Wire>, Vec<Wire>) = Default::default();
    let mut reported = Vec::new();
    for &target in asked {
        let node = &graph.nodes[target];
        if node.sink_path.is_none() {
            let first = Wire { node: target, port: 0 };
            let first = Some(first).filter(|_| !node.kind.outputs.is_empty()).filter(is_picture);
            wires.extend(first);
            shown.extend(first);
            continue;
        }
        for (port, read) in node.kind.inputs.iter().zip(&node.inputs) {
            let pictures = read.iter().filter(|wire| is_picture(wire));
            if node.kind.name != WriteExr::NAME {
                shown.extend(pictures.clone());
            }
            if ["image", "frames"].contains(&port.name) { &mut wires } else { &mut layers }.extend(pictures);
        }
    }
    wires.sort_unstable();
    wires.dedup();
    layers.retain(|layer| !wires.contains(layer));
    if wires.is_empty() {
        wires = layers;
        wires.sort_unstable();
        wires.dedup();
    } else if !layers.is_empty() {
        reported.push("layers of an EXR file are not scored, since there are other pictures".to_owned());
    }
    let output = |wire: Wire| {
        let node = &graph.nodes[wire.node];
        let port = node.kind.outputs[wire.port].name;
        let name = if wire.port == 0 { node.id.clone() } else { format!("{}.{port}", node.id) };
        let inserted = if node.kind.name == Composite::NAME { Insertion::of(graph, wire.node) } else { None };
        let space = if shown.contains(&wire) { Space::Display } else { Space::Linear };
        Output { name, wire, space, inserted, uncomputed: None }
    };
    (wires.into_iter().map(output).collect(), reported)
}

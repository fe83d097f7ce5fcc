//! One graph of all cases: their files, the method, the baselines and the scores.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::case::{Case, REFLECTION, SHADOW, View};
use crate::error::Error;
use crate::method::Method;
use crate::pictures::Given;
use crate::set::Set;
use crate::tier::Tier;

/// The baselines, each with its name in the tables and the node of `bench-baselines.ron` that makes it. "Nothing
/// inserted" is the background itself.
pub const BASELINES: [(&str, &str); 4] = [
    ("nothing inserted", "background"),
    ("no shadow", "no_shadow"),
    ("LDR light", "ldr_light"),
    ("perfect ratio", "perfect_ratio"),
];

/// The cases, methods and tiers to run.
pub struct Wanted<'a> {
    /// The set, with the cases to run.
    pub set: &'a Set,
    /// The method.
    pub method: &'a Method,
    /// Pictures of other methods.
    pub given: &'a [Given],
    /// The tiers, in order.
    pub tiers: &'a [Tier],
    /// Samples per pixel of the baselines, and of the method if it declares `samples`.
    pub samples: u32,
    /// Weights of LPIPS, absolute.
    pub lpips: Option<&'a Path>,
}

/// A picture that is scored, and where its scores and files are.
#[derive(Debug, Clone, PartialEq)]
pub struct Scored {
    /// The tier.
    pub tier: Tier,
    /// Index of the case in the set.
    pub case: usize,
    /// Name of the method or the baseline.
    pub picture: String,
    /// Node that compares the colours.
    pub colours: String,
    /// Node that compares the ratios.
    pub shade: String,
    /// Path of its picture below the output folder, with `{view}` for the view.
    pub path: String,
    /// Path of the FLIP map of its picture.
    pub flip: String,
}

/// A case that is not run in a tier.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// The tier.
    pub tier: Tier,
    /// Name of the case.
    pub case: String,
    /// The reason, and what to do.
    pub why: String,
}

/// A graph over all cases.
#[derive(Debug, Clone)]
pub struct Composed {
    /// Text of the graph.
    pub text: String,
    /// Prefixes of the names of the nodes of the method, one per case and tier.
    pub methods: Vec<String>,
    /// The scored pictures.
    pub scored: Vec<Scored>,
    /// Cases that are not run, with the reason.
    pub left_out: Vec<LeftOut>,
}

/// Path of the true picture with (`with`) or without the object, below the output folder.
pub fn truth_path(case: &Case, which: &str) -> String {
    format!("pictures/truth/{}/{which}_{{view}}.png", case.name)
}

/// Path of the light of a case, clipped at white, in the folder of the graph.
pub(crate) fn dim_path(folder: &Path, case: &Case) -> PathBuf {
    folder.join(format!("{}-dim.exr", case.name))
}

/// Makes the graph. `folder` is the folder in which [`write`](crate::write::write) puts it.
///
/// # Errors
/// [`Error::NoneLeft`] if no case can be run.
pub fn compose(wanted: &Wanted<'_>, folder: &Path) -> Result<Composed, Error> {
    let set = wanted.set;
    let mut made =
        Composed { text: String::new(), methods: Vec::new(), scored: Vec::new(), left_out: Vec::new() };
    let mut nodes = String::new();
    for (index, case) in set.cases.iter().enumerate() {
        let id = case.id();
        let before = made.scored.len();
        let mut body = String::new();
        for tier in wanted.tiers {
            match reason(case, *tier, wanted.method) {
                Some(why) => {
                    made.left_out.push(LeftOut { tier: *tier, case: case.name.clone(), why: why.to_owned() });
                }
                None => in_tier(wanted, index, *tier, &mut body, &mut made),
            }
        }
        if made.scored.len() == before {
            continue;
        }
        let _ = writeln!(nodes, "\n        // {}", case.name);
        nodes.push_str(&files(case, &id, folder));
        nodes.push_str(&body);
    }
    if made.scored.is_empty() {
        let reasons = made.left_out.iter().map(|out| format!("  {} ({}): {}", out.case, out.tier, out.why));
        return Err(Error::NoneLeft(reasons.collect::<Vec<_>>().join("\n")));
    }
    made.text = format!(
        "// The set `{}` {}, written by `lightharmony bench`. Run it with `lightharmony run`.\nGraph(\n    version: 1,\n    scene: \
         (up: \"{}\", metres_per_unit: {:?}, seed: {}),\n    nodes: ({nodes}    ),\n)\n",
        set.name,
        set.version.replace(['\n', '\r'], " "),
        set.up,
        set.metres_per_unit,
        set.seed
    );
    Ok(made)
}

/// The reason why a case cannot be run in a tier; `None` if it can.
fn reason(case: &Case, tier: Tier, method: &Method) -> Option<&'static str> {
    if case.splats.is_none() && (tier.needs_splats() || method.takes("splats")) {
        return Some(
            "the case has no splats; add them, or run the tier `true-light` with a graph that needs none",
        );
    }
    if case.splats.is_none() && case.mesh.is_none() {
        return Some("the case has neither a mesh nor splats to extract one from; add one of them");
    }
    None
}

fn quoted(path: &Path) -> String {
    format!("{:?}", path.display().to_string())
}

fn listed<T: std::fmt::Debug>(items: impl IntoIterator<Item = T>) -> String {
    let items: Vec<String> = items.into_iter().map(|item| format!("{item:?}")).collect();
    format!("[{}]", items.join(", "))
}

/// Two fields: the first of several files as `name`, the others as `more_name`.
fn several(name: &str, paths: &[PathBuf]) -> String {
    let texts: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    let (first, rest) = texts.split_first().map(|(first, rest)| (first.as_str(), rest)).unwrap_or_default();
    format!("{name}: {first:?}, more_{name}: {}", listed(rest))
}

/// The nodes that load the files of a case.
fn files(case: &Case, id: &str, folder: &Path) -> String {
    let of = |file: &str| -> Vec<PathBuf> { case.views.iter().map(|view| view.file(file)).collect() };
    let vector = |[x, y, z]: [f64; 3]| format!("({x:?}, {y:?}, {z:?})");
    let views = listed(case.views.iter().map(|view| view.name.as_str()));
    let mut text = format!(
        "        {id}_files: Subgraph(graph: \"bench-case.ron\", cameras: {}, views: {views},\n            {},\n            {},\n            \
         {},\n            object: {}, translation: {}, yaw_deg: {:?}, scale: {:?}, probe: {},\n            light: {}, dim: {},\n            \
         path_without: {:?}, path_with: {:?}),\n",
        quoted(&case.cameras),
        several("without", &of("without.exr")),
        several("with", &of("with.exr")),
        several("alpha", &of("alpha.exr")),
        quoted(&case.object),
        vector(case.translation),
        case.yaw_deg,
        case.scale,
        vector(case.probe),
        quoted(&case.light),
        quoted(&dim_path(folder, case)),
        truth_path(case, "without"),
        truth_path(case, "with"),
    );
    if let Some(splats) = &case.splats {
        let _ = writeln!(text, "        {id}_splats: LoadSplats(path: {}, frame: AsStored),", quoted(splats));
    }
    let _ = match &case.mesh {
        Some(mesh) => writeln!(text, "        {id}_mesh: LoadMesh(path: {}, colours: Srgb),", quoted(mesh)),
        None => writeln!(
            text,
            "        {id}_mesh: ExtractMesh(splats: \"{id}_splats\", cameras: \"{id}_files.rig\", around: \"{id}_files.pose\"),"
        ),
    };
    for (present, file, name) in
        [(case.shadow_masks, SHADOW, "shadow"), (case.reflection_masks, REFLECTION, "reflection")]
    {
        if present {
            let masks: Vec<PathBuf> = case.views.iter().map(|view: &View| view.file(file)).collect();
            let (first, rest) =
                masks.split_first().map(|(f, r)| (f.as_path(), r)).unwrap_or((Path::new(""), &[]));
            let rest = listed(rest.iter().map(|path| path.display().to_string()));
            let _ = writeln!(
                text,
                "        {id}_{name}: LoadImage(path: {}, more: {rest}, names: {views}, encoding: Data),",
                quoted(first)
            );
        }
    }
    text
}

/// The nodes of the method, the baselines and the scores of a case in a tier.
fn in_tier(wanted: &Wanted<'_>, index: usize, tier: Tier, text: &mut String, made: &mut Composed) {
    let case = &wanted.set.cases[index];
    let id = case.id();
    let base = format!("{id}_{}", tier.id());
    let samples = wanted.samples;
    let background = match tier {
        Tier::Splats => {
            let _ = writeln!(
                text,
                "        {base}_view: SplatRender(splats: \"{id}_splats\", rig: \"{id}_files.rig\"),"
            );
            format!("{base}_view")
        }
        _ => format!("{id}_files.without"),
    };
    let env = match tier {
        Tier::TrueLight => format!("{id}_files.light"),
        _ => {
            let _ = writeln!(
                text,
                "        {base}_light: Subgraph(graph: \"bench-light.ron\", splats: \"{id}_splats\", mesh: \"{id}_mesh\", probe: \
                 \"{id}_files.probe\"),"
            );
            format!("{base}_light.env")
        }
    };
    let inputs = [
        ("rig", format!("\"{id}_files.rig\"")),
        ("background", format!("\"{background}\"")),
        ("env", format!("\"{env}\"")),
        ("object", format!("\"{id}_files.object\"")),
        ("pose", format!("\"{id}_files.pose\"")),
        ("placed", format!("\"{id}_files.placed\"")),
        ("probe", format!("\"{id}_files.probe\"")),
        ("mesh", format!("\"{id}_mesh\"")),
        ("splats", format!("\"{id}_splats\"")),
        ("samples", samples.to_string()),
    ];
    let given: Vec<String> = inputs
        .iter()
        .filter(|(name, _)| wanted.method.takes(name))
        .map(|(name, value)| format!("{name}: {value}"))
        .collect();
    let file = wanted.method.file.as_deref().unwrap_or(Path::new("method.ron"));
    let _ = writeln!(text, "        {base}: Subgraph(graph: {}, {}),", quoted(file), given.join(", "));
    let _ = writeln!(
        text,
        "        {base}_baselines: Subgraph(graph: \"bench-baselines.ron\", rig: \"{id}_files.rig\", background: \"{background}\",\n            \
         env: \"{env}\", dim: \"{id}_files.dim\", placed: \"{id}_files.placed\", mesh: \"{id}_mesh\",\n            without: \
         \"{id}_files.without\", with: \"{id}_files.with\", samples: {samples}),"
    );
    made.methods.push(base.clone());
    let mut score = |picture: &str, part: &str, image: &str, background: &str| {
        let scored = Scored {
            tier,
            case: index,
            picture: picture.to_owned(),
            colours: format!("{base}_{part}_score.colours"),
            shade: format!("{base}_{part}_score.shade"),
            path: format!("pictures/{tier}/{}/{part}_{{view}}.png", case.name),
            flip: format!("pictures/{tier}/{}/{part}_{{view}}_flip.png", case.name),
        };
        text.push_str(&score_node(wanted, case, &scored, image, background));
        made.scored.push(scored);
    };
    score(&wanted.method.name, "method", &format!("{base}.final"), &background);
    for (name, node) in BASELINES {
        let image =
            if node == "background" { background.clone() } else { format!("{base}_baselines.{node}") };
        let part = if node == "background" { "nothing_inserted" } else { node };
        score(name, part, &image, &background);
    }
    // The background of another method is not known; its ratio is that to the true picture.
    let views = listed(case.views.iter().map(|view| view.name.as_str()));
    let mut loaded = String::new();
    for (number, other) in wanted.given.iter().enumerate() {
        let Some(paths) = &other.cases[index] else { continue };
        let node = format!("{base}_given_{number}");
        let _ = writeln!(
            loaded,
            "        {node}: LoadImage({}, names: {views}),",
            several("path", paths).replace("more_path", "more")
        );
        score(&other.name, &format!("given_{number}"), &node, &format!("{id}_files.without"));
    }
    text.push_str(&loaded);
}

/// The node that scores a picture.
fn score_node(wanted: &Wanted<'_>, case: &Case, scored: &Scored, image: &str, background: &str) -> String {
    let id = case.id();
    let node = scored.colours.strip_suffix(".colours").unwrap_or(&scored.colours);
    let shadow = if case.shadow_masks { format!("{id}_shadow") } else { format!("{id}_files.masks.shadow") };
    let mut regions = vec![("object", format!("{id}_files.masks.object")), ("shadow", shadow.clone())];
    if case.reflection_masks {
        regions.push(("reflection", format!("{id}_reflection")));
    }
    regions.push(("rest", format!("{id}_files.masks.rest")));
    let names = listed(regions.iter().map(|(name, _)| *name));
    let regions = listed(regions.iter().map(|(_, wire)| wire.as_str()));
    let lpips = wanted.lpips.map(|path| format!(" lpips: {},", quoted(path))).unwrap_or_default();
    format!(
        "        {node}: Subgraph(graph: \"bench-score.ron\", image: \"{image}\", reference: \"{id}_files.with\",\n            regions: \
         {regions}, names: {names},{lpips}\n            background: \"{background}\", exact: \"{id}_files.exact\", shadow: \
         \"{shadow}\",\n            path: {:?}, path_flip: {:?}),\n",
        scored.path, scored.flip
    )
}

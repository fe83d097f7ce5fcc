//! `compare`: differences between a picture and a reference, per region.

mod pair;
mod params;
mod table;

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes, SourceFile, SourceRoot, ViewCount, Wired};
use scene::io::foreign::refuse_placeholder;
use scene::math::metrics::Lpips;
use scene::types::layers::matching;
use scene::types::{Images, NamedImage, Picture, Report};

use pair::Pair;
pub use params::{Compare, Space};
use table::{cells, unknown};

engine::inputs! {
    /// Pictures to compare.
    pub struct In {
        /// Picture to judge.
        image: Arc<Images>,
        /// Reference picture.
        reference: Arc<Images>,
        /// Mask of the pixels that are compared: those at which its first channel is above 0.5. It applies to the
        /// row `whole` and to every region.
        mask: Option<Arc<Images>>,
        /// Regions to report separately, as masks: a pixel belongs to a region if the first channel is above 0.5.
        regions: Vec<Arc<Images>>,
        /// Picture without the object, for the baseline "nothing inserted".
        background: Option<Arc<Images>>,
        /// Picture with the object and without its shadow, for the baseline "no shadow".
        no_shadow: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// Outputs of [`Compare`].
    pub struct Out {
        /// Tables `compare` for colours and `ratio` for data.
        report: Arc<Report>,
        /// Absolute difference of each sample, times `gain`, as data.
        difference: Arc<Images>,
        /// FLIP of each pixel, 0 to 1, as data; only for pictures of colours.
        flip: Arc<Images>,
    }
}

impl Kind for Compare {
    const NAME: &'static str = "compare";
    const VERSION: u32 = 10;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn sources(p: &Self, root: &SourceRoot) -> Result<Vec<SourceFile>, NodeError> {
        Ok(p.lpips.iter().map(|path| root.file(path)).collect())
    }

    fn check_wires(p: &Self, wired: &Wired) -> Result<(), NodeError> {
        check_names(p, wired.of("regions").len())
    }

    fn views(_: &Self, _: &SourceRoot) -> ViewCount {
        ViewCount::As(&["image"])
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        check_names(p, inputs.regions.len())?;
        let lpips = match &p.lpips {
            Some(path) => {
                let bytes = cx.read(path)?;
                let parsed = refuse_placeholder(&path.0, &bytes).and_then(|()| Lpips::parse(&path.0, &bytes));
                Some(parsed.map_err(|e| NodeError::from(e).at("lpips"))?)
            }
            None => None,
        };
        let mut notes = Notes::none();
        let (mut colour, mut ratio) = (Vec::new(), Vec::new());
        let (mut differences, mut flips) = (Vec::new(), Vec::new());
        let views = &inputs.image.0;
        for (index, view) in views.iter().enumerate() {
            cx.progress(index as f32 / views.len() as f32);
            let size = view.picture.size();
            let find = |images: &'_ Arc<Images>, port: &'static str| -> Result<Picture, NodeError> {
                // A single picture applies to a single view, but not to each of several.
                if views.len() > 1 && !images.0.iter().any(|image| image.name == view.name) {
                    return Err(NodeError::new(format!("`{port}` has no view `{}`", view.name)).at(port));
                }
                matching(images, port, &view.name, (size.0, size.1)).cloned()
            };
            let reference = find(&inputs.reference, "reference")?;
            let mask = inputs.mask.as_ref().map(|mask| find(mask, "mask").map(|m| inside(&m))).transpose()?;
            if let Some(mask) = &mask {
                let shown = mask.iter().filter(|shown| **shown).count();
                let text = format!("the mask of `{}` contains {shown} of {} pixels", view.name, mask.len());
                notes.decision(
                    "masked",
                    format!("{text}; the row `whole` and all regions contain only these pixels"),
                );
            }
            let mut regions = vec![("whole".to_owned(), None)];
            for (k, region) in inputs.regions.iter().enumerate() {
                let name = p.names.get(k).cloned().unwrap_or_else(|| format!("region {}", k + 1));
                regions.push((name, Some(inside(&find(region, "regions")?))));
            }
            let baseline = |images: &Option<Arc<Images>>, port| {
                images.as_ref().map(|images| find(images, port)).transpose()
            };
            let pictures = [
                ("image", Some(view.picture.clone())),
                ("nothing inserted", baseline(&inputs.background, "background")?),
                ("no shadow", baseline(&inputs.no_shadow, "no_shadow")?),
            ];
            let mut is_colour = true;
            for (k, (name, picture)) in pictures.iter().enumerate() {
                cx.check()?;
                let table = if is_colour { &mut colour } else { &mut ratio };
                let Some(picture) = picture else {
                    // A baseline without a wire is not computed, and its row has no values.
                    table.extend(
                        regions.iter().map(|(region, _)| unknown([&view.name, name, region], is_colour)),
                    );
                    continue;
                };
                let pair = Pair::new(p, picture, &reference, lpips.as_ref(), cx)?;
                if k == 0 {
                    let named = |picture: Picture| NamedImage { name: view.name.clone(), picture };
                    let open = open(picture).max(open(&reference));
                    if open > 0 && pair.is_colour() {
                        let text = format!(
                            "`{}` has transparent pixels, which are composited on black (count: {open})",
                            view.name
                        );
                        notes.decision(
                            "alpha-on-black",
                            format!("{text}; `backdrop` of `composite` fills them"),
                        );
                    }
                    differences.push(named(pair.difference(p.gain).into()));
                    flips.extend(pair.flip().map(|map| named(map.into())));
                    for (id, what) in pair.not_computed(p, mask.is_some()) {
                        notes.decision(id, format!("`{}`: {what}", view.name));
                    }
                }
                for (region, within) in &regions {
                    let row = pair.row(within.as_deref(), mask.as_deref());
                    if row.is_none() {
                        notes.warning(
                            "empty-region",
                            format!("region `{region}` of `{}` contains no pixel", view.name),
                        );
                    }
                    is_colour = pair.is_colour();
                    let table = if is_colour { &mut colour } else { &mut ratio };
                    table.push(cells([&view.name, name, region], row, pair.is_colour(), size.0 * size.1));
                }
            }
        }
        let report = Arc::new(table::report(p, colour, ratio));
        Ok((Out { report, difference: Arc::new(Images(differences)), flip: Arc::new(Images(flips)) }, notes))
    }
}

fn check_names(p: &Compare, regions: usize) -> Result<(), NodeError> {
    for (at, name) in p.names.iter().enumerate() {
        if name == "whole" || p.names[..at].contains(name) {
            let what = format!("two rows of each view would have the name `{name}`");
            return Err(NodeError::new(what).at("names").hint("give every region a unique name"));
        }
    }
    if p.names.is_empty() || p.names.len() == regions {
        return Ok(());
    }
    let what =
        format!("`names` must list one name per region (names: {}, regions: {regions})", p.names.len());
    Err(NodeError::new(what).at("names").hint("name every region, in the order of the wires"))
}

/// Number of transparent pixels whose value would change by half an 8-bit code or more if they were composited on
/// white instead of black.
fn open(picture: &Picture) -> usize {
    let (_, _, channels) = picture.size();
    let pixels = picture.samples().chunks_exact(channels.max(1));
    pixels.filter(|pixel| channels == 4 && 1.0 - pixel[3] > 0.5 / 255.0).count()
}

fn inside(mask: &Picture) -> Vec<bool> {
    mask.samples().chunks_exact(mask.size().2.max(1)).map(|pixel| pixel[0] > 0.5).collect()
}

#[cfg(test)]
mod tests;

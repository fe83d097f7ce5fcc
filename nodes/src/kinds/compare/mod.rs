//! `compare`: how far a picture lies from a reference, for each region.

mod pair;
mod table;

use std::sync::Arc;

use engine::{Context, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, ViewCount, Wired};

use crate::math::metrics::{Lpips, PIXELS_PER_DEGREE};
use crate::types::layers::matching;
use crate::types::{Images, NamedImage, Picture, Report};
use pair::Pair;
use table::{cells, unknown};

engine::choices! {
    /// In which numbers pictures are compared.
    pub enum Space {
        /// Display-encoded with the sRGB curve, cut off to 0 to 1; as papers do.
        Display,
        /// Linear light, not cut off; PSNR and SSIM still take white as 1, and in place of FLIP there is HDR-FLIP over the
        /// exposures that the reference asks for, in columns of that name.
        Linear,
    }
}
engine::params! {
    /// Measures how far a picture lies from a reference.
    ///
    /// One row for each view, picture and region, in a table `compare` for colours: PSNR; SSIM as the code
    /// of 3D Gaussian splatting has it (`ssim_3dgs_zero_pad`) and without the border (`ssim_valid`, whole
    /// pictures only); FLIP, the difference that a viewer sees when the two alternate, as mean and 95th
    /// percentile; CIEDE2000; LPIPS where weights are given; mean and largest error; relative MSE in linear
    /// light, `mean((a - b)^2 / (b^2 + 0.01))`. Data, such as the ratio of a shadow, has a table `ratio`:
    /// the mean of `|ln a - ln b|`, where what is below 0.001 counts as that, and how far the two agree on what is
    /// shadow (below 0.98) as intersection over union. What cannot be computed is left out of its row, never 0.
    ///
    /// A region's SSIM and FLIP average the map over it. In `Linear` the columns of FLIP are of high dynamic range
    /// (`hdr-flip mean`, `hdr-flip p95`), and CIEDE2000 and LPIPS are not computed, which is told. Judge an inserted object beside two baselines, since whole-picture numbers hardly move: wire
    /// `background` for the row "nothing inserted" and `no_shadow` for "no shadow"; without its wire a
    /// baseline is not computed.
    ///
    /// Alpha itself is not compared. What it leaves open is black, put there in the numbers of the picture: in
    /// display values behind a view of splats, as its trainer's metrics have it, and in light behind what
    /// `composite` gives. `Linear` puts it behind both in light, so that a composite of nothing is its background.
    pub struct Compare {
        /// In which numbers to compare. Pictures of data are compared as they are.
        space: Space = Space::Display, other("Linear");
        /// Rounds display values to 8 bits first, as papers do that read PNG files.
        quantise: bool = true, other("false");
        /// Names of the regions, in the order of the wires: each another one, and none `whole`.
        names: Vec<String> = Vec::new(), other("[\"shadow\"]"), inert("without regions there is nothing to name");
        /// Multiplies the difference picture.
        gain: f64 = 1.0, range(0, 1e6), other("4.0");
        /// How densely the viewer sees pixels, for FLIP.
        pixels_per_degree: f64 = PIXELS_PER_DEGREE, range(1, 1000), unit("1/deg"), other("32.0");
        /// Weights of LPIPS, a safetensors file of AlexNet or VGG16 and its five heads, named as torchvision
        /// and the `lpips` package name them. None are shipped: the networks are not ours to give.
        lpips: Option<InputFile> = None, other("\"lpips.safetensors\"");
        /// Scores that another program gave pictures for what a text asks for and for what it forbids: (positive,
        /// negative), from 0 up. A table `prompt` then has `positive / (positive + negative)` of each, the mean of
        /// these, and that of the sums, which papers are not always clear about.
        scores: Vec<[f64; 2]> = Vec::new(), range(0, 1e9), other("[(0.6, 0.2)]");
        /// Gives LPIPS its input from -1 to 1, as its networks expect. The code of 3D Gaussian splatting
        /// gives 0 to 1, and prints smaller numbers.
        lpips_scaled: bool = true, other("false"), inert("without weights there is no LPIPS");
    }
}
engine::inputs! {
    /// What to compare.
    pub struct In {
        /// The picture to judge.
        image: Arc<Images>,
        /// The truth.
        reference: Arc<Images>,
        /// Only pixels where its first channel is above 0.5 count, for the row `whole` and every region.
        mask: Option<Arc<Images>>,
        /// Regions to report on their own: masks whose first channel is above 0.5 inside.
        regions: Vec<Arc<Images>>,
        /// The picture with nothing inserted, for that baseline.
        background: Option<Arc<Images>>,
        /// The picture with the object and no shadow, for that baseline.
        no_shadow: Option<Arc<Images>>,
    }
}
engine::outputs! {
    /// What was found.
    pub struct Out {
        /// Tables `compare` and `ratio`, where there are such pictures.
        report: Arc<Report>,
        /// Absolute difference of each sample, times `gain`, as data.
        difference: Arc<Images>,
        /// FLIP of each pixel, 0 to 1, as data; only of pictures that are colours.
        flip: Arc<Images>,
    }
}

impl Kind for Compare {
    const NAME: &'static str = "compare";
    const VERSION: u32 = 7;
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
                Some(Lpips::parse(&path.0, &cx.read(path)?).map_err(|e| NodeError::from(e).at("lpips"))?)
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
                // One picture stands for the only view, but not for each of several.
                if views.len() > 1 && !images.0.iter().any(|image| image.name == view.name) {
                    return Err(NodeError::new(format!("`{port}` has no view `{}`", view.name)).at(port));
                }
                matching(images, port, &view.name, (size.0, size.1)).cloned()
            };
            let reference = find(&inputs.reference, "reference")?;
            let mask = inputs.mask.as_ref().map(|mask| find(mask, "mask").map(|m| inside(&m))).transpose()?;
            if let Some(mask) = &mask {
                let shown = mask.iter().filter(|shown| **shown).count();
                let text = format!("{shown} of {} pixels of `{}` are in the mask", mask.len(), view.name);
                notes.decision(
                    "masked",
                    format!("{text}: `whole` is these, and every region is what it has of them"),
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
                    // What is not wired is not computed, and says so.
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
                            "`{}`: {open} pixels are not opaque and are compared on black",
                            view.name
                        );
                        notes
                            .decision("alpha-on-black", format!("{text}; `composite(backdrop:)` fills them"));
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
                            format!("region `{region}` of `{}` has no pixel", view.name),
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
            let what = format!("two rows of each view would be called `{name}`");
            return Err(NodeError::new(what).at("names").hint("give every region a name of its own"));
        }
    }
    if p.names.is_empty() || p.names.len() == regions {
        return Ok(());
    }
    let what = format!("{regions} regions but {} names", p.names.len());
    Err(NodeError::new(what).at("names").hint("name every region, in the order of the wires"))
}

/// Pixels through which at least half a code of 8 bits of something white behind would show.
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

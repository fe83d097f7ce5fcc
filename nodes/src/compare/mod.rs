//! `compare`: how far a picture lies from a reference, for each region.

mod pair;

use std::sync::Arc;

use engine::{Context, InputFile, Kind, NodeError, Notes, SourceFile, SourceRoot, ViewCount, Wired};

use crate::layers::matching;
use crate::metrics::{Lpips, PIXELS_PER_DEGREE};
use crate::types::{Cell, Images, NamedImage, Picture, Report, Table};
use pair::{Pair, Row};

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

/// Columns of both tables, then of each.
const COMMON: [&str; 5] = ["view", "picture", "region", "pixels", "share of picture"];
const COLOUR: [&str; 10] = [
    "psnr (dB)",
    "ssim_3dgs_zero_pad",
    "ssim_valid",
    "flip mean",
    "flip p95",
    "ciede2000 mean",
    "lpips",
    "mean absolute error",
    "largest error",
    "relative mse (linear, eps 0.01)",
];
/// Where the columns of FLIP begin, and what they are in `Linear`.
const FLIP: usize = 3;
const HDR_FLIP: [&str; 2] = ["hdr-flip mean", "hdr-flip p95"];
const RATIO: [&str; 5] = [
    "psnr (dB)",
    "mean absolute error",
    "largest error",
    "mean |ln a - ln b| (from 0.001 up)",
    "shadow IoU (below 0.98)",
];
/// Less light than this share is as good as none: what is below counts as this in the logarithm, so that a shadow which is
/// pitch black, as `shadow-ratio` may give, is off by a number and not left out.
const DARKEST: f64 = 0.001;

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
        let space = match p.space {
            Space::Display if p.quantise => "display values, 8 bits",
            Space::Display => "display values",
            Space::Linear => "linear light, HDR-FLIP",
        };
        let title = match (colour.is_empty(), ratio.is_empty()) {
            (true, false) => "Distance to the reference, of data as they are".to_owned(),
            (false, false) => format!("Distance to the reference, in {space}; of data as they are"),
            (_, true) => format!("Distance to the reference, in {space}"),
        };
        let table = |name: &str, columns: &[&str], rows| Table {
            name: name.to_owned(),
            columns: COMMON.iter().chain(columns).map(|&c| c.to_owned()).collect(),
            rows,
        };
        let mut tables = Vec::new();
        if !colour.is_empty() || ratio.is_empty() {
            let mut columns = COLOUR;
            if p.space == Space::Linear {
                columns[FLIP..].iter_mut().zip(HDR_FLIP).for_each(|(column, hdr)| *column = hdr);
            }
            tables.push(table("compare", &columns, colour));
        }
        if !ratio.is_empty() {
            tables.push(table("ratio", &RATIO, ratio));
        }
        if !p.scores.is_empty() {
            tables.push(prompt(&p.scores));
        }
        let report = Arc::new(Report { title, tables });
        Ok((Out { report, difference: Arc::new(Images(differences)), flip: Arc::new(Images(flips)) }, notes))
    }
}

/// Shares of the positive scores. Where both are 0 there is none, and no mean counts them.
fn prompt(scores: &[[f64; 2]]) -> Table {
    let share = |[positive, negative]: [f64; 2]| {
        (positive + negative > 0.0).then(|| positive / (positive + negative))
    };
    let row = |name: String, [a, b]: [f64; 2], share: Option<f64>| {
        vec![Cell::Text(name), Cell::Number(a), Cell::Number(b), number(share)]
    };
    let mut rows: Vec<Vec<Cell>> =
        scores.iter().enumerate().map(|(i, s)| row((i + 1).to_string(), *s, share(*s))).collect();
    let shares: Vec<f64> = scores.iter().filter_map(|s| share(*s)).collect();
    let count = shares.len().max(1) as f64;
    let mean = (!shares.is_empty()).then(|| shares.iter().sum::<f64>() / count);
    // Scores are not negative, so those without a share add nothing to the sums.
    let sums = scores.iter().fold([0.0; 2], |sum, s| [sum[0] + s[0], sum[1] + s[1]]);
    rows.push(row("mean of those with a share".to_owned(), sums.map(|s| s / count), mean));
    rows.push(row("share of the sums".to_owned(), sums, share(sums)));
    let columns =
        ["score", "positive", "negative", "positive / (positive + negative)"].map(String::from).to_vec();
    Table { name: "prompt".to_owned(), columns, rows }
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

fn number(value: Option<f64>) -> Cell {
    match value {
        Some(value) if value.is_finite() => Cell::Number(value),
        Some(value) if value.is_infinite() => Cell::Text(value.to_string()),
        _ => Cell::Missing,
    }
}

/// A row of which nothing is known.
fn unknown(names: [&str; 3], colour: bool) -> Vec<Cell> {
    let mut cells: Vec<Cell> = names.iter().map(|name| Cell::Text((*name).to_owned())).collect();
    cells.resize(COMMON.len() + if colour { COLOUR.len() } else { RATIO.len() }, Cell::Missing);
    cells
}

fn cells(names: [&str; 3], row: Option<Row>, colour: bool, pixels: usize) -> Vec<Cell> {
    let mut cells: Vec<Cell> = names.iter().map(|name| Cell::Text((*name).to_owned())).collect();
    let count = row.as_ref().map_or(0, |row| row.errors.pixels);
    cells.push(Cell::Count(count));
    cells.push(number(Some(count as f64 / pixels.max(1) as f64)));
    let Some(row) = row else {
        let more = if colour { COLOUR.len() } else { RATIO.len() };
        cells.resize(cells.len() + more, Cell::Missing);
        return cells;
    };
    let (psnr, absolute, largest) =
        (Some(row.errors.psnr()), Some(row.errors.mean_absolute), Some(row.errors.largest));
    let values: &[Option<f64>] = if colour {
        &[
            psnr,
            row.ssim,
            row.ssim_valid,
            row.flip,
            row.flip_p95,
            row.ciede2000,
            row.lpips,
            absolute,
            largest,
            row.relative,
        ]
    } else {
        &[psnr, absolute, largest, row.log_error, row.iou]
    };
    cells.extend(values.iter().map(|value| number(*value)));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num;
    use crate::testing::context;
    use crate::types::{Data, Image, Linear, Srgb};

    fn one(picture: impl Into<Picture>) -> Arc<Images> {
        Arc::new(Images::single("v", picture))
    }
    fn node() -> Compare {
        Compare {
            space: Space::Display,
            quantise: true,
            names: Vec::new(),
            gain: 1.0,
            pixels_per_degree: PIXELS_PER_DEGREE,
            lpips: None,
            scores: Vec::new(),
            lpips_scaled: true,
        }
    }
    fn inputs(image: Arc<Images>, reference: Arc<Images>) -> In {
        In { image, reference, mask: None, regions: Vec::new(), background: None, no_shadow: None }
    }
    fn flat(v: f32) -> Arc<Images> {
        one(Image::<Srgb>::from_samples(16, 12, 3, vec![v; 576]))
    }
    fn left_half() -> Arc<Images> {
        one(Image::<Data>::from_samples(16, 12, 1, (0..192).map(|i| f32::from(i % 16 < 8)).collect()))
    }

    // A view of which every pixel is half there, and the same with nothing inserted, which is light.
    #[test]
    fn what_is_open_is_black_in_the_numbers_of_the_picture() {
        use crate::composite::{Composite, In as Layers};
        let view = one(Image::<Srgb>::from_samples(16, 12, 4, [0.3, 0.2, 0.1, 0.5].repeat(192)));
        let layers = Layers {
            background: view.clone(),
            object: one(Image::<Linear>::new(16, 12, 4)),
            shadow: None,
            added: None,
            front: None,
            variance: None,
        };
        let (made, _) = Composite::run(&Composite { backdrop: None }, layers, &context()).expect("runs");
        let off = |space: Space| {
            let node = Compare { space, quantise: false, ..node() };
            let (out, notes) =
                Compare::run(&node, inputs(made.image.clone(), view.clone()), &context()).expect("runs");
            let told = notes.iter().find(|note| note.id == "alpha-on-black").expect("told");
            assert!(told.text.contains("192 pixels"), "{}", told.text);
            out.difference.0[0].picture.samples()[0]
        };
        assert_eq!(off(Space::Linear), 0.0);
        let light = 0.5 * crate::color::linear_from_srgb(0.6);
        let expected = (crate::color::srgb_from_linear(light) - 0.3).abs();
        assert!((off(Space::Display) - expected).abs() < 1e-6 && expected > 0.1);
        let opaque = one(Image::<Srgb>::from_samples(16, 12, 4, [0.3, 0.2, 0.1, 1.0].repeat(192)));
        let (_, notes) = Compare::run(&node(), inputs(opaque.clone(), opaque), &context()).expect("runs");
        assert!(notes.iter().all(|note| note.id != "alpha-on-black"));
    }

    #[test]
    fn rows_for_baselines_and_regions() {
        let names = vec!["left".to_owned()];
        let all = In {
            regions: vec![left_half()],
            background: Some(flat(0.2)),
            no_shadow: Some(flat(0.6)),
            ..inputs(flat(0.8), flat(0.8))
        };
        let (out, notes) = Compare::run(&Compare { names, ..node() }, all, &context()).expect("runs");
        assert_eq!(notes.iter().count(), 0);
        let table = &out.report.tables[0];
        let rows: Vec<(&Cell, &Cell, &Cell)> = table.rows.iter().map(|r| (&r[1], &r[2], &r[3])).collect();
        let text = |t: &str| Cell::Text(t.to_owned());
        assert_eq!(rows[0], (&text("image"), &text("whole"), &Cell::Count(192)));
        assert_eq!(rows[1], (&text("image"), &text("left"), &Cell::Count(96)));
        assert_eq!(rows[3], (&text("nothing inserted"), &text("left"), &Cell::Count(96)));
        assert_eq!(rows[4].0, &text("no shadow"));
        assert_eq!(table.rows[0][5], text("inf"));
        assert!(
            matches!(table.rows[2][5], Cell::Number(db) if (db - 4.436_974_992).abs() < 1e-8),
            "{:?}",
            table.rows[2][5]
        );
        assert_eq!(table.rows[1][7], Cell::Missing, "ssim_valid of a region is not computed");
        assert!(table.rows.iter().all(|row| row.len() == table.columns.len()));
    }

    #[test]
    fn a_mask_restricts_everything_and_empty_regions_are_told() {
        let half =
            one(Image::<Srgb>::from_samples(16, 12, 3, (0..576).map(|i| f32::from(i % 48 < 24)).collect()));
        let masked = In { mask: Some(left_half()), ..inputs(half.clone(), flat(1.0)) };
        let (out, notes) = Compare::run(&node(), masked, &context()).expect("runs");
        assert!(notes.iter().any(|note| note.id == "masked" && note.text.contains("`whole` is these")));
        assert_eq!(out.report.tables[0].rows[0][5], Cell::Text("inf".to_owned()));
        let nothing = one(Image::<Data>::new(16, 12, 1));
        let empty = In { regions: vec![nothing], ..inputs(half, flat(1.0)) };
        let (out, notes) = Compare::run(&node(), empty, &context()).expect("runs");
        assert!(notes.iter().any(|n| n.id == "empty-region"));
        assert_eq!(out.report.tables[0].rows[1][5], Cell::Missing);
    }

    #[test]
    fn spaces_and_rounding_differ_as_they_should() {
        let dim = one(Image::<Linear>::from_samples(16, 12, 3, vec![0.5; 576]));
        let bright = one(Image::<Linear>::from_samples(16, 12, 3, vec![2.0; 576]));
        let psnr = |p: &Compare| {
            let (out, _) = Compare::run(p, inputs(dim.clone(), bright.clone()), &context()).expect("runs");
            match out.report.tables[0].rows[0][5] {
                Cell::Number(db) => db,
                _ => f64::NAN,
            }
        };
        let linear = psnr(&Compare { space: Space::Linear, ..node() });
        assert!((linear + 20.0 * libm::log10(1.5)).abs() < 1e-9);
        // The display cuts 2 off to 1, and 0.5 shows as 187.5 codes.
        let exact = psnr(&Compare { quantise: false, ..node() });
        assert!((exact + 20.0 * libm::log10(1.0 - 0.735_356_98)).abs() < 1e-5);
        assert!((psnr(&node()) + 20.0 * libm::log10(1.0 - 188.0 / 255.0)).abs() < 1e-9);
    }

    #[test]
    fn difference_has_gain_and_mismatches_are_refused() {
        let p = Compare { gain: 2.0, ..node() };
        let (out, _) = Compare::run(&p, inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
        assert!(out.difference.0[0].picture.samples().iter().all(|v| (v - 0.8).abs() < 1e-6));
        let small = one(Image::<Srgb>::new(4, 4, 3));
        assert!(Compare::run(&node(), inputs(flat(0.1), small), &context()).is_err());
        let (out, _) = Compare::run(&node(), inputs(flat(0.8), flat(0.8)), &context()).expect("runs");
        let bare = &out.report.tables[0].rows;
        assert!(
            bare.len() == 3
                && bare[2][1] == Cell::Text("no shadow".to_owned())
                && bare[2][5] == Cell::Missing,
            "{bare:?}"
        );
        assert!(Compare::run(&node(), inputs(flat(0.1), left_half()), &context()).is_err());
        let named = Compare { names: vec!["a".into()], ..node() };
        assert!(Compare::run(&named, inputs(flat(0.1), flat(0.1)), &context()).is_err());
    }

    #[test]
    fn the_mean_of_shares_is_not_the_share_of_sums() {
        let p = Compare { scores: vec![[0.6, 0.2], [0.0, 0.0], [1.0, 3.0]], ..node() };
        let (out, _) = Compare::run(&p, inputs(flat(0.5), flat(0.5)), &context()).expect("runs");
        let table = &out.report.tables[1];
        let shares: Vec<&Cell> = table.rows.iter().map(|row| &row[3]).collect();
        let number = |cell: &Cell, want: f64| matches!(cell, Cell::Number(v) if (v - want).abs() < 1e-12);
        assert!(number(shares[0], 0.75) && *shares[1] == Cell::Missing && number(shares[2], 0.25));
        assert!(number(&table.rows[3][1], 0.8) && number(&table.rows[3][2], 1.6), "of the two that have one");
        assert!(number(shares[3], 0.5) && number(shares[4], 1.6 / 4.8), "{shares:?}");
    }

    #[test]
    fn no_two_rows_of_a_view_have_one_name() {
        let twice = |names: [&str; 2]| {
            let names = names.map(str::to_owned).to_vec();
            let all = In { regions: vec![left_half(), left_half()], ..inputs(flat(0.2), flat(0.6)) };
            Compare::run(&Compare { names, ..node() }, all, &context()).map(|_| ())
        };
        assert!(twice(["left", "right"]).is_ok());
        for names in [["left", "left"], ["left", "whole"]] {
            let error = twice(names).expect_err("is refused");
            assert!(error.to_string().contains(names[1]), "{error}");
        }
    }

    #[test]
    fn ratios_have_their_own_table() {
        let map = |dark: f32| {
            one(Image::<Data>::from_samples(
                16,
                12,
                1,
                (0..192).map(|i| if i % 16 < 8 { dark } else { 1.0 }).collect(),
            ))
        };
        let (out, _) = Compare::run(&node(), inputs(map(0.25), map(0.5)), &context()).expect("runs");
        let table = &out.report.tables[0];
        assert_eq!((out.report.tables.len(), &*table.name), (1, "ratio"));
        let value = |c: &str| {
            let at = table.columns.iter().position(|column| column.starts_with(c));
            table.rows[0][at.expect("is a column")].clone()
        };
        // Half of the pixels are off by a factor of two, and both call the same half a shadow.
        assert!(matches!(value("mean |ln"), Cell::Number(v) if (v - 0.5 * num::f64::ln(2.0)).abs() < 1e-12));
        assert_eq!(value("shadow IoU"), Cell::Number(1.0));
        let (out, _) = Compare::run(&node(), inputs(map(1.0), map(0.5)), &context()).expect("runs");
        assert_eq!(out.report.tables[0].rows[0].last(), Some(&Cell::Number(0.0)));
        assert!(out.flip.0.is_empty());
    }

    // Half of the pixels are black where the truth is one half. And nothing equals what is infinitely far off.
    #[test]
    fn what_is_pitch_black_or_infinite_is_off() {
        let map = |dark: f32| one(Image::<Data>::from_samples(2, 1, 1, vec![dark, 1.0]));
        let row = |dark: f32| {
            let (out, _) = Compare::run(&node(), inputs(map(dark), map(0.5)), &context()).expect("runs");
            let table = &out.report.tables[0];
            let at =
                |name: &str| table.columns.iter().position(|c| c.starts_with(name)).expect("is a column");
            [at("psnr"), at("mean |ln")].map(|at| table.rows[0][at].clone())
        };
        let want = 0.5 * num::f64::ln(500.0);
        for dark in [0.0, -1.0, 1e-4] {
            assert!(matches!(row(dark)[1], Cell::Number(v) if (v - want).abs() < 1e-12), "{dark}");
        }
        assert_eq!(row(f32::INFINITY), [Cell::Text("-inf".to_owned()), Cell::Text("inf".to_owned())]);
        assert_eq!(row(0.5)[0], Cell::Text("inf".to_owned()));
        assert_eq!(row(f32::NAN)[1], Cell::Missing);
    }

    // A depth beside itself: what is not there is there in neither. Data of other channels are refused by them.
    #[test]
    fn what_is_infinite_alike_is_no_difference() {
        let depth = |channels: usize, values: &[f32]| {
            one(Image::<Data>::from_samples(values.len() / channels, 1, channels, values.to_vec()))
        };
        let row = |a: Arc<Images>, b: Arc<Images>| {
            let (out, notes) = Compare::run(&node(), inputs(a, b), &context()).expect("runs");
            let row = out.report.tables[0].rows[0][COMMON.len()..].to_vec();
            (row, notes.iter().map(|note| note.text.clone()).collect::<Vec<_>>().join("; "))
        };
        let far = [2.0, f32::INFINITY, 4.0, f32::NEG_INFINITY];
        let (own, notes) = row(depth(1, &far), depth(1, &far));
        let text = |text: &str| Cell::Text(text.to_owned());
        let zero = Cell::Number(0.0);
        assert_eq!(own, [text("inf"), zero.clone(), zero.clone(), zero, Cell::Number(1.0)]);
        assert_eq!(notes, "");
        let (off, _) = row(depth(1, &far), depth(1, &[2.5, f32::INFINITY, 4.0, f32::NEG_INFINITY]));
        assert_eq!(off[1], Cell::Number(0.125));
        assert_eq!(row(depth(1, &far), depth(1, &[2.0, 3.0, 4.0, 0.0])).0[1], text("inf"));
        let (_, notes) = row(depth(1, &[1.0, f32::NAN]), depth(1, &[1.0, 1.0]));
        assert!(notes.contains("1 samples are no numbers"), "{notes}");
        let other = inputs(depth(1, &[1.0]), depth(3, &[1.0; 3]));
        let Err(told) = Compare::run(&node(), other, &context()) else { panic!("is compared") };
        assert!(told.to_string().contains("data of 1 channels"), "{told}");
    }

    #[test]
    fn luminance_alone_is_grey() {
        let light =
            |channels: usize, values: Vec<f32>| one(Image::<Linear>::from_samples(16, 12, channels, values));
        let ramp = |v: usize| v as f32 / 192.0;
        let grey = light(1, (0..192).map(ramp).collect());
        let clear = light(2, (0..192).flat_map(|v| [ramp(v), 1.0]).collect());
        let colour = light(3, (0..192).flat_map(|v| [ramp(v); 3]).collect());
        for other in [grey, clear] {
            let (out, _) = Compare::run(&node(), inputs(other, colour.clone()), &context()).expect("runs");
            assert_eq!(out.report.tables[0].rows[0][COMMON.len()], Cell::Text("inf".to_owned()));
        }
    }

    #[test]
    fn what_a_viewer_sees_has_a_map_and_what_is_missing_is_said() {
        let (out, notes) = Compare::run(&node(), inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
        let map = out.flip.0[0].picture.samples();
        let table = &out.report.tables[0];
        let at = table.columns.iter().position(|c| c == "flip mean").expect("is a column");
        assert!(
            matches!(table.rows[0][at], Cell::Number(v) if (v - f64::from(map[0])).abs() < 1e-6 && v > 0.2)
        );
        assert_eq!(table.rows[0][at + 3], Cell::Missing, "LPIPS without weights");
        assert_eq!(notes.iter().count(), 0, "nobody asked for LPIPS");
        let linear = Compare { space: Space::Linear, ..node() };
        let (hdr, _) = Compare::run(&linear, inputs(flat(0.2), flat(0.6)), &context()).expect("runs");
        let columns = &hdr.report.tables[0].columns;
        assert_eq!(
            columns[at..at + 2],
            ["hdr-flip mean", "hdr-flip p95"],
            "another measure has another name"
        );
        assert_eq!(columns[..at], table.columns[..at]);
        let broken = Compare { lpips: Some(InputFile("none".into())), ..node() };
        assert!(Compare::run(&broken, inputs(flat(0.2), flat(0.6)), &context()).is_err());
    }
}

//! `compare`: how far a picture lies from a reference, for each region.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes};

use crate::color::srgb_from_linear;
use crate::layers::{linear, matching};
use crate::metrics::{Errors, Plane, SSIM_RADIUS, errors, mean_over, ssim_map};
use crate::types::{Cell, Data, Image, Images, NamedImage, Picture, Report, Table};

engine::choices! {
    /// In which numbers pictures are compared.
    pub enum Space {
        /// Display-encoded with the sRGB curve, cut off to 0 to 1; as papers do.
        Display,
        /// Linear light, not cut off; PSNR and SSIM still take white as 1.
        Linear,
    }
}
engine::params! {
    /// Measures how far a picture lies from a reference.
    ///
    /// One row for each view, picture and region: PSNR; SSIM as the code of 3D Gaussian splatting has it
    /// (`ssim_3dgs_zero_pad`) and without the border (`ssim_valid`, whole pictures only); mean and largest
    /// error; relative MSE in linear light, `mean((a - b)^2 / (b^2 + 0.01))`. A region's SSIM averages the
    /// map over it. Judge an inserted object beside two baselines, since whole-picture numbers hardly move:
    /// wire `background` for the row "nothing inserted" and `no_shadow` for "no shadow". Alpha is left on
    /// black.
    pub struct Compare {
        /// In which numbers to compare. Pictures of data are compared as they are.
        space: Space = Space::Display, other("Linear");
        /// Rounds display values to 8 bits first, as papers do that read PNG files.
        quantise: bool = true, other("false");
        /// Names of the regions, in the order of the wires.
        names: Vec<String> = Vec::new(), other("[\"shadow\"]"), inert("without regions there is nothing to name");
        /// Multiplies the difference picture.
        gain: f64 = 1.0, range(0, 1e6), other("4.0");
    }
}
engine::inputs! {
    /// What to compare.
    pub struct In {
        /// The picture to judge.
        image: Arc<Images>,
        /// The truth.
        reference: Arc<Images>,
        /// Only pixels where its first channel is above 0.5 count.
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
        /// A table `compare`.
        report: Arc<Report>,
        /// Absolute difference of each sample, times `gain`, as data.
        difference: Arc<Images>,
    }
}

const COLUMNS: [&str; 11] = [
    "view",
    "picture",
    "region",
    "pixels",
    "share of picture",
    "psnr (dB)",
    "ssim_3dgs_zero_pad",
    "ssim_valid",
    "mean absolute error",
    "largest error",
    "relative mse (linear, eps 0.01)",
];

impl Kind for Compare {
    const NAME: &'static str = "compare";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        if !p.names.is_empty() && p.names.len() != inputs.regions.len() {
            let what = format!("{} regions but {} names", inputs.regions.len(), p.names.len());
            return Err(NodeError::new(what)
                .at("names")
                .hint("name every region, in the order of the wires"));
        }
        let mut notes = Notes::none();
        let (mut rows, mut differences) = (Vec::new(), Vec::new());
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
            let mut regions = vec![("whole".to_owned(), None)];
            for (k, region) in inputs.regions.iter().enumerate() {
                let name = p.names.get(k).cloned().unwrap_or_else(|| format!("region {}", k + 1));
                regions.push((name, Some(inside(&find(region, "regions")?))));
            }
            let mut pictures = vec![("image", view.picture.clone())];
            if let Some(background) = &inputs.background {
                pictures.push(("nothing inserted", find(background, "background")?));
            }
            if let Some(no_shadow) = &inputs.no_shadow {
                pictures.push(("no shadow", find(no_shadow, "no_shadow")?));
            }
            for (k, (name, picture)) in pictures.iter().enumerate() {
                cx.check()?;
                let pair = Pair::new(p, picture, &reference, cx)?;
                if k == 0 {
                    differences.push(NamedImage {
                        name: view.name.clone(),
                        picture: pair.difference(p.gain).into(),
                    });
                }
                for (region, within) in &regions {
                    let row = pair.row(within.as_deref(), mask.as_deref());
                    if row.is_none() {
                        notes.warning(
                            "empty-region",
                            format!("region `{region}` of `{}` has no pixel", view.name),
                        );
                    }
                    rows.push(cells([&view.name, name, region], row, size.0 * size.1));
                }
            }
        }
        let columns = COLUMNS.map(str::to_owned).to_vec();
        let space = match p.space {
            Space::Display if p.quantise => "display values, 8 bits",
            Space::Display => "display values",
            Space::Linear => "linear light",
        };
        let title = format!("Distance to the reference, in {space}");
        let report = Report { title, tables: vec![Table { name: "compare".to_owned(), columns, rows }] };
        Ok((Out { report: Arc::new(report), difference: Arc::new(Images(differences)) }, notes))
    }
}

fn inside(mask: &Picture) -> Vec<bool> {
    mask.samples().chunks_exact(mask.size().2.max(1)).map(|pixel| pixel[0] > 0.5).collect()
}

/// Two pictures in the numbers to compare, and in linear light where they are colours.
struct Pair {
    a: Plane,
    b: Plane,
    light: Option<(Plane, Plane)>,
    ssim: Vec<f64>,
}

impl Pair {
    fn new(p: &Compare, a: &Picture, b: &Picture, cx: &Context) -> Result<Self, NodeError> {
        let data = |picture: &Picture| matches!(picture, Picture::Data(_));
        let (a, b, light) = if data(a) || data(b) {
            if a.encoding() != b.encoding() || a.size() != b.size() {
                let what =
                    format!("a picture of {} cannot be compared with one of {}", a.encoding(), b.encoding());
                return Err(NodeError::new(what).at("reference"));
            }
            (plain(a), plain(b), None)
        } else {
            let light = (light(a, "image")?, light(b, "reference")?);
            match p.space {
                Space::Display => (display(p, a), display(p, b), Some(light)),
                Space::Linear => (copy(&light.0), copy(&light.1), Some(light)),
            }
        };
        let ssim = ssim_map(&a, &b, cx)?;
        Ok(Self { a, b, light, ssim })
    }

    fn row(&self, region: Option<&[bool]>, mask: Option<&[bool]>) -> Option<Row> {
        let counts = |pixel: usize| region.is_none_or(|r| r[pixel]) && mask.is_none_or(|m| m[pixel]);
        let (width, height) = (self.a.width, self.a.height);
        let interior = |pixel: usize| {
            let (x, y) = (pixel % width, pixel / width);
            x >= SSIM_RADIUS && y >= SSIM_RADIUS && x + SSIM_RADIUS < width && y + SSIM_RADIUS < height
        };
        let errors_here = errors(&self.a, &self.b, counts);
        let whole = region.is_none() && mask.is_none();
        (errors_here.pixels > 0).then(|| Row {
            errors: errors_here,
            ssim: mean_over(&self.ssim, counts),
            ssim_valid: if whole { mean_over(&self.ssim, interior) } else { None },
            relative: self.light.as_ref().map(|(a, b)| errors(a, b, counts).relative_square),
        })
    }

    fn difference(&self, gain: f64) -> Image<Data> {
        let channels = self.a.channels.min(self.b.channels);
        let pixels =
            self.a.samples.chunks_exact(self.a.channels).zip(self.b.samples.chunks_exact(self.b.channels));
        let samples = pixels
            .flat_map(|(a, b)| {
                a.iter()
                    .zip(b)
                    .take(channels)
                    .map(|(a, b)| {
                        let d = (a - b).abs() * gain;
                        // Infinite depth against infinite depth is no difference.
                        if d.is_nan() { 0.0 } else { d as f32 }
                    })
                    .collect::<Vec<_>>()
            })
            .collect();
        Image::from_samples(self.a.width, self.a.height, channels, samples)
    }
}

struct Row {
    errors: Errors,
    ssim: Option<f64>,
    ssim_valid: Option<f64>,
    relative: Option<f64>,
}

fn number(value: Option<f64>) -> Cell {
    match value {
        Some(value) if value.is_finite() => Cell::Number(value),
        Some(value) if value.is_infinite() => Cell::Text("inf".to_owned()),
        _ => Cell::Missing,
    }
}

fn cells(names: [&str; 3], row: Option<Row>, pixels: usize) -> Vec<Cell> {
    let mut cells: Vec<Cell> = names.iter().map(|name| Cell::Text((*name).to_owned())).collect();
    let errors = row.as_ref().map(|row| row.errors);
    cells.push(Cell::Count(errors.map_or(0, |e| e.pixels)));
    cells.push(number(Some(errors.map_or(0, |e| e.pixels) as f64 / pixels.max(1) as f64)));
    cells.push(number(errors.map(|e| e.psnr())));
    cells.push(number(row.as_ref().and_then(|row| row.ssim)));
    cells.push(number(row.as_ref().and_then(|row| row.ssim_valid)));
    cells.push(number(errors.map(|e| e.mean_absolute)));
    cells.push(number(errors.map(|e| e.largest)));
    cells.push(number(row.and_then(|row| row.relative)));
    cells
}

fn copy(plane: &Plane) -> Plane {
    Plane { samples: plane.samples.clone(), ..*plane }
}

fn plain(picture: &Picture) -> Plane {
    let (width, height, channels) = picture.size();
    Plane { width, height, channels, samples: picture.samples().iter().map(|v| f64::from(*v)).collect() }
}

/// The colour channels in linear light, on black.
fn light(picture: &Picture, port: &'static str) -> Result<Plane, NodeError> {
    let image = linear(picture, port)?;
    let samples = image.samples.chunks_exact(image.channels).flat_map(|p| [p[0], p[1], p[2]]).map(f64::from);
    Ok(Plane { width: image.width, height: image.height, channels: 3, samples: samples.collect() })
}

/// The colour channels as a display shows them, on black.
fn display(p: &Compare, picture: &Picture) -> Plane {
    let (width, height, channels) = picture.size();
    let is_linear = matches!(picture, Picture::Linear(_));
    let shown = |v: &f32| {
        let v = f64::from(if is_linear { srgb_from_linear(*v) } else { *v }).clamp(0.0, 1.0);
        if p.quantise { (v * 255.0 + 0.5).floor() / 255.0 } else { v }
    };
    let samples = picture.samples().chunks_exact(channels).flat_map(|pixel| pixel[..3].iter().map(shown));
    Plane { width, height, channels: 3, samples: samples.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::context;
    use crate::types::{Linear, Srgb};

    fn one(picture: impl Into<Picture>) -> Arc<Images> {
        Arc::new(Images::single("v", picture))
    }
    fn node() -> Compare {
        Compare { space: Space::Display, quantise: true, names: Vec::new(), gain: 1.0 }
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
        let (out, _) = Compare::run(&node(), masked, &context()).expect("runs");
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
        assert!(Compare::run(&node(), inputs(flat(0.1), left_half()), &context()).is_err());
        let named = Compare { names: vec!["a".into()], ..node() };
        assert!(Compare::run(&named, inputs(flat(0.1), flat(0.1)), &context()).is_err());
    }
}

//! Sheets: the pictures of an output side by side, as a display shows them.

use engine::{Engine, Graph, Wire};
use scene::io::png::{self, Raster};
use scene::math::color::{code8, srgb_from_linear};
use scene::math::num;
use scene::types::{Environment, Images, NamedImage, Panorama, Picture, Views};

/// Space between the pictures of a sheet, in pixels.
const GAP: usize = 4;

/// Types of outputs that are pictures.
const PICTURES: [&str; 4] = ["image", "views", "pano", "env"];

/// Width and height into which a thumbnail fits, in pixels.
pub const THUMBNAIL: [usize; 2] = [160, 90];

/// True if an output consists of pictures.
pub fn is_picture(graph: &Graph, wire: Wire) -> bool {
    PICTURES.contains(&graph.nodes[wire.node].kind.outputs[wire.port].artifact.name)
}

/// The pictures of an output, one per view. `None` if the value is not in the cache or not a picture.
pub fn pictures(engine: &Engine, graph: &Graph, wire: Wire) -> Option<Vec<NamedImage>> {
    let single = |picture: Picture| Images::single("", picture).0;
    Some(match graph.nodes[wire.node].kind.outputs[wire.port].artifact.name {
        "views" => {
            let views = engine.value::<Views>(graph, wire)?.0.into_iter();
            views.map(|view| NamedImage { name: view.camera.name, picture: view.colour }).collect()
        }
        "pano" => single(engine.value::<Panorama>(graph, wire)?.image),
        "env" => single(engine.value::<Environment>(graph, wire)?.image.into()),
        "image" => engine.value::<Images>(graph, wire)?.0,
        _ => return None,
    })
}

/// A small picture of the first output of a node that consists of pictures: a PNG file, its width and its height.
/// `None` if there is no such output, or its value is not in the cache.
pub fn thumbnail(engine: &Engine, graph: &Graph, node: usize) -> Option<(Vec<u8>, [usize; 2])> {
    let outputs = graph.nodes[node].kind.outputs.len();
    let wire = (0..outputs).map(|port| Wire { node, port }).find(|wire| is_picture(graph, *wire))?;
    let whole = sheet(&pictures(engine, graph, wire)?, 0.0).0;
    let small = shrunk(&whole, THUMBNAIL)?;
    let bytes = png::write(&small, true, &[]).ok()?;
    Some((bytes, [small.width, small.height]))
}

/// Reduces a picture to at most this width and height, each pixel the mean of the pixels that it replaces. `None`
/// for a picture without pixels.
fn shrunk(whole: &Raster, most: [usize; 2]) -> Option<Raster> {
    let (width, height) = (whole.width, whole.height);
    if width == 0 || height == 0 {
        return None;
    }
    // The larger of the two ratios of sizes, as a fraction.
    let [wide, high] = [(width, most[0]), (height, most[1])];
    let (by, of) = if wide.0 * high.1 > high.0 * wide.1 { wide } else { high };
    let (by, of) = if by > of { (by, of) } else { (1, 1) };
    let size = |length: usize| (length * of / by).max(1);
    let (columns, rows) = (size(width), size(height));
    let range = |i: usize, all: usize, parts: usize| {
        i * all / parts..((i + 1) * all / parts).max(i * all / parts + 1)
    };
    let mut codes = Vec::with_capacity(columns * rows * 3);
    for row in 0..rows {
        for column in 0..columns {
            let (xs, ys) = (range(column, width, columns), range(row, height, rows));
            let count = (xs.len() * ys.len()) as u32;
            for channel in 0..3 {
                let of_row = |y: usize| {
                    xs.clone().map(|x| u32::from(whole.codes[(y * width + x) * 3 + channel])).sum::<u32>()
                };
                let sum: u32 = ys.clone().map(of_row).sum();
                codes.push(((sum + count / 2) / count) as u16);
            }
        }
    }
    Some(Raster {
        width: columns,
        height: rows,
        channels: 3,
        largest: 255,
        codes,
        colour: None,
        ignored: Vec::new(),
    })
}

/// Draws all views in a grid on black. Also returns a line for each view whose values were stretched.
pub fn sheet(views: &[NamedImage], exposure: f32) -> (Raster, Vec<String>) {
    let size = |of: fn((usize, usize, usize)) -> usize| {
        views.iter().map(|v| of(v.picture.size())).max().unwrap_or(0)
    };
    let (cell_width, cell_height) = (size(|(width, ..)| width), size(|(_, height, _)| height));
    // As square as the cells allow.
    let columns = (1..=views.len().max(1))
        .find(|columns| columns * cell_width >= views.len().div_ceil(*columns) * cell_height)
        .unwrap_or(1);
    let rows = views.len().div_ceil(columns);
    let width = (columns * (cell_width + GAP)).saturating_sub(GAP);
    let height = (rows * (cell_height + GAP)).saturating_sub(GAP);
    let mut raster = Raster {
        width,
        height,
        channels: 3,
        largest: 255,
        codes: vec![0; width * height * 3],
        colour: None,
        ignored: Vec::new(),
    };
    let mut ranges = Vec::new();
    for (at, view) in views.iter().enumerate() {
        let (x0, y0) = (at % columns * (cell_width + GAP), at / columns * (cell_height + GAP));
        let (codes, range) = shown(&view.picture, exposure);
        ranges.extend(range.map(|range| {
            format!(
                "{}{range}",
                if view.name.is_empty() { String::new() } else { format!("{}: ", view.name) }
            )
        }));
        let row = view.picture.size().0 * 3;
        for (y, line) in codes.chunks_exact(row.max(1)).enumerate() {
            let start = ((y0 + y) * width + x0) * 3;
            raster.codes[start..start + row].copy_from_slice(line);
        }
    }
    (raster, ranges)
}

/// The RGB codes (0 to 255) of a picture and, if it is not a colour picture, a description of the range of its
/// values.
fn shown(picture: &Picture, exposure: f32) -> (Vec<u16>, Option<String>) {
    let (_, _, channels) = picture.size();
    let pixels = picture.samples().chunks_exact(channels.max(1));
    let code = |value: f32| u16::from(code8(value));
    // Alpha is left out: pictures are premultiplied, so they are shown on black.
    let rgb = |pixel: &[f32]| if channels >= 3 { [pixel[0], pixel[1], pixel[2]] } else { [pixel[0]; 3] };
    match picture {
        Picture::Linear(_) => {
            let factor = num::f64::exp2(f64::from(exposure)) as f32;
            (pixels.flat_map(|p| rgb(p).map(|v| code(srgb_from_linear(v * factor)))).collect(), None)
        }
        Picture::Srgb(_) => (pixels.flat_map(|p| rgb(p).map(code)).collect(), None),
        Picture::Data(_) if channels >= 3 => {
            (pixels.flat_map(|p| rgb(p).map(|v| code(0.5 + 0.5 * v))).collect(), None)
        }
        Picture::Data(_) => {
            let finite = || picture.samples().iter().copied().filter(|v| v.is_finite());
            let (low, high) =
                (finite().fold(f32::INFINITY, f32::min), finite().fold(f32::NEG_INFINITY, f32::max));
            let range = if high > low { high - low } else { 1.0 };
            let codes = pixels.flat_map(|p| {
                // Values that are not finite, such as the depth of the sky, are white.
                let value = if p[0].is_finite() { (p[0] - low) / range } else { 1.0 };
                [code(value); 3]
            });
            let text = (low <= high).then(|| format!("black is {low}, white is {high}"));
            (codes.collect(), text)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene::types::{Data, Image, Linear};

    fn view(picture: Picture) -> NamedImage {
        NamedImage { name: "a".to_owned(), picture }
    }

    #[test]
    fn a_thumbnail_fits_and_has_the_mean_colours() {
        let raster = |width: usize, height: usize| Raster {
            width,
            height,
            channels: 3,
            largest: 255,
            codes: (0..width * height).flat_map(|i| [(i % width % 2 * 200) as u16, 7, 0]).collect(),
            colour: None,
            ignored: Vec::new(),
        };
        let small = shrunk(&raster(960, 540), THUMBNAIL).expect("has pixels");
        assert_eq!((small.width, small.height), (160, 90));
        assert!(
            small.codes.chunks(3).all(|code| code == [100, 7, 0]),
            "three dark columns and three bright ones"
        );
        let tall = shrunk(&raster(100, 1000), THUMBNAIL).expect("has pixels");
        assert_eq!((tall.width, tall.height), (9, 90));
        let kept = shrunk(&raster(32, 16), THUMBNAIL).expect("has pixels");
        assert_eq!((kept.width, kept.height, &kept.codes), (32, 16, &raster(32, 16).codes));
        assert!(shrunk(&raster(0, 4), THUMBNAIL).is_none());
    }

    #[test]
    fn views_stand_in_a_grid_and_numbers_are_stretched() {
        let light = Image::<Linear>::from_samples(2, 1, 3, vec![0.25, 0.25, 0.25, 0.0, 0.0, 0.0]);
        let depth = Image::<Data>::from_samples(2, 1, 1, vec![2.0, f32::INFINITY]);
        let (sheet, ranges) = sheet(&[view(light.into()), view(depth.into())], 2.0);
        assert_eq!((sheet.width, sheet.height), (2, 2 + GAP), "below each other: two rows are squarer");
        assert_eq!(sheet.codes[..6], [255, 255, 255, 0, 0, 0], "two stops brighter");
        assert_eq!(sheet.codes[sheet.codes.len() - 6..], [0, 0, 0, 255, 255, 255], "infinitely far is white");
        assert_eq!(ranges, ["a: black is 2, white is 2"]);
        let normal = Image::<Data>::from_samples(1, 1, 3, vec![-1.0, 0.0, 1.0]);
        assert_eq!(shown(&normal.into(), 0.0).0, [0, 128, 255]);
    }
}

//! `contact-sheet`: many pictures side by side.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes};
use scene::types::{Data, Image, Images, Linear, NamedImage, Picture, Srgb};

engine::params! {
    /// Arranges many pictures in one picture, row by row, in the order of the wires. The input can be the output of
    /// a `Gather`, for example.
    ///
    /// All cells have the same size, which fits every picture. Smaller pictures are placed at the upper left of
    /// their cell. The rest of a cell is black, or transparent if the pictures have alpha.
    pub struct ContactSheet {
        /// Number of pictures per row; 0 arranges them in about as many rows as columns.
        columns: u32 = 0, range(0, 1000), other("1");
        /// Gap between two pictures.
        gap_px: u32 = 4, range(0, 1000), unit("px"), other("0");
    }
}
engine::inputs! {
    /// Pictures to show.
    pub struct In {
        /// Pictures, all of the same encoding. If a wire has several views, the sheet shows each of them.
        images: Vec<Arc<Images>>,
    }
}
engine::outputs! {
    /// The sheet.
    pub struct Out {
        /// One picture.
        image: Arc<Images>,
    }
}

/// Positions of the cells of a sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Layout {
    columns: usize,
    cell: (usize, usize),
    gap: usize,
    /// Width and height of the sheet, in pixels.
    size: (usize, usize),
}

impl Layout {
    fn new(p: &ContactSheet, views: &[&NamedImage]) -> Self {
        let count = views.len();
        let cell = views
            .iter()
            .map(|view| view.picture.size())
            .fold((0, 0), |(width, height), (w, h, _)| (usize::max(width, w), usize::max(height, h)));
        let square = (1..count).find(|side| side * side >= count).unwrap_or(count.max(1));
        let columns = if p.columns == 0 { square } else { (p.columns as usize).min(count.max(1)) };
        let gap = p.gap_px as usize;
        let along = |cells: usize, side: usize| cells * (side + gap) - gap.min(cells * (side + gap));
        Self { columns, cell, gap, size: (along(columns, cell.0), along(count.div_ceil(columns), cell.1)) }
    }
}

impl Kind for ContactSheet {
    const NAME: &'static str = "contact-sheet";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(p: &Self, inputs: &In) -> Cost {
        let views: Vec<&NamedImage> = inputs.images.iter().flat_map(|images| &images.0).collect();
        let (width, height) = Layout::new(p, &views).size;
        Cost::of([((width as u64).saturating_mul(height as u64), 16)])
    }

    fn run(p: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let views: Vec<&NamedImage> = inputs.images.iter().flat_map(|images| &images.0).collect();
        let Some(first) = views.first() else {
            return Err(NodeError::new("there is no picture to show").at("images"));
        };
        let like = |picture: &Picture| (picture.encoding(), picture.size().2);
        if let Some(other) = views.iter().find(|view| like(&view.picture) != like(&first.picture)) {
            let text = |view: &NamedImage| {
                let (encoding, channels) = like(&view.picture);
                format!("`{}` has the encoding `{encoding}` (channels: {channels})", view.name)
            };
            return Err(NodeError::new(format!("{}, but {}", text(first), text(other)))
                .at("images")
                .hint("gather pictures with the same encoding and number of channels"));
        }
        let layout = Layout::new(p, &views);
        let (width, height) = layout.size;
        let channels = first.picture.size().2;
        let mut samples = vec![0.0; width * height * channels];
        for (index, view) in views.iter().enumerate() {
            cx.check()?;
            let (left, top) = (index % layout.columns, index / layout.columns);
            let (left, top) = (left * (layout.cell.0 + layout.gap), top * (layout.cell.1 + layout.gap));
            let (columns, ..) = view.picture.size();
            for (y, row) in view.picture.samples().chunks_exact((columns * channels).max(1)).enumerate() {
                let at = ((top + y) * width + left) * channels;
                samples[at..at + row.len()].copy_from_slice(row);
            }
            cx.progress((index + 1) as f32 / views.len() as f32);
        }
        let picture: Picture = match first.picture {
            Picture::Linear(_) => Image::<Linear>::from_samples(width, height, channels, samples).into(),
            Picture::Srgb(_) => Image::<Srgb>::from_samples(width, height, channels, samples).into(),
            Picture::Data(_) => Image::<Data>::from_samples(width, height, channels, samples).into(),
        };
        Ok((Out { image: Arc::new(Images::single("sheet", picture)) }, Notes::none()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(columns: u32, gap_px: u32, images: Vec<Images>) -> Result<Image<Data>, String> {
        let cx = testing::context();
        let inputs = In { images: images.into_iter().map(Arc::new).collect() };
        let (out, _) =
            ContactSheet::run(&ContactSheet { columns, gap_px }, inputs, &cx).map_err(|e| e.to_string())?;
        match &out.image.0[0].picture {
            Picture::Data(image) => Ok(image.clone()),
            other => Err(other.encoding().to_owned()),
        }
    }

    fn plain(width: usize, height: usize, value: f32) -> Images {
        Images::single("v", Image::<Data>::from_samples(width, height, 1, vec![value; width * height]))
    }

    #[test]
    fn cells_stand_row_by_row_at_their_upper_left() {
        let images = vec![plain(2, 1, 1.0), plain(1, 2, 2.0), plain(2, 2, 3.0)];
        let image = sheet(2, 1, images).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((image.width, image.height), (5, 5));
        #[rustfmt::skip]
        let wanted = [
            1.0, 1.0, 0.0, 2.0, 0.0,
            0.0, 0.0, 0.0, 2.0, 0.0,
            0.0, 0.0, 0.0, 0.0, 0.0,
            3.0, 3.0, 0.0, 0.0, 0.0,
            3.0, 3.0, 0.0, 0.0, 0.0,
        ];
        assert_eq!(image.samples, wanted);
    }

    #[test]
    fn a_sheet_is_about_square_unless_reported() {
        let size = |columns, count: usize| {
            let image = sheet(columns, 0, vec![plain(1, 1, 1.0); count]).unwrap_or_else(|e| panic!("{e}"));
            (image.width, image.height)
        };
        assert_eq!([size(0, 1), size(0, 2), size(0, 5), size(0, 12)], [(1, 1), (2, 1), (3, 2), (4, 3)]);
        assert_eq!([size(5, 12), size(99, 3)], [(5, 3), (3, 1)]);
    }

    #[test]
    fn pictures_of_two_sorts_and_no_picture_are_refused() {
        let display = Images::single("photo", Image::<Srgb>::new(1, 1, 3));
        let why = sheet(0, 0, vec![plain(1, 1, 1.0), display]).err().unwrap_or_default();
        assert!(
            why.contains(
                "`v` has the encoding `data` (channels: 1), but `photo` has the encoding `srgb` (channels: 3)"
            ),
            "{why}"
        );
        assert!(sheet(0, 0, vec![]).is_err());
    }
}

//! `stitch`: a panorama from views around a point.

#[cfg(test)]
mod tests;

use std::f64::consts::PI;
use std::sync::Arc;

use engine::{Context, ContextField, Cost, Kind, NodeError, Notes, Sizes, Up};
use glam::DVec3;
use render::light::energy_table::EnergyTable;
use render::light::linear::{Transfer, linear_pixels};
use render::light::panorama::{COLUMNS_A_PIXEL, Unfilled, check_width, finish, linear_row};
use scene::math::{color, equirect, num};
use scene::types::{Images, Panorama, Picture, Report, View, Views};

pub use render::light::panorama::Holes;

engine::params! {
    /// Resamples views around a point into an equirectangular panorama.
    ///
    /// Each pixel is the mean over its solid angle, in linear light and weighted by alpha. The result is converted
    /// back to the encoding of the views. Overlapping views are blended with weights that rise with the distance
    /// from the borders of each view, so that no seam is visible.
    pub struct Stitch {
        /// Width of the panorama, even; the height is half of it.
        width_px: u32 = 2048, range(2, 16384), unit("px"), other("64"),
            knob(Resolution, "256", "512", "1024", "2048");
        /// True to limit the width to twice the side of the largest view in pixels. At this width, a panorama has
        /// the resolution of the faces of a cube. Use it for views whose size was chosen by `fit-probe`.
        as_views: bool = false, other("true");
        /// Content of pixels where nothing was seen. Alpha marks these pixels, no matter how they are filled.
        holes: Holes = Holes::PushPull, other("Black");
        /// Alpha below which a pixel is partly a hole and is blended with its surroundings.
        hole_alpha: f64 = 0.25, range(1e-6, 1.0), other("0.9");
    }
}
engine::inputs! {
    /// Inputs of [`Stitch`].
    pub struct In {
        /// Views of cameras that all stand at one point.
        views: Arc<Views>,
    }
}
engine::outputs! {
    /// Outputs of [`Stitch`].
    pub struct Out {
        /// The panorama.
        pano: Arc<Panorama>,
        /// Colours of the panorama, for `write-image`.
        image: Arc<Images>,
        /// Coverage of each pixel, 0 to 1.
        alpha: Arc<Images>,
        /// The energy of the views, of the panorama, and of the panorama with filled holes, in total and for each
        /// light source.
        report: Arc<Report>,
    }
}

/// Fraction of a view's shorter side over which it fades towards its border.
const FADE: f64 = 0.08;
/// Weight of a view at its border. It is above 0, so that directions seen only at a border are not lost.
const LEAST: f64 = 1e-6;
/// Samples per pixel of a face along each axis, at the centre of a view.
const SAMPLES_PER_PIXEL: f64 = 2.0;

/// View prepared for sampling: linear light, premultiplied.
struct Source {
    axes: [DVec3; 3],
    focal: [f64; 2],
    centre: [f64; 2],
    size: [f64; 2],
    width: usize,
    height: usize,
    rgba: Vec<[f32; 4]>,
}

impl Source {
    fn new(view: &View, cx: &Context) -> Result<Self, NodeError> {
        let (width, height, channels) = view.colour.size();
        let encoded = match &view.colour {
            Picture::Srgb(_) => true,
            Picture::Linear(_) => false,
            Picture::Data(_) => return Err(NodeError::new("the views hold data, not colours").at("views")),
        };
        if channels != 4 || width == 0 || height == 0 {
            let what = format!(
                "view `{}` must have 4 channels and must not be empty, but is {width}x{height} pixels (channels: {channels})",
                view.camera.name
            );
            return Err(NodeError::new(what).at("views"));
        }
        if !view.camera.lens.is_pinhole() {
            let what = format!("view `{}` has lens distortion", view.camera.name);
            let error = NodeError::new(what).at("views");
            return Err(error.hint("render the views with the cameras of `cube-rig`"));
        }
        let pixels = view.colour.samples().as_chunks::<4>().0;
        let rows = cx.for_each_tile(height, |y| linear_row(&pixels[y * width..(y + 1) * width], encoded))?;
        let m = view.camera.world_from_camera();
        Ok(Self {
            axes: [m.x_axis.truncate(), m.y_axis.truncate(), m.z_axis.truncate()],
            focal: [view.camera.fx, view.camera.fy],
            centre: [view.camera.cx, view.camera.cy],
            size: [width as f64, height as f64],
            width,
            height,
            rgba: rows.concat(),
        })
    }

    /// Position of `direction` in the view, in pixels, and the weight of the view there. `None` if the view
    /// does not contain the direction.
    #[inline]
    fn place(&self, direction: DVec3) -> Option<([f64; 2], f64)> {
        let z = self.axes[2].dot(direction);
        if z <= 0.0 {
            return None;
        }
        let x = self.axes[0].dot(direction) / z * self.focal[0] + self.centre[0];
        let y = self.axes[1].dot(direction) / z * self.focal[1] + self.centre[1];
        let border = x.min(self.size[0] - x).min(y).min(self.size[1] - y);
        if border < 0.0 {
            return None;
        }
        let t = (border / (FADE * self.size[0].min(self.size[1]))).min(1.0);
        Some(([x, y], (t * t * (3.0 - 2.0 * t)).max(LEAST)))
    }

    /// Adds the value of the view in `direction`, times its weight there, to `sum`. Returns the weight.
    #[inline]
    fn add(&self, direction: DVec3, sum: &mut [f64; 4]) -> f64 {
        let Some(([x, y], weight)) = self.place(direction) else { return 0.0 };
        // Bilinear between pixel centres, clamped to the outermost ones.
        let place = |p: f64, n: usize| {
            let at = (p - 0.5).clamp(0.0, (n - 1) as f64);
            let first = at as usize;
            (first, (first + 1).min(n - 1), at - first as f64)
        };
        let (x0, x1, fx) = place(x, self.width);
        let (y0, y1, fy) = place(y, self.height);
        let corners = [
            (y0 * self.width + x0, (1.0 - fx) * (1.0 - fy)),
            (y0 * self.width + x1, fx * (1.0 - fy)),
            (y1 * self.width + x0, (1.0 - fx) * fy),
            (y1 * self.width + x1, fx * fy),
        ];
        for (index, share) in corners {
            let pixel = self.rgba[index];
            for (sum, value) in sum.iter_mut().zip(pixel) {
                *sum += weight * share * f64::from(value);
            }
        }
        weight
    }

    /// Direction, solid angle and luminance of each pixel of a row.
    fn row(&self, y: usize) -> impl Iterator<Item = (DVec3, f64, f64)> {
        let [right, down, forward] = self.axes;
        let rise = (y as f64 + 0.5 - self.centre[1]) / self.focal[1];
        self.rgba[y * self.width..][..self.width].iter().enumerate().map(move |(x, [r, g, b, _])| {
            let aside = (x as f64 + 0.5 - self.centre[0]) / self.focal[0];
            let toward = forward + right * aside + down * rise;
            let length = toward.length();
            let size = 1.0 / (self.focal[0] * self.focal[1] * length * length * length);
            (toward / length, size, f64::from(color::luminance([*r, *g, *b])))
        })
    }
}

/// Mean of the views over each pixel of the panorama, linear and premultiplied, row by row.
fn resample(sources: &[Source], up: Up, width: usize, cx: &Context) -> Result<Vec<[f32; 4]>, NodeError> {
    let height = width / 2;
    let [right, forward, above] = equirect::axes(up);
    let focal = sources.iter().flat_map(|source| source.focal).fold(0.0, f64::max);
    let density = SAMPLES_PER_PIXEL * focal * 2.0 * PI / width as f64;
    let across = (density.ceil() as usize).clamp(2, 32);
    let columns: Vec<(f64, f64)> = (0..width * across)
        .map(|i| num::sin_cos(2.0 * PI * ((i as f64 + 0.5) / (width * across) as f64 - 0.5)))
        .collect();
    let rows = cx.for_each_tile(height, |y| {
        let mut sums = vec![[0.0_f64; 5]; width];
        let mut directions = 0;
        for sub in 0..across {
            let theta = PI * (y as f64 + (sub as f64 + 0.5) / across as f64) / height as f64;
            let (sin_theta, cos_theta) = num::sin_cos(theta);
            let flat = above * cos_theta;
            // Fewer samples in shorter rows, evenly spaced.
            let wanted = ((across as f64 * sin_theta).ceil() as usize).clamp(1, across);
            directions += (wanted * width) as u64;
            for (x, sum) in sums.iter_mut().enumerate() {
                for i in 0..wanted {
                    let column = x * across + (2 * i + 1) * across / (2 * wanted);
                    let (sin_phi, cos_phi) = columns[column];
                    let direction = flat + (right * sin_phi + forward * cos_phi) * sin_theta;
                    let mut seen = [0.0; 4];
                    let weight: f64 = sources.iter().map(|source| source.add(direction, &mut seen)).sum();
                    let share = sin_theta / wanted as f64;
                    sum[4] += share;
                    if weight > 0.0 {
                        for (sum, value) in sum.iter_mut().zip(seen) {
                            *sum += share * (value / weight);
                        }
                    }
                }
            }
        }
        cx.count("directions", directions);
        sums.iter()
            .map(|sum| [sum[0] / sum[4], sum[1] / sum[4], sum[2] / sum[4], sum[3] / sum[4]].map(|v| v as f32))
            .collect::<Vec<_>>()
    })?;
    Ok(rows.concat())
}

/// Width over which resampling may spread a light, in pixels of a view plus pixels of the panorama.
const MARGIN: f64 = 2.0;

/// Reports the energy of each light in the views, after resampling, and after the holes are filled. Views are
/// weighted as in the panorama. `resampled` and `filled` are the luminance before and after filling, row by
/// row.
fn energy_report(
    sources: &[Source],
    (up, width): (Up, usize),
    resampled: &[f64],
    filled: &[f64],
    cx: &Context,
) -> Result<Report, NodeError> {
    let coarsest = sources.iter().flat_map(|source| source.focal).fold(f64::INFINITY, f64::min);
    let margin = MARGIN * (2.0 * PI / width as f64 + 1.0 / coarsest);
    let mut table = EnergyTable::new(up, width, resampled, margin);
    let rows: Vec<(&Source, usize)> =
        sources.iter().flat_map(|source| (0..source.height).map(move |y| (source, y))).collect();
    table.record("views", rows.len(), cx, |i| {
        let (source, y) = rows[i];
        source.row(y).map(move |(toward, size, luminance)| {
            let weight = |source: &Source| source.place(toward).map_or(0.0, |(_, weight)| weight);
            let all: f64 = sources.iter().map(weight).sum();
            (toward, size * weight(source) / all.max(f64::MIN_POSITIVE), luminance)
        })
    })?;
    table.record_panorama("resampled", width, resampled, cx)?;
    table.record_panorama("holes filled", width, filled, cx)?;
    Ok(Report { title: "Light of a panorama".to_owned(), tables: table.tables().into() })
}

impl Stitch {
    /// Width, in pixels, of the panorama that is made from `views`.
    fn columns(&self, views: &Views) -> usize {
        let sides = views.0.iter().map(|view| view.camera.width_px.max(view.camera.height_px));
        let worth = sides.max().map_or(self.width_px, |side| side.saturating_mul(COLUMNS_A_PIXEL));
        (if self.as_views { self.width_px.min(worth) } else { self.width_px }) as usize
    }
}

impl Kind for Stitch {
    const NAME: &'static str = "stitch";
    const VERSION: u32 = 6;
    const READS: &'static [ContextField] = &[ContextField::Up];
    type Params = Self;
    type In = In;
    type Out = Out;

    fn estimate(params: &Self, inputs: &In) -> Cost {
        let pixels = u64::from(params.width_px) * u64::from(params.width_px) / 2;
        let faces: usize = inputs.views.0.iter().map(|view| view.colour.samples().len()).sum();
        Cost::of([(pixels, 80), (faces as u64, 4)])
    }

    fn work(params: &Self, sizes: &Sizes) -> f64 {
        f64::from(params.width_px) * f64::from(params.width_px) * 8.0 + sizes.of("views")
    }

    fn check(params: &Self) -> Result<(), NodeError> {
        check_width(params.width_px)
    }

    fn run(params: &Self, In { views }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(params)?;
        let mut notes = Notes::none();
        let Some(first) = views.0.first() else {
            return Err(NodeError::new("there is no view to stitch").at("views"));
        };
        let origin = first.camera.eye();
        for view in &views.0 {
            let apart = (view.camera.eye() - origin).length();
            if apart > 1e-6 * (1.0 + origin.length()) {
                let what = format!(
                    "the positions of the views `{}` and `{}` are {apart:.4} world units apart",
                    first.camera.name, view.camera.name
                );
                return Err(NodeError::new(what)
                    .at("views")
                    .hint("all views of a panorama need the same position: use `CubeRig`"));
            }
            if view.colour.encoding() != first.colour.encoding() {
                return Err(NodeError::new("the views have different encodings").at("views"));
            }
        }
        let encoded = matches!(first.colour, Picture::Srgb(_));
        let up = cx.up();
        let sources = views.0.iter().map(|view| Source::new(view, cx)).collect::<Result<Vec<_>, _>>()?;
        cx.progress(0.2);
        let width = params.columns(&views);
        let premultiplied = resample(&sources, up, width, cx)?;
        cx.progress(0.7);
        let light = |rgb: [f32; 3]| f64::from(color::luminance(rgb));
        let resampled: Vec<f64> = premultiplied.iter().map(|&[r, g, b, _]| light([r, g, b])).collect();

        let found = Unfilled { premultiplied, width, encoded, up, origin };
        let pano = finish(found, params.holes, params.hole_alpha, &mut notes, cx)?;
        cx.progress(0.8);
        let filled: Vec<f64> =
            linear_pixels(&pano.image, Transfer::Srgb).rgb.into_iter().map(light).collect();
        let report = energy_report(&sources, (up, width), &resampled, &filled, cx)?;
        let out = Out {
            image: Arc::new(Images::single("pano", pano.image.clone())),
            alpha: Arc::new(Images::single("pano", pano.alpha.clone())),
            pano: Arc::new(pano),
            report: Arc::new(report),
        };
        Ok((out, notes))
    }
}

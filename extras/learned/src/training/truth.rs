//! Ground truth for training: HDR panoramas, simulated photographs of them in which lights are clipped, and the
//! light that the clipping hides.

use std::collections::BTreeMap;

use engine::Up;
use glam::DVec3;
use render::geometry::sampling::{hash, unit};
use render::light::exposure::ev0_scale;
use render::light::measure::{self, DOMINANT_COS};
use render::light::regions;
use scene::math::color::{code8, srgb_from_linear};
use scene::math::equirect::{axes, direction, pixel_solid_angle};
use scene::math::num;
use scene::types::{Environment, Image, Linear, Panorama, Srgb};

use render::light::hidden::clip::{CLIPPED, clip_mask, clipped_light};
use render::light::hidden::grid::Grid;
use render::light::hidden::network::Scene;

/// Width of the panoramas in training, and the smallest width that is accepted.
pub const WIDTH: usize = 256;

/// Width of the finer panoramas, which are also evaluated: four pixels per cell of the grid.
pub const FINE: usize = 512;

/// An HDR panorama and the direction of its strongest light.
pub struct Truth {
    /// Linear light of [`WIDTH`] columns, scaled to EV 0.
    pub image: Image<Linear>,
    /// Linear light of [`FINE`] columns, if the panorama has that resolution.
    pub fine: Option<Image<Linear>>,
    /// Direction of the dominant light.
    pub light: DVec3,
}

/// Parameters of a photograph.
#[derive(Debug, Clone, Copy)]
pub struct Shot {
    /// Exposure of the photograph, in stops above EV 0.
    pub ev: f64,
    /// Gain of each channel, which imitates the white balance.
    pub balance: [f64; 3],
    /// True if the picture is softened after clipping, as splats trained on it would be.
    pub soft: bool,
    /// Maximum random error added to each sample, in 8-bit codes, to imitate compression.
    pub grain: f64,
    /// Seed of the random numbers for the grain.
    pub seed: u32,
    /// Sine of the elevation below which all pixels are holes.
    pub hole: f64,
    /// True if the finer panorama is used, so that cells of the grid can be clipped in part.
    pub fine: bool,
    /// Number of pixels below the horizon that are glints: clipped to white, but hardly brighter than white.
    pub glints: u32,
}

impl Shot {
    /// Parameters of a photograph without defects.
    pub fn plain(ev: f64) -> Self {
        Self { ev, balance: [1.0; 3], soft: false, grain: 0.0, seed: 0, hole: -1.0, fine: false, glints: 0 }
    }
}

/// One photographed panorama.
pub struct Example {
    /// Linear light of the photograph, averaged over each cell of the grid.
    pub rgb: Vec<[f64; 3]>,
    /// The input of the network.
    pub scene: Scene,
    /// Light hidden in each clipped cell: true minus visible luminance, times solid angle.
    pub hidden: Vec<f64>,
    /// RGB of the light hidden in each clipped region, times solid angle.
    pub hidden_rgb: Vec<[f64; 3]>,
    /// For each clipped cell, the cosine of the angle between its direction and the normal of the plane on which
    /// contrast is measured. If the cell is within 15 degrees of the dominant light, the first entry holds the
    /// cosine, and otherwise the second entry. The other entry is 0.
    pub toward: Vec<[f64; 2]>,
    /// Flux of the visible panorama, as three numbers: the total, the flux on the plane of `toward` from directions
    /// within 15 degrees of the dominant light, and the flux on this plane from all other directions.
    pub visible: [f64; 3],
    /// Flux of the ground truth, split like `visible`.
    pub truth: [f64; 3],
}

/// Reduces linear RGB of any size to `columns` columns. Means are weighted by solid angle.
pub fn shrink((width, height): (usize, usize), rgb: &[f32], columns: usize) -> Image<Linear> {
    let mut sums = vec![[0.0_f64; 4]; columns * columns / 2];
    for y in 0..height {
        let solid_angle = pixel_solid_angle(width, height, y);
        for x in 0..width {
            let (column, row) =
                ((2 * x + 1) * columns / (2 * width), (2 * y + 1) * (columns / 2) / (2 * height));
            let sum = &mut sums[row * columns + column];
            sum[3] += solid_angle;
            for c in 0..3 {
                sum[c] += solid_angle * f64::from(rgb[(y * width + x) * 3 + c].max(0.0));
            }
        }
    }
    let mean = |[r, g, b, w]: [f64; 4]| [r, g, b].map(|v| (v / w.max(f64::MIN_POSITIVE)) as f32);
    Image::from_samples(columns, columns / 2, 3, sums.into_iter().flat_map(mean).collect())
}

impl Truth {
    /// Scales the light of a panorama to EV 0. `None` if the panorama contains no light.
    pub fn new(panorama: Image<Linear>) -> Option<Self> {
        let size = (panorama.width, panorama.height);
        let fine = (size.0 > WIDTH).then_some(&panorama);
        let mut image = shrink(size, &panorama.samples, WIDTH);
        let scale = ev0_scale(&image)?;
        let expose = |image: &mut Image<Linear>| {
            image.samples.iter_mut().for_each(|v| *v = (f64::from(*v) * scale) as f32);
        };
        expose(&mut image);
        let mut fine = fine.map(|image| shrink(size, &image.samples, FINE));
        fine.iter_mut().for_each(expose);
        let env = Environment { image: image.into(), up: Up::PlusZ, origin: None };
        let light = measure::dominant(&measure::cells(&env, WIDTH / 2), &measure::cells(&env, WIDTH))?;
        Some(Self { image: Image::clone(&env.image), fine, light })
    }

    /// The panorama, coarse or fine, from which a photograph is taken.
    fn taken(&self, shot: Shot) -> &Image<Linear> {
        self.fine.as_ref().filter(|_| shot.fine).unwrap_or(&self.image)
    }

    /// Takes a photograph in 8 bits.
    pub fn photograph(&self, shot: Shot) -> Panorama {
        let exposure = num::f64::exp2(shot.ev);
        let image = self.taken(shot);
        let (width, height) = (image.width, image.height);
        let expose = |(i, v): (usize, &f32)| {
            srgb_from_linear((f64::from(*v) * exposure * shot.balance[i % 3]).min(1.0) as f32)
        };
        let mut codes: Vec<f32> = image.samples.iter().enumerate().map(expose).collect();
        glints(shot, (width, height)).keys().for_each(|&at| codes[3 * at..][..3].fill(1.0));
        if shot.soft {
            codes = soften(&codes, width);
        }
        for (i, code) in codes.iter_mut().enumerate() {
            let off = f64::from(unit(hash(shot.seed, i as u32))) * 2.0 - 1.0;
            *code = f32::from(code8(*code + (off * shot.grain / 255.0) as f32)) / 255.0;
        }
        let seen = |i: usize| {
            let up = num::f64::cos(std::f64::consts::PI * ((i / width) as f64 + 0.5) / height as f64);
            if up < shot.hole { 0.0 } else { 1.0 }
        };
        Panorama {
            image: Image::<Srgb>::from_samples(width, height, 3, codes).into(),
            alpha: Image::from_samples(width, height, 1, (0..width * height).map(seen).collect()),
            up: Up::PlusZ,
            origin: None,
            turned_deg: 0.0,
        }
    }

    /// Makes the example of one photograph. `None` if the light of the photograph is not valid.
    pub fn example(&self, shot: Shot) -> Option<Example> {
        let pano = self.photograph(shot);
        let pixels = clipped_light(&pano, &mut engine::Notes::none()).ok()?;
        let mask = clip_mask(&pano, &pixels, CLIPPED);
        let grid = Grid::new(&pixels, &mask, &pano.alpha.samples);
        let labels = regions::label(&grid.clipped, grid.width);
        let scene = Scene::new(&grid, pano.up, &labels, 1.0);
        let exposure = num::f64::exp2(shot.ev);
        let image = self.taken(shot);
        let (width, height) = (image.width, image.height);
        let up = axes(pano.up)[2];
        let normal = if self.light.dot(up) > 0.1 { up } else { self.light };
        let (mut visible, mut truth) = ([0.0; 3], [0.0; 3]);
        let mut of_cell = vec![0.0; grid.rgb.len()];
        let mut hidden_rgb = vec![[0.0; 3]; labels.count];
        let glints = glints(shot, (width, height));
        // Weights for the plane on which contrast is measured, near the dominant light and elsewhere.
        let toward = |d: DVec3| {
            let cosine = d.dot(normal).max(0.0);
            if d.dot(self.light) > DOMINANT_COS { [cosine, 0.0] } else { [0.0, cosine] }
        };
        for (i, &is_clipped) in mask.iter().enumerate().take(width * height) {
            let (x, y) = (i % width, i / width);
            let d = direction(pano.up, (x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
            let (size, toward) = (pixel_solid_angle(width, height, y), toward(d));
            let rgb = image.rgb(x, y);
            let real: [f64; 3] = std::array::from_fn(|c| f64::from(rgb[c]) * exposure * shot.balance[c]);
            let real = glints.get(&i).map_or(real, |light| real.map(|v| v.max(*light)));
            let fluxes = [real, pixels.rgb[i].map(f64::from)].map(|rgb| measure::luminance(rgb) * size);
            for (sums, flux) in [&mut truth, &mut visible].into_iter().zip(fluxes) {
                sums[0] += flux;
                sums[1] += flux * toward[0];
                sums[2] += flux * toward[1];
            }
            if is_clipped {
                let cell = grid.cell_of[i] as usize;
                of_cell[cell] += (fluxes[0] - fluxes[1]).max(0.0);
                if let Some(region) = labels.of[cell] {
                    let sums = &mut hidden_rgb[region as usize];
                    (0..3).for_each(|c| sums[c] += (real[c] - f64::from(pixels.rgb[i][c])) * size);
                }
            }
        }
        let hidden = scene.cells.iter().map(|cell| of_cell[cell.index]).collect();
        let toward = scene.cells.iter().map(|cell| toward(grid.direction(pano.up, cell.index))).collect();
        Some(Example { rgb: grid.rgb, scene, hidden, hidden_rgb, toward, visible, truth })
    }
}

/// Luminance of each glint, keyed by the index of its pixel. It is at most three times white.
fn glints(shot: Shot, (width, height): (usize, usize)) -> BTreeMap<usize, f64> {
    let key = hash(shot.seed, 1);
    let glint = |k: u32| {
        let by_chance = |n: u32| f64::from(unit(hash(key, 3 * k + n)));
        let down = num::f64::acos(-by_chance(0)) / std::f64::consts::PI;
        let [x, y] =
            [(by_chance(1), width), (down, height)].map(|(at, of)| ((at * of as f64) as usize).min(of - 1));
        (y * width + x, 1.0 + 2.0 * by_chance(2))
    };
    (0..shot.glints).map(glint).collect()
}

/// Smooths samples with a 3x3 kernel, whose weights are 1, 2, 1 in both directions. Rows wrap around, and the rows
/// at the poles are repeated.
fn soften(samples: &[f32], width: usize) -> Vec<f32> {
    let height = samples.len() / (3 * width);
    let sample = |x: usize, y: usize, c: usize| samples[(y * width + x % width) * 3 + c];
    let across = |x: usize, y: usize, c: usize| {
        0.25 * sample(x + width - 1, y, c) + 0.5 * sample(x, y, c) + 0.25 * sample(x + 1, y, c)
    };
    let mean = |i: usize| {
        let (c, x, y) = (i % 3, i / 3 % width, i / (3 * width));
        let (above, below) = (y.saturating_sub(1), (y + 1).min(height - 1));
        0.25 * across(x, above, c) + 0.5 * across(x, y, c) + 0.25 * across(x, below, c)
    };
    (0..samples.len()).map(mean).collect()
}

//! Share of the panorama's light that the receiver lets through to a point.

use crate::geometry::bvh::Ray;
use crate::transport::scene::block::Block;
use crate::transport::scene::receiver::Receiver;
use crate::transport::sky::environment::EnvironmentLight;
use glam::Vec3;
use scene::math::color::luminance;

/// Maximum number of columns and rows of cells, each tested by one ray.
const MOST: [usize; 2] = [128, 64];

/// Share of the sky's light, by luminance, that reaches the point `from` if the receiver blocks light by the given
/// rule. Returns 1 if the sky is black.
pub fn share_past(sky: &EnvironmentLight, receiver: &Receiver, from: Vec3, block: &Block) -> f64 {
    let grid = &sky.texel_grid;
    let [width, height] = [grid.width, grid.height];
    let [columns, rows] = [width.min(MOST[0]), height.min(MOST[1])];
    let mut cells = vec![0.0; columns * rows];
    for (y, row) in sky.texels.chunks_exact(width).enumerate() {
        let solid_angle = grid.solid_angle(y);
        for (x, [r, g, b, _]) in row.iter().enumerate() {
            let cell = y * rows / height * columns + x * columns / width;
            cells[cell] += solid_angle * f64::from(luminance([*r, *g, *b]));
        }
    }
    let (mut all, mut past) = (0.0, 0.0);
    for (cell, light) in cells.iter().enumerate().filter(|(_, light)| **light > 0.0) {
        all += light;
        let middle = |number: usize, cells: usize, texels: usize| (2 * number + 1) * texels / (2 * cells);
        let texel = (middle(cell % columns, columns, width), middle(cell / columns, rows, height));
        let ray = Ray::new(from, grid.within(texel, [0.5; 2]));
        past += if block.passes(receiver, ray) { *light } else { 0.0 };
    }
    if all > 0.0 { past / all } else { 1.0 }
}

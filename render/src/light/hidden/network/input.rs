//! Input of the networks for one panorama.

use engine::Up;

use super::super::grid::Grid;
use super::super::sun;
use super::correction::Maps;
use super::features::{CELL, COLOUR, GridQuantities, OVERVIEW, Region};
use super::rings::{Open, rings};
use crate::light::regions::{self, Regions};

/// Input of the networks for one panorama.
pub struct Scene {
    /// Features of the whole panorama.
    pub overview: [f32; OVERVIEW],
    /// Clipped cells, in order of their index in the grid.
    pub cells: Vec<ClippedCell>,
    /// Maps of the whole panorama.
    pub maps: Maps,
    /// Features of each region that predict the colour of its light.
    pub colours: Vec<[f32; COLOUR]>,
    /// Sum of luminance times solid angle over the visible unclipped parts of all cells.
    pub open_flux: f64,
    /// Sum of luminance times solid angle over all visible parts above the horizon.
    pub above: f64,
    /// For each region, the degree to which it is the sun, from 0 to 1.
    pub suns: Vec<f64>,
}

/// One clipped cell.
pub struct ClippedCell {
    /// Index of the cell in the grid.
    pub index: usize,
    /// Index of the region that contains the cell.
    pub region: usize,
    /// Features of the cell.
    pub features: [f32; CELL],
    /// Solid angle of the clipped part of the cell.
    pub size: f64,
    /// Luminance of the clipped part of the cell, times its solid angle.
    pub flux: f64,
    /// Sine of the elevation of the cell.
    pub sine: f64,
}

impl Scene {
    /// Sum of luminance times solid angle over all visible parts.
    pub fn visible(&self) -> f64 {
        self.open_flux + self.cells.iter().map(|cell| cell.flux).sum::<f64>()
    }

    /// Describes a panorama. `labels` are its clipped regions, and `ceiling` is its white level. Features are
    /// normalised to a white level of 1, as in training; fluxes are in the unit of the panorama.
    pub fn new(grid: &Grid, up: Up, labels: &Regions, ceiling: f64) -> Self {
        let view = GridQuantities::new(grid, up, ceiling);
        let mut members = vec![Vec::new(); labels.count];
        for (cell, region) in labels.of.iter().enumerate() {
            if let Some(region) = region {
                members[*region as usize].push(cell);
            }
        }
        let sizes: Vec<f64> = members.iter().map(|m| m.iter().map(|&c| view.clipped[c]).sum()).collect();
        let total = sizes.iter().sum();
        let around = view.neighbourhoods();
        let depth = regions::distance_to_edge(&grid.clipped, grid.width);
        let open = Open { size: &view.open, rgb: &view.open_rgb };
        let rings = rings(&members, grid.width, &open);
        let described = members.iter().zip(&rings);
        let regions: Vec<Region> =
            described.map(|(cells, rings)| view.region((cells, rings), total, &depth, &around)).collect();
        let cell = |(index, region): (usize, &Option<u32>)| {
            let region = (*region)? as usize;
            let features = view.cell(index, &regions[region], f64::from(depth[index]), &around);
            let flux = ceiling * view.clipped_luminance[index] * view.clipped[index];
            Some(ClippedCell {
                index,
                region,
                features,
                size: view.clipped[index],
                flux,
                sine: view.sine(index),
            })
        };
        let overview = view.overview(&members, &sizes);
        Self {
            overview,
            maps: Maps::new(&view),
            colours: regions.iter().map(|region| region.colour(&overview)).collect(),
            cells: labels.of.iter().enumerate().filter_map(cell).collect(),
            above: view
                .cells()
                .filter(|&c| grid.seen[c] && view.sine(c) > 0.0)
                .map(|c| ceiling * view.luminance[c] * view.solid_angle(c))
                .sum(),
            suns: sun::suns(grid, up, &members),
            open_flux: view.cells().map(|c| ceiling * view.open_luminance[c] * view.open[c]).sum(),
        }
    }
}

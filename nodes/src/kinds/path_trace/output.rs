//! Outputs: the images of all cameras, and the report.

use std::sync::Arc;

use glam::DVec3;
use render::transport::path::rays::Rays;
use render::transport::picture::accumulator::FinishedView;
use render::transport::picture::accumulator::ReachedError;
use scene::types::{Camera, Cell, Images, NamedImage, Report, Table};

use super::decided::Decided;
use super::interface::{In, Out};
use super::lobes;

/// Builds the rows of decisions and ray counts of the report.
fn decisions(
    inputs: &In,
    Decided { name, rules, probe, twice }: &Decided,
    centre: DVec3,
    crop: &str,
    rays: &Rays,
) -> Vec<Vec<Cell>> {
    let [nodes, triangles] = rays.steps_each();
    let row = |item: &str, value: Cell| vec![Cell::Text(item.to_owned()), value];
    let text = |item: &str, value: &str| row(item, Cell::Text(value.to_owned()));
    let capture = format!("{}, {}, {}", centre.x, centre.y, centre.z);
    let mut decisions = vec![
        text("surroundings", name),
        text("crop", crop),
        text("point of capture", &capture),
        row("camera rays", Cell::Count(rays.camera)),
        row("shadow rays", Cell::Count(rays.shadow)),
        row("scattered rays", Cell::Count(rays.scattered)),
        row("rays", Cell::Count(rays.all())),
        row("BVH nodes visited per ray", Cell::Number(nodes)),
        row("triangles tested per ray", Cell::Number(triangles)),
        text("lobes that no material has", &lobes::absent(&inputs.objects)),
    ];
    if rules.near.is_none() {
        decisions
            .push(text("the mesh reflects scattered light", if rules.bounce_solid { "yes" } else { "no" }));
        decisions
            .push(text("reflections show", if rules.specular_env { "the panorama" } else { "the mesh" }));
    }
    if let Some(twice) = twice {
        decisions.push(row(
            "light added by mesh bounces, relative to the light without them",
            Cell::Number(*twice),
        ));
    }
    if let Some(probe) = probe {
        decisions.push(row("share of probe rays that miss the mesh", Cell::Number(probe.escaped_share())));
        decisions.push(row(
            "share of hits on front faces among the probe rays that hit the mesh",
            Cell::Number(probe.front_share()),
        ));
    }
    decisions
}

/// Assembles the outputs from the finished images of cameras; `crop` describes the cropping.
pub(crate) fn assemble(
    inputs: &In,
    (cameras, views): (&[Camera], Vec<FinishedView>),
    decided: &Decided,
    centre: DVec3,
    crop: String,
) -> Out {
    let mut sets: [Vec<NamedImage>; 7] = Default::default();
    let mut rows = Vec::with_capacity(views.len());
    let mut plans = Vec::new();
    let mut rays = Rays::default();
    for (camera, view) in cameras.iter().zip(views) {
        let [without, with, object] = view.images;
        let pictures = [
            without.into(),
            with.into(),
            object.into(),
            view.depth.into(),
            view.nearest.into(),
            view.normal.into(),
            view.variance.into(),
        ];
        for (set, picture) in sets.iter_mut().zip(pictures) {
            set.push(NamedImage { name: camera.name.clone(), picture });
        }
        rows.push(view.row);
        if let Some(ReachedError { asked, predicted, worst, blocks: [all, more, short], samples }) =
            view.reached
        {
            let name = Cell::Text(camera.name.clone());
            let errors = [asked.error, predicted, worst].map(Cell::Number);
            let blocks = [all, more, short].map(Cell::Count);
            plans.push(
                [name].into_iter().chain(errors).chain(blocks).chain([Cell::Number(samples)]).collect(),
            );
        }
        rays += view.rays;
    }
    let mut report = Report {
        title: "Path tracing".to_owned(),
        tables: vec![
            Table::new("decisions", ["item", "value"], decisions(inputs, decided, centre, &crop, &rays)),
            Table::new(
                "views",
                [
                    "view",
                    "mean luminance of `without`",
                    "RMS standard error of the pixels of `without`",
                    "mean luminance of `with`",
                    "RMS standard error of the pixels of `with`",
                    "mean luminance of `object`",
                    "RMS standard error of the pixels of `object`",
                    "rays",
                    "share of chunks of samples that no object changes",
                    "share of chunks of samples that `crop` left out",
                ],
                rows,
            ),
        ],
    };
    if !plans.is_empty() {
        report.tables.push(Table::new(
            "samples",
            [
                "view",
                "target error",
                "error predicted from the first samples",
                "error reached",
                "blocks of pixels",
                "blocks that took further samples",
                "blocks whose error is above the target",
                "samples per pixel",
            ],
            plans,
        ));
    }
    let [without, with, object, depth, nearest, normal, variance] = sets.map(|set| Arc::new(Images(set)));
    Out { without, with, object, depth, nearest, normal, variance, report: Arc::new(report) }
}

//! The outputs: the pictures of all cameras, and the report.

use std::sync::Arc;

use glam::DVec3;

use super::accumulator::FinishedView;
use super::auto::Decided;
use super::film::Rays;
use super::sample_plan::ReachedError;
use super::visibility::Block;
use super::{In, Out, lobes};
use crate::types::{Cell, Images, NamedImage, Report, Table};

pub(super) fn columns(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

/// How the receiver blocks the environment, in words.
fn block_text(block: &Block) -> String {
    match block {
        Block::Solid => "Solid".to_owned(),
        Block::Pass => "Pass".to_owned(),
        Block::FrontFace { max_layers, flip, .. } => {
            let side = if *flip { ", normals turned round" } else { "" };
            format!("FrontFace, {max_layers} layers{side}")
        }
        Block::PassBeyond { radius, .. } => format!("PassBeyond {radius} units from the point of capture"),
    }
}

/// The rows of what was decided, and what it took.
fn decisions(
    inputs: &In,
    Decided { rules, probe, twice }: &Decided,
    centre: DVec3,
    crop: String,
    rays: &Rays,
) -> Vec<Vec<Cell>> {
    let [nodes, triangles] = rays.steps_each();
    let text = |value: String| Cell::Text(value);
    let mut decisions = vec![
        vec![text("env_block".to_owned()), text(block_text(&rules.block))],
        vec![text("bounce".to_owned()), text(if rules.bounce_solid { "Solid" } else { "Env" }.to_owned())],
        vec![
            text("object_specular_sees".to_owned()),
            text(if rules.specular_env { "Env" } else { "Receiver" }.to_owned()),
        ],
        vec![text("near_field".to_owned()), text(if rules.near.is_some() { "On" } else { "Off" }.to_owned())],
        vec![text("crop".to_owned()), text(crop)],
        vec![text("point of capture".to_owned()), text(format!("{}, {}, {}", centre.x, centre.y, centre.z))],
        vec![text("camera rays".to_owned()), Cell::Count(rays.camera)],
        vec![text("shadow rays".to_owned()), Cell::Count(rays.shadow)],
        vec![text("scattered rays".to_owned()), Cell::Count(rays.scattered)],
        vec![text("rays".to_owned()), Cell::Count(rays.all())],
        vec![text("nodes of trees that a ray meets".to_owned()), Cell::Number(nodes)],
        vec![text("triangles that a ray is tested with".to_owned()), Cell::Number(triangles)],
        vec![text("lobes that no material has".to_owned()), text(lobes::absent(&inputs.objects))],
    ];
    if let Some(twice) = twice {
        decisions.push(vec![text("light that walls counted twice add".to_owned()), Cell::Number(*twice)]);
    }
    if let Some(probe) = probe {
        decisions.push(vec![text("probe rays that leave".to_owned()), Cell::Number(probe.escaped_share())]);
        decisions
            .push(vec![text("front faces among the others".to_owned()), Cell::Number(probe.front_share())]);
    }
    decisions
}

/// The outputs, of finished pictures; `crop` tells what was cropped.
pub(super) fn assemble(
    inputs: &In,
    views: Vec<FinishedView>,
    decided: &Decided,
    centre: DVec3,
    crop: String,
) -> Out {
    let mut sets: [Vec<NamedImage>; 7] = Default::default();
    let mut rows = Vec::with_capacity(views.len());
    let mut plans = Vec::new();
    let mut rays = Rays::default();
    for (camera, view) in inputs.rig.cameras.iter().zip(views) {
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
            let errors = [asked, predicted, worst].map(Cell::Number);
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
            Table {
                name: "decisions".to_owned(),
                columns: columns(&["what", "value"]),
                rows: decisions(inputs, decided, centre, crop, &rays),
            },
            Table {
                name: "views".to_owned(),
                columns: columns(&[
                    "view",
                    "mean luminance of without",
                    "standard error of a pixel of without",
                    "mean luminance of with",
                    "standard error of a pixel of with",
                    "mean luminance of object",
                    "standard error of a pixel of object",
                    "rays",
                    "share of chunks that no object touches",
                    "share of chunks that objects are too far from",
                ]),
                rows,
            },
        ],
    };
    if !plans.is_empty() {
        report.tables.push(Table {
            name: "samples".to_owned(),
            columns: columns(&[
                "view",
                "error asked for",
                "error that the first samples promise",
                "error reached",
                "blocks",
                "blocks with more than the first samples",
                "blocks short of the error",
                "samples a pixel",
            ]),
            rows: plans,
        });
    }
    let [without, with, object, depth, nearest, normal, variance] = sets.map(|set| Arc::new(Images(set)));
    Out { without, with, object, depth, nearest, normal, variance, report: Arc::new(report) }
}

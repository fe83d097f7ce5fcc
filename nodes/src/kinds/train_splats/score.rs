//! Scores of held-out photographs, and the report.

use engine::{Context, NodeError};
use render::splat::{Settings, render};
use render::train::state::State;
use scene::math::metrics::{Plane, errors, mean_over, ssim_map};
use scene::math::num;
use scene::types::{Camera, Cell, Photo, Report, Splats, Table};

use super::checkpoint::Stretch;
use super::interface::TrainSplats;

/// Score of a photograph that was held out.
pub struct Score {
    name: String,
    psnr: f64,
    ssim: f64,
}

/// Scores the photographs that were held out. If exposure is fitted, the render is multiplied by the factor per
/// channel that fits the photograph best.
pub fn scores(
    splats: &Splats,
    held: &[&Photo],
    state: &State,
    (settings, exposure): (&Settings, bool),
    cx: &Context,
) -> Result<Vec<Score>, NodeError> {
    held.iter().map(|photo| score(splats, photo, state, (settings, exposure), cx)).collect()
}

fn score(
    splats: &Splats,
    photo: &Photo,
    state: &State,
    (settings, exposure): (&Settings, bool),
    cx: &Context,
) -> Result<Score, NodeError> {
    let Photo { camera, pixels } = photo;
    let rendered = render(splats, camera, None, settings, cx)?;
    let size = (camera.width_px as usize, camera.height_px as usize);
    let plane = |samples| Plane { width: size.0, height: size.1, channels: 3, samples };
    let behind = state.background.log_gain.map(f64::from);
    let used = |at: usize| pixels[at][3] > 0;
    let mut view = Vec::with_capacity(3 * pixels.len());
    for pixel in rendered.rgba.as_chunks::<4>().0 {
        let through = 1.0 - f64::from(pixel[3]);
        view.extend((0..3).map(|c| f64::from(pixel[c]) + through * behind[c]));
    }
    let truth: Vec<f64> =
        pixels.iter().flat_map(|p| [p[0], p[1], p[2]]).map(|c| f64::from(c) / 255.0).collect();
    for c in 0..3 {
        let both =
            || (0..pixels.len()).filter(|at| used(*at)).map(|at| (view[3 * at + c], truth[3 * at + c]));
        let (along, square) = both().fold((0.0, 0.0), |sum, (x, y)| (sum.0 + x * y, sum.1 + x * x));
        if exposure && square > 0.0 {
            (0..pixels.len()).for_each(|at| view[3 * at + c] *= along / square);
        }
    }
    // A display shows at most white. Pixels that are ignored count as equal.
    for (at, (x, y)) in view.iter_mut().zip(&truth).enumerate() {
        *x = if used(at / 3) { x.clamp(0.0, 1.0) } else { *y };
    }
    let (view, truth) = (plane(view), plane(truth));
    let map = ssim_map(&view, &truth, cx)?;
    Ok(Score {
        name: camera.name.clone(),
        psnr: errors(&view, &truth, used).psnr(),
        ssim: mean_over(&map, used).unwrap_or(1.0),
    })
}

/// Mean PSNR of photographs, in dB. `None` without photographs, or if one is reproduced exactly.
pub fn mean_psnr(scores: &[Score]) -> Option<f64> {
    let sum: f64 = scores.iter().map(|score| score.psnr).sum();
    Some(sum / scores.len() as f64).filter(|mean| mean.is_finite())
}

fn finite(value: f64) -> Cell {
    if value.is_finite() { Cell::Number(value) } else { Cell::Missing }
}

/// Report of a training.
pub fn report(
    stretches: &[Stretch],
    scores: &[Score],
    state: &State,
    p: &TrainSplats,
    cameras: &[Camera],
) -> Report {
    let row = |stretch: &Stretch| {
        vec![
            Cell::Count(stretch.iterations.into()),
            Cell::Count(stretch.splats),
            finite(stretch.loss),
            stretch.psnr.map_or(Cell::Missing, Cell::Number),
            Cell::Count(stretch.relocated),
        ]
    };
    let columns = [
        "iterations",
        "splats",
        "mean loss since the row above",
        "held-out PSNR (dB)",
        "faded splats moved since the row above",
    ];
    let mut tables = vec![Table::new("training", columns, stretches.iter().map(row).collect())];
    let mut rows: Vec<Vec<Cell>> = scores
        .iter()
        .map(|score| vec![Cell::Text(score.name.clone()), finite(score.psnr), finite(score.ssim)])
        .collect();
    if !scores.is_empty() {
        let psnr = mean_psnr(scores).map_or(Cell::Missing, Cell::Number);
        let ssim = scores.iter().map(|score| score.ssim).sum::<f64>() / scores.len() as f64;
        rows.push(vec![Cell::Text("mean".to_owned()), psnr, finite(ssim)]);
    }
    tables.push(Table::new("held-out", ["photograph", "PSNR (dB)", "SSIM"], rows));
    if p.exposure {
        let row = |(camera, exposure): (&Camera, &render::train::state::Exposure)| {
            let gains = exposure.log_gain.map(|v| Cell::Number(num::f64::exp(v.into())));
            std::iter::once(Cell::Text(camera.name.clone())).chain(gains).collect()
        };
        let rows = cameras.iter().zip(&state.exposures).map(row).collect();
        tables.push(Table::new("exposure", ["photograph", "factor on red", "on green", "on blue"], rows));
    }
    if p.background {
        let colour = state.background.log_gain.map(|v| Cell::Number(v.into())).to_vec();
        tables.push(Table::new("background", ["red", "green", "blue"], vec![colour]));
    }
    Report { title: format!("Splats after {} iterations", state.step), tables }
}

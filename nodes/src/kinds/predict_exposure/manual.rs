//! Lights given by the user.

use engine::{Context, NodeError, Notes, Up};
use render::light::linear::LinearPixels;
use scene::math::equirect::direction;
use scene::math::num;

/// Largest gain of a light, in stops.
const STOPS: f64 = 24.0;

/// Checks that the numbers of each light are within their ranges.
pub(super) fn check(emitters: &[[f64; 4]]) -> Result<(), NodeError> {
    for (i, &[azimuth, elevation, radius, stops]) in emitters.iter().enumerate() {
        let wrong = if azimuth.abs() > 360.0 {
            format!("an azimuth of {azimuth}, outside -360 to 360 degrees (clockwise from forward)")
        } else if elevation.abs() > 90.0 {
            format!("an elevation of {elevation}, outside -90 to 90 degrees above the horizon")
        } else if radius <= 0.0 || radius > 180.0 {
            format!("a radius of {radius}, outside 0 (exclusive) to 180 degrees")
        } else if !(0.0..=STOPS).contains(&stops) {
            format!("a gain of {stops}, outside 0 to {STOPS} stops")
        } else {
            continue;
        };
        return Err(NodeError::new(format!("emitter {} has {wrong}", i + 1))
            .at("method")
            .hint("write (azimuth, elevation, radius, stops)"));
    }
    Ok(())
}

/// log2 gain of every pixel: the gain of the narrowest emitter that covers the pixel (the nearest of equally narrow
/// emitters), or 0 if none covers it.
pub(super) fn predict(
    emitters: &[[f64; 4]],
    (pixels, mask): (&LinearPixels, &[bool]),
    up: Up,
    notes: &mut Notes,
    cx: &Context,
) -> Result<Vec<f32>, NodeError> {
    let (width, height) = (pixels.width, pixels.height);
    let toward = |&[azimuth, elevation, ..]: &[f64; 4]| {
        direction(up, (azimuth / 360.0 + 0.5).rem_euclid(1.0), 0.5 - elevation / 180.0)
    };
    let lights: Vec<_> = emitters.iter().map(|e| (toward(e), num::f64::cos(e[2].to_radians()))).collect();
    let rows = cx.for_each_tile(height, |y| {
        let nearest = |x: usize| {
            let d = direction(up, (x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
            let cosines = lights.iter().map(|(light, _)| d.dot(*light)).enumerate();
            let within = cosines.filter(|(i, cosine)| *cosine >= lights[*i].1);
            // The larger its cosine, the narrower or nearer is an emitter. The first of equal emitters is taken.
            let rank = |&(i, cosine): &(usize, f64)| (lights[i].1, cosine);
            within.reduce(|a, b| if rank(&b) > rank(&a) { b } else { a }).map(|(i, _)| i)
        };
        (0..width).map(|x| if mask[y * width + x] { nearest(x) } else { None }).collect::<Vec<_>>()
    })?;
    let mut log2_gain = vec![0.0_f32; mask.len()];
    let mut used = vec![false; emitters.len()];
    for (gain, light) in log2_gain.iter_mut().zip(rows.into_iter().flatten()) {
        if let Some(i) = light {
            *gain = emitters[i][3] as f32;
            used[i] = true;
        }
    }
    let idle: Vec<String> =
        (1..).zip(&used).filter(|(_, used)| !**used).map(|(i, _)| i.to_string()).collect();
    if !idle.is_empty() {
        let text = format!(
            "emitters without effect, because they cover no clipped pixel or only pixels of narrower emitters: {}",
            idle.join(", ")
        );
        notes.warning("nothing-to-light", text);
    }
    Ok(log2_gain)
}

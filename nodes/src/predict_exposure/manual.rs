//! Lights that the user states.

use engine::{Context, NodeError, Notes};

use super::{Clipped, Found};
use crate::equirect::{direction, pixel_solid_angle};
use crate::light::measure;
use crate::num;

/// Largest gain that may be stated, in stops.
const STOPS: f64 = 24.0;

/// Refuses what is no light.
pub(super) fn check(emitters: &[[f64; 4]]) -> Result<(), NodeError> {
    for (i, &[azimuth, elevation, radius, stops]) in emitters.iter().enumerate() {
        let sound = azimuth.abs() <= 360.0
            && elevation.abs() <= 90.0
            && radius > 0.0
            && radius <= 180.0
            && (0.0..=STOPS).contains(&stops);
        if !sound {
            let text = format!(
                "emitter {} is no light: azimuth is within +-360, elevation within +-90, radius above 0 up to 180, stops 0 to {STOPS}",
                i + 1
            );
            return Err(NodeError::new(text)
                .at("emitters")
                .hint("write (azimuth, elevation, radius, stops)"));
        }
    }
    Ok(())
}

/// The log2 gain of every pixel: that of the narrowest emitter that reaches it (of equal ones the nearest), 0
/// elsewhere; and the emitters.
pub(super) fn predict(
    emitters: &[[f64; 4]],
    clipped: &Clipped<'_>,
    notes: &mut Notes,
    cx: &Context,
) -> Result<(Vec<f32>, Vec<Found>), NodeError> {
    let Clipped { up, pixels, mask, .. } = *clipped;
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
            // The larger its cosine the narrower is an emitter, and the nearer; the first of equal ones.
            let rank = |&(i, cosine): &(usize, f64)| (lights[i].1, cosine);
            within.reduce(|a, b| if rank(&b) > rank(&a) { b } else { a }).map(|(i, _)| i)
        };
        (0..width).map(|x| if mask[y * width + x] { nearest(x) } else { None }).collect::<Vec<_>>()
    })?;
    let mut log2_gain = vec![0.0_f32; mask.len()];
    let mut solid_angle = vec![0.0; emitters.len()];
    for (at, light) in rows.into_iter().flatten().enumerate() {
        if let Some(i) = light {
            log2_gain[at] = emitters[i][3] as f32;
            solid_angle[i] += pixel_solid_angle(width, height, at / width);
        }
    }
    let dark = solid_angle.iter().filter(|size| **size == 0.0).count() as u64;
    if dark > 0 {
        notes.warning(
            "nothing-to-light",
            format!("{dark} of the emitters reach no clipped pixel and do nothing"),
        );
    }
    let found = |((light, _), (emitter, &solid_angle)): ((_, _), (&[f64; 4], &f64))| {
        let (azimuth_deg, elevation_deg) = measure::angles_deg(up, light);
        let stops = if solid_angle > 0.0 { emitter[3] } else { 0.0 };
        Found {
            sun: false,
            azimuth_deg,
            elevation_deg,
            solid_angle,
            mean_log2_gain: stops,
            peak_log2_gain: stops,
            uncertainty: None,
        }
    };
    let found = lights.into_iter().zip(emitters.iter().zip(&solid_angle)).map(found).collect();
    Ok((log2_gain, found))
}

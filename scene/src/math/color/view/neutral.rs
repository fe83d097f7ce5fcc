//! Khronos PBR Neutral (specification 1.0, 2024).

/// Value at which compression begins.
const START: f64 = 0.8 - OFFSET;
/// Reflectance of a dielectric at normal incidence, which is subtracted so that a base colour is shown as it is.
const OFFSET: f64 = 0.04;
/// Rate at which compressed colours lose their saturation.
const DESATURATION: f64 = 0.15;

/// Light of a display, 0 to 1, for scene light of Rec.709. Negative components count as 0.
pub(super) fn compressed(light: [f64; 3]) -> [f64; 3] {
    let light = light.map(|v| v.max(0.0));
    let smallest = light[0].min(light[1]).min(light[2]);
    let offset = if smallest < 2.0 * OFFSET { smallest - 6.25 * smallest * smallest } else { OFFSET };
    let colour = light.map(|v| v - offset);
    let peak = colour[0].max(colour[1]).max(colour[2]);
    if peak < START {
        return colour;
    }
    let range = 1.0 - START;
    let new_peak = 1.0 - range * range / (peak + range - START);
    let kept = 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    colour.map(|v| {
        let scaled = v * (new_peak / peak);
        new_peak + (scaled - new_peak) * kept
    })
}

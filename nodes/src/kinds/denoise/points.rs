//! Denoising of the ratio at splats: every splat gets the mean of the splats around it that have the same ratio within the
//! noise.

use std::collections::BTreeSet;

use engine::{Context, NodeError};
use glam::{DVec3, Vec3};
use render::transport::picture::splat_rays::{SplatPixels, curve};
use scene::math::color::luminance;
use scene::types::{Image, Linear, Splats};

use super::view::{ViewLayers, known};

/// Number of splats per job.
const CHUNK: usize = 2048;
/// Shifts of the curves along which neighbours are searched.
const SHIFTS: [f64; 3] = [0.0, 0.37, 0.71];
/// Number of splats before and after a splat on each curve among which its neighbours are searched.
const WINDOW: usize = 40;
/// Maximum number of neighbours.
const NEIGHBOURS: usize = 48;
/// Number of nearest splats whose mean is compared: single ratios have too much noise to tell edges from noise.
const PILOT: usize = 10;
/// Minimum cosine of the angle between the normals of splats that are averaged.
const ALIKE: f32 = 0.8;
/// Allowed difference of the means of two splats, in standard deviations of the difference, at `strength` 1.
const DEVIATIONS: f64 = 2.0;

/// A splat on the receiver.
#[derive(Clone, Copy)]
struct Point {
    position: DVec3,
    normal: Vec3,
    without: [f32; 3],
    with: [f32; 3],
    /// Variance of the ratio.
    variance: f64,
}

impl Point {
    fn is_changed(&self) -> bool {
        self.without != self.with
    }

    /// Luminance of the ratio.
    fn ratio(&self) -> f64 {
        let [with, without] = [self.with, self.without].map(|light| f64::from(luminance(light)));
        if without > 0.0 { with / without } else { 1.0 }
    }
}

/// Returns `without` and `with` with less noise, and `object`; and true if nothing can be filtered, since `variance` is 0
/// although objects change the light. Splats keep their bits if no object affects one of their neighbours.
///
/// # Errors
/// If `name`, the name of the images, is not that of images of these splats, or the run was cancelled.
pub(super) fn filter(
    splats: &Splats,
    (name, view): (&str, &ViewLayers<'_>),
    strength: f64,
    cx: &Context,
) -> Result<([Image<Linear>; 3], bool), NodeError> {
    let pixels = SplatPixels::of(splats);
    let size = (pixels.size.0 as usize, pixels.size.1 as usize);
    if name != pixels.name() || (view.without.width, view.without.height) != size {
        let text = format!("the layers were not traced at these {} splats", splats.len());
        let hint = "give `path-trace` and `denoise` the same `points`";
        return Err(NodeError::new(text).at("points").hint(hint));
    }
    let mut out = [view.without.clone(), view.with.clone(), view.object.clone()];
    if strength == 0.0 {
        return Ok((out, false));
    }
    let (mut points, mut at) = (vec![None; splats.len()], vec![0; splats.len()]);
    for (splat, (x, y)) in pixels.iter() {
        let pixel = y as usize * size.0 + x as usize;
        at[splat] = pixel;
        points[splat] = point(splats, splat, view, pixel);
    }
    // Without a variance, no difference counts as noise.
    let is_blind = points.iter().flatten().any(Point::is_changed)
        && points.iter().flatten().all(|point| point.variance == 0.0);
    let curves = SHIFTS.map(|shift| curve(splats, shift));
    let places = curves.each_ref().map(|curve| {
        let mut places = vec![0_u32; curve.len()];
        curve.iter().enumerate().for_each(|(place, splat)| places[*splat as usize] = place as u32);
        places
    });
    let neighbours = cx.for_each_tile(splats.len().div_ceil(CHUNK), |chunk| {
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(splats.len());
        range.map(|splat| around(splat, &points, (&curves, &places))).collect::<Vec<_>>()
    })?;
    let neighbours = neighbours.concat();
    let pilots = cx.for_each_tile(splats.len().div_ceil(CHUNK), |chunk| {
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(splats.len());
        range.map(|splat| pilot(&neighbours[splat], &points)).collect::<Vec<_>>()
    })?;
    let pilots = pilots.concat();
    let filtered = cx.for_each_tile(splats.len().div_ceil(CHUNK), |chunk| {
        let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(splats.len());
        range.map(|splat| average(splat, &neighbours[splat], &points, &pilots, strength)).collect::<Vec<_>>()
    })?;
    for (splat, light) in filtered.concat().into_iter().enumerate() {
        if let Some(light) = light {
            for (image, light) in out.iter_mut().zip(light) {
                image.samples[3 * at[splat]..3 * at[splat] + 3].copy_from_slice(&light);
            }
        }
    }
    Ok((out, is_blind))
}

/// A splat with its light. `None` if it does not lie on the receiver, or if its light is not finite.
fn point(splats: &Splats, splat: usize, view: &ViewLayers<'_>, pixel: usize) -> Option<Point> {
    let three = |samples: &[f32]| [0, 1, 2].map(|k| samples[3 * pixel + k]);
    let normal = Vec3::from_array(three(view.normal.samples()));
    let (without, with) = (three(&view.without.samples), three(&view.with.samples));
    let is_usable = normal != Vec3::ZERO && without.iter().chain(&with).all(|light| light.is_finite());
    let variance = f64::from(known(view.variance.samples()[4 * pixel + 3]));
    is_usable.then(|| Point { position: splats.mean(splat), normal, without, with, variance })
}

/// The splats nearest to a splat on the receiver, nearest first, beginning with itself. Empty if no object affects any of
/// them.
fn around(
    splat: usize,
    points: &[Option<Point>],
    (curves, places): (&[Vec<u32>; 3], &[Vec<u32>; 3]),
) -> Vec<u32> {
    let Some(own) = points[splat] else { return Vec::new() };
    let mut found = BTreeSet::new();
    for (curve, places) in curves.iter().zip(places) {
        let place = places[splat] as usize;
        found.extend(&curve[place.saturating_sub(WINDOW)..(place + WINDOW + 1).min(curve.len())]);
    }
    let near = found.into_iter().filter_map(|&other| {
        let point = points[other as usize].filter(|point| point.normal.dot(own.normal) > ALIKE)?;
        Some((point.position.distance_squared(own.position), other))
    });
    let mut near: Vec<(f64, u32)> = near.collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(NEIGHBOURS);
    let changed = near.iter().any(|(_, other)| points[*other as usize].is_some_and(|p| p.is_changed()));
    if changed { near.into_iter().map(|(_, other)| other).collect() } else { Vec::new() }
}

/// Mean ratio of the nearest neighbours, and the variance of this mean.
fn pilot(neighbours: &[u32], points: &[Option<Point>]) -> (f64, f64) {
    let nearest = neighbours.iter().take(PILOT).filter_map(|other| points[*other as usize]);
    let (sum, variance, count) = nearest.fold((0.0, 0.0, 0.0), |(sum, variance, count), p| {
        (sum + p.ratio(), variance + p.variance, count + 1.0)
    });
    if count > 0.0 { (sum / count, variance / (count * count)) } else { (1.0, 0.0) }
}

/// The light of a splat, averaged over its neighbours. `None` if it stays as it is.
fn average(
    splat: usize,
    neighbours: &[u32],
    points: &[Option<Point>],
    pilots: &[(f64, f64)],
    strength: f64,
) -> Option<[[f32; 3]; 2]> {
    let own = points[splat]?;
    let (ratio, variance) = pilots[splat];
    let (mut sums, mut weights) = ([[0.0_f64; 3]; 2], 0.0);
    for &other in neighbours {
        let Some(point) = points[other as usize] else { continue };
        let (other_ratio, other_variance) = pilots[other as usize];
        let allowed = DEVIATIONS * strength * (variance + other_variance).sqrt();
        let off = (ratio - other_ratio).abs();
        // Falls to 0 at twice the allowed difference.
        let weight = if allowed > 0.0 {
            (2.0 - off / allowed).clamp(0.0, 1.0)
        } else {
            f64::from(u8::from(off == 0.0))
        };
        weights += weight;
        for (sums, light) in sums.iter_mut().zip([point.without, point.with]) {
            sums.iter_mut().zip(light).for_each(|(sum, light)| *sum += weight * f64::from(light));
        }
    }
    if weights <= 0.0
        || !neighbours.iter().any(|other| points[*other as usize].is_some_and(|p| p.is_changed()))
    {
        return None;
    }
    // The light of the splat without objects stays; the ratio is that of the means.
    let with = [0, 1, 2].map(|k| {
        let ratio = if sums[0][k] > 0.0 { sums[1][k] / sums[0][k] } else { 1.0 };
        (f64::from(own.without[k]) * ratio) as f32
    });
    Some([own.without, with])
}

#[cfg(test)]
mod tests {
    use scene::types::{Data, Picture};
    use testing::context;

    use super::*;

    const SIDE: usize = 60;

    /// A floor of splats in the light. In its right half the ratio is 0.4. The noise of the ratio has this deviation, all
    /// of which is in 2 of 97 splats, like that of rare bright paths.
    fn noisy(deviation: f32) -> (Splats, [Image<Linear>; 3], [Picture; 3]) {
        let mut splats = Splats::empty();
        for i in 0..SIDE * SIDE {
            splats.means.push([(i % SIDE) as f32, (i / SIDE) as f32, 0.0]);
        }
        let pixels = SplatPixels::of(&splats);
        let (width, height) = (pixels.size.0 as usize, pixels.size.1 as usize);
        let mut images = [3, 3, 4].map(|channels| Image::<Linear>::new(width, height, channels));
        let mut guides = [1, 3, 4].map(|channels| Image::<Data>::new(width, height, channels));
        for (splat, (x, y)) in pixels.iter() {
            let pixel = y as usize * width + x as usize;
            let random = match splat * 7919 % 97 {
                0 => 48.5_f32.sqrt(),
                48 => -48.5_f32.sqrt(),
                _ => 0.0,
            };
            let shaded = splat % SIDE >= SIDE / 2;
            let ratio = if shaded { 0.4 + deviation * random } else { 1.0 };
            let albedo = 0.2 + 0.01 * (splat % 7) as f32;
            images[0].samples[3 * pixel..3 * pixel + 3].fill(albedo);
            images[1].samples[3 * pixel..3 * pixel + 3].fill(if shaded { albedo * ratio } else { albedo });
            guides[1].samples[3 * pixel + 2] = 1.0;
            guides[2].samples[4 * pixel + 3] = if shaded { deviation * deviation } else { 0.0 };
        }
        (splats, images, guides.map(Picture::from))
    }

    fn filtered(noise: f32, strength: f64) -> (Splats, [Image<Linear>; 3], [Image<Linear>; 3]) {
        let (splats, images, [depth, normal, variance]) = noisy(noise);
        let view = ViewLayers {
            without: &images[0],
            with: &images[1],
            object: &images[2],
            depth: &depth,
            normal: &normal,
            variance: &variance,
        };
        let (out, is_blind) =
            filter(&splats, (&SplatPixels::of(&splats).name(), &view), strength, &context())
                .expect("filters");
        assert_eq!(is_blind, noise == 0.0, "a variance of 0 is reported");
        let mut moved = splats.clone();
        moved.means.reverse();
        let refused = filter(&moved, (&SplatPixels::of(&splats).name(), &view), strength, &context());
        assert!(refused.is_err(), "splats at other places are refused");
        (splats, images, out)
    }

    /// The noise falls to a quarter or less, the edge of the shadow stays, and splats far from it keep their bits. This
    /// test fails if single ratios are compared instead of their means.
    #[test]
    fn noise_falls_and_the_edge_stays() {
        let (splats, before, after) = filtered(0.05, 1.0);
        let pixels = SplatPixels::of(&splats);
        let (mut errors, mut count) = ([0.0; 2], 0.0);
        for (splat, (x, y)) in pixels.iter() {
            let pixel = 3 * (y as usize * pixels.size.0 as usize + x as usize);
            let ratio = |images: &[Image<Linear>; 3]| {
                f64::from(images[1].samples[pixel]) / f64::from(images[0].samples[pixel])
            };
            assert_eq!(before[0].samples[pixel], after[0].samples[pixel], "the light without objects stays");
            match splat % SIDE {
                column if column < SIDE / 2 - 12 => {
                    assert_eq!(before[1].samples[pixel], after[1].samples[pixel]);
                }
                column if column >= SIDE / 2 + 4 => {
                    let squared =
                        [&before, &after].map(|images| (ratio(images) - 0.4) * (ratio(images) - 0.4));
                    errors = [errors[0] + squared[0], errors[1] + squared[1]];
                    count += 1.0;
                }
                column if column == SIDE / 2 - 3 => assert!(ratio(&after) > 0.9, "{}", ratio(&after)),
                column if column == SIDE / 2 + 2 => assert!(ratio(&after) < 0.55, "{}", ratio(&after)),
                _ => {}
            }
        }
        let [before, after] = errors.map(|sum| (sum / count).sqrt());
        assert!((before - 0.05).abs() < 0.01 && after < 0.25 * before, "{before} {after}");
    }

    #[test]
    fn nothing_changes_without_strength_or_noise() {
        let (_, before, after) = filtered(0.1, 0.0);
        assert_eq!(before[1], after[1]);
        let (_, before, after) = filtered(0.0, 1.0);
        for (a, b) in before[1].samples.iter().zip(&after[1].samples) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}

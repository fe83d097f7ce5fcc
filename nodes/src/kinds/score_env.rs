//! `score-env`: compares recovered light with a reference.

use std::sync::Arc;

use engine::{Context, Kind, NodeError, Notes};
use glam::DVec3;
use render::light::emitters;
use render::light::measure::{
    self, brightest, cells, centroid, contrast, irradiance, irradiances, luminance, spiral,
};
use render::light::spheres::{Sphere, sphere_error};
use scene::error::Error;
use scene::math::equirect::{axes, pixel_solid_angle};
use scene::math::num;
use scene::types::{Cell, Environment, Report, Table};

engine::params! {
    /// Scores recovered light against a reference.
    ///
    /// Compares the illumination of a scene: the irradiance on planes that face every direction and on six planes
    /// that face along the axes of the world, the direction of the dominant light, its contrast, the panoramas
    /// weighted by solid angle, and renders of a matte, a glossy and a mirror sphere seen along the world's forward
    /// axis. Contrast is the ratio of the dominant light to all other light; it determines how dark a shadow is. In
    /// the recovered light, the dominant light is the light from within 15 degrees of the true direction, so a
    /// light in any other direction counts as missing.
    ///
    /// Irradiance over all planes, energy, panoramas and spheres use red, green and blue, as published; the six
    /// planes, the dominant light and the peak use luminance.
    ///
    /// The table `emitters` compares the strength, colour and share of each region of the reference that is at least
    /// as bright as white, with a margin of 1.5 degrees. Regions within 3 degrees of each other are one emitter. The
    /// strength is the luminance of the integral of radiance over solid angle.
    ///
    /// The six planes and the panorama are computed per texel. The planes in every direction, the spheres and the
    /// dominant light use a grid of 128 columns; contrast and peak use a grid of 256. A texel is added to the cell
    /// that contains its centre, and texels larger than a cell are split. If no direction stands out, there is no
    /// dominant light.
    pub struct ScoreEnv {
        /// Number of planes, with normals spread evenly over all directions, on which the irradiance is compared.
        normals: u32 = 512, range(1, 100000), other("64");
    }
}

engine::inputs! {
    /// Inputs of `score-env`.
    pub struct In {
        /// Light to score.
        env: Arc<Environment>,
        /// Reference light.
        truth: Arc<Environment>,
    }
}

engine::outputs! {
    /// Outputs of `score-env`.
    pub struct Out {
        /// The scores, one per row.
        report: Arc<Report>,
    }
}

/// Number of columns of the grid for contrast and peak.
const FINE: usize = 256;
/// Number of columns of the grid for the planes in every direction, the spheres and the dominant light.
const COARSE: usize = 128;
/// Minimum ratio of the radiance in the brightest direction to the mean radiance of the sphere for a light to be
/// dominant. The radiance is first smoothed with a lobe of 10 degrees.
const STANDS_OUT: f64 = 1.1;

impl Kind for ScoreEnv {
    const NAME: &'static str = "score-env";
    const VERSION: u32 = 9;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn run(params: &Self, inputs: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        let (env, truth) = (&inputs.env, &inputs.truth);
        if env.up != truth.up {
            let what = Error::Mismatch("the two environments have different up axes".to_owned());
            return Err(NodeError::from(what).at("truth"));
        }
        let mut notes = Notes::none();
        if let (Some(a), Some(b)) = (env.origin, truth.origin)
            && (a - b).length() > 1e-6 * (1.0 + b.length())
        {
            let apart = (a - b).length();
            notes.warning(
                "other-origin",
                format!("the two environments were captured {apart:.3} world units apart"),
            );
        }
        let scores = score(env, truth, params.normals as usize, cx)?;
        let row = |(name, unit, value): &Score| {
            let value = value.map_or(Cell::Missing, Cell::Number);
            vec![Cell::Text((*name).to_owned()), value, Cell::Text((*unit).to_owned())]
        };
        let table = Table::new("light", ["measure", "value", "unit"], scores.iter().map(row).collect());
        let tables = vec![table, emitters_table(env, truth)];
        let report = Report { title: "Recovered light compared with the reference".to_owned(), tables };
        Ok((Out { report: Arc::new(report) }, notes))
    }
}

/// Maximum number of emitters that are listed.
const LISTED: usize = 12;
/// Minimum share of all light for an emitter to be listed.
const LEAST: f64 = 0.005;

/// Strength, colour and share of each emitter of the reference.
fn emitters_table(env: &Environment, truth: &Environment) -> Table {
    let found = emitters::find(truth);
    let total = luminance;
    let (all, all_truth) = (total(emitters::total(env)), total(found.total));
    let listed = found.list.iter().zip(found.fluxes(truth)).zip(found.fluxes(env));
    let rows = listed.filter(|((_, want), _)| total(*want) >= LEAST * all_truth).take(LISTED).map(
        |((emitter, want), flux)| {
            let (azimuth, elevation) = measure::angles_deg(truth.up, emitter.direction);
            let [share, share_truth] = [total(flux) / all, total(want) / all_truth];
            let stops = num::f64::log2(total(flux) / total(want));
            let number = |value: f64| if value.is_finite() { Cell::Number(value) } else { Cell::Missing };
            let colour = emitters::colour_angle_deg(flux, want).map_or(Cell::Missing, Cell::Number);
            let shares = [share_truth, share, num::f64::log2(share / share_truth)];
            let mut row = vec![number(azimuth), number(elevation), number(stops), colour];
            row.extend(shares.map(number));
            row
        },
    );
    let columns = [
        "azimuth (deg, clockwise from forward)",
        "elevation (deg)",
        "strength, log2(recovered / reference) (stops)",
        "colour, angle in RGB (deg)",
        "share of all light in the reference",
        "share of all light in the recovered environment",
        "share, log2(recovered / reference) (stops)",
    ];
    Table::new("emitters", columns, rows.collect())
}

/// Name and unit of a score, and its value; `None` if it cannot be computed.
type Score = (&'static str, &'static str, Option<f64>);

/// Computes all scores of `env`, with `truth` as the reference.
fn score(
    env: &Environment,
    truth: &Environment,
    normals: usize,
    cx: &Context,
) -> Result<Vec<Score>, NodeError> {
    let (fine, fine_truth) = (cells(env, FINE), cells(truth, FINE));
    let (coarse, coarse_truth) = (cells(env, COARSE), cells(truth, COARSE));
    let normals = spiral(normals);
    let both = cx.for_each_tile(normals.len(), |i| {
        (irradiance(&coarse, normals[i]), irradiance(&coarse_truth, normals[i]))
    })?;
    let (mut sum, mut sum_truth, mut error, mut power) = (0.0, 0.0, 0.0, 0.0);
    for (found, want) in &both {
        for (f, w) in found.iter().zip(want) {
            sum += f;
            sum_truth += w;
            error += (f - w) * (f - w);
            power += w * w;
        }
    }
    let ratio = (sum > 0.0 && sum_truth > 0.0).then(|| num::f64::log2(sum / sum_truth));
    let relative = (power > 0.0).then(|| (error / power).sqrt());
    let dominant = |coarse: &[measure::Cell], fine: &[measure::Cell]| {
        let stands_out = brightest(coarse).filter(|(_, over_mean)| *over_mean > STANDS_OUT);
        stands_out.map(|(around, _)| centroid(fine, around))
    };
    let light = dominant(&coarse_truth, &fine_truth);
    let found = dominant(&coarse, &fine);
    cx.check()?;
    let angle = |a: DVec3, b: DVec3| num::atan2(a.cross(b).length(), a.dot(b)).to_degrees();
    let off = light.zip(found).map(|(a, b)| angle(a, b));
    let above = axes(truth.up)[2];
    let contrasts = light.zip(found).and_then(|(light, _)| {
        let of = |cells: &[measure::Cell]| Some(num::f64::log2(contrast(cells, light, above)?.max(1e-4)));
        Some(of(&fine)? - of(&fine_truth)?)
    });
    let peak = |cells: &[measure::Cell]| cells.iter().map(|cell| luminance(cell.rgb)).fold(0.0, f64::max);
    let (peak, peak_truth) = (peak(&fine), peak(&fine_truth));
    let peaks = (peak > 0.0 && peak_truth > 0.0).then(|| num::f64::log2(peak / peak_truth));
    let mut scores = vec![
        (
            "mean irradiance over all planes (red, green and blue), log2(recovered / reference)",
            "stops",
            ratio,
        ),
        ("irradiance on all planes, relative RMS error", "", relative),
        ("direction of the dominant light, angular error", "deg", off),
        ("contrast of the dominant light, log2(recovered / reference)", "stops", contrasts),
        ("peak luminance on a grid of 256 columns, log2(recovered / reference)", "stops", peaks),
    ];
    let [right, forward, up] = axes(truth.up);
    let sides = [
        ("irradiance on a plane that faces up (luminance), log2(recovered / reference)", up),
        ("irradiance on a plane that faces down (luminance), log2(recovered / reference)", -up),
        ("irradiance on a plane that faces right (luminance), log2(recovered / reference)", right),
        ("irradiance on a plane that faces left (luminance), log2(recovered / reference)", -right),
        ("irradiance on a plane that faces forward (luminance), log2(recovered / reference)", forward),
        ("irradiance on a plane that faces back (luminance), log2(recovered / reference)", -forward),
    ];
    let [planes, planes_truth] = [env, truth].map(|of| irradiances(of, sides.map(|(_, normal)| normal)));
    for ((name, _), (found, want)) in sides.into_iter().zip(planes.into_iter().zip(planes_truth)) {
        let [found, want] = [found, want].map(luminance);
        scores.push((name, "stops", (found > 0.0 && want > 0.0).then(|| num::f64::log2(found / want))));
    }
    let (absolute, energy) = weighed(env, truth);
    scores.push(("panorama, mean absolute error divided by the mean of the reference", "", absolute));
    scores.push((
        "energy over the whole sphere (red, green and blue), log2(recovered / reference)",
        "stops",
        energy,
    ));
    for (sphere, names) in SPHERES {
        let error = sphere_error(sphere, &coarse, &coarse_truth, [right, forward, up], cx)?;
        scores.push((names[0], "", error.map(|e| e.relative)));
        scores.push((names[1], "", error.map(|e| e.scaled)));
        if sphere == Sphere::Diffuse {
            scores.push(("matte sphere, mean RGB angular error", "deg", error.map(|e| e.angle_deg)));
        }
    }
    Ok(scores)
}

/// Spheres with the names of their two scores.
const SPHERES: [(Sphere, [&str; 2]); 3] = [
    (
        Sphere::Diffuse,
        ["matte sphere, relative RMS error", "matte sphere, scale-invariant relative RMS error"],
    ),
    (
        Sphere::Glossy,
        ["glossy sphere, relative RMS error", "glossy sphere, scale-invariant relative RMS error"],
    ),
    (
        Sphere::Mirror,
        ["mirror sphere, relative RMS error", "mirror sphere, scale-invariant relative RMS error"],
    ),
];

/// Two scores of the panoramas: the mean absolute difference of radiance over channels and solid angle, divided by
/// the mean radiance of the truth; and log2 of the ratio of the two energies. They are computed per texel.
/// Panoramas of different sizes are compared on the finest grid that both fill. `None` if a panorama is black.
fn weighed(env: &Environment, truth: &Environment) -> (Option<f64>, Option<f64>) {
    let (mut off, mut found, mut want) = (0.0, 0.0, 0.0);
    let mut add = |[a, b]: [[f64; 3]; 2], solid_angle: f64| {
        for (a, b) in a.into_iter().zip(b) {
            off += (a - b).abs() * solid_angle;
            found += a * solid_angle;
            want += b * solid_angle;
        }
    };
    let (width, height) = (truth.image.width, truth.image.height);
    if (env.image.width, env.image.height) == (width, height) {
        for i in 0..width * height {
            let (x, y) = (i % width, i / width);
            add(
                [env, truth].map(|of| of.image.rgb(x, y).map(f64::from)),
                pixel_solid_angle(width, height, y),
            );
        }
    } else {
        // Heights may also limit the grid: both must have the same cells.
        let columns = [env, truth]
            .map(|of| of.image.width.min(2 * of.image.height))
            .into_iter()
            .fold(width, usize::min);
        for (f, t) in cells(env, columns).iter().zip(&cells(truth, columns)) {
            add([f.rgb, t.rgb], t.solid_angle);
        }
    }
    ((want > 0.0).then(|| off / want), (found > 0.0 && want > 0.0).then(|| num::f64::log2(found / want)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::{Scene, Up};
    use scene::math::equirect::direction;
    use scene::types::Image;

    fn env(width: usize, sun: DVec3, power: f32) -> Environment {
        let height = width / 2;
        let mut image = Image::new(width, height, 3);
        for y in 0..height {
            for x in 0..width {
                let d =
                    direction(Up::PlusY, (x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
                image.pixel_mut(x, y).fill(if d.dot(sun) > 0.998 { power } else { 0.3 });
            }
        }
        Environment { image: image.into(), up: Up::PlusY, origin: None }
    }

    fn scores(a: Environment, b: Environment) -> Vec<f64> {
        let cx =
            Context::detached(Scene { up: Up::PlusY, metres_per_unit: 1.0, seed: 1, exhaustive: false }, ".");
        let inputs = In { env: Arc::new(a), truth: Arc::new(b) };
        let (out, _) = ScoreEnv::run(&ScoreEnv { normals: 128 }, inputs, &cx).expect("runs");
        let value = |row: &Vec<Cell>| if let Cell::Number(v) = row[1] { v } else { f64::NAN };
        out.report.tables[0].rows.iter().map(value).collect()
    }

    #[test]
    fn truth_scores_zero_at_any_resolution() {
        let sun = DVec3::new(0.4, 0.7, 0.2).normalize();
        assert!(scores(env(256, sun, 900.0), env(256, sun, 900.0)).iter().all(|s| s.abs() < 1e-9));
        let coarser = scores(env(512, sun, 900.0), env(256, sun, 900.0));
        assert!(coarser[0].abs() < 0.08 && coarser[2] < 0.3 && coarser[3].abs() < 0.1, "{coarser:?}");
    }

    #[test]
    fn twice_the_light_is_one_stop_and_a_moved_sun_is_its_angle() {
        let sun = DVec3::new(0.4, 0.7, 0.2).normalize();
        let mut twice = env(256, sun, 900.0);
        twice.image.samples.iter_mut().for_each(|v| *v *= 2.0);
        let found = scores(twice, env(256, sun, 900.0));
        assert!((found[0] - 1.0).abs() < 1e-6 && found[3].abs() < 1e-9 && (found[1] - 1.0).abs() < 1e-6);
        // The six planes, the panorama, its energy; spheres twice as bright and, with the best exposure, equal.
        assert!(found[5..13].iter().all(|score| (score - 1.0).abs() < 1e-6), "{found:?}");
        assert!((found[13] - 1.0).abs() < 1e-6 && found[14] < 1e-5 && found[15] < 1e-4, "{found:?}");
        let moved = DVec3::new(-0.4, 0.7, 0.2).normalize();
        let found = scores(env(256, moved, 900.0), env(256, sun, 900.0));
        let want = num::f64::acos(moved.dot(sun)).to_degrees();
        assert!((found[2] - want).abs() < 0.5, "{} {want}", found[2]);
    }

    // This test fails if the fluxes of both environments are exchanged.
    #[test]
    fn emitters_are_compared_one_by_one() {
        let (lamp, window) = (DVec3::new(0.4, 0.7, 0.2).normalize(), DVec3::new(-0.9, 0.3, 0.1).normalize());
        let both = |lamp_rgb: [f32; 3]| {
            let mut both = env(256, lamp, 0.3);
            for at in 0..256 * 128 {
                let d = emitters::texel(&both, at).0;
                let rgb = if d.dot(lamp) > 0.998 { Some(lamp_rgb) } else { None };
                let rgb = if d.dot(window) > 0.99 { Some([8.0; 3]) } else { rgb };
                if let Some(rgb) = rgb {
                    both.image.samples[3 * at..3 * at + 3].copy_from_slice(&rgb);
                }
            }
            both
        };
        let (truth, found) = (both([200.0, 100.0, 50.0]), both([400.0, 200.0, 100.0]));
        let table = emitters_table(&found, &truth);
        let number = |row: usize, column: usize| {
            if let Cell::Number(value) = table.rows[row][column] { value } else { f64::NAN }
        };
        assert_eq!(table.rows.len(), 2);
        // The margin contains other light, which is equal in both.
        assert!((number(0, 2) - 1.0).abs() < 0.02 && number(0, 3) < 0.1, "{table:?}");
        assert!(number(1, 2).abs() < 1e-9 && number(1, 3) < 1e-6, "{table:?}");
        assert!(number(0, 6) > 0.0 && number(1, 6) < 0.0, "{table:?}");
    }

    /// Scores do not depend on the unit of light; if both lights are scaled, only the ratio of the factors matters.
    /// This test fails if `rest > 0.0` is changed to `rest > 1e-9` in `contrast`.
    #[test]
    fn scores_do_not_depend_on_the_unit_of_light() {
        let (a, b) = (DVec3::new(0.4, 0.7, 0.2).normalize(), DVec3::new(0.38, 0.7, 0.25).normalize());
        let scaled = |mut env: Environment, by: f32| {
            env.image.samples.iter_mut().for_each(|v| *v *= by);
            env
        };
        let at = |found: f32, truth: f32| {
            scores(scaled(env(128, a, 700.0), found), scaled(env(128, b, 900.0), truth))
        };
        let plain = at(1.0, 1.0);
        assert!(plain[3] < -0.1, "{plain:?}");
        for unit in [1e-30, 1e-12, 1e12, 1e30] {
            for (score, plain) in at(unit, unit).iter().zip(&plain) {
                assert!((score - plain).abs() < 1e-4 * (1.0 + plain.abs()), "{unit}: {score} {plain}");
            }
            assert!((at(unit, 1.0)[3] - plain[3]).abs() < 1e-5, "{unit}");
        }
    }

    /// The panorama is compared per texel at any size. This test fails if `cells` always has 256 columns.
    #[test]
    fn the_panorama_is_compared_texel_by_texel() {
        let mut truth = env(512, DVec3::Y, 0.3);
        let mut found = truth.clone();
        for (i, pixel) in found.image.samples.chunks_exact_mut(3).enumerate() {
            pixel.iter_mut().for_each(|v| *v *= if (i + i / 512).is_multiple_of(2) { 1.5 } else { 0.5 });
        }
        assert!((scores(found, truth.clone())[11] - 0.5).abs() < 1e-6);
        // Panoramas of different sizes are compared by the means over the texels of the coarser one.
        truth.image.samples.iter_mut().for_each(|v| *v *= 1.25);
        assert!((scores(truth, env(256, DVec3::Y, 0.3))[11] - 0.25).abs() < 1e-6);
    }

    /// A sky without a light has no dominant direction, at any resolution. This test fails if `STANDS_OUT` is 0.
    #[test]
    fn skies_without_a_light_have_no_direction() {
        let sky = |width| env(width, DVec3::Y, 0.3);
        for (a, b) in [(8, 128), (32, 256), (16, 16)] {
            for (i, score) in scores(sky(a), sky(b)).into_iter().enumerate() {
                assert!(
                    if i == 2 || i == 3 { score.is_nan() } else { score.abs() < 3e-3 },
                    "{a} {i}: {score}"
                );
            }
        }
    }

    #[test]
    fn darkness_has_no_scores_and_no_nan() {
        let dark = Environment { image: Image::new(16, 8, 3).into(), up: Up::PlusY, origin: None };
        let found = scores(dark.clone(), dark);
        assert!(found.iter().all(|s| s.is_nan()), "every score is missing: {found:?}");
    }
}

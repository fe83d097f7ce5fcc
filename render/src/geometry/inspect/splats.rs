//! Summary of a splat scene: its size, up axis and floor, and warnings about values that are implausible for a
//! capture.

use engine::{Context, NodeError};
use scene::math::num;
use scene::types::{SplatEncoding, Splats};
use serde::Serialize;

use super::{Extent, Finding, percentile};
use crate::geometry::level::{self, LevelEstimate};

/// Sizes of splats. Lengths are standard deviations, in world units.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Sizes {
    /// Median of the longest axes.
    pub median_longest: f64,
    /// 99th percentile of the longest axes.
    pub p99_longest: f64,
    /// The longest axis of all.
    pub longest: f64,
    /// Fraction of splats that are needles: their longest axis is more than 30 times as long as the middle axis.
    pub needles: f64,
    /// Fraction of splats that are flat: their shortest axis is less than a third of the middle axis.
    pub flat: f64,
}

/// Opacities, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Opacities {
    /// Median opacity.
    pub median: f64,
    /// Fraction of splats with an opacity below 1/255, which renderers do not draw.
    pub unseen: f64,
    /// Fraction of splats with an opacity above 0.95.
    pub opaque: f64,
}

/// Number of splats per pixel without occlusion, estimated from sizes and opacities. Splats end where their alpha
/// is 1/255.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Overdraw {
    /// Mean over all directions, seen from the median of the centres.
    pub from_inside: f64,
    /// Mean over the disc that the core covers when seen from far away.
    pub from_outside: f64,
}

/// Summary of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Number of splats that can be drawn.
    pub splats: usize,
    /// Degree of the spherical harmonics.
    pub sh_degree: u32,
    /// `srgb` or `linear`.
    pub encoding: &'static str,
    /// True if the file says that the splats were trained with compensation for a screen-space filter.
    pub antialiased: bool,
    /// Box around all centres. This and the other optional fields are `None` if there are no splats.
    pub bounds: Option<Extent>,
    /// Box around the middle 96 % of the centres along each axis.
    pub core: Option<Extent>,
    /// Median of the centres.
    pub centre: Option<[f64; 3]>,
    /// The up direction, the floor and the scale.
    pub level: Option<LevelEstimate>,
    /// Sizes of splats.
    pub sizes: Option<Sizes>,
    /// Opacities.
    pub opacities: Option<Opacities>,
    /// Estimated number of splats per pixel.
    pub overdraw: Option<Overdraw>,
    /// Warnings.
    pub findings: Vec<Finding>,
}

/// Returns the shortest, middle and longest standard deviation.
fn sorted(scale: [f32; 3]) -> [f64; 3] {
    let mut scale = scale.map(f64::from);
    scale.sort_by(f64::total_cmp);
    scale
}

/// Computes the summary of a scene. `splats` may lack the harmonics above degree 0, which are not used; `sh_degree`
/// is the degree of the harmonics of the scene.
pub fn inspect(splats: &Splats, sh_degree: u32, cx: &Context) -> Result<Inspection, NodeError> {
    let mut found = Inspection {
        splats: splats.len(),
        sh_degree,
        encoding: match splats.encoding {
            SplatEncoding::Srgb => "srgb",
            SplatEncoding::Linear => "linear",
        },
        antialiased: splats.antialiased,
        bounds: None,
        core: None,
        centre: None,
        level: None,
        sizes: None,
        opacities: None,
        overdraw: None,
        findings: Vec::new(),
    };
    if splats.is_empty() {
        found.findings.push(Finding { id: "no-splats", text: "no splats can be drawn".to_owned() });
        return Ok(found);
    }
    let columns = cx.for_each_tile(3, |axis| {
        let mut column: Vec<f32> = splats.means.iter().map(|mean| mean[axis]).collect();
        [0.0, 0.02, 0.5, 0.98, 1.0].map(|share| percentile(&mut column, share))
    })?;
    let along = |which: usize| [0, 1, 2].map(|axis| columns[axis][which]);
    let (bounds, core) = (Extent { min: along(0), max: along(4) }, Extent { min: along(1), max: along(3) });
    let centre = along(2);
    let sizes = sizes(splats);
    found.level = level::of_splats(splats, None);
    found.overdraw = Some(overdraw(splats, centre, &core));
    let share = |test: fn(&f32) -> bool| {
        splats.opacities.iter().filter(|o| test(o)).count() as f64 / splats.len() as f64
    };
    let opacities = Opacities {
        median: percentile(&mut splats.opacities.clone(), 0.5),
        unseen: share(|o| *o < 1.0 / 255.0),
        opaque: share(|o| *o > 0.95),
    };
    (found.bounds, found.core, found.centre) = (Some(bounds), Some(core), Some(centre));
    (found.sizes, found.opacities) = (Some(sizes), Some(opacities));
    found.findings = findings(&found, &bounds, &core, &sizes, &opacities);
    Ok(found)
}

fn sizes(splats: &Splats) -> Sizes {
    let mut longest: Vec<f32> = splats.scales.iter().map(|s| s[0].max(s[1]).max(s[2])).collect();
    let share = |test: fn([f64; 3]) -> bool| {
        splats.scales.iter().filter(|s| test(sorted(**s))).count() as f64 / splats.len() as f64
    };
    Sizes {
        median_longest: percentile(&mut longest, 0.5),
        p99_longest: percentile(&mut longest, 0.99),
        longest: percentile(&mut longest, 1.0),
        needles: share(|[_, middle, longest]| longest > 30.0 * middle),
        flat: share(|[shortest, middle, _]| shortest * 3.0 < middle),
    }
}

/// Radius at which the alpha of a splat is 1/255, in standard deviations; 0 if its alpha is lower everywhere.
fn reach(opacity: f32) -> f64 {
    let ratio = f64::from(opacity) * 255.0;
    if ratio > 1.0 { (2.0 * num::f64::ln(ratio)).sqrt() } else { 0.0 }
}

fn overdraw(splats: &Splats, centre: [f64; 3], core: &Extent) -> Overdraw {
    // Mean area of the projections of an ellipsoid: a quarter of its surface (Cauchy), by Thomsen's formula.
    const P: f64 = 1.6075;
    let (mut inside, mut outside) = (0.0, 0.0);
    for (i, scale) in splats.scales.iter().enumerate() {
        let [a, b, c] = scale.map(|s| num::pow(f64::from(s) * reach(splats.opacities[i]), P));
        let area = std::f64::consts::PI * num::pow((a * b + b * c + c * a) / 3.0, 1.0 / P);
        let mean = splats.means[i].map(f64::from);
        let distance: f64 = (0..3).map(|k| (mean[k] - centre[k]) * (mean[k] - centre[k])).sum();
        // A splat around the eye covers half of the view.
        let near = area / std::f64::consts::TAU;
        inside += if area > 0.0 { area / (distance + near) } else { 0.0 };
        let within = (0..3).all(|k| (core.min[k]..=core.max[k]).contains(&mean[k]));
        outside += if within { area } else { 0.0 };
    }
    let radius = core.diagonal() / 2.0;
    let disc = std::f64::consts::PI * radius * radius;
    Overdraw {
        from_inside: inside / (4.0 * std::f64::consts::PI),
        from_outside: if disc > 0.0 { outside / disc } else { 0.0 },
    }
}

fn findings(
    found: &Inspection,
    bounds: &Extent,
    core: &Extent,
    sizes: &Sizes,
    opacities: &Opacities,
) -> Vec<Finding> {
    let (all, middle) = (bounds.diagonal(), core.diagonal());
    let relative = sizes.median_longest / middle;
    let overdraw = found.overdraw.map_or(0.0, |o| o.from_inside.min(o.from_outside));
    let list = [
        (
            "scales-not-logarithms",
            // The size of splats relative to the scene is undefined if all lie at one point.
            middle > 0.0 && relative > 0.05,
            format!(
                "half of the splats are larger than {:.0} % of the size of the scene; the scales may have been exponentiated twice",
                relative * 100.0
            ),
        ),
        (
            "scales-tiny",
            middle > 0.0 && relative < 1e-6,
            format!(
                "half of the splats are smaller than {relative:.1e} times the size of the scene, so nothing would be visible"
            ),
        ),
        (
            "needles",
            sizes.needles > 0.05,
            format!("{:.0} % of the splats are needles, which appear as streaks", sizes.needles * 100.0),
        ),
        (
            "transparent",
            opacities.median < 0.08,
            format!(
                "half of the splats have an opacity below {:.3}; training may have failed, or the values may be logits",
                opacities.median
            ),
        ),
        (
            "unseen",
            opacities.unseen > 0.2,
            format!("{:.0} % of the splats are never drawn (opacity below 1/255)", opacities.unseen * 100.0),
        ),
        (
            "one-point",
            all > 0.0 && middle == 0.0,
            "nearly all splats are at one point; their centres may be damaged".to_owned(),
        ),
        (
            "far-splats",
            middle > 0.0 && all > 30.0 * middle,
            format!(
                "the bounding box of all splats is {:.0} times as large as the box around the middle 96 % of the centres along each axis",
                all / middle
            ),
        ),
        (
            "heavy-overdraw",
            overdraw > 1000.0,
            format!("about {overdraw:.0} splats overlap at each pixel, so rendering is slow"),
        ),
        (
            "floor-unclear",
            found.level.as_ref().is_none_or(|level| !level.is_sure()),
            "the up axis cannot be determined from the splats; look at the scene with `inspect --picture`"
                .to_owned(),
        ),
    ];
    list.into_iter().filter(|(_, holds, _)| *holds).map(|(id, _, text)| Finding { id, text }).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use crate::geometry::inspect::AXES;
    use testing::context;

    /// A floor of flat splats with walls around it and some dust above. Up is the direction `sign` along `axis`,
    /// and the height of the floor is -1.
    fn room(axis: usize, sign: f32) -> Splats {
        let mut splats = Splats::empty();
        let unit = |i: usize, k: usize| ((i * 7919 + k * 104_729) % 1009) as f32 / 1008.0 * 2.0 - 1.0;
        for i in 0..4000 {
            let (mut mean, mut scale) = ([unit(i, 1) * 4.0, unit(i, 2) * 4.0, unit(i, 3) * 4.0], [0.05; 3]);
            match i % 4 {
                0 | 1 => (mean[axis], scale[axis]) = (-sign, 0.001),
                2 => (mean[(axis + 1) % 3], scale[(axis + 1) % 3]) = (4.0 * unit(i, 9).signum(), 0.001),
                _ => mean[axis] = sign * (unit(i, 4) + 1.0),
            }
            if i % 4 == 2 {
                mean[axis] = sign * (unit(i, 5) * 1.5 + 0.5);
            }
            splats.means.push(mean);
            splats.scales.push(scale);
            splats.quats.push([1.0, 0.0, 0.0, 0.0]);
            splats.opacities.push(0.9);
            splats.sh.push([0.0; 3]);
        }
        splats
    }

    #[test]
    fn floors_are_found_along_every_axis() {
        for (axis, names) in AXES.iter().enumerate() {
            for (sign, name) in [(-1.0, names[0]), (1.0, names[1])] {
                let found = inspect(&room(axis, sign), 0, &context()).unwrap();
                let level = found.level.unwrap();
                assert_eq!(level.axis(), Some(name));
                assert!((level.floor + 1.0).abs() < 0.05 && level.is_floor_sure(), "{level:?}");
            }
        }
    }

    // In noise of any shape and any number of splats, the flat area in a plane does not exceed chance.
    #[test]
    fn no_floor_is_found_in_noise() {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        for (count, tries) in [(3, 40), (30, 40), (300, 40), (3000, 40), (30_000, 8)] {
            for attempt in 0..tries {
                let mut splats = Splats::empty();
                for _ in 0..count {
                    // A box, or a ball that is denser in the middle.
                    let mut sum = || (0..if attempt % 2 == 0 { 1 } else { 4 }).map(|_| next() - 0.5).sum();
                    splats.means.push([sum(), sum(), sum()]);
                    // Aligned with the axes, or random.
                    let aligned = attempt % 4 < 2;
                    splats.quats.push(if aligned { [1.0, 0.0, 0.0, 0.0] } else { [0; 4].map(|_| sum()) });
                    splats.scales.push([0; 3].map(|_| num::f64::exp(f64::from(next() * 4.0 - 6.0)) as f32));
                    splats.opacities.push(next());
                    splats.sh.push([0.0; 3]);
                }
                for quat in &mut splats.quats {
                    let length = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
                    *quat = quat.map(|q| q / length);
                }
                let found = inspect(&splats, 0, &context()).unwrap();
                let sure = found.level.as_ref().is_some_and(LevelEstimate::is_sure);
                assert!(!sure, "{count} splats, try {attempt}: {:?}", found.level);
                assert!(found.findings.iter().any(|finding| finding.id == "floor-unclear"));
            }
        }
    }

    #[test]
    fn overdraw_of_equal_spheres_is_exact() {
        // 100 spheres of radius r at distance d cover 100 pi r^2 / (4 pi d^2) of a panorama.
        let mut splats = room(0, 1.0);
        splats.means.iter_mut().enumerate().for_each(|(i, mean)| {
            *mean = [[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, -3.0, 0.0]][i % 4];
        });
        splats.scales = vec![[0.01; 3]; 4000];
        splats.opacities = vec![(num::f64::exp(0.5) / 255.0) as f32; 4000];
        let overdraw = inspect(&splats, 0, &context()).unwrap().overdraw.unwrap();
        // Reach is 1 standard deviation.
        let expected = 4000.0 * 0.01 * 0.01 / (4.0 * 9.0);
        assert!((overdraw.from_inside / expected - 1.0).abs() < 1e-3, "{overdraw:?} {expected}");
    }

    /// Sizes are not reported relative to a scene without extent. This test fails if the condition `middle > 0.0`
    /// before `relative > 0.05` is removed.
    #[test]
    fn scenes_without_extent_give_no_infinite_figures() {
        let reported = |change: fn(&mut Splats)| {
            let mut splats = room(2, 1.0);
            change(&mut splats);
            let found = inspect(&splats, 0, &context()).unwrap();
            found.findings.into_iter().map(|finding| finding.text).collect::<String>()
        };
        for text in [
            reported(|s| s.means.fill([1.0; 3])),
            reported(|s| s.means[10..].fill([1.0; 3])),
            reported(|s| {
                s.means.truncate(1);
                s.quats.truncate(1);
                s.scales.truncate(1);
                s.opacities.truncate(1);
                s.sh.truncate(1);
            }),
            reported(|s| s.scales.fill([0.0; 3])),
        ] {
            assert!(["inf", "NaN"].iter().all(|word| !text.contains(word)), "{text}");
        }
    }

    #[test]
    fn harm_is_found() {
        let ids = |change: fn(&mut Splats)| {
            let mut splats = room(2, 1.0);
            change(&mut splats);
            inspect(&splats, 0, &context()).unwrap().findings.iter().map(|f| f.id).collect::<Vec<_>>()
        };
        assert!(ids(|_| {}).is_empty());
        assert!(ids(|s| s.scales = vec![[2.0; 3]; 4000]).contains(&"scales-not-logarithms"));
        assert!(ids(|s| s.scales = vec![[1e-7; 3]; 4000]).contains(&"scales-tiny"));
        assert!(ids(|s| s.scales = vec![[0.5, 0.001, 0.001]; 4000]).contains(&"needles"));
        assert!(ids(|s| s.opacities = vec![0.01; 4000]).contains(&"transparent"));
        assert!(ids(|s| s.means[0] = [1e5, 0.0, 0.0]).contains(&"far-splats"));
        assert!(ids(|s| s.means[10..].fill([1.0; 3])).contains(&"one-point"));
        let mut none = room(0, 1.0);
        none.means.clear();
        assert_eq!(inspect(&none, 0, &context()).unwrap().findings[0].id, "no-splats");
    }
}

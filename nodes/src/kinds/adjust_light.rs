//! `adjust-light`: turns, dims or tints light.

use std::sync::Arc;

use engine::{Context, Cost, Kind, NodeError, Notes};
use render::light::emitters::{self, Emitters};
use render::light::measure::{angles_deg, luminance};
use render::light::regions;
use render::light::whole_sphere::turn_in_place;
use scene::math::equirect::direction;
use scene::math::num;
use scene::types::{Cell, Environment, Images, Report, Table};

engine::params! {
    /// Turns, dims or tints an environment of light, or one of its emitters.
    ///
    /// An emitter is a region at least as bright as white, such as a lamp, a window or a sun; the output `report` lists
    /// them. Choose one by `emitter` or `towards`; without both, all of the light is changed. The light of an emitter
    /// is what exceeds its surroundings, so an emitter that is switched off leaves the wall around it, and one that is
    /// turned takes its light along. To change several emitters, use one node after another.
    pub struct AdjustLight {
        /// Rotates the light about the up axis, counter-clockwise seen from above. An emitter is rotated by whole
        /// pixels.
        turn_deg: f64 = 0.0, range(-36000, 36000), unit("degrees"), other("90.0");
        /// Exposure of the light; 1 doubles it.
        stops: f64 = 0.0, range(-48, 48), unit("EV"), other("-1.0");
        /// Factors for red, green and blue, in linear Rec.709.
        tint: [f64; 3] = [1.0, 1.0, 1.0], range(0, 1e6), other("(1.0, 0.8, 0.5)");
        /// Index of the emitter in the table `emitters-before` of the report, which begins with 0, the strongest.
        emitter: Option<u32> = None, other("Some(0)"), inert("nothing is changed by default");
        /// Direction of the emitter: its azimuth, clockwise from forward seen from above, and its elevation above the
        /// horizon. A direction within 1.5 degrees of the emitter is sufficient.
        towards: Option<[f64; 2]> = None, range(-360, 360), unit("degrees"), other("Some((-90.0, 14.0))"), inert("nothing is changed by default");
    }
}
engine::inputs! {
    /// Inputs of [`AdjustLight`].
    pub struct In {
        /// The light.
        env: Arc<Environment>,
    }
}
engine::outputs! {
    /// Outputs of [`AdjustLight`].
    pub struct Out {
        /// The changed light, at the same point of capture.
        env: Arc<Environment>,
        /// The same light as a picture, for sinks and comparisons.
        image: Arc<Images>,
        /// The emitters before and after the change, and the sum of all light.
        report: Arc<Report>,
    }
}

impl Kind for AdjustLight {
    const NAME: &'static str = "adjust-light";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = In;
    type Out = Out;

    fn check(p: &Self) -> Result<(), NodeError> {
        if p.emitter.is_some() && p.towards.is_some() {
            return Err(NodeError::new("`emitter` and `towards` both choose an emitter")
                .at("towards")
                .hint("remove one of them"));
        }
        Ok(())
    }

    fn estimate(_: &Self, inputs: &In) -> Cost {
        // The new light, and for each texel an index and a direction of the search for emitters.
        Cost::of([
            (inputs.env.image.samples.len() as u64, 4),
            (inputs.env.image.samples.len() as u64 / 3, 32),
        ])
    }

    fn run(p: &Self, In { env }: In, cx: &Context) -> Result<(Out, Notes), NodeError> {
        Self::check(p)?;
        let before = emitters::find(&env);
        cx.check()?;
        let chosen = p.chosen(&before, &env)?;
        let mut light = Environment::clone(&env);
        let gain = p.tint.map(|tint| num::f64::exp2(p.stops) * tint);
        let mut notes = Notes::none();
        match chosen {
            None => {
                let width = light.image.width;
                turn_in_place(light.image.samples.as_chunks_mut::<3>().0, width, p.turn_deg, cx)?;
                if gain != [1.0; 3] {
                    for pixel in light.image.samples.as_chunks_mut::<3>().0 {
                        *pixel = [0, 1, 2].map(|c| (f64::from(pixel[c]) * gain[c]) as f32);
                    }
                }
            }
            Some(index) => p.adjust(index, &before, gain, &mut light, cx)?,
        }
        let capped = light.image.samples.iter().filter(|v| !v.is_finite()).count() as u64;
        light.image.samples.iter_mut().filter(|v| !v.is_finite()).for_each(|v| *v = f32::MAX);
        let what = "of the samples overflowed, and had to be clamped to the largest 32-bit float";
        notes.count("radiance-capped", capped, what);
        cx.check()?;
        let after = emitters::find(&light);
        let tables = vec![
            table("emitters", &after, &light),
            table("emitters-before", &before, &env),
            sums(before.total, after.total),
        ];
        let report = Report { title: "Light that was changed".to_owned(), tables };
        let image = light.image.pictures();
        Ok((Out { env: Arc::new(light), image, report: Arc::new(report) }, notes))
    }
}

impl AdjustLight {
    /// Index of the emitter to change; `None` for all of the light.
    fn chosen(&self, found: &Emitters, env: &Environment) -> Result<Option<usize>, NodeError> {
        let angles = |index: usize| {
            let (azimuth, elevation) = angles_deg(env.up, found.list[index].direction);
            format!("{index} at ({azimuth:.1}, {elevation:.1})")
        };
        let list = || match found.list.len() {
            0 => "the light has no emitter: nothing in it is as bright as white".to_owned(),
            count => {
                let all: Vec<String> = (0..count.min(12)).map(angles).collect();
                format!("the emitters, with azimuth and elevation, are {}", all.join(", "))
            }
        };
        if let Some(index) = self.emitter {
            if index as usize >= found.list.len() {
                let what = format!("there is no emitter {index}; {}", list());
                return Err(NodeError::new(what).at("emitter"));
            }
            return Ok(Some(index as usize));
        }
        let Some([azimuth, elevation]) = self.towards else { return Ok(None) };
        let towards = direction(
            env.up,
            (azimuth / 360.0 + 0.5).rem_euclid(1.0),
            (0.5 - elevation / 180.0).clamp(0.0, 1.0),
        );
        let at = found.at(env.up, towards).ok_or_else(|| {
            let what = format!("there is no emitter towards ({azimuth}, {elevation}); {}", list());
            NodeError::new(what).at("towards")
        })?;
        Ok(Some(at))
    }

    /// Changes the light of one emitter, which is what exceeds the mean of the ring around it.
    fn adjust(
        &self,
        index: usize,
        found: &Emitters,
        gain: [f64; 3],
        light: &mut Environment,
        cx: &Context,
    ) -> Result<(), NodeError> {
        let (width, height) = (light.image.width, light.image.height);
        let of = cx.for_each_tile(height, |y| {
            let at = |x: usize| found.at(light.up, emitters::texel(light, y * width + x).0);
            (0..width).map(at).collect::<Vec<_>>()
        })?;
        let of: Vec<Option<usize>> = of.concat();
        let own: Vec<usize> = (0..of.len()).filter(|&at| of[at] == Some(index)).collect();
        let steps = (RING_DEG * width as f64 / 360.0).ceil().max(1.0) as usize;
        let ring = regions::around(&own, (width, of.len()), steps);
        let (mut sum, mut weight) = ([0.0; 3], 0.0);
        for at in ring.into_iter().filter(|&at| of[at].is_none()) {
            let (_, solid_angle) = emitters::texel(light, at);
            weight += solid_angle;
            let rgb = emitters::radiance(light, at);
            sum.iter_mut().zip(rgb).for_each(|(sum, value)| *sum += value * solid_angle);
        }
        let fill = sum.map(|sum| if weight > 0.0 { sum / weight } else { 0.0 });
        let shift = (self.turn_deg / 360.0 * width as f64).round().rem_euclid(width as f64) as usize;
        // Removed everywhere before anything is added, since the emitter may move onto itself.
        let excess: Vec<[f64; 3]> = own
            .iter()
            .map(|&at| {
                let rgb = emitters::radiance(light, at);
                std::array::from_fn(|c| (rgb[c] - fill[c]).max(0.0))
            })
            .collect();
        if shift == 0 {
            // What is kept by a gain of 1 keeps its bits.
            for (&at, excess) in own.iter().zip(&excess) {
                let samples = &mut light.image.samples[3 * at..3 * at + 3];
                for ((sample, excess), gain) in samples.iter_mut().zip(excess).zip(gain) {
                    *sample = (f64::from(*sample) + excess * (gain - 1.0)) as f32;
                }
            }
            return Ok(());
        }
        let mut add = |at: usize, by: [f64; 3]| {
            for (c, by) in by.into_iter().enumerate() {
                let sample = &mut light.image.samples[3 * at + c];
                *sample = (f64::from(*sample) + by) as f32;
            }
        };
        own.iter().zip(&excess).for_each(|(&at, excess)| add(at, excess.map(|v| -v)));
        for (&at, excess) in own.iter().zip(&excess) {
            // Columns grow clockwise.
            let to = at / width * width + (at % width + width - shift) % width;
            add(to, [0, 1, 2].map(|c| excess[c] * gain[c]));
        }
        Ok(())
    }
}

/// Width of the ring around an emitter whose mean is the light of its surroundings, in degrees.
const RING_DEG: f64 = 1.5;

/// Table of the emitters, the strongest first.
fn table(name: &str, found: &Emitters, env: &Environment) -> Table {
    let all = luminance(found.total);
    let row = |(index, emitter): (usize, &emitters::Emitter)| {
        let (azimuth, elevation) = angles_deg(env.up, emitter.direction);
        let share = if all > 0.0 { Cell::Number(luminance(emitter.flux) / all) } else { Cell::Missing };
        let numbers = [azimuth, elevation, emitter.solid_angle];
        let mut row = vec![Cell::Count(index as u64)];
        row.extend(numbers.into_iter().chain(emitter.flux).map(Cell::Number));
        row.push(share);
        row
    };
    let columns =
        ["emitter", "azimuth (deg)", "elevation (deg)", "solid angle (sr)", "red", "green", "blue", "share"];
    Table::new(name, columns, found.list.iter().enumerate().map(row).collect())
}

/// Table of the integral of radiance over all directions, before and after.
fn sums(before: [f64; 3], after: [f64; 3]) -> Table {
    let row = |name: &str, sum: [f64; 3]| {
        let mut row = vec![Cell::Text(name.to_owned())];
        row.extend(sum.map(Cell::Number));
        row
    };
    Table::new(
        "all-light",
        ["light", "red", "green", "blue"],
        vec![row("before", before), row("after", after)],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use engine::Up;
    use glam::DVec3;
    use scene::types::Image;
    use testing::context;

    const WIDTH: usize = 256;

    /// A grey room with a warm lamp in front, 30 degrees up, and a cold one at the right, at the horizon.
    fn room() -> Environment {
        let mut env = Environment {
            image: Image::new(WIDTH, WIDTH / 2, 3).into(),
            up: Up::PlusZ,
            origin: Some(DVec3::X),
        };
        let lamps = [(0.0, 30.0, [60.0, 40.0, 20.0]), (90.0, 0.0, [4.0, 6.0, 9.0])];
        for at in 0..WIDTH * WIDTH / 2 {
            let (towards, _) = emitters::texel(&env, at);
            let lamp = lamps.iter().find(|(azimuth, elevation, _)| {
                direction(env.up, azimuth / 360.0 + 0.5, 0.5 - elevation / 180.0).dot(towards) > 0.998
            });
            let rgb = lamp.map_or([0.3, 0.3, 0.25], |(_, _, rgb)| *rgb);
            env.image.samples[3 * at..3 * at + 3].copy_from_slice(&rgb);
        }
        env
    }

    fn run(p: &AdjustLight, env: Environment) -> Out {
        AdjustLight::check(p).unwrap_or_else(|e| panic!("{e}"));
        AdjustLight::run(p, In { env: Arc::new(env) }, &context()).unwrap_or_else(|e| panic!("{e}")).0
    }

    fn near(a: [f64; 3], b: [f64; 3]) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs()), "{a:?}, not {b:?}");
    }

    #[test]
    fn nothing_changes_by_default() {
        let out = run(&AdjustLight::default(), room());
        assert_eq!(*out.env, room());
        for choice in [Some(0), Some(1)] {
            assert_eq!(*run(&AdjustLight { emitter: choice, ..AdjustLight::default() }, room()).env, room());
        }
    }

    /// The whole light is scaled and tinted, and a turn keeps its sum and moves its emitters.
    #[test]
    fn the_whole_light_is_scaled_and_turned() {
        let before = emitters::total(&room());
        let p = AdjustLight { stops: -1.5, tint: [1.0, 0.5, 2.0], turn_deg: 37.3, ..AdjustLight::default() };
        let out = run(&p, room());
        let factor = num::f64::exp2(-1.5);
        near(
            emitters::total(&out.env),
            [before[0] * factor, before[1] * factor * 0.5, before[2] * factor * 2.0],
        );
        assert_eq!((out.env.origin, out.env.up), (Some(DVec3::X), Up::PlusZ));
        let turned =
            emitters::find(&run(&AdjustLight { turn_deg: 37.3, ..AdjustLight::default() }, room()).env);
        let (azimuth, elevation) = angles_deg(Up::PlusZ, turned.list[0].direction);
        // Azimuths are clockwise.
        assert!((azimuth + 37.3).abs() < 0.3 && (elevation - 30.0).abs() < 0.7, "{azimuth}, {elevation}");
        assert_eq!(out.image.0[0].picture.samples(), &out.env.image.samples[..]);
    }

    /// One emitter is scaled by its excess over the wall: the sum changes by it, the rest of the light keeps its bits,
    /// and an emitter that is switched off leaves the wall. This test fails if the texels themselves are scaled.
    #[test]
    fn a_single_emitter_is_scaled_and_the_rest_is_kept() {
        let before = emitters::find(&room());
        let (original, wall) = (room(), [0.3_f32, 0.3, 0.25].map(f64::from));
        for (index, p) in [
            (
                0,
                AdjustLight {
                    emitter: Some(0),
                    stops: 1.0,
                    tint: [1.0, 0.5, 0.25],
                    ..AdjustLight::default()
                },
            ),
            (1, AdjustLight { towards: Some([90.4, 0.3]), stops: -48.0, ..AdjustLight::default() }),
        ] {
            let gain = p.tint.map(|tint| num::f64::exp2(p.stops) * tint);
            let out = run(&p, room());
            let lamp = &before.list[index];
            let wanted = std::array::from_fn(|c| {
                before.total[c] + (gain[c] - 1.0) * (lamp.flux[c] - wall[c] * lamp.solid_angle)
            });
            near(emitters::total(&out.env), wanted);
            let changed: Vec<usize> = (0..WIDTH * WIDTH / 2)
                .filter(|&at| emitters::radiance(&out.env, at) != emitters::radiance(&original, at))
                .collect();
            assert_eq!(changed, lamp.texels);
            if index == 1 {
                let off = emitters::radiance(&out.env, lamp.texels[0]);
                assert!(off.iter().zip(wall).all(|(a, b)| (a - b).abs() < 1e-6), "{off:?}");
                assert_eq!(emitters::find(&out.env).list.len(), 1);
            }
        }
    }

    /// A turned emitter takes its light along: the sum stays, its place becomes wall, and the report lists it at its new
    /// azimuth. A turn by one pixel moves it onto itself.
    #[test]
    fn a_single_emitter_is_turned_with_its_light() {
        for turn_deg in [-120.0, 360.0 / WIDTH as f64, 719.0] {
            let p = AdjustLight { emitter: Some(0), turn_deg, ..AdjustLight::default() };
            let out = run(&p, room());
            near(emitters::total(&out.env), emitters::total(&room()));
            let after = emitters::find(&out.env);
            assert_eq!(after.list.len(), 2);
            let (azimuth, elevation) = angles_deg(Up::PlusZ, after.list[0].direction);
            let off = (azimuth + turn_deg + 180.0).rem_euclid(360.0) - 180.0;
            assert!(off.abs() < 0.75 && (elevation - 30.0).abs() < 0.7, "{turn_deg}: {azimuth}, {elevation}");
            assert!((after.list[0].flux[0] / emitters::find(&room()).list[0].flux[0] - 1.0).abs() < 1e-5);
            let [now, before, _] = &out.report.tables[..] else { panic!("three tables") };
            assert_eq!((now.rows.len(), before.rows.len()), (2, 2));
            assert_eq!(now.rows[0][1], Cell::Number(azimuth));
        }
    }

    #[test]
    fn emitters_that_are_not_there_are_named() {
        let refused = |p: AdjustLight| {
            let run = AdjustLight::run(&p, In { env: Arc::new(room()) }, &context());
            run.err().map(|error| error.message().to_owned()).unwrap_or_default()
        };
        let text = refused(AdjustLight { emitter: Some(2), ..AdjustLight::default() });
        assert!(text.contains("no emitter 2; the emitters") && text.contains("1 at (90.0, "), "{text}");
        let text = refused(AdjustLight { towards: Some([180.0, 0.0]), ..AdjustLight::default() });
        assert!(text.contains("no emitter towards (180, 0)"), "{text}");
        let both = AdjustLight { emitter: Some(0), towards: Some([0.0; 2]), ..AdjustLight::default() };
        assert!(AdjustLight::check(&both).is_err());
    }
}

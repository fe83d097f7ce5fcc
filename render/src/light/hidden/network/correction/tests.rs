//! Tests of the maps and of the forward pass.

use scene::math::nn::Weights;
use scene::math::num;

use super::super::WEIGHTS;
use super::super::features::OVERVIEW;
use super::super::tests::scene;
use super::layers::Map;
use super::maps::CHANNELS;
use super::member::LAYERS;
use super::*;

fn correction() -> Correction {
    let weights = Weights::parse("w", WEIGHTS).expect("is sound");
    Correction::parse("w", &weights, OVERVIEW).expect("is sound").expect("is there")
}

fn numbers(count: usize, stream: u32) -> Vec<f32> {
    let number = |i: usize| {
        let [at, _] = crate::geometry::sampling::Points::new(stream, i as u32).bits(0);
        (f64::from(at) / 4_294_967_296.0 * 3.0 - 1.5) as f32
    };
    (0..count).map(number).collect()
}

/// Values of a layer of network `member` in float64: weights by input and output, and biases.
fn layer(member: usize, name: &str) -> (Vec<Vec<f64>>, Vec<f64>) {
    let weights = Weights::parse("w", WEIGHTS).expect("is sound");
    let of = |name: &str| weights.tensor(&format!("map.{name}")).expect("is there");
    let (shape, values) = of(&format!("{name}.weight"));
    let (inputs, outputs) = (shape[1], shape[2]);
    let weight = |i: usize, o: usize| f64::from(values[(member * inputs + i) * outputs + o]);
    let (_, bias) = of(&format!("{name}.bias"));
    (
        (0..inputs).map(|i| (0..outputs).map(|o| weight(i, o)).collect()).collect(),
        bias[member * outputs..][..outputs].iter().map(|v| f64::from(*v)).collect(),
    )
}

/// A map as a function of row, column and channel, in float64.
type Field = Vec<Vec<Vec<f64>>>;

fn leaky(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.1 * x }
}

fn affine(x: &[f64], (weight, bias): &(Vec<Vec<f64>>, Vec<f64>)) -> Vec<f64> {
    assert_eq!(x.len(), weight.len());
    (0..bias.len()).map(|o| bias[o] + x.iter().zip(weight).map(|(v, w)| v * w[o]).sum::<f64>()).collect()
}

fn each(field: &Field, f: impl Fn(usize, usize) -> Vec<f64>) -> Field {
    (0..field.len()).map(|y| (0..field[0].len()).map(|x| f(y, x)).collect()).collect()
}

fn convolution(field: &Field, layer: &(Vec<Vec<f64>>, Vec<f64>)) -> Field {
    let (height, width) = (field.len() as i64, field[0].len() as i64);
    let at = |y: i64, x: i64| {
        let (y, x) = match y {
            -1 => (0, x + width / 2),
            y if y == height => (height - 1, x + width / 2),
            y => (y, x),
        };
        &field[y as usize][x.rem_euclid(width) as usize]
    };
    each(field, |y, x| {
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx)));
        let inputs: Vec<f64> = around.flat_map(|(dy, dx)| at(y as i64 + dy, x as i64 + dx).clone()).collect();
        affine(&inputs, layer).into_iter().map(leaky).collect()
    })
}

fn sum(a: &Field, b: &Field) -> Field {
    each(a, |y, x| a[y][x].iter().zip(&b[y][x]).map(|(a, b)| a + b).collect())
}

fn half(field: &Field) -> Field {
    let smaller: Field = vec![vec![Vec::new(); field[0].len() / 2]; field.len() / 2];
    each(&smaller, |y, x| {
        let four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| &field[2 * y + i][2 * x + j]);
        (0..four[0].len()).map(|c| four.iter().map(|cell| cell[c]).sum::<f64>() / 4.0).collect()
    })
}

/// The forward pass of network `member` in float64: correction and scores.
fn reference(member: usize, map: &Map, overview: &[f32]) -> (f64, Vec<f64>) {
    let get = |name: &str| layer(member, name);
    let value = |y: usize, x: usize, c: usize| f64::from(map.values[(y * map.width + x) * map.channels + c]);
    let input: Field = (0..map.height)
        .map(|y| (0..map.width).map(|x| (0..map.channels).map(|c| value(y, x, c)).collect()).collect())
        .collect();
    let refined = |field: Field, name: &str| sum(&convolution(&field, &get(name)), &field);
    let x0 = convolution(&input, &get("a0"));
    let x1 = refined(convolution(&half(&x0), &get("a1")), "b1");
    let x2 = refined(convolution(&half(&x1), &get("a2")), "b2");
    let x3 = refined(convolution(&half(&x2), &get("a3")), "b3");
    let (rows, columns) = (x3.len(), x3[0].len());
    let height = |y: usize| num::f64::cos(std::f64::consts::PI * y as f64 / rows as f64);
    let size = |y: usize| (height(y) - height(y + 1)) / (2 * columns) as f64;
    let mean = |weight: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        let cells = || (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x)));
        let total: f64 = cells().map(|(y, x)| weight(y, x)).sum();
        let channel = |c: usize| cells().map(|(y, x)| weight(y, x) * x3[y][x][c]).sum::<f64>() / total;
        (0..x3[0][0].len()).map(channel).collect()
    };
    let mut inputs = mean(&|y, _| size(y));
    for head in 0..4 {
        inputs.extend(mean(&|y, x| size(y) * num::f64::exp(affine(&x3[y][x], &get("att"))[head])));
    }
    inputs.extend(overview.iter().map(|v| f64::from(*v)));
    let summary: Vec<f64> = affine(&inputs, &get("h1")).into_iter().map(leaky).collect();
    let raw = affine(&summary, &get("h2"))[0];
    let e = num::f64::exp(raw);
    let back = affine(&summary, &get("gl"));
    let x3 = each(&x3, |y, x| x3[y][x].iter().zip(&back).map(|(a, b)| a + b).collect());
    let merged = |coarse: &Field, fine: &Field, name: &str| {
        let layer = get(name);
        each(fine, |y, x| {
            let inputs = [coarse[y / 2][x / 2].as_slice(), fine[y][x].as_slice()].concat();
            affine(&inputs, &layer).into_iter().map(leaky).collect()
        })
    };
    let y2 = refined(merged(&x3, &x2, "u2"), "v2");
    let y1 = refined(merged(&y2, &x1, "u1"), "v1");
    let last = get("s");
    let scores = merged(&y1, &x0, "u0").iter().flatten().map(|cell| affine(cell, &last)[0]).collect();
    // 2 tanh(raw / 2).
    (2.0 * (e - 1.0) / (e + 1.0), scores)
}

/// The forward pass of the built-in networks agrees with a direct computation in float64.
#[test]
fn the_forward_pass_is_that_of_float64() {
    let map = Map { width: 64, height: 32, channels: CHANNELS, values: numbers(64 * 32 * CHANNELS, 5) };
    let overview = numbers(OVERVIEW, 6);
    for (i, member) in correction().members.iter().enumerate() {
        let (amount, scores) = reference(i, &map, &overview);
        let found = member.apply(&map, &overview);
        assert!((found.amount - amount).abs() < 1e-4, "{} {amount}", found.amount);
        assert_eq!(found.scores.len(), scores.len());
        let off =
            found.scores.iter().zip(&scores).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
        let spread = scores.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        assert!(off < 1e-4 * spread.max(1.0), "{off} of {spread}");
    }
}

/// Maps of a sky of 0.5 above a ground of 0.25 with a clipped square: radiances, irradiances and shares are as computed
/// by hand.
#[test]
fn maps_state_radiance_irradiance_and_what_is_clipped() {
    let scene = scene(|x, y| match (x, y) {
        (64..68, 40..44) => [1.0, 1.0, 0.5],
        (_, ..64) => [0.5; 3],
        _ => [0.25; 3],
    });
    let map = scene.maps.map();
    let of = |at: usize| &map.values[at * CHANNELS..][..CHANNELS];
    let log = |v: f64| num::f64::log2(v);
    let (zenith, nadir) = (of(0), of(31 * 64));
    let close = |found: f32, wanted: f64, within: f64| {
        assert!((f64::from(found) - wanted).abs() < within, "{found} {wanted}");
    };
    close(zenith[0], log(0.501) / 3.0 + 1.0, 1e-6);
    close(zenith[12], log(0.2501) / 2.0, 0.01);
    close(nadir[12], log(0.5001) / 2.0, 0.01);
    close(zenith[13], log(0.5001) / 2.0, 0.01);
    close(zenith[1], (log(0.501) - log(0.2501)) / 2.0, 0.01);
    close(nadir[2], (log(0.251) - log(0.5001)) / 2.0, 0.01);
    for (channel, wanted) in [(3, 0.0), (4, 0.0), (5, 0.0), (9, 1.0)] {
        close(zenith[channel], wanted, 1e-6);
    }
    close(zenith[10], num::f64::cos(std::f64::consts::PI / 64.0), 1e-3);
    close(nadir[11], num::f64::cos(std::f64::consts::PI / 64.0), 1e-3);
    // The square covers one cell of the maps and is not clipped in blue.
    let square = scene.maps.place(40 * 256 + 64);
    assert!((40..44).flat_map(|y| (64..68).map(move |x| y * 256 + x)).all(|at| {
        let place = scene.maps.place(at);
        place / 64 == square / 64 && (place + 64 - square) % 64 <= 1
    }));
    let clipped: f32 = (0..2048).map(|at| of(at)[5]).sum();
    let (red, blue): (f32, f32) = ((0..2048).map(|at| of(at)[7]).sum(), (0..2048).map(|at| of(at)[8]).sum());
    assert!(
        (clipped - 1.0).abs() < 0.05 && (red - clipped).abs() < 1e-6 && blue == 0.0,
        "{clipped} {red} {blue}"
    );
    assert!(of(square)[6] == 0.0, "not clipped in all channels");
}

/// The maps of a rotated panorama are the same, and those of a mirrored panorama are mirrored. This test fails if the maps
/// begin at the first column of the grid.
#[test]
fn maps_rotate_and_mirror_with_the_panorama() {
    let light = |x: usize, y: usize| match (x, y) {
        (200..204, 30..40) => [1.0; 3],
        _ => [0.2 + 0.002 * (x % 64) as f32, 0.3, 0.1 + 0.004 * (y as f32)],
    };
    let plain = scene(light);
    let rotated = scene(|x, y| light((x + 77) % 256, y));
    let mirrored = scene(|x, y| light(255 - x, y));
    let off = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    let values = |scene: &super::super::Scene| scene.maps.map().values.clone();
    assert!(off(&values(&plain), &values(&rotated)) < 1e-5);
    assert!(off(&values(&plain), &mirrored.maps.mirrored().map().values) < 1e-5);
    assert!(off(&values(&plain), &values(&mirrored)) > 0.1);
    let at = 35 * 256 + 202;
    assert_eq!(plain.maps.place(at), rotated.maps.place(35 * 256 + 125));
    assert_eq!(plain.maps.place(at), Maps::mirror(mirrored.maps.place(35 * 256 + 53)));
}

/// Weights of the largest f16 give finite shares and a correction within its limits.
#[test]
fn weights_of_any_size_give_finite_light() {
    let mut correction = correction();
    let largest = |(_, inputs, outputs): &(&str, usize, usize)| {
        (vec![65504.0; inputs * outputs], vec![-65504.0; *outputs])
    };
    correction.members = vec![Member::new(LAYERS.iter().map(largest).collect())];
    let scene = scene(|x, y| if x < 4 && y < 40 { [1.0; 3] } else { [0.5; 3] });
    let found = correction.apply(&[1e4; OVERVIEW], &scene.maps, &[0, 5, 2047], &[1.0, 2.0, 3.0]);
    assert!(found.amount.abs() <= 2.0, "{}", found.amount);
    assert!((found.shares[0].iter().sum::<f64>() - 1.0).abs() < 1e-12, "{:?}", found.shares);
}

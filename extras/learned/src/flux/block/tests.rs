//! Tests that compare both kinds of blocks with simple loops in f64. The heads have the same length as in the
//! published model.

use candle_core::{Device, Tensor};

use super::*;
use crate::flux::linear::Matrix;
use crate::flux::noise::normal;

const HEADS: usize = 2;
const HEAD: usize = 128;
const HIDDEN: usize = HEADS * HEAD;
const MLP: usize = 512;
const AXES: [usize; 3] = [16, 56, 56];
/// Places of two text tokens, followed by tokens of the new picture and tokens of the original picture. The picture
/// tokens are as far apart as in a picture of 1440 x 720.
const PLACES: [[f32; 3]; 7] =
    [[0.0; 3], [0.0; 3], [0.0; 3], [0.0, 44.0, 1.0], [0.0, 3.0, 89.0], [1.0, 44.0, 89.0], [1.0, 0.0, 45.0]];
const TEXTS: usize = 2;

type Rows = Vec<Vec<f64>>;

/// Returns `count` rows of `length` random numbers, which f32 can represent exactly.
fn rows(stream: u64, count: usize, length: usize, spread: f64) -> Rows {
    let value = |i: usize| f64::from((normal(5, stream, i as u64) * spread) as f32);
    (0..count).map(|row| (0..length).map(|column| value(row * length + column)).collect()).collect()
}

fn tensor(rows: &Rows) -> Tensor {
    let values: Vec<f32> = rows.iter().flatten().map(|v| *v as f32).collect();
    Tensor::from_vec(values, (rows.len(), rows[0].len()), &Device::Cpu).expect("sizes agree")
}

fn vector(row: &[f64]) -> Tensor {
    Tensor::new(row.iter().map(|v| *v as f32).collect::<Vec<_>>(), &Device::Cpu).expect("is a vector")
}

/// A linear layer in f64.
struct Layer {
    weight: Rows,
    bias: Vec<f64>,
}

impl Layer {
    fn new(stream: u64, rows_: usize, columns: usize) -> Self {
        let spread = 1.0 / (columns as f64).sqrt();
        Self {
            weight: rows(stream, rows_, columns, spread),
            bias: rows(stream + 500, 1, rows_, 0.3).remove(0),
        }
    }

    fn ours(&self) -> Linear {
        Linear::new("layer", Matrix::Plain(tensor(&self.weight)), vector(&self.bias))
    }

    fn apply(&self, x: &[f64]) -> Vec<f64> {
        let dot = |w: &Vec<f64>| w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
        self.weight.iter().zip(&self.bias).map(|(w, b)| dot(w) + b).collect()
    }
}

struct Scales {
    query: Vec<f64>,
    key: Vec<f64>,
}

impl Scales {
    fn new(stream: u64) -> Self {
        let mut two = rows(stream, 2, HEAD, 0.2);
        two.iter_mut().flatten().for_each(|v| *v = f64::from((*v + 1.0) as f32));
        Self { key: two.remove(1), query: two.remove(0) }
    }

    fn ours(&self) -> HeadNorm {
        HeadNorm { query: vector(&self.query), key: vector(&self.key) }
    }
}

fn modulated(x: &[f64], shift: &[f64], scale: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let variance = x.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    let normal = |v: f64| (v - mean) / (variance + 1e-6).sqrt();
    x.iter().zip(scale).zip(shift).map(|((v, scale), shift)| normal(*v) * (1.0 + scale) + shift).collect()
}

fn gelu(x: f64) -> f64 {
    0.5 * x * (1.0 + libm::tanh((2.0 / std::f64::consts::PI).sqrt() * (x + 0.044_715 * x * x * x)))
}

/// Normalizes a head and rotates it. Pair `i` of an axis is rotated by `place / 10000^(2i / width)` radians.
fn placed(x: &[f64], scale: &[f64], place: [f32; 3]) -> Vec<f64> {
    let square = x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64;
    let normal: Vec<f64> = x.iter().zip(scale).map(|(v, s)| v / (square + 1e-6).sqrt() * s).collect();
    let mut turned = Vec::new();
    for (coordinate, width) in place.iter().zip(AXES) {
        for i in 0..width / 2 {
            let angle = f64::from(*coordinate) / libm::pow(10_000.0, 2.0 * i as f64 / width as f64);
            let (sin, cos) = libm::sincos(angle);
            let at = turned.len();
            let (a, b) = (normal[at], normal[at + 1]);
            turned.extend([a * cos - b * sin, a * sin + b * cos]);
        }
    }
    turned
}

/// Attention from each token to all tokens. Each row of `qkv` contains the queries of all heads, then the keys,
/// then the values.
fn mixed(qkv: &Rows, norms: &[&Scales]) -> Rows {
    let mut out = vec![Vec::new(); qkv.len()];
    for head in 0..HEADS {
        let part = |token: usize, which: usize| &qkv[token][which * HIDDEN + head * HEAD..][..HEAD];
        let q: Rows = (0..qkv.len()).map(|t| placed(part(t, 0), &norms[t].query, PLACES[t])).collect();
        let k: Rows = (0..qkv.len()).map(|t| placed(part(t, 1), &norms[t].key, PLACES[t])).collect();
        for (token, out) in out.iter_mut().enumerate() {
            let score = |key: &Vec<f64>| key.iter().zip(&q[token]).map(|(a, b)| a * b).sum::<f64>();
            let powers: Vec<f64> = k.iter().map(|key| libm::exp(score(key) / (HEAD as f64).sqrt())).collect();
            let total: f64 = powers.iter().sum();
            let taken = |i: usize| (0..qkv.len()).map(|t| powers[t] / total * part(t, 2)[i]).sum::<f64>();
            out.extend((0..HEAD).map(taken));
        }
    }
    out
}

fn added(x: &[f64], gate: &[f64], more: &[f64]) -> Vec<f64> {
    x.iter().zip(gate).zip(more).map(|((x, gate), more)| x + gate * more).collect()
}

fn assert_close(ours: &Tensor, wanted: &[Vec<f64>]) {
    let ours = ours.to_vec2::<f32>().expect("is a matrix");
    let size = wanted.iter().flatten().fold(0.0_f64, |most, v| most.max(v.abs()));
    for (ours, wanted) in ours.iter().flatten().zip(wanted.iter().flatten()) {
        assert!((f64::from(*ours) - wanted).abs() < 2e-6 * size, "{ours} for {wanted} among {size}");
    }
}

#[test]
fn a_double_block_is_the_f64_one() -> Result<()> {
    struct Reference {
        modulation: Layer,
        qkv: Layer,
        norm: Scales,
        proj: Layer,
        mlp: [Layer; 2],
    }
    let reference = |stream: u64| Reference {
        modulation: Layer::new(stream, 6 * HIDDEN, HIDDEN),
        qkv: Layer::new(stream + 1, 3 * HIDDEN, HIDDEN),
        norm: Scales::new(stream + 2),
        proj: Layer::new(stream + 3, HIDDEN, HIDDEN),
        mlp: [Layer::new(stream + 4, MLP, HIDDEN), Layer::new(stream + 5, HIDDEN, MLP)],
    };
    let side = |r: &Reference| Side {
        modulation: r.modulation.ours(),
        qkv: r.qkv.ours(),
        norm: r.norm.ours(),
        proj: r.proj.ours(),
        mlp: [r.mlp[0].ours(), r.mlp[1].ours()],
    };
    let (txt, img) = (reference(10), reference(20));
    let mood = rows(1, 1, HIDDEN, 1.0).remove(0);
    let x = rows(2, PLACES.len(), HIDDEN, 1.0);
    let of = |token: usize| if token < TEXTS { &txt } else { &img };

    let wanted: Rows = {
        let m: Rows = (0..x.len()).map(|t| of(t).modulation.apply(&mood)).collect();
        let vector = |t: usize, i: usize| &m[t][i * HIDDEN..][..HIDDEN];
        let qkv: Rows =
            (0..x.len()).map(|t| of(t).qkv.apply(&modulated(&x[t], vector(t, 0), vector(t, 1)))).collect();
        let norms: Vec<&Scales> = (0..x.len()).map(|t| &of(t).norm).collect();
        let mixed = mixed(&qkv, &norms);
        let finish = |t: usize| {
            let r = of(t);
            let x = added(&x[t], vector(t, 2), &r.proj.apply(&mixed[t]));
            let inner = r.mlp[0].apply(&modulated(&x, vector(t, 3), vector(t, 4)));
            added(&x, vector(t, 5), &r.mlp[1].apply(&inner.into_iter().map(gelu).collect::<Vec<_>>()))
        };
        (0..x.len()).map(finish).collect()
    };
    let rotations = Rotations::new(&PLACES, AXES, &Device::Cpu)?;
    let shared = Shared { mood: vector(&mood).unsqueeze(0)?, rotations: &rotations, head: HEAD };
    let block = Double { img: side(&img), txt: side(&txt) };
    let (texts, picture) = x.split_at(TEXTS);
    let (texts, picture) =
        block.forward(&tensor(&texts.to_vec()), &tensor(&picture.to_vec()), &shared, &mut ())?;
    assert_close(&texts, &wanted[..TEXTS]);
    assert_close(&picture, &wanted[TEXTS..]);
    Ok(())
}

#[test]
fn a_single_block_is_the_f64_one() -> Result<()> {
    let modulation = Layer::new(30, 3 * HIDDEN, HIDDEN);
    let (inward, outward) = (Layer::new(31, 3 * HIDDEN + MLP, HIDDEN), Layer::new(32, HIDDEN, HIDDEN + MLP));
    let norm = Scales::new(33);
    let mood = rows(1, 1, HIDDEN, 1.0).remove(0);
    let x = rows(2, PLACES.len(), HIDDEN, 1.0);

    let wanted: Rows = {
        let m = modulation.apply(&mood);
        let vector = |i: usize| &m[i * HIDDEN..][..HIDDEN];
        let inner: Rows = x.iter().map(|x| inward.apply(&modulated(x, vector(0), vector(1)))).collect();
        let mixed = mixed(&inner, &[&norm; PLACES.len()]);
        let finish = |t: usize| {
            let bent = inner[t][3 * HIDDEN..].iter().map(|v| gelu(*v));
            added(&x[t], vector(2), &outward.apply(&mixed[t].iter().copied().chain(bent).collect::<Vec<_>>()))
        };
        (0..x.len()).map(finish).collect()
    };
    let rotations = Rotations::new(&PLACES, AXES, &Device::Cpu)?;
    let shared = Shared { mood: vector(&mood).unsqueeze(0)?, rotations: &rotations, head: HEAD };
    let block = Single {
        modulation: modulation.ours(),
        inward: inward.ours(),
        norm: norm.ours(),
        outward: outward.ours(),
    };
    assert_close(&block.forward(&tensor(&x), &shared, &mut ())?, &wanted);
    Ok(())
}

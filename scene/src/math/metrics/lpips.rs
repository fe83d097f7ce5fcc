//! LPIPS, the learned perceptual distance (Zhang et al. 2018), with weights that the user supplies.

use engine::{Context, NodeError};

use super::plane::Plane;
use crate::error::Error;
use crate::math::nn::{Conv, Tensor, Weights, max_pool, relu};

/// AlexNet or VGG16 up to its last convolution, and the weights of its five layers of features.
///
/// Tensor names are those of torchvision and the `lpips` package (`features.0.weight`, `lin0.model.1.weight`), or
/// short names (AlexNet `conv0` to `conv4`, VGG `s0.conv0` to `s4.conv2`, `lin0.weight`). There may be fewer
/// channels than in the published networks.
pub struct Lpips {
    /// Stages of convolutions, separated by pooling.
    stages: Vec<Stage>,
    /// Window size and stride of the pooling, in pixels.
    pool: (usize, usize),
}

struct Stage {
    pooled: bool,
    convs: Vec<Conv>,
    /// Non-negative weight of each channel of the features that the last convolution of the stage computes.
    heads: Vec<f32>,
}

impl Lpips {
    /// Reads the weights. The names of the tensors determine which network it is. `file` is the name of the file
    /// for messages.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Self, Error> {
        let weights = Weights::parse(file, bytes)?;
        let vgg = weights.has("s0.conv0.weight") || weights.has("features.2.weight");
        // For each convolution: torchvision's index, ours, stride and padding; for each stage: pooled before.
        type Layer = (usize, &'static str, usize, usize);
        let layout: [(bool, &[Layer]); 5] = if vgg {
            [
                (false, &[(0, "s0.conv0", 1, 1), (2, "s0.conv1", 1, 1)]),
                (true, &[(5, "s1.conv0", 1, 1), (7, "s1.conv1", 1, 1)]),
                (true, &[(10, "s2.conv0", 1, 1), (12, "s2.conv1", 1, 1), (14, "s2.conv2", 1, 1)]),
                (true, &[(17, "s3.conv0", 1, 1), (19, "s3.conv1", 1, 1), (21, "s3.conv2", 1, 1)]),
                (true, &[(24, "s4.conv0", 1, 1), (26, "s4.conv1", 1, 1), (28, "s4.conv2", 1, 1)]),
            ]
        } else {
            [
                (false, &[(0, "conv0", 4, 2)]),
                (true, &[(3, "conv1", 1, 2)]),
                (true, &[(6, "conv2", 1, 1)]),
                (false, &[(8, "conv3", 1, 1)]),
                (false, &[(10, "conv4", 1, 1)]),
            ]
        };
        let mut inputs = 3;
        let mut stages = Vec::new();
        for (k, (pooled, layers)) in layout.into_iter().enumerate() {
            let mut convs = Vec::new();
            for (index, name, stride, padding) in layers {
                let published = format!("features.{index}");
                let published_is_there = weights.has(&format!("{published}.weight"));
                let name = if published_is_there { &published } else { *name };
                let conv = weights.conv(name, Some(inputs), *stride, *padding)?;
                inputs = conv.shape[0];
                convs.push(conv);
            }
            let published = format!("lin{k}.model.1.weight");
            let name = if weights.has(&published) { published } else { format!("lin{k}.weight") };
            let (shape, heads) = weights.tensor(&name)?;
            if heads.len() != inputs {
                let what =
                    format!("tensor `{name}` has shape {shape:?}, but the layer has {inputs} channels");
                return Err(Error::format(file, what));
            }
            stages.push(Stage { pooled, convs, heads });
        }
        Ok(Self { stages, pool: if vgg { (2, 2) } else { (3, 2) } })
    }

    /// The distance between two display-encoded pictures (0 to 1, three channels) of equal size. `None` if they are
    /// too small for the network. `scaled` maps the input to -1..1 as the network expects; the code of 3D Gaussian
    /// splatting does not do so, and reports smaller numbers.
    pub fn distance(
        &self,
        a: &Plane,
        b: &Plane,
        scaled: bool,
        cx: &Context,
    ) -> Result<Option<f64>, NodeError> {
        let (mut a, mut b) = (input(a, scaled), input(b, scaled));
        let mut distance = 0.0;
        for stage in &self.stages {
            for tensor in [&mut a, &mut b] {
                if stage.pooled {
                    *tensor = max_pool(tensor, self.pool.0, self.pool.1);
                }
                for conv in &stage.convs {
                    *tensor = conv.apply(tensor, cx)?;
                    relu(tensor);
                }
            }
            if a.data.is_empty() {
                return Ok(None);
            }
            distance += layer(&a, &b, &stage.heads);
        }
        Ok(Some(distance))
    }
}

/// Converts a picture to the input of the network, normalised like the pictures with which the network was trained.
fn input(plane: &Plane, scaled: bool) -> Tensor {
    const SHIFT: [f64; 3] = [-0.030, -0.088, -0.188];
    const SCALE: [f64; 3] = [0.458, 0.448, 0.450];
    let mut tensor = Tensor::new(3, plane.height, plane.width);
    let count = plane.height * plane.width;
    for (i, pixel) in plane.samples.chunks_exact(plane.channels).enumerate() {
        for c in 0..3 {
            let v = if scaled { pixel[c] * 2.0 - 1.0 } else { pixel[c] };
            tensor.data[c * count + i] = ((v - SHIFT[c]) / SCALE[c]) as f32;
        }
    }
    tensor
}

/// The mean over pixels of the weighted squared difference of features, where the features of each pixel are scaled
/// to length 1.
fn layer(a: &Tensor, b: &Tensor, heads: &[f32]) -> f64 {
    let count = a.height * a.width;
    let length = |t: &Tensor, i: usize| {
        let squares = (0..t.channels).map(|c| f64::from(t.data[c * count + i]));
        squares.fold(0.0, |sum, v| sum + v * v).sqrt() + 1e-10
    };
    let mut sum = 0.0;
    for i in 0..count {
        let (la, lb) = (length(a, i), length(b, i));
        for (c, weight) in heads.iter().enumerate() {
            let d = f64::from(a.data[c * count + i]) / la - f64::from(b.data[c * count + i]) / lb;
            sum += f64::from(*weight) * d * d;
        }
    }
    sum / count as f64
}

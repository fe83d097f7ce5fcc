//! Reading and writing of weights files.

use std::path::Path;

use crate::exposure::{Network, Scale};
use half::f16;
use safetensors::tensor::{Dtype, TensorView, serialize};
use scene::error::Error;
use scene::math::nn::Weights;

use super::ridge::Ridge;

/// Names of the tensors of a network, in order.
pub(super) const TENSORS: [&str; 5] =
    ["score.linear", "score.cell", "score.overview", "score.bias", "score.out"];

fn write(tensors: &[(String, Vec<usize>, Vec<u8>)], dtype: Dtype) -> Result<Vec<u8>, Error> {
    let fail = |error| Error::Mismatch(format!("cannot encode the weights: {error}"));
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| Ok((name.as_str(), TensorView::new(dtype, shape.clone(), bytes)?)))
        .collect::<Result<Vec<_>, _>>()
        .map_err(fail)?;
    serialize(views, None).map_err(fail)
}

/// Bytes of a weights file in f16: models of the total hidden light and of its colour, and a set of networks.
pub(super) fn file(
    scales: &[Scale; 3],
    (amount, colour): (&Ridge, &[Ridge; 2]),
    members: &[Network],
    residual: f32,
) -> Result<Vec<u8>, Error> {
    let halves =
        |values: &[f32]| values.iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect::<Vec<u8>>();
    let mut tensors = vec![
        ("residual".to_owned(), vec![1], halves(&[residual])),
        ("amount.linear".to_owned(), vec![amount.weight.len()], halves(&amount.weight)),
        ("amount.bias".to_owned(), vec![1], halves(&[amount.bias])),
    ];
    let of_colour: Vec<f32> = colour.iter().flat_map(|map| map.weight.iter().copied()).collect();
    tensors.push(("colour.linear".to_owned(), vec![2, of_colour.len() / 2], halves(&of_colour)));
    tensors.push(("colour.bias".to_owned(), vec![2], halves(&colour.each_ref().map(|map| map.bias))));
    for (name, scale) in ["overview", "cell", "colour"].into_iter().zip(scales) {
        // The smallest standard deviation is one that f16 can represent.
        let spread: Vec<f32> = scale.spread.iter().map(|v| v.max(1e-4)).collect();
        tensors.push((format!("{name}.mean"), vec![scale.mean.len()], halves(&scale.mean)));
        tensors.push((format!("{name}.spread"), vec![spread.len()], halves(&spread)));
    }
    for (k, name) in TENSORS.into_iter().enumerate() {
        let mut shape = vec![members.len()];
        shape.extend(members.first().map(|m| m.tensors[k].1.clone()).unwrap_or_default());
        let values: Vec<f32> = members.iter().flat_map(|m| m.tensors[k].2.iter().copied()).collect();
        tensors.push((name.to_owned(), shape, halves(&values)));
    }
    write(&tensors, Dtype::F16)
}

/// Stores one network without rounding.
pub(super) fn write_part(path: &Path, network: &Network) -> Result<(), Error> {
    let tensors: Vec<_> = network
        .tensors
        .iter()
        .map(|(name, shape, values)| {
            ((*name).to_owned(), shape.clone(), values.iter().flat_map(|v| v.to_le_bytes()).collect())
        })
        .collect();
    let bytes = write(&tensors, Dtype::F32)?;
    let fail = |error: std::io::Error| {
        Error::format(path.display().to_string(), format!("cannot be written: {error}"))
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(fail)?;
    }
    // Renamed when complete, so that a partial file is never read as a network.
    let temporary = path.with_extension("partial");
    std::fs::write(&temporary, bytes).and_then(|()| std::fs::rename(&temporary, path)).map_err(fail)
}

/// Reads a stored network. `None` if there is no such file.
pub(super) fn read_part(path: &Path) -> Option<Network> {
    let bytes = std::fs::read(path).ok()?;
    let name = path.display().to_string();
    let weights = Weights::parse(&name, &bytes).ok()?;
    let tensor = |name: &'static str| weights.tensor(name).ok().map(|(shape, values)| (name, shape, values));
    Some(Network { tensors: TENSORS.into_iter().map(tensor).collect::<Option<_>>()? })
}

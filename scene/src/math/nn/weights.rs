//! Weights of networks, from safetensors files.

use half::{bf16, f16};
use safetensors::{Dtype, SafeTensors};

use super::conv::Conv;
use crate::error::Error;

/// The tensors of one file.
pub struct Weights<'a> {
    file: &'a str,
    tensors: SafeTensors<'a>,
}

impl<'a> Weights<'a> {
    /// Reads the header. `file` is the name of the file for messages.
    pub fn parse(file: &'a str, bytes: &'a [u8]) -> Result<Self, Error> {
        let tensors = SafeTensors::deserialize(bytes)
            .map_err(|error| Error::format(file, format!("the file is not valid safetensors: {error}")))?;
        Ok(Self { file, tensors })
    }

    /// True if a tensor with this name exists.
    pub fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// Returns the shape and the values of a tensor. f16 and bf16 are converted to f32, which is exact.
    pub fn tensor(&self, name: &str) -> Result<(Vec<usize>, Vec<f32>), Error> {
        let wrong = |what: String| Error::format(self.file, format!("tensor `{name}` {what}"));
        let view = self.tensors.tensor(name).map_err(|_| wrong("is missing".to_owned()))?;
        let bytes = view.data();
        let values: Vec<f32> = match view.dtype() {
            Dtype::F32 => bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
            Dtype::F16 => bytes.as_chunks().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect(),
            Dtype::BF16 => bytes.as_chunks().0.iter().map(|b| bf16::from_le_bytes(*b).to_f32()).collect(),
            other => return Err(wrong(format!("has the type {other:?}; F32, F16 and BF16 are supported"))),
        };
        if let Some(at) = values.iter().position(|v| !v.is_finite()) {
            return Err(wrong(format!("contains {} at index {at}", values[at])));
        }
        Ok((view.shape().to_vec(), values))
    }

    /// Reads a convolution from the tensors `name.weight` and, if it exists, `name.bias`. The weights must have
    /// four axes and, if `inputs` is given, this number of input channels.
    pub fn conv(
        &self,
        name: &str,
        inputs: Option<usize>,
        stride: usize,
        padding: usize,
    ) -> Result<Conv, Error> {
        let weight_name = format!("{name}.weight");
        let (shape, weight) = self.tensor(&weight_name)?;
        let wrong = |what: String| {
            Error::format(self.file, format!("tensor `{weight_name}` has shape {shape:?}{what}"))
        };
        let shape: [usize; 4] = shape.clone().try_into().map_err(|_| wrong(", not four axes".to_owned()))?;
        if shape.contains(&0) || inputs.is_some_and(|inputs| inputs != shape[1]) {
            let wanted = inputs.map_or(String::new(), |n| format!(" with {n} input channels"));
            return Err(wrong(format!("; a convolution{wanted} is expected")));
        }
        let bias_name = format!("{name}.bias");
        let bias = if self.has(&bias_name) { self.tensor(&bias_name)?.1 } else { Vec::new() };
        if !bias.is_empty() && bias.len() != shape[0] {
            let what = format!(
                "tensor `{bias_name}` has {} values, but `{weight_name}` has {} output channels",
                bias.len(),
                shape[0]
            );
            return Err(Error::format(self.file, what));
        }
        Ok(Conv { shape, weight, bias, stride, padding })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use safetensors::tensor::{TensorView, serialize};

    fn file(dtype: Dtype, shape: Vec<usize>, data: &[u8]) -> Vec<u8> {
        let view = TensorView::new(dtype, shape, data).expect("sound");
        serialize([("a.weight", view)], None).expect("serializes")
    }

    #[test]
    fn every_width_is_read_and_what_is_wrong_is_named() {
        let halves: Vec<u8> = [1.5, -0.25].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
        let bytes = file(Dtype::F16, vec![2, 1, 1, 1], &halves);
        let weights = Weights::parse("w", &bytes).expect("parses");
        let conv = weights.conv("a", Some(1), 1, 0).expect("is one");
        assert_eq!((conv.shape, conv.weight, conv.bias), ([2, 1, 1, 1], vec![1.5, -0.25], vec![]));
        let message = |result: Result<Conv, Error>| result.map(|_| ()).expect_err("is wrong").to_string();
        assert_eq!(message(weights.conv("b", None, 1, 0)), "`w`: tensor `b.weight` is missing");
        let what =
            "`w`: tensor `a.weight` has shape [2, 1, 1, 1]; a convolution with 3 input channels is expected";
        assert_eq!(message(weights.conv("a", Some(3), 1, 0)), what);
        let bytes = file(Dtype::F32, vec![1], &f32::NAN.to_le_bytes());
        let weights = Weights::parse("w", &bytes).expect("parses");
        assert_eq!(message(weights.conv("a", None, 1, 0)), "`w`: tensor `a.weight` contains NaN at index 0");
        let bytes = file(Dtype::U8, vec![4], &[0; 4]);
        let weights = Weights::parse("w", &bytes).expect("parses");
        assert!(message(weights.conv("a", None, 1, 0)).contains("U8"));
        for cut in 0..bytes.len() {
            assert!(Weights::parse("w", &bytes[..cut]).is_err());
        }
    }
}

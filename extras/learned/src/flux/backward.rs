//! Gradients of the loss with respect to the low-rank updates, computed one block at a time.
//!
//! The forward pass keeps only the input of each block, and the backward pass computes each block again. So memory
//! is needed only for the intermediate values of one block at a time, and for the gradients of the frozen weights
//! of that block, which the tensor library always computes. For the whole model, these gradients would take 48 GB.

use std::collections::HashMap;

use candle_core::backprop::GradStore;
use candle_core::{Tensor, TensorId, Var};

use super::block::Shared;
use super::error::Result;
use super::prompt::Prompt;
use super::rope::Place;
use super::transformer::{Begun, Transformer};
use super::watch::Watch;

/// Inputs of the transformer.
pub struct Given<'a> {
    /// Tokens; see [`Transformer::forward`].
    pub tokens: &'a Tensor,
    /// Places of the tokens; see [`Transformer::forward`].
    pub places: &'a [Place],
    /// Encoded prompt.
    pub prompt: &'a Prompt,
    /// Noise level of the new picture: 1 for pure noise, 0 for no noise.
    pub time: f32,
    /// Strength with which the model follows the prompt.
    pub guidance: f32,
}

impl Transformer {
    /// Returns the loss and its gradients with respect to `vars`. `loss` computes the loss, a single number, from
    /// the predicted velocity. All `vars` must belong to updates of layers in blocks.
    pub fn gradients(
        &self,
        given: &Given<'_>,
        vars: &[Var],
        loss: &dyn Fn(&Tensor) -> Result<Tensor>,
        watch: &mut dyn Watch,
    ) -> Result<(f32, Vec<Option<Tensor>>)> {
        let Given { tokens, places, prompt, time, guidance } = *given;
        let Begun { rotations, mood, txt, img } =
            self.begin(tokens, places, prompt, time, guidance, watch)?;
        let shared = Shared { mood: mood.detach(), rotations: &rotations, head: self.config().head() };

        let mut pairs = vec![(txt.detach(), img.detach())];
        for block in &self.doubles {
            watch.check()?;
            let (txt, img) = &pairs[pairs.len() - 1];
            let (txt, img) = block.forward(txt, img, &shared, watch)?;
            pairs.push((txt.detach(), img.detach()));
        }
        let Some((txt, img)) = pairs.pop() else { unreachable!("`pairs` is not empty") };
        let (texts, pictures) = (txt.dim(0)?, img.dim(0)?);
        let mut wholes = vec![Tensor::cat(&[&txt, &img], 0)?];
        for block in &self.singles {
            watch.check()?;
            wholes.push(block.forward(&wholes[wholes.len() - 1], &shared, watch)?.detach());
        }

        let mut found = Gradients { vars, of: HashMap::new() };
        let Some(last) = wholes.pop() else { unreachable!("`wholes` is not empty") };
        let last = Var::from_tensor(&last)?;
        let lost = loss(&self.end(&last.narrow(0, texts, pictures)?, &shared, watch)?)?;
        let mut way = found.gradient(&last, &lost.backward()?)?;
        for (block, whole) in self.singles.iter().zip(&wholes).rev() {
            watch.check()?;
            let whole = Var::from_tensor(whole)?;
            let grads = back(&[(&block.forward(&whole, &shared, watch)?, &way)])?;
            found.take(&grads)?;
            way = found.gradient(&whole, &grads)?;
        }
        let (mut txt_way, mut img_way) = (way.narrow(0, 0, texts)?, way.narrow(0, texts, pictures)?);
        for (block, (txt, img)) in self.doubles.iter().zip(&pairs).rev() {
            watch.check()?;
            let (txt, img) = (Var::from_tensor(txt)?, Var::from_tensor(img)?);
            let (new_txt, new_img) = block.forward(&txt, &img, &shared, watch)?;
            let grads = back(&[(&new_txt, &txt_way), (&new_img, &img_way)])?;
            found.take(&grads)?;
            (txt_way, img_way) = (found.gradient(&txt, &grads)?, found.gradient(&img, &grads)?);
        }
        let gradients = vars.iter().map(|var| found.of.remove(&var.id())).collect();
        Ok((lost.to_scalar()?, gradients))
    }
}

/// Computes the gradients of the loss with respect to the inputs and variables of a block. `outputs` pairs each
/// output of the block with the gradient of the loss with respect to this output.
fn back(outputs: &[(&Tensor, &Tensor)]) -> Result<GradStore> {
    let mut sum = Tensor::zeros((), outputs[0].0.dtype(), outputs[0].0.device())?;
    for (output, gradient) in outputs {
        sum = (sum + (*output * *gradient)?.sum_all()?)?;
    }
    Ok(sum.backward()?)
}

/// Gradients of variables, collected from all blocks.
struct Gradients<'a> {
    vars: &'a [Var],
    of: HashMap<TensorId, Tensor>,
}

impl Gradients<'_> {
    fn take(&mut self, grads: &GradStore) -> Result<()> {
        for var in self.vars {
            if let Some(gradient) = grads.get(var) {
                // Without `detach`, the gradient would keep the values inside its block alive.
                self.of.insert(var.id(), gradient.detach());
            }
        }
        Ok(())
    }

    /// The gradient of the loss with respect to an input of a block; zeros if the block does not read this input.
    fn gradient(&self, input: &Var, grads: &GradStore) -> Result<Tensor> {
        Ok(match grads.get(input) {
            Some(gradient) => gradient.detach(),
            None => input.zeros_like()?,
        })
    }
}

//! The two kinds of blocks of which the transformer consists.

use candle_core::{DType, Tensor};

use super::attention::{MAX_SCORES, attention};
use super::config::Config;
use super::error::Result;
use super::linear::Linear;
use super::loader::Loader;
use super::norm::{modulated, root_mean_square};
use super::rope::Rotations;
use super::watch::Watch;

/// The inputs that are the same for all blocks.
pub struct Shared<'a> {
    /// Conditioning vector, of shape 1 x hidden: the silu of the sum of the embeddings of noise level, guidance and
    /// text.
    pub mood: Tensor,
    /// Rotations of all tokens. The text tokens come first.
    pub rotations: &'a Rotations,
    /// Number of channels of a head.
    pub head: usize,
}

/// Applies `layer` to the conditioning vector and splits the result into `N` vectors of equal length.
pub(crate) fn modulation<const N: usize>(layer: &Linear, mood: &Tensor) -> Result<[Tensor; N]> {
    let all = layer.forward(mood)?;
    let width = all.dim(1)? / N;
    let mut parts = Vec::new();
    for i in 0..N {
        parts.push(all.narrow(1, i * width, width)?);
    }
    Ok(parts.try_into().unwrap_or_else(|_| unreachable!("the vector has N parts")))
}

/// Scales of the norms that are applied to the queries and keys of each head.
struct HeadNorm {
    query: Tensor,
    key: Tensor,
}

impl HeadNorm {
    fn load(loader: &mut Loader<'_>, name: &str, head: usize) -> Result<Self> {
        Ok(Self {
            query: loader.scale(&format!("{name}.query_norm"), head)?,
            key: loader.scale(&format!("{name}.key_norm"), head)?,
        })
    }

    /// Splits `qkv`, of shape tokens x (3 * hidden), into queries, keys and values, each of shape heads x tokens x
    /// head. Then normalizes the queries and keys.
    fn split(&self, qkv: &Tensor, head: usize) -> Result<[Tensor; 3]> {
        let (tokens, width) = qkv.dims2()?;
        let apart = qkv.reshape((tokens, 3, width / 3 / head, head))?.permute((1, 2, 0, 3))?.contiguous()?;
        let part = |i: usize| apart.narrow(0, i, 1)?.squeeze(0);
        let query = root_mean_square(&part(0)?, &self.query)?;
        let key = root_mean_square(&part(1)?, &self.key)?;
        Ok([query, key, part(2)?])
    }
}

/// The weights of a [`Double`] for its text tokens or for its picture tokens.
struct Side {
    modulation: Linear,
    qkv: Linear,
    norm: HeadNorm,
    proj: Linear,
    mlp: [Linear; 2],
}

impl Side {
    fn load(loader: &mut Loader<'_>, config: &Config, name: &str) -> Result<Self> {
        let hidden = config.hidden;
        Ok(Self {
            modulation: loader.linear(&format!("{name}_mod.lin"), 6 * hidden, hidden)?,
            qkv: loader.linear(&format!("{name}_attn.qkv"), 3 * hidden, hidden)?,
            norm: HeadNorm::load(loader, &format!("{name}_attn.norm"), config.head())?,
            proj: loader.linear(&format!("{name}_attn.proj"), hidden, hidden)?,
            mlp: [
                loader.linear(&format!("{name}_mlp.0"), config.mlp, hidden)?,
                loader.linear(&format!("{name}_mlp.2"), hidden, config.mlp)?,
            ],
        })
    }

    fn linears(&mut self) -> impl Iterator<Item = &mut Linear> {
        [&mut self.modulation, &mut self.qkv, &mut self.proj].into_iter().chain(&mut self.mlp)
    }

    /// Applies the layers that follow attention.
    fn finish(&self, x: &Tensor, mixed: &Tensor, m: &[Tensor; 6]) -> Result<Tensor> {
        let x = (x + self.proj.forward(mixed)?.broadcast_mul(&m[2])?)?;
        let inner = self.mlp[0].forward(&modulated(&x, &m[4], &m[3])?)?.gelu()?;
        Ok((&x + self.mlp[1].forward(&inner)?.broadcast_mul(&m[5])?)?)
    }
}

/// A block in which text and picture have separate weights, but attend to each other.
pub struct Double {
    img: Side,
    txt: Side,
}

impl Double {
    /// Loads the block with index `index`.
    pub fn load(loader: &mut Loader<'_>, config: &Config, index: usize) -> Result<Self> {
        let side = |loader: &mut Loader<'_>, side: &str| {
            Side::load(loader, config, &format!("double_blocks.{index}.{side}"))
        };
        Ok(Self { img: side(loader, "img")?, txt: side(loader, "txt")? })
    }

    /// All linear layers of the block.
    pub fn linears(&mut self) -> impl Iterator<Item = &mut Linear> {
        self.img.linears().chain(self.txt.linears())
    }

    /// Applies the block. Returns the new text tokens and picture tokens, each of shape tokens x hidden.
    pub fn forward(
        &self,
        txt: &Tensor,
        img: &Tensor,
        shared: &Shared<'_>,
        watch: &mut dyn Watch,
    ) -> Result<(Tensor, Tensor)> {
        let texts = txt.dim(0)?;
        let [tm, im] = [
            modulation::<6>(&self.txt.modulation, &shared.mood)?,
            modulation(&self.img.modulation, &shared.mood)?,
        ];
        let inward = |side: &Side, x: &Tensor, m: &[Tensor; 6]| {
            side.norm.split(&side.qkv.forward(&modulated(x, &m[1], &m[0])?)?, shared.head)
        };
        let (t, i) = (inward(&self.txt, txt, &tm)?, inward(&self.img, img, &im)?);
        let both = |part: usize| Tensor::cat(&[&t[part], &i[part]], 1);
        let (q, k) = (shared.rotations.turn(&both(0)?)?, shared.rotations.turn(&both(1)?)?);
        let mixed = attention(&q, &k, &both(2)?, MAX_SCORES, watch)?;
        let txt = self.txt.finish(txt, &mixed.narrow(0, 0, texts)?, &tm)?;
        let img = self.img.finish(img, &mixed.narrow(0, texts, img.dim(0)?)?, &im)?;
        Ok((txt, img))
    }
}

/// A block in which text and picture form one sequence, and in which attention and the perceptron read the same
/// input.
pub struct Single {
    modulation: Linear,
    inward: Linear,
    norm: HeadNorm,
    outward: Linear,
}

impl Single {
    /// Loads the block with index `index`.
    pub fn load(loader: &mut Loader<'_>, config: &Config, index: usize) -> Result<Self> {
        let name = |part: &str| format!("single_blocks.{index}.{part}");
        let Config { hidden, mlp, .. } = *config;
        Ok(Self {
            modulation: loader.linear(&name("modulation.lin"), 3 * hidden, hidden)?,
            inward: loader.linear(&name("linear1"), 3 * hidden + mlp, hidden)?,
            norm: HeadNorm::load(loader, &name("norm"), config.head())?,
            outward: loader.linear(&name("linear2"), hidden, hidden + mlp)?,
        })
    }

    /// All linear layers of the block.
    pub fn linears(&mut self) -> impl Iterator<Item = &mut Linear> {
        [&mut self.modulation, &mut self.inward, &mut self.outward].into_iter()
    }

    /// Applies the block. Returns the new sequence, of shape tokens x hidden.
    pub fn forward(&self, x: &Tensor, shared: &Shared<'_>, watch: &mut dyn Watch) -> Result<Tensor> {
        let hidden = x.dim(1)?;
        let [shift, scale, gate] = modulation(&self.modulation, &shared.mood)?;
        let inner = self.inward.forward(&modulated(x, &scale, &shift)?)?;
        let [q, k, v] = self.norm.split(&inner.narrow(1, 0, 3 * hidden)?, shared.head)?;
        let (q, k) = (shared.rotations.turn(&q)?, shared.rotations.turn(&k)?);
        let mixed = attention(&q, &k, &v, MAX_SCORES, watch)?;
        let bent = inner.narrow(1, 3 * hidden, inner.dim(1)? - 3 * hidden)?.contiguous()?.gelu()?;
        let out = self.outward.forward(&Tensor::cat(&[mixed, bent], 1)?)?;
        Ok((x + out.broadcast_mul(&gate)?)?)
    }
}

/// The activation function silu. It is computed in f32, and the result has the type of the input.
pub(crate) fn silu(x: &Tensor) -> Result<Tensor> {
    Ok(x.to_dtype(DType::F32)?.silu()?.to_dtype(x.dtype())?)
}

#[cfg(test)]
mod tests;

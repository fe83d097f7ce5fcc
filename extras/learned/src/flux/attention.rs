//! Attention between all tokens. It is computed for one block of queries at a time.

use candle_core::{D, Tensor};

use super::error::Result;
use super::norm::wide;
use super::watch::Watch;

/// Maximum number of attention scores in memory at once, summed over all heads: 134 MB in f32. For a picture of
/// 1440 x 720, all scores together would take 7 GB.
pub const MAX_SCORES: usize = 1 << 25;

/// Attention of the queries `q` to the keys `k` and values `v`, each of shape heads x tokens x head, where `head`
/// is the number of channels per head. The result has the shape tokens x (heads * head). Scores are computed in
/// f32, or in f64 for f64 input.
pub fn attention(
    q: &Tensor,
    k: &Tensor,
    v: &Tensor,
    max_scores: usize,
    watch: &mut dyn Watch,
) -> Result<Tensor> {
    let (heads, tokens, head) = q.dims3()?;
    let scale = 1.0 / (head as f64).sqrt();
    let keys = k.transpose(1, 2)?.contiguous()?;
    let values = v.contiguous()?;
    let rows = (max_scores / (heads * keys.dim(2)?)).clamp(1, tokens);
    let mut parts = Vec::new();
    for start in (0..tokens).step_by(rows) {
        watch.check()?;
        let block = (q.narrow(1, start, rows.min(tokens - start))?.contiguous()? * scale)?;
        let scores = block.matmul(&keys)?.to_dtype(wide(q.dtype()))?;
        parts.push(softmax(&scores)?.to_dtype(values.dtype())?.matmul(&values)?);
    }
    let mixed = if parts.len() == 1 { parts.remove(0) } else { Tensor::cat(&parts, 1)? };
    Ok(mixed.transpose(0, 1)?.reshape((tokens, heads * head))?)
}

/// Softmax along the last axis.
fn softmax(scores: &Tensor) -> Result<Tensor> {
    // Shifting by any constant changes nothing, so the shift has no gradient.
    let most = scores.max_keepdim(D::Minus1)?.detach();
    let powers = scores.broadcast_sub(&most)?.exp()?;
    Ok(powers.broadcast_div(&powers.sum_keepdim(D::Minus1)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flux::noise::normals;
    use candle_core::Device;

    #[test]
    fn blocks_of_any_size_give_the_same() -> Result<()> {
        let [q, k, v] = [0, 1, 2].map(|stream| normals(3, stream, (2, 37, 8), &Device::Cpu));
        let (q, k, v) = (q?, k?, v?);
        let whole = attention(&q, &k, &v, MAX_SCORES, &mut ())?;
        for max_scores in [1, 2 * 37, 2 * 37 * 5, 2 * 37 * 36] {
            let parts = attention(&q, &k, &v, max_scores, &mut ())?;
            let difference = (&whole - &parts)?.abs()?.max_all()?.to_scalar::<f32>()?;
            assert!(difference < 1e-6, "{max_scores}: {difference}");
        }
        // If all keys are equal, each token receives the mean of the values.
        let mean = v.mean_keepdim(1)?.broadcast_as((2, 37, 8))?.transpose(0, 1)?.reshape((37, 16))?;
        let equal = attention(&q, &k.zeros_like()?, &v, 200, &mut ())?;
        assert!((mean - equal)?.abs()?.max_all()?.to_scalar::<f32>()? < 1e-6);
        Ok(())
    }
}

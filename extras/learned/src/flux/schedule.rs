//! Noise levels of the steps of an edit.

/// The `steps + 1` noise levels of an edit, from 1 down to 0: `steps` evenly spaced levels from 1 to `1 / steps`,
/// shifted towards 1, and then 0. The shift increases with the number of tokens of the new picture, `tokens`. The
/// formula is from Esser et al. 2024, with the constants of Flux.1: a shift of e^0.5 at 256 tokens and e^1.15 at
/// 4096.
pub fn noise_levels(steps: usize, tokens: usize) -> Vec<f32> {
    let slope = (1.15 - 0.5) / (4096.0 - 256.0);
    let shift = libm::exp(0.5 + (tokens as f64 - 256.0) * slope);
    let level = |step: usize| {
        let even = 1.0 - step as f64 / steps as f64;
        (shift / (shift + 1.0 / even - 1.0)) as f32
    };
    (0..steps).map(level).chain([0.0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_fall_from_one_to_zero_and_more_tokens_keep_more_noise() {
        for tokens in [32, 4050] {
            let levels = noise_levels(28, tokens);
            assert_eq!((levels.len(), levels[0], levels[28]), (29, 1.0, 0.0));
            assert!(levels.windows(2).all(|pair| pair[0] > pair[1]));
        }
        let halfway = |tokens| noise_levels(2, tokens)[1];
        assert!(halfway(4096) > halfway(256));
        // At 256 tokens and a level of 1/2 the formula is e^0.5 / (e^0.5 + 1).
        assert!((halfway(256) - 0.622_459_3).abs() < 1e-6);
    }
}

//! Fireflies: single pixels that one improbable path makes far too bright.
//!
//! A path that reaches a sun by way of an object may give a pixel many times the light of its surroundings. Such
//! paths are rare: one pixel among hundreds receives the light that should be spread over all of these pixels.
//! Averaging over the surrounding pixels does not dilute this light enough. It would leave a bright patch in a thin
//! shadow, and the large variance of the pixel would make everything near it appear similar.

use super::means::Field;

/// Minimum ratio of the brightness of a firefly to the brightness of each pixel around it.
const BRIGHTER: f32 = 2.0;
/// Minimum ratio of the variance of a firefly to the mean variance of the pixels around it. The ratio of a real
/// highlight is smaller, since the highlight appears in every chunk of samples.
const LESS_SURE: f32 = 16.0;

impl Field {
    /// Replaces the light of fireflies, and its variance, with the mean of the pixels around them. `least` is
    /// the signal below which a pixel is not a firefly; `relight` sets the values of a pixel from its new
    /// signal. Returns the number of fireflies.
    pub fn quench(&mut self, least: f32, relight: impl Fn(&mut [f32], [f32; 3])) -> u64 {
        let found: Vec<_> = (0..self.pixels.len())
            .filter_map(|i| self.around_firefly(i, least).map(|(signal, variance)| (i, signal, variance)))
            .collect();
        for &(i, signal, variance) in &found {
            let pixel = &mut self.pixels[i];
            (pixel.signal, pixel.variance) = (signal, variance);
            relight(&mut pixel.values, signal);
        }
        found.len() as u64
    }

    /// The mean signal and variance of the pixels around a firefly; `None` for other pixels.
    fn around_firefly(&self, at: usize, least: f32) -> Option<([f32; 3], f32)> {
        let pixel = &self.pixels[at];
        let bright = |signal: &[f32; 3]| signal.iter().sum::<f32>() / 3.0;
        if !pixel.there || bright(&pixel.signal) <= least {
            return None;
        }
        let (x, y) = (at % self.width, at / self.width);
        let (mut signal, mut variance, mut highest, mut count) = ([0.0; 3], 0.0, 0.0_f32, 0.0);
        for j in y.saturating_sub(1)..=(y + 1).min(self.height - 1) {
            for i in x.saturating_sub(1)..=(x + 1).min(self.width - 1) {
                let other = &self.pixels[j * self.width + i];
                if other.there && (i, j) != (x, y) {
                    (0..3).for_each(|k| signal[k] += other.signal[k]);
                    variance += other.variance;
                    highest = highest.max(bright(&other.signal));
                    count += 1.0;
                }
            }
        }
        let alone = count > 0.0
            && bright(&pixel.signal) > BRIGHTER * highest
            && pixel.variance * count > LESS_SURE * variance;
        alone.then(|| (signal.map(|sum| sum / count), variance / count))
    }
}

//! Reference for the non-local means of `denoise`, in float64 and pixel by pixel (Rousselle, Knaus and
//! Zwicker 2012).

use glam::DVec3;
use scene::math::num;

use super::references::luminance;

/// Outputs of `path-trace` for one view, with interleaved channels.
pub struct Layers {
    pub width: usize,
    pub without: Vec<f64>,
    pub with: Vec<f64>,
    pub object: Vec<f64>,
    pub depth: Vec<f64>,
    pub normal: Vec<f64>,
    pub variance: Vec<f64>,
}

#[derive(Clone)]
struct Pixel {
    signal: [f64; 3],
    variance: f64,
    /// Reported variance of the pixel, and the variance up to which a neighbour is averaged with full weight.
    doubt: [f64; 2],
    /// The values that are averaged.
    values: [f64; 6],
    there: bool,
    normal: DVec3,
}

struct Field<'l> {
    layers: &'l Layers,
    pixels: Vec<Pixel>,
}

impl Layers {
    fn nearness(&self, i: usize) -> f64 {
        if self.depth[i] > 0.0 { 1.0 / self.depth[i] } else { 0.0 }
    }

    /// Denoises `without`, `with` and `object`, and returns their samples, concatenated.
    pub fn averaged(&self) -> Vec<f64> {
        let lit = self.receiver();
        let [mut without, mut with, mut object] = [&self.without, &self.with, &self.object].map(Clone::clone);
        for (i, values) in lit.averages(7, 0.7, 0.5).into_iter().enumerate() {
            if lit.pixels[i].there {
                without[3 * i..3 * i + 3].copy_from_slice(&values[..3]);
                with[3 * i..3 * i + 3].copy_from_slice(&values[3..]);
            }
        }
        let inserted = self.inserted();
        for (i, values) in inserted.averages(4, 0.5, 0.05).into_iter().enumerate() {
            let pixel = &inserted.pixels[i];
            if pixel.there && pixel.variance > 0.0 {
                (0..3).for_each(|k| object[4 * i + k] = values[k] * pixel.values[3] / values[3]);
            }
        }
        [without, with, object].concat()
    }

    /// Pixels of the receiver, after the removal of fireflies. They are compared by the ratio `with` / `without`
    /// and the variance of this ratio.
    fn receiver(&self) -> Field<'_> {
        let pixel = |i: usize| {
            let (r0, r1) = (&self.without[3 * i..3 * i + 3], &self.with[3 * i..3 * i + 3]);
            Pixel {
                signal: [0, 1, 2].map(|k| if r0[k] > 0.0 { (r1[k] / r0[k]).clamp(0.0, 8.0) } else { 1.0 }),
                variance: self.variance[4 * i + 3],
                doubt: [0.0, f64::INFINITY],
                values: [r0[0], r0[1], r0[2], r1[0], r1[1], r1[2]],
                there: self.nearness(i) > 0.0 && luminance(r0) > 0.0,
                normal: if self.object[4 * i + 3] > 0.0 { DVec3::ZERO } else { self.normal(i) },
            }
        };
        let raw = Field { layers: self, pixels: (0..self.depth.len()).map(pixel).collect() };
        let mut field = Field { layers: self, pixels: raw.pixels.clone() };
        let bright = |pixel: &Pixel| pixel.signal.iter().sum::<f64>() / 3.0;
        for (i, pixel) in field.pixels.iter_mut().enumerate() {
            let near: Vec<&Pixel> = raw.around(i, 1).filter(|j| *j != i).map(|j| &raw.pixels[j]).collect();
            let near: Vec<&Pixel> = near.into_iter().filter(|other| other.there).collect();
            let (count, noise) = (near.len() as f64, near.iter().map(|other| other.variance).sum::<f64>());
            let highest = near.iter().map(|other| bright(other)).fold(0.0, f64::max);
            let alone = bright(pixel) > f64::max(1.0, 2.0 * highest) && pixel.variance * count > 16.0 * noise;
            if pixel.there && count > 0.0 && alone {
                pixel.signal =
                    [0, 1, 2].map(|k| near.iter().map(|other| other.signal[k]).sum::<f64>() / count);
                pixel.variance = noise / count;
                (0..3).for_each(|k| pixel.values[3 + k] = pixel.values[k] * pixel.signal[k]);
            }
        }
        field.smoothed(3)
    }

    /// Pixels of the object. They are compared by colour, scaled by a power of 2 so that the mean is between 1 and
    /// 2.
    fn inserted(&self) -> Field<'_> {
        let pixels = self.object.chunks_exact(4);
        let [light, cover] = pixels
            .filter(|o| o[3] > 0.0)
            .fold([0.0; 2], |[light, cover], o| [light + luminance(&o[..3]), cover + o[3]]);
        let exposure = num::f64::exp2(-num::f64::log2(light / cover).floor());
        let pixel = |(i, o): (usize, &[f64])| Pixel {
            signal: [0, 1, 2].map(|k| if o[3] > 0.0 { o[k] / o[3] * exposure } else { 0.0 }),
            variance: if o[3] > 0.0 {
                self.variance[4 * i + 2] / (o[3] * o[3]) * exposure * exposure
            } else {
                0.0
            },
            values: [o[0], o[1], o[2], o[3], 0.0, 0.0],
            doubt: [0.0; 2],
            there: o[3] > 0.0,
            normal: self.normal(i),
        };
        let pixels = self.object.chunks_exact(4).enumerate().map(pixel).collect();
        Field { layers: self, pixels }.doubted().smoothed(1)
    }

    fn normal(&self, i: usize) -> DVec3 {
        DVec3::from_slice(&self.normal[3 * i..3 * i + 3])
    }
}

impl Field<'_> {
    /// Indices of the pixels that are at most `reach` columns and at most `reach` rows away from the pixel `i`, row
    /// by row.
    fn around(&self, i: usize, reach: usize) -> impl Iterator<Item = usize> {
        let (width, height) = (self.layers.width, self.pixels.len() / self.layers.width);
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
        (y.saturating_sub(reach)..(y + reach + 1).min(height))
            .flat_map(move |row| columns.clone().map(move |column| row * width + column))
    }

    /// Computes the variance up to which the neighbours of each pixel are averaged with full weight. It is 16 times
    /// the mean of the variances of the pixel and its eight neighbours, after the largest of these variances is
    /// left out.
    fn doubted(mut self) -> Self {
        for i in 0..self.pixels.len() {
            let near = self.around(i, 1).filter(|j| self.pixels[*j].there);
            let mut near: Vec<f64> = near.map(|j| self.pixels[j].variance).collect();
            near.sort_by(f64::total_cmp);
            near.pop();
            let mean = near.iter().sum::<f64>() / near.len().max(1) as f64;
            self.pixels[i].doubt = [self.pixels[i].variance, 16.0 * mean];
        }
        self
    }

    /// Replaces the variance of each pixel with the mean of the variances within `reach` of the pixel, or with a
    /// tenth of its own variance if that is larger.
    fn smoothed(mut self, reach: usize) -> Self {
        let mean = |i: usize| {
            let near: Vec<f64> = self
                .around(i, reach)
                .filter(|j| self.pixels[*j].there)
                .map(|j| self.pixels[j].variance)
                .collect();
            near.iter().sum::<f64>() / near.len().max(1) as f64
        };
        let smooth: Vec<f64> = (0..self.pixels.len()).map(mean).collect();
        for (pixel, mean) in self.pixels.iter_mut().zip(smooth) {
            pixel.variance = mean.max(0.1 * pixel.variance);
        }
        self
    }

    /// Change of the inverse depth per column or per row at a pixel. If the changes to both neighbours have the
    /// same sign, this is the smaller of the two, otherwise 0.
    fn slope(&self, i: usize, step: usize, before: bool, after: bool) -> f64 {
        if !(before && after) {
            return 0.0;
        }
        let near = |i: usize| self.layers.nearness(i);
        let (a, b) = (near(i) - near(i - step), near(i + step) - near(i));
        if a * b <= 0.0 {
            0.0
        } else if a.abs() < b.abs() {
            a
        } else {
            b
        }
    }

    /// Mean squared difference of the signals of two pixels, minus the part that is expected from noise, divided by
    /// the variance of the noise.
    fn apart(&self, p: &Pixel, q: &Pixel, strength: f64) -> f64 {
        let square =
            (0..3).map(|k| (p.signal[k] - q.signal[k]) * (p.signal[k] - q.signal[k])).sum::<f64>() / 3.0;
        (square - p.variance - p.variance.min(q.variance))
            / (1e-8 + strength * strength * (p.variance + q.variance))
    }

    fn averages(&self, reach: usize, strength: f64, bend: f64) -> Vec<[f64; 6]> {
        let (width, height) = (self.layers.width, self.pixels.len() / self.layers.width);
        let place = |i: usize| [(i % width) as i64, (i / width) as i64];
        let at = |x: i64, y: i64| {
            let inside = (0..width as i64).contains(&x) && (0..height as i64).contains(&y);
            inside.then(|| &self.pixels[y as usize * width + x as usize]).filter(|pixel| pixel.there)
        };
        let average = |i: usize| {
            let p = &self.pixels[i];
            if !p.there || p.variance <= 0.0 {
                return p.values;
            }
            let [x, y] = place(i);
            let columns = self.slope(i, 1, x > 0, x + 1 < width as i64);
            let rows = self.slope(i, width, y > 0, y + 1 < height as i64);
            let (mut sums, mut total) = ([0.0; 6], 0.0);
            for j in self.around(i, reach) {
                let q = &self.pixels[j];
                if !q.there {
                    continue;
                }
                let [dx, dy] = [place(j)[0] - x, place(j)[1] - y];
                let patch = (-2..=2).flat_map(|b| (-2..=2).map(move |a| (x + a, y + b)));
                let pairs = patch.filter_map(|(x, y)| at(x, y).zip(at(x + dx, y + dy)));
                let distance = pairs.map(|(p, q)| self.apart(p, q, strength)).sum::<f64>() / 25.0;
                let alike = (1.0 - 0.25 * distance).clamp(0.0, 1.0);
                let mut weight = alike * alike * alike * alike;
                if p.normal != DVec3::ZERO && q.normal != DVec3::ZERO {
                    let [near, other] = [i, j].map(|i| self.layers.nearness(i));
                    let off = (other - near - columns * dx as f64 - rows * dy as f64).abs();
                    let level = 1.0 - off / (0.05 * near.max(other));
                    weight *=
                        (1.0 - (1.0 - p.normal.dot(q.normal)) / bend).clamp(0.0, 1.0) * level.clamp(0.0, 1.0);
                }
                let [one, other] = [(p, q), (q, p)].map(|(p, q)| p.doubt[1] / q.doubt[0].max(1e-30));
                weight *= one.min(other).min(1.0);
                let weight = if i == j { 1.0 } else { weight };
                total += weight;
                sums.iter_mut().zip(q.values).for_each(|(sum, value)| *sum += weight * value);
            }
            sums.map(|sum| sum / total)
        };
        (0..self.pixels.len()).map(average).collect()
    }
}

//! Shares of objects in a pixel.

/// Shares of the objects in a pixel, by index, in rising order of the indices. They need not sum to 1.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Shares(Vec<(u32, f64)>);

impl Shares {
    /// Shares with the given weights, whose indices may be in any order and repeat.
    pub(super) fn of(weights: impl IntoIterator<Item = (u32, f64)>) -> Self {
        let mut shares = Self::default();
        weights.into_iter().for_each(|(index, weight)| shares.add(index, weight));
        shares
    }

    fn add(&mut self, index: u32, weight: f64) {
        match self.0.binary_search_by_key(&index, |(known, _)| *known) {
            Ok(at) => self.0[at].1 += weight,
            Err(at) => self.0.insert(at, (index, weight)),
        }
    }

    /// True if no sample shows an object.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn sum(&self) -> f64 {
        self.0.iter().map(|(_, weight)| weight).sum()
    }

    /// Pairs of index and coverage, scaled to the sum `alpha`, by falling coverage and then by index.
    pub(super) fn ranked(&self, alpha: f64) -> Vec<(u32, f32)> {
        let sum = self.sum();
        let scaled = |(index, weight): &(u32, f64)| (*index, (weight / sum * alpha) as f32);
        let mut pairs: Vec<_> = self.0.iter().map(scaled).filter(|(_, coverage)| *coverage > 0.0).collect();
        pairs.sort_by(|(a, first), (b, second)| second.total_cmp(first).then(a.cmp(b)));
        pairs
    }
}

/// Gives each pixel without shares for which `wanted` holds the mean of the shares of the nearest pixels, step by step
/// from neighbour to neighbour. Returns the number of these pixels, and of those that no pixel with shares is connected
/// to.
pub(super) fn spread(shares: &mut [Shares], width: usize, wanted: impl Fn(usize) -> bool) -> [u64; 2] {
    let is_open = |pixel: &usize| shares[*pixel].is_empty() && wanted(*pixel);
    let mut open: Vec<usize> = (0..shares.len()).filter(is_open).collect();
    let mut taken = 0;
    loop {
        let found: Vec<_> = open.iter().map(|pixel| around(shares, width, *pixel)).collect();
        let before = taken;
        let mut rest = Vec::new();
        for (pixel, found) in open.into_iter().zip(found) {
            if found.is_empty() {
                rest.push(pixel);
            } else {
                shares[pixel] = found;
                taken += 1;
            }
        }
        if taken == before || rest.is_empty() {
            return [taken, rest.len() as u64];
        }
        open = rest;
    }
}

/// Mean of the shares of the eight neighbours of a pixel that have shares.
fn around(shares: &[Shares], width: usize, pixel: usize) -> Shares {
    let (x, y, height) = (pixel % width, pixel / width, shares.len() / width);
    let near = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    let mut mean = Shares::default();
    for own in near(y, height).flat_map(|y| near(x, width).map(move |x| &shares[y * width + x])) {
        let sum = own.sum();
        own.0.iter().for_each(|(index, weight)| mean.add(*index, weight / sum));
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    /// This test fails if pairs of equal coverage are in the order of the weights that came first.
    #[test]
    fn coverages_are_ranked_and_sum_to_alpha() {
        let shares = Shares::of([(4, 1.0), (2, 1.0), (9, 3.0), (4, 1.0), (1, 2.0)]);
        assert_eq!(shares.ranked(0.5), [(9, 0.1875), (1, 0.125), (4, 0.125), (2, 0.0625)]);
        assert_eq!(shares.ranked(0.0), []);
        assert_eq!(Shares::default().ranked(1.0), []);
    }

    /// This test fails if pixels of one step are seen within the same step, or if pixels without alpha pass shares on.
    #[test]
    fn shares_spread_to_pixels_with_alpha() {
        let mut row = vec![Shares::default(); 7];
        (row[0], row[3]) = (Shares::of([(0, 5.0)]), Shares::of([(1, 2.0)]));
        let wanted = [true, true, true, true, false, true, true];
        assert_eq!(spread(&mut row, 7, |pixel| wanted[pixel]), [2, 2]);
        let one = |index| Shares::of([(index, 1.0)]);
        assert_eq!((&row[1], &row[2]), (&one(0), &one(1)));
        assert_eq!((&row[4], &row[5]), (&Shares::default(), &Shares::default()));
        let mut two = vec![one(0), Shares::default(), one(1)];
        assert_eq!(spread(&mut two, 3, |_| true), [1, 0]);
        assert_eq!(two[1], Shares::of([(0, 1.0), (1, 1.0)]));
    }
}

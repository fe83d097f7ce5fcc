//! The search for settings: one knob at a time by measured error for work, among values in a known order.

/// What is wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// The least work whose error is at most this.
    Error(f64),
    /// The least error whose cost is at most this.
    Cost(f64),
}

/// A position and what it was measured to cost and to be off.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    pub position: Vec<usize>,
    pub cost: f64,
    pub error: f64,
}

impl Tried {
    fn fits(&self, goal: Goal) -> bool {
        match goal {
            Goal::Error(most) => self.error <= most,
            Goal::Cost(most) => self.cost <= most,
        }
    }

    /// Whether it serves the goal better than another that fits, too.
    fn beats(&self, other: &Self, goal: Goal) -> bool {
        let (mine, theirs) = match goal {
            Goal::Error(_) => ((self.cost, self.error), (other.cost, other.error)),
            Goal::Cost(_) => ((self.error, self.cost), (other.error, other.cost)),
        };
        mine.0 < theirs.0 || (mine.0 == theirs.0 && mine.1 < theirs.1)
    }
}

/// Those of some points that no other one beats in both cost and error, by cost; of equal ones the first.
pub fn pareto(tried: &[Tried]) -> Vec<usize> {
    let mut by_cost: Vec<usize> = (0..tried.len()).collect();
    by_cost.sort_by(|&a, &b| {
        tried[a]
            .cost
            .total_cmp(&tried[b].cost)
            .then(tried[a].error.total_cmp(&tried[b].error))
            .then(a.cmp(&b))
    });
    let mut least = f64::INFINITY;
    by_cost.retain(|&index| {
        let better = tried[index].error < least;
        least = least.min(tried[index].error);
        better
    });
    by_cost
}

/// Searches from the given positions. `sizes` has the number of values of each knob, `measure` gives cost and
/// error of a position, `None` once there is to be no more measuring; a position is measured once. Gives
/// everything that was tried, and which of it serves the goal best.
///
/// To save work the best start that fits is taken, to save error the cheapest, and of the turns of a round only the
/// best is kept. In each round every knob is turned by one value, down where work is to be
/// saved and up where error is, and the turns are tried together in the order of what each gained for what it
/// lost, each kept where the goal still holds. A turn that alone breaks the goal is not tried again from a
/// position that is worse in every knob, so the number of measurements is at most about the sum of `sizes`
/// times two. It ends where no turn helps: a local optimum, which is what is promised.
pub fn search(
    starts: &[Vec<usize>],
    sizes: &[usize],
    goal: Goal,
    mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
) -> (Vec<Tried>, Option<usize>) {
    let mut tried: Vec<Tried> = Vec::new();
    let mut look = |position: &[usize], tried: &mut Vec<Tried>| -> Option<usize> {
        if let Some(known) = tried.iter().position(|t| t.position == position) {
            return Some(known);
        }
        let (cost, error) = measure(position)?;
        tried.push(Tried { position: position.to_vec(), cost, error });
        Some(tried.len() - 1)
    };
    let best_of = |tried: &[Tried]| {
        let fitting = (0..tried.len()).filter(|&index| tried[index].fits(goal));
        fitting.reduce(|best, index| if tried[index].beats(&tried[best], goal) { index } else { best })
    };
    for start in starts {
        if look(start, &mut tried).is_none() {
            let best = best_of(&tried);
            return (tried, best);
        }
    }
    let down = matches!(goal, Goal::Error(_));
    let turned = |position: &[usize], knob: usize| -> Option<Vec<usize>> {
        let mut position = position.to_vec();
        let next = if down { position[knob].checked_sub(1)? } else { position[knob] + 1 };
        (next < sizes[knob]).then(|| position[knob] = next)?;
        Some(position)
    };
    // Work is saved from the best start, error from the cheapest: what a dear knob that does little has taken of the
    // cost is not given back by turning others up.
    let cheapest = |tried: &[Tried]| {
        let fitting = (0..tried.len()).filter(|&index| tried[index].fits(goal));
        fitting.reduce(|best, index| if tried[index].cost < tried[best].cost { index } else { best })
    };
    let mut next_from = if down { best_of(&tried) } else { cheapest(&tried) };
    while let Some(from) = next_from {
        let here = tried[from].clone();
        let mut turns = Vec::new();
        for knob in 0..sizes.len() {
            let Some(position) = turned(&here.position, knob) else { continue };
            let Some(at) = look(&position, &mut tried) else {
                let best = best_of(&tried);
                return (tried, best);
            };
            if tried[at].fits(goal) && tried[at].beats(&here, goal) {
                let (saved, lost) = if down {
                    (here.cost - tried[at].cost, tried[at].error - here.error)
                } else {
                    (here.error - tried[at].error, tried[at].cost - here.cost)
                };
                // What gains and loses nothing comes first.
                turns.push((saved / lost.max(1e-12), knob));
            }
        }
        turns.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        if !down {
            turns.truncate(1);
        }
        let mut at = from;
        for (_, knob) in turns {
            let Some(position) = turned(&tried[at].position, knob) else { continue };
            let Some(next) = look(&position, &mut tried) else {
                let best = best_of(&tried);
                return (tried, best);
            };
            if tried[next].fits(goal) && tried[next].beats(&tried[at], goal) {
                at = next;
            }
        }
        next_from = Some(at).filter(|at| *at != from);
    }
    let best = best_of(&tried);
    (tried, best)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]
mod tests {
    use super::*;

    /// Costs double with each value; errors are independent and halve, as noise and resolution do.
    fn model(weights: &'static [(f64, f64)]) -> impl FnMut(&[usize]) -> Option<(f64, f64)> {
        move |position| {
            let value = |(&at, &(cost, error)): (&usize, &(f64, f64))| {
                let scale = f64::from(1_u32 << at);
                (cost * scale, (error / scale) * (error / scale))
            };
            let (cost, square) =
                position.iter().zip(weights).map(value).fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
            Some((cost, square.sqrt()))
        }
    }

    fn exhaustive(
        sizes: &[usize],
        goal: Goal,
        mut measure: impl FnMut(&[usize]) -> Option<(f64, f64)>,
    ) -> Tried {
        let total: usize = sizes.iter().product();
        let at = |mut n: usize| -> Vec<usize> {
            sizes
                .iter()
                .map(|size| {
                    let digit = n % size;
                    n /= size;
                    digit
                })
                .collect()
        };
        let all = (0..total).filter_map(|n| {
            let (cost, error) = measure(&at(n))?;
            Some(Tried { position: at(n), cost, error })
        });
        let fits: Vec<Tried> = all.filter(|t| t.fits(goal)).collect();
        fits.iter().fold(fits[0].clone(), |best, t| if t.beats(&best, goal) { t.clone() } else { best })
    }

    // One knob is dear and does little: a preset turns it up all the same.
    const BAD: &[(f64, f64)] = &[(1.0, 1.0), (100.0, 0.01), (3.0, 0.5)];

    #[test]
    fn a_dear_knob_that_does_little_is_turned_down() {
        let sizes = [9, 9, 9];
        for most in [0.5, 0.1, 0.02] {
            let goal = Goal::Error(most);
            let presets: Vec<Vec<usize>> = [0, 3, 6, 8].map(|at| vec![at; 3]).to_vec();
            let (tried, best) = search(&presets, &sizes, goal, model(BAD));
            let best = &tried[best.unwrap()];
            let ideal = exhaustive(&sizes, goal, model(BAD));
            let naive =
                tried[..4].iter().filter(|t| t.fits(goal)).map(|t| t.cost).fold(f64::INFINITY, f64::min);
            assert!(best.error <= most && best.cost <= 1.1 * ideal.cost, "{best:?} {ideal:?}");
            assert!(best.cost < 0.5 * naive || naive == ideal.cost, "{best:?} {naive}");
            assert!(tried.len() <= 4 + 2 * 27, "{}", tried.len());
        }
    }

    #[test]
    fn the_least_error_within_a_cost() {
        let (sizes, goal) = ([9, 9, 9], Goal::Cost(900.0));
        let (tried, best) = search(&[vec![0; 3], vec![3; 3]], &sizes, goal, model(BAD));
        let (best, ideal) = (&tried[best.unwrap()], exhaustive(&sizes, goal, model(BAD)));
        assert!(best.cost <= 900.0 && best.error <= 1.2 * ideal.error, "{best:?} {ideal:?}");
    }

    #[test]
    fn what_cannot_be_reached_is_no_result_and_a_stop_keeps_what_is_known() {
        let (tried, best) = search(&[vec![0, 0, 0]], &[1, 1, 1], Goal::Error(1e-9), model(BAD));
        assert_eq!((tried.len(), best), (1, None));
        let (mut left, mut of) = (5, model(BAD));
        let limited = |position: &[usize]| {
            left -= 1;
            if left < 0 { None } else { of(position) }
        };
        let (tried, best) = search(&[vec![8; 3]], &[9; 3], Goal::Error(0.1), limited);
        assert!(tried.len() == 5 && best.is_some());
    }

    #[test]
    fn the_front_holds_what_nothing_beats() {
        let of = |cost, error| Tried { position: vec![], cost, error };
        let all = [of(3.0, 1.0), of(1.0, 3.0), of(2.0, 3.0), of(2.0, 2.0), of(1.0, 3.0)];
        assert_eq!(pareto(&all), [1, 3, 0]);
    }
}

//! k-medoids: which sentences of a cell stand for the others.
//!
//! Cells are small, so where all choices can be tried they are ([`medoids`]); beyond that, PAM: BUILD picks greedily,
//! SWAP exchanges the best pair until nothing improves. Ties go to the smaller index, so that equal input gives
//! equal output.
//!
//! # Source
//!
//! Kaufman and Rousseeuw, *Finding Groups in Data* (1990), chapter 2.

/// The most choices that are all tried.
const MAX_CHOICES: u64 = 50_000;

/// Distances between `n` things. Shape `[n, n]`, symmetric, zero on the diagonal.
#[derive(Clone, Debug)]
pub(super) struct Distances {
    n: usize,
    values: Vec<f64>,
}

impl Distances {
    /// Measures every pair of `n` things once; the distance is symmetric.
    pub(super) fn new(n: usize, distance: impl Fn(usize, usize) -> f64) -> Self {
        let mut values = vec![0.0; n * n];
        for a in 0..n {
            for b in 0..a {
                let d = distance(a, b);
                values[a * n + b] = d;
                values[b * n + a] = d;
            }
        }
        Self { n, values }
    }

    fn between(&self, a: usize, b: usize) -> f64 {
        self.values[a * self.n + b]
    }

    /// Computes the sum of everybody's distances to the nearest of `medoids`.
    pub(super) fn cost(&self, medoids: &[usize]) -> f64 {
        (0..self.n).map(|i| self.nearest(i, medoids).1).sum()
    }

    /// Finds the nearest of `medoids`: its place in the list, and the distance.
    pub(super) fn nearest(&self, i: usize, medoids: &[usize]) -> (usize, f64) {
        let mut best = (0, f64::INFINITY);
        for (place, &medoid) in medoids.iter().enumerate() {
            let d = self.between(i, medoid);
            if d < best.1 {
                best = (place, d);
            }
        }
        best
    }
}

/// Chooses `k` of `n` so that the others are near one of them; in rising order. All if there are no more than `k`.
pub(super) fn medoids(distances: &Distances, k: usize) -> Vec<usize> {
    if k >= distances.n {
        return (0..distances.n).collect();
    }
    if n_choices(distances.n, k) <= MAX_CHOICES {
        return best_of_all(distances, k);
    }
    pam(distances, k)
}

/// Chooses as [`medoids`], by BUILD and SWAP alone.
fn pam(distances: &Distances, k: usize) -> Vec<usize> {
    let mut chosen = build(distances, k.min(distances.n));
    let mut cost = distances.cost(&chosen);
    loop {
        let mut best: Option<(f64, Vec<usize>)> = None;
        for place in 0..chosen.len() {
            for candidate in (0..distances.n).filter(|i| !chosen.contains(i)) {
                let mut swapped = chosen.clone();
                swapped[place] = candidate;
                keep_less(&mut best, distances.cost(&swapped), swapped);
            }
        }
        match best {
            // Rounding must not make two equal choices swap for ever.
            Some((less, swapped)) if less < cost - 1e-12 => (cost, chosen) = (less, swapped),
            _ => break,
        }
    }
    chosen.sort_unstable();
    chosen
}

fn build(distances: &Distances, k: usize) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::with_capacity(k);
    while chosen.len() < k {
        let mut best = None;
        for candidate in (0..distances.n).filter(|i| !chosen.contains(i)) {
            let with = [&chosen[..], &[candidate]].concat();
            keep_less(&mut best, distances.cost(&with), with);
        }
        let Some((_, with)) = best else { break };
        chosen = with;
    }
    chosen
}

/// Keeps what costs less; of equals, what came first.
fn keep_less<T>(best: &mut Option<(f64, T)>, cost: f64, found: T) {
    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
        *best = Some((cost, found));
    }
}

/// Counts the ways to choose `k` of `n`, up to a little more than [`MAX_CHOICES`].
fn n_choices(n: usize, k: usize) -> u64 {
    let mut ways = 1_u64;
    for i in 0..k.min(n - k) as u64 {
        ways = ways * (n as u64 - i) / (i + 1);
        if ways > MAX_CHOICES {
            break;
        }
    }
    ways
}

fn best_of_all(distances: &Distances, k: usize) -> Vec<usize> {
    let mut choice: Vec<usize> = (0..k).collect();
    let mut best = (distances.cost(&choice), choice.clone());
    while advance(&mut choice, distances.n) {
        let cost = distances.cost(&choice);
        if cost < best.0 {
            best = (cost, choice.clone());
        }
    }
    best.1
}

/// Turns a rising choice into the next one; false after the last.
fn advance(choice: &mut [usize], n: usize) -> bool {
    let k = choice.len();
    let Some(place) = (0..k).rev().find(|&i| choice[i] < n - k + i) else { return false };
    choice[place] += 1;
    for i in place + 1..k {
        choice[i] = choice[i - 1] + 1;
    }
    true
}

#[cfg(test)]
#[path = "medoids_tests.rs"]
mod tests;

//! How often intervals over training seeds cover the truth: a simulation, printed as a table.
//!
//! `cargo run --release -p leadtime-numerics --example coverage`
//!
//! Three truths say how well a training does; each trained policy is then evaluated on 100 episodes, of which it
//! succeeds in so many. A cell is the share of simulated tables whose interval covers the mean over all possible
//! trainings, and the mean width of these intervals. Nominal is .95.

#![expect(clippy::print_stdout, reason = "a program, whose output is its result")]

use leadtime_numerics::stats::{Bootstrap, Interval, mean, standard_error};
use leadtime_numerics::{Pcg64, Purpose, stream};

/// Seed of every draw.
const SEED: u64 = 1;
/// Simulated tables per cell.
const N_TABLES: u64 = 1_000;
/// Resamples per interval: fewer than tables use, as a thousand intervals are made per cell.
const N_RESAMPLES: usize = 999;
/// Episodes per training seed.
const N_EPISODES: usize = 100;
/// Training seeds, with the 97.5th percentile of Student's t with one degree of freedom less.
const SEEDS: [(usize, f64); 4] = [(3, 4.302_653), (5, 2.776_445), (10, 2.262_157), (20, 2.093_024)];

/// How well trainings do.
#[derive(Clone, Copy)]
enum Truth {
    /// Normal around .85, with this deviation.
    Normal(f64),
    /// .97, but for this share of the trainings, which have that success.
    Mixed { share: f64, success: f64 },
}

const GOOD: f64 = 0.97;

impl Truth {
    fn title(self) -> String {
        match self {
            Self::Normal(deviation) => format!("normal, s.d. {deviation}"),
            Self::Mixed { share, success } => {
                format!("{GOOD}, but {success} in one of {:.0} trainings", 1.0 / share)
            }
        }
    }

    fn mean(self) -> f64 {
        match self {
            Self::Normal(_) => 0.85,
            Self::Mixed { share, success } => share * success + (1.0 - share) * GOOD,
        }
    }

    fn draw(self, rng: &mut Pcg64) -> f64 {
        match self {
            Self::Normal(deviation) => (self.mean() + deviation * rng.normal()).clamp(0.0, 1.0),
            Self::Mixed { share, success } => {
                if rng.unit() < share {
                    success
                } else {
                    GOOD
                }
            }
        }
    }
}

/// Makes an interval of the episodes of every training.
type Method = fn(&[Vec<f64>], f64, u64) -> Interval;

const METHODS: [(&str, Method); 3] = [
    ("bootstrap of seeds, then episodes", bootstrapped),
    ("Student's t over seeds", student),
    ("cautious", cautious),
];

fn plan() -> Bootstrap {
    Bootstrap { seed: SEED, n_resamples: N_RESAMPLES, confidence: 0.95 }
}

fn means(groups: &[Vec<f64>]) -> Vec<f64> {
    groups.iter().map(|group| mean(group)).collect()
}

fn bootstrapped(groups: &[Vec<f64>], _: f64, index: u64) -> Interval {
    let groups: Vec<&[f64]> = groups.iter().map(Vec::as_slice).collect();
    plan().hierarchical_mean(&groups, index).expect("there are groups")
}

fn student(groups: &[Vec<f64>], quantile: f64, _: u64) -> Interval {
    let means = means(groups);
    let (estimate, half) = (mean(&means), quantile * standard_error(&means));
    Interval { estimate, low: estimate - half, high: (estimate + half).min(1.0) }
}

fn cautious(groups: &[Vec<f64>], _: f64, index: u64) -> Interval {
    plan().cautious_mean(&means(groups), index).expect("there are groups")
}

/// Simulates one table: the episodes of every training.
fn table(truth: Truth, n_seeds: usize, index: u64) -> Vec<Vec<f64>> {
    let mut rng = stream(SEED, Purpose::World, n_seeds as u32, index);
    let mut training = || {
        let success = truth.draw(&mut rng);
        (0..N_EPISODES).map(|_| f64::from(u8::from(rng.unit() < success))).collect()
    };
    (0..n_seeds).map(|_| training()).collect()
}

fn main() {
    let truths = [
        Truth::Normal(0.05),
        Truth::Mixed { share: 0.2, success: 0.78 },
        Truth::Mixed { share: 0.1, success: 0.0 },
    ];
    let seeds = SEEDS.map(|(n, _)| format!("{n} seeds")).join(" | ");
    println!("| success of a training | interval | {seeds} |\n|---|---|---|---|---|---|");
    for truth in truths {
        for (name, method) in METHODS {
            let cells = SEEDS.map(|(n_seeds, quantile)| {
                let make = |index| method(&table(truth, n_seeds, index), quantile, index);
                let intervals: Vec<Interval> = (0..N_TABLES).map(make).collect();
                let n_covered = intervals.iter().filter(|made| made.contains(truth.mean())).count();
                let widths: Vec<f64> = intervals.iter().map(|made| made.high - made.low).collect();
                let covered = n_covered as f64 / N_TABLES as f64;
                format!("{covered:.2}, width {:.2}", mean(&widths))
            });
            println!("| {} | {name} | {} |", truth.title(), cells.join(" | "));
        }
    }
}

"""Prints the golden numbers of crates/numerics/src/stats.rs and proportion.rs.

pip install numpy scipy; python3 crates/numerics/golden/golden_stats.py

SciPy's bootstrap resamples with `rng.integers(0, n, (n_resamples, n))`, sample after sample, and takes
percentiles with linear interpolation. Our generator is numpy's, so the two agree draw for draw.
"""

import numpy as np
from scipy import stats

A = [0.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.5]
B = [-3.25, 10.5, 0.125, 7.0, 2.0, -1.5, 4.75]
GROUPS = [[1.0, 2.0, 4.0], [0.0, 0.5], [3.0, 3.5, 5.0, 2.5]]
COUNTS = [(0, 1), (3, 3), (0, 20), (2, 20), (17, 20), (192, 200), (200, 200), (9871, 10000)]
RESAMPLES = 999
CONFIDENCE = 0.95
SEED = 11


def rng(index):
    """Opens stream(SEED, Purpose::Bootstrap, 0, index) of crates/numerics/src/streams.rs."""
    words = [SEED, 0, 6, 0, index, 0]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


def scipy_interval(data, statistic, index):
    result = stats.bootstrap(
        data, statistic, n_resamples=RESAMPLES, confidence_level=CONFIDENCE,
        method="percentile", rng=rng(index), vectorized=True)
    return result.confidence_interval


def hierarchical(groups, index):
    """Resamples groups, then members within each drawn group; every group weighs the same."""
    g = rng(index)
    means = []
    for _ in range(RESAMPLES):
        drawn = []
        for _ in range(len(groups)):
            group = groups[int(g.integers(0, len(groups)))]
            picks = [group[int(g.integers(0, len(group)))] for _ in range(len(group))]
            drawn.append(np.mean(picks))
        means.append(np.mean(drawn))
    tail = 100 * (1 - CONFIDENCE) / 2
    return np.percentile(means, [tail, 100 - tail])


def mean(x, axis=-1):
    return np.mean(x, axis=axis)


def difference(x, y, axis=-1):
    return np.mean(x, axis=axis) - np.mean(y, axis=axis)


def literal(value):
    """Writes a number as Rust, its fraction in groups of three."""
    whole, _, fraction = repr(float(value)).partition(".")
    return whole + "." + "_".join(fraction[i:i + 3] for i in range(0, len(fraction), 3))


def row(name, values):
    print(f"const {name}: [f64; {len(values)}] = [{', '.join(map(literal, values))}];")


print("// numpy", np.__version__)
row("MEAN_SD_SEM_OF_B", [np.mean(B), np.std(B, ddof=1), stats.sem(B)])
row("PERCENTILES_OF_B", np.percentile(B, [0, 2.5, 33, 50, 97.5, 100]))
row("MEAN_INTERVAL_OF_A", scipy_interval((A,), mean, 0))
row("MEAN_INTERVAL_OF_B", scipy_interval((B,), mean, 1))
row("DIFFERENCE_INTERVAL", scipy_interval((B, A), difference, 2))
row("HIERARCHICAL_INTERVAL", hierarchical(GROUPS, 3))
# The interquartile mean as rliable defines it: scipy.stats.trim_mean(scores, 0.25).
row("INTERQUARTILE_MEANS", [stats.trim_mean(x, 0.25) for x in (A, B, B[:3], B[:4])])
exact = [stats.binomtest(k, n).proportion_ci(CONFIDENCE, "exact") for k, n in COUNTS]
bounds = ", ".join(f"[{literal(ci.low)}, {literal(ci.high)}]" for ci in exact)
print(f"const CLOPPER_PEARSON: [[f64; 2]; {len(COUNTS)}] = [{bounds}];")

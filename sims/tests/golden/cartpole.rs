// Written by cartpole.py (gymnasium 1.4.0); do not edit.
struct CartPoleGolden {
    seed: u64,
    first: [f32; 4],
    n_steps: usize,
    last: [f32; 4],
}

#[expect(clippy::unreadable_literal, reason = "as numpy prints them")]
const GOLDEN: &[CartPoleGolden] = &[
    CartPoleGolden {
        seed: 0,
        first: [0.013696169, -0.02302133, -0.045902647, -0.048347235],
        n_steps: 14,
        last: [0.09069317, 0.7729804, -0.21647738, -1.5934578],
    },
    CartPoleGolden {
        seed: 1,
        first: [0.0011821624, 0.04504637, -0.03558404, 0.044864945],
        n_steps: 16,
        last: [0.13420475, 0.8413449, -0.23216093, -1.5103068],
    },
    CartPoleGolden {
        seed: 7,
        first: [0.012509546, 0.03972138, 0.02756857, -0.027479282],
        n_steps: 19,
        last: [0.20290343, 1.0231978, -0.24100614, -1.7072707],
    },
    CartPoleGolden {
        seed: 123,
        first: [0.018235186, -0.0446179, -0.027964013, -0.03156282],
        n_steps: 15,
        last: [0.10363158, 0.9442488, -0.2118135, -1.8217739],
    },
    CartPoleGolden {
        seed: 1099511627776,
        first: [-0.013919042, 0.012824025, 0.049522936, -0.03422783],
        n_steps: 20,
        last: [0.18489005, 1.1864213, -0.22632027, -1.8944029],
    },
];

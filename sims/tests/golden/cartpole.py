"""Prints cartpole.rs: python3 cartpole.py > cartpole.rs (gymnasium 1.4.0)."""

import gymnasium

print("// Written by cartpole.py (gymnasium 1.4.0); do not edit.")
print("struct CartPoleGolden {\n    seed: u64,\n    first: [f32; 4],\n    n_steps: usize,\n    last: [f32; 4],\n}\n")
print('#[expect(clippy::unreadable_literal, reason = "as numpy prints them")]')
print("const GOLDEN: &[CartPoleGolden] = &[")
for seed in (0, 1, 7, 123, 2**40):
    env = gymnasium.make("CartPole-v1")
    first, _ = env.reset(seed=seed)
    n_steps, done, last = 0, False, first
    while not done:
        action = 0 if n_steps % 3 == 0 else 1
        last, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
        n_steps += 1
    row = lambda values: "[" + ", ".join(str(v) for v in values) + "]"
    print(f"    CartPoleGolden {{ seed: {seed}, first: {row(first)}, n_steps: {n_steps}, last: {row(last)} }},")
print("];")

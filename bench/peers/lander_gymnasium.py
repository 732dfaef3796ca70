"""Frames per second of Gymnasium's LunarLander-v3 on one core, beside `cargo bench -p leadtime-lander --bench lander`.

    pip install "gymnasium[box2d]==1.4.0"
    python3 bench/peers/lander_gymnasium.py [FRAMES]

Resets, observations, rewards and the 1,000-frame limit are included. Prints CPU-time rates, one JSON line each.
"""
import json
import sys
import time

try:
    import gymnasium as gym
    import numpy as np
    from gymnasium.envs.box2d.lunar_lander import heuristic
except ImportError as missing:
    print(f'skipped: {missing.name} is not installed (pip install "gymnasium[box2d]==1.4.0")')
    sys.exit(0)

N_FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000


def rate(driver, wind):
    env = gym.make("LunarLander-v3", enable_wind=wind)
    actions = np.random.default_rng(7).integers(0, 4, N_FRAMES)
    observation, _ = env.reset(seed=1)
    start = time.process_time()
    for action in actions:
        chosen = int(action) if driver == "random" else heuristic(env.unwrapped, observation)
        observation, _, terminated, truncated, _ = env.step(chosen)
        if terminated or truncated:
            observation, _ = env.reset()
    return N_FRAMES / (time.process_time() - start)


for driver in ("random", "heuristic"):
    for wind in (False, True):
        row = {"peer": f"gymnasium {gym.__version__}", "driver": driver, "wind": wind,
               "frames_per_second": round(rate(driver, wind))}
        print(json.dumps(row), flush=True)

"""Frames per second of Gymnasium's LunarLander-v3 on one core, beside `cargo bench -p leadtime-lander --bench lander`.

    pip install "gymnasium[box2d]==1.4.0"
    python3 bench/peers/lander_gymnasium.py [FRAMES]

Resets, observations, rewards and the 1,000-frame limit are included. Prints CPU-time rates, one JSON line each; that of EnvPool's
LunarLander-v3 (64 environments on one thread, random actions, four times as many frames) only where it is installed (pip install envpool).
"""
import json
import sys
import time

N_FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
N_ENVS = 64


def report(row, rate):
    print(json.dumps(row | {"frames_per_second": round(rate)}), flush=True)


def skipped(missing, package):
    print(f"skipped: {missing.name} is not installed (pip install {package})", flush=True)


def single(driver, wind):
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


def pooled():
    # Finished environments are reset by it.
    env = envpool.make("LunarLander-v3", env_type="gymnasium", num_envs=N_ENVS, num_threads=1, seed=1)
    actions = np.random.default_rng(7).integers(0, 4, (4 * N_FRAMES // N_ENVS, N_ENVS)).astype(np.int32)
    env.reset()
    start = time.process_time()
    for batch in actions:
        env.step(batch)
    return actions.size / (time.process_time() - start)


try:
    import gymnasium as gym
    import numpy as np
    from gymnasium.envs.box2d.lunar_lander import heuristic
except ImportError as missing:
    skipped(missing, '"gymnasium[box2d]==1.4.0"')
else:
    for driver in ("random", "heuristic"):
        for wind in (False, True):
            row = {"peer": f"gymnasium {gym.__version__}", "driver": driver, "wind": wind}
            report(row, single(driver, wind))

try:
    import envpool
    import numpy as np
except ImportError as missing:
    skipped(missing, "envpool")
else:
    row = {"peer": f"envpool {envpool.__version__}", "driver": "random", "n_envs": N_ENVS, "threads": 1}
    report(row, pooled())

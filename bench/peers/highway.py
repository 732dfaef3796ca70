"""Frames per second of highway-env's merge-v0 on one core, beside `cargo bench -p leadtime-highway --bench highway`.

    pip install highway-env==1.12.1
    python3 bench/peers/highway.py [FRAMES]

Five frames of 1/15 s per decision, as in our default; observation, reward and resets are included, and left out in
the row `frames only`. Prints CPU-time rates, one JSON line each; EnvPool's (a port to C++) only where it is
installed (pip install envpool).
"""
import json
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
try:
    import gymnasium as gym
    import highway_env
    import numpy as np
except ImportError as missing:
    print(f"skipped: {missing.name} is not installed (pip install highway-env==1.12.1)")
    sys.exit(0)

N_FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
FRAMES_PER_DECISION = 5
gym.logger.min_level = 50  # merge-v0 is reported as out of date: it is what is wanted here


def make():
    env = gym.make("merge-v0", config={"policy_frequency": 3})
    env.reset(seed=1)
    return env


def end_to_end(driver):
    env = make()
    actions = np.random.default_rng(7).integers(0, 5, N_FRAMES // FRAMES_PER_DECISION)
    frames, start = 0, time.process_time()
    for action in actions:
        chosen = {"random": int(action), "idle": 1, "slower": 4}[driver]
        _, _, terminated, truncated, _ = env.step(chosen)
        frames += FRAMES_PER_DECISION
        if terminated or truncated:
            env.reset()
    return frames / (time.process_time() - start)


def frames_only():
    env = make()
    frames, spent = 0, 0.0
    while frames < N_FRAMES:
        env.reset()
        road, start = env.unwrapped.road, time.process_time()
        for _ in range(200):
            road.act()
            road.step(1 / 15)
        spent += time.process_time() - start
        frames += 200
    return frames / spent


def report(peer, driver, rate):
    print(json.dumps({"peer": peer, "driver": driver, "frames_per_second": round(rate)}), flush=True)


NAME = f"highway-env {highway_env.__version__} merge-v0"
for driver in ("random", "idle", "slower"):
    report(NAME, driver, end_to_end(driver))
report(NAME, "frames only", frames_only())

try:
    import envpool
except ImportError:
    print("skipped: envpool is not installed (pip install envpool)")
    sys.exit(0)

N_ENVS = 64


def pooled(driver):
    env = envpool.make("merge-v0", env_type="gymnasium", num_envs=N_ENVS, num_threads=1, policy_frequency=3, seed=1)
    n_decisions = 20 * N_FRAMES // FRAMES_PER_DECISION // N_ENVS
    actions = np.random.default_rng(7).integers(0, 5, (n_decisions, N_ENVS)).astype(np.int32)
    if driver != "random":
        actions[:] = {"idle": 1, "slower": 4}[driver]
    env.reset()
    start = time.process_time()
    for batch in actions:
        env.step(batch)
    return actions.size * FRAMES_PER_DECISION / (time.process_time() - start)


for driver in ("random", "idle", "slower"):
    report(f"envpool {envpool.__version__} merge-v0, {N_ENVS} environments, one thread", driver, pooled(driver))

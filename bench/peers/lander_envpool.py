"""Frames per second of EnvPool's LunarLander-v3, 64 environments on one thread, beside our own bench.

    pip install envpool
    python3 bench/peers/lander_envpool.py [FRAMES]

Prints a CPU-time rate as a JSON line. Random actions; EnvPool resets finished environments by itself.
"""
import json
import sys
import time

try:
    import envpool
    import numpy as np
except ImportError as missing:
    print(f"skipped: {missing.name} is not installed (pip install envpool)")
    sys.exit(0)

N_FRAMES = int(sys.argv[1]) if len(sys.argv) > 1 else 400_000
N_ENVS = 64

env = envpool.make("LunarLander-v3", env_type="gymnasium", num_envs=N_ENVS, num_threads=1, seed=1)
actions = np.random.default_rng(7).integers(0, 4, (N_FRAMES // N_ENVS, N_ENVS)).astype(np.int32)
env.reset()
start = time.process_time()
for batch in actions:
    env.step(batch)
rate = actions.size / (time.process_time() - start)
print(json.dumps({"peer": f"envpool {envpool.__version__}", "driver": "random", "n_envs": N_ENVS,
                  "threads": 1, "frames_per_second": round(rate)}))

"""Steps per second of the steakhouse in Python on one core, beside `cargo bench -p leadtime-steakhouse --bench steakhouse`.

    python3 bench/peers/steakhouse.py [STEPS]

Steps sims/steakhouse/tests/golden/steakhouse.py, the program that recorded the golden episodes: `world and cook` as there, with
random starts and resets but no reference run; `domain` with rewards, observations and the reference run of every
episode. Prints CPU-time rates, one JSON line each.
"""
import json
import platform
import random
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "sims" / "steakhouse" / "tests" / "golden"))
import steakhouse as kitchen  # noqa: E402

N_STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000


def start(seed):
    rng = random.Random(seed)
    world = kitchen.World(kitchen.LAYOUTS["ring"])
    return dict(occ=kitchen.family("ring", "random", rng), pos=rng.choice(world.tiles(" ")), ori=rng.randrange(4))


def world_and_cook():
    steps, seed = 0, 0
    begin = time.process_time()
    while steps < N_STEPS:
        at, seed = start(seed), seed + 1
        world = kitchen.World(kitchen.LAYOUTS["ring"], at["occ"], pos=at["pos"], ori=at["ori"])
        cook = kitchen.Human(world, random.Random(seed))
        for _ in range(100):
            action = cook.act()
            cook.after(action, world.step(action))
            cook.tick()
            cook.look()
            steps += 1
            if world.delivered:
                break
    return steps / (time.process_time() - begin)


def domain():
    steps, seed = 0, 0
    begin = time.process_time()
    while steps < N_STEPS:
        env = kitchen.Env(seed=seed, **start(seed))
        seed, done = seed + 1, False
        while not done:
            _, done = env.step()
            env.obs()
            steps += 1
    return steps / (time.process_time() - begin)


for name, rate in (("world and cook", world_and_cook), ("domain", domain)):
    row = {"peer": f"Python {platform.python_version()}", "what": name, "steps_per_second": round(rate())}
    print(json.dumps(row), flush=True)

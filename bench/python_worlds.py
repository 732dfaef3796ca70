"""CPU time per step of the worlds in Python: as `gymnasium.Env`, and 64 of them with one native call, beside Gymnasium's own.

    python3 bench/python_worlds.py [ROUNDS, default 5]

Needs the package `leadtime` (python/build.sh) with its extra `gym`, and for LunarLander gymnasium[box2d]. Actions are random and
drawn before. Every figure is the best of the rounds, each of which measures all of them, one after the other: so what else runs on
the machine moves all alike. Prints a table, with the least that each is meant to reach, and what the import costs.
"""

import subprocess
import sys
import time

try:
    import gymnasium

    import leadtime.gym  # noqa: F401  registers the worlds
except ImportError as missing:
    print(f"skipped: {missing}; python/build.sh builds the package")
    sys.exit(0)

ROUNDS = int(sys.argv[1]) if len(sys.argv) > 1 else 5
SECONDS = 0.3  # of a measurement, about
N_ENVS, N_ACTIONS = 64, 1024
CARTPOLE, LANDER = "CartPole-v1", "LunarLander-v3"
# What is measured, what it has to reach, and which of Gymnasium's own it has to reach how many times.
SINGLE = {"leadtime/CartPole-v0": (1.5e6, CARTPOLE, 10), "leadtime/Pilot-v0": (None, LANDER, 20), "leadtime/Lander-v0": (120e3, None, None),
          "leadtime/Highway-v0": (None, None, None), "leadtime/Steakhouse-v0": (None, None, None)}
VECTOR = {"leadtime/CartPole-v0": 20e6, "leadtime/Pilot-v0": None, "leadtime/Lander-v0": 200e3, "leadtime/Highway-v0": None,
          "leadtime/Steakhouse-v0": None}


def single(name):
    """Returns what takes 1,024 steps of an environment, and how many steps that are."""
    env = gymnasium.make(name, disable_env_checker=True)
    env.action_space.seed(1)
    actions = [env.action_space.sample() for _ in range(N_ACTIONS)]
    env.reset(seed=1)

    def steps():
        step, reset = env.step, env.reset
        for action in actions:
            _, _, terminated, truncated, _ = step(action)
            if terminated or truncated:
                reset()

    return steps, N_ACTIONS


def vector(name):
    """Returns what takes 256 steps of 64 environments, and how many steps that are."""
    envs = gymnasium.make_vec(name, num_envs=N_ENVS, vectorization_mode="vector_entry_point")
    envs.action_space.seed(1)
    actions = [envs.action_space.sample() for _ in range(N_ACTIONS // 4)]
    envs.reset(seed=1)

    def steps():
        step = envs.step
        for action in actions:
            step(action)

    return steps, N_ENVS * len(actions)


def rate(steps, n_steps):
    """Returns steps per second of CPU time."""
    started, n = time.process_time(), 0
    while (spent := time.process_time() - started) < SECONDS:
        steps()
        n += n_steps
    return n / spent


def made(make, names):
    """Makes those that can be made here."""
    for name in names:
        try:
            yield name, make(name)
        except gymnasium.error.DependencyNotInstalled as missing:
            print(f"skipped: {name}: {' '.join(str(missing).split())}", file=sys.stderr)


def import_seconds():
    """Returns the CPU time of `import leadtime.gym` in a Python of its own, the least of the rounds."""
    code = "import time; before = time.process_time(); import leadtime.gym; print(time.process_time() - before)"
    return min(float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout) for _ in range(ROUNDS))


def shown(number):
    return f"{number / 1e6:.2f} M" if number >= 1e6 else f"{number / 1e3:.1f} k"


def main():
    cases = {("single", name): case for name, case in made(single, [*SINGLE, CARTPOLE, LANDER])}
    cases |= {("vector", name): case for name, case in made(vector, VECTOR)}
    best = dict.fromkeys(cases, 0.0)
    for _ in range(ROUNDS):
        for key, case in cases.items():
            best[key] = max(best[key], rate(*case))
    print("| steps/s of CPU time, random actions | one `gymnasium.Env` | goal | Gymnasium's own | times | goal | native vector of 64 | goal |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (least, own, times) in SINGLE.items():
        rates = best["single", name], best["vector", name]
        own = best.get(("single", own))
        cells = [f"`{name}`", shown(rates[0]), shown(least) if least else "–", shown(own) if own else "–",
                 f"{rates[0] / own:.1f}" if own else "–", str(times or "–"), shown(rates[1]), shown(VECTOR[name]) if VECTOR[name] else "–"]
        print("| " + " | ".join(cells) + " |")
    print(f"\n`import leadtime.gym`, Gymnasium and numpy included: {import_seconds():.2f} s of CPU time; the goal is 0.3.")


main()

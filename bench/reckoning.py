#!/usr/bin/env python3
"""How far one learner reaches: reckons, from what `bench/scale.sh` measured, what N actors ask of it and of its line.

    python3 bench/reckoning.py [--cores CORES] [--line BITS PER SECOND ...] [--envs ENVIRONMENTS PER ACTOR] [--steps STEPS PER ROLLOUT]

Every actor has a core and `envs` environments, so an update trains on `actors * envs * steps` steps, and every actor fetches the
weights once per update. `python3 -m doctest bench/reckoning.py` checks the formulas; docs/scale.md explains them.
"""

import argparse
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

FIGURES = Path(__file__).resolve().parent / "scale.json"
ACTORS = (10, 100, 1_000, 10_000)
# Lines of a learner, in bits per second: to other places, and within a hall.
LINES = (1e9, 10e9)
# Actors that one regional relay fetches weights for.
REGION = 100


@dataclass
class Task:
    """What was measured of a task.

    `acting` and `learning` are seconds of CPU per step, `per_actor` seconds of the learner's CPU per actor and update, `step_bytes`
    what a step sends to the learner, `weights_bytes` what an actor receives per update.
    """

    name: str
    acting: float
    learning: float
    per_actor: float
    step_bytes: float
    weights_bytes: float


@dataclass
class Site:
    """What is assumed: cores that the learner trains on, its line in bits per second, environments per actor, steps per rollout."""

    cores: int = 16
    line: float = 1e9
    envs: int = 8
    steps: int = 64


def limits(task, site, actors, relayed=False):
    """Returns what limits a run with these actors and one learner, in steps/s: each limit with its name, the lowest first.

    A hundred actors at 100 us a step make a million steps a second. At 8 us of learning a step, 16 cores take two million. A line of
    1 Gbit/s carries 1.25 million steps of 100 bytes. Every actor fetches 512,000 bytes for 512 steps, 1,000 bytes a step, so the
    line carries the weights for 125,000 steps; if one relay fetches them for a hundred actors, for a hundred times as many.

    >>> task = Task("slow", acting=100e-6, learning=8e-6, per_actor=0, step_bytes=100, weights_bytes=512_000)
    >>> site = Site(cores=16, line=1e9, envs=8, steps=64)
    >>> [(name, round(rate)) for rate, name in limits(task, site, 100)]
    [('weights', 125000), ('actors', 1000000), ('rollouts', 1250000), ('learner', 2000000)]
    >>> [(name, round(rate)) for rate, name in limits(task, site, 100, relayed=True)]
    [('actors', 1000000), ('rollouts', 1250000), ('learner', 2000000), ('weights', 12500000)]

    What the learner does once per actor and update is spread over the actor's steps of the update: 4,096 us over 512 steps.

    >>> task.per_actor = 4_096e-6
    >>> dict((name, round(rate)) for rate, name in limits(task, site, 100))["learner"]
    1000000
    """
    per_update = site.envs * site.steps
    fetching = math.ceil(actors / REGION) if relayed else actors
    return sorted([
        (actors / task.acting, "actors"),
        (site.cores / (task.learning + task.per_actor / per_update), "learner"),
        (site.line / 8 / task.step_bytes, "rollouts"),
        (site.line / 8 / task.weights_bytes * per_update * actors / fetching, "weights"),
    ])


def reach(task, site):
    """Returns with how many actors each limit but theirs is reached.

    >>> task = Task("slow", acting=100e-6, learning=8e-6, per_actor=0, step_bytes=100, weights_bytes=512_000)
    >>> {name: round(actors, 6) for name, actors in reach(task, Site(cores=16, line=1e9)).items()}
    {'weights': 12.5, 'rollouts': 125.0, 'learner': 200.0}
    """
    return {name: rate * task.acting for rate, name in limits(task, site, 1) if name != "actors"}


def least_lag(round_trip, update):
    """Returns the least `learner.lag` with which updates do not wait for a line: `lag` updates take two round trips at least.

    >>> [least_lag(0.010, update) for update in (0.2, 0.02, 0.007)]
    [1, 1, 3]
    """
    return max(1, math.ceil(2 * round_trip / update))


def slope(points):
    """Fits a line through (x, y) by least squares; returns its value at 0 and its slope.

    >>> [round(x, 6) for x in slope([(1, 5), (8, 12), (64, 68)])]
    [4.0, 1.0]
    """
    mean_x, mean_y = (sum(values) / len(points) for values in zip(*points))
    spread = sum((x - mean_x) ** 2 for x, _ in points)
    rise = sum((x - mean_x) * (y - mean_y) for x, y in points) / spread if spread else 0.0
    return mean_y - rise * mean_x, rise


def measured(figures):
    """Makes a Task of every task for which learners were measured."""
    tasks = []
    for name in dict.fromkeys(cell["task"] for cell in figures["learner"]):
        cells = [cell for cell in figures["learner"] if cell["task"] == name]
        # Few actors, so that they do not fight for the cores of the machine that measures.
        few = min(cells, key=lambda cell: (abs(cell["actors"] - 8), cell["actors"]))
        per_update = cells[0]["steps"] / cells[0]["updates"]
        base, per_actor = slope([(cell["actors"], sum(cell["learner"].values()) / cell["updates"]) for cell in cells])
        _, weights = slope([(cell["actors"], (cell["sent"] or 0) / cell["updates"]) for cell in cells])
        tasks.append(Task(name, sum(few["acting"].values()) / few["steps"], base / per_update, max(per_actor, 0.0),
                          (few["received"] or 0) / few["steps"], max(weights, 0.0)))
    return tasks


def amount(number):
    """Writes a number with three digits at most.

    >>> [amount(x) for x in (0.0712, 8.26, 123.4, 1234567, 4.4e10)]
    ['0.071', '8.3', '123', '1.23 M', '44 G']
    """
    for unit, size in (("G", 1e9), ("M", 1e6), ("k", 1e4)):
        if number >= size:
            number, unit = number / (1e3 if unit == "k" else size), f" {unit}"
            return f"{number:.3g}{unit}" if number < 1_000 else f"{number:,.0f}{unit}"
    return f"{number:.0f}" if number >= 100 else f"{number:.2g}"


def tables(figures, site, lines=LINES):
    """Writes what was measured of the tasks, how far they reach, and what limits a run of these numbers of actors, as Markdown."""
    tasks = [task for task in measured(figures) if task.step_bytes and task.weights_bytes]
    first, wide = (replace(site, cores=1, line=line) for line in (lines[0], lines[-1]))
    text = ["| task | acting *a* | learning *t* | per actor and update *e* | rollouts *r*, per step | weights *w* | actors that fill a core of "
            f"the learner | {bits(first.line)} with rollouts | with weights |", "|---|---|---|---|---|---|---|---|---|"]
    for task in tasks:
        filled = reach(task, first)
        text.append(f"| `{task.name}` | {amount(1e6 * task.acting)} us | {amount(1e6 * task.learning)} us | "
                    f"{amount(1e6 * task.per_actor)} us | {amount(task.step_bytes)} B | {amount(task.weights_bytes / 1e3)} kB | "
                    f"{amount(filled['learner'])} | {amount(filled['rollouts'])} | {amount(filled['weights'])} |")
    columns = " | ".join(f"{bits(line)} | with relays" for line in lines)
    text += ["", f"| task | actors | they make, steps/s | {columns} | learners for all, with {bits(wide.line)} and relays |",
             "|---|---|---|" + "---|" * (2 * len(lines) + 1)]
    for task in tasks:
        for actors in ACTORS:
            made = actors / task.acting
            found = [limits(task, replace(site, line=line), actors, relayed)[0] for line in lines for relayed in (False, True)]
            cells = " | ".join("all" if name == "actors" else f"{amount(rate)} ({name})" for rate, name in found)
            text.append(f"| `{task.name}` | {actors:,} | {amount(made)} | {cells} | {math.ceil(made / found[-1][0]):,} |")
    return "\n".join(text)


def bits(line):
    """Writes the speed of a line.

    >>> bits(1e9), bits(2.5e8)
    ('1 Gbit/s', '250 Mbit/s')
    """
    return f"{line / 1e9:g} Gbit/s" if line >= 1e9 else f"{line / 1e6:g} Mbit/s"


def main():
    site = Site()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cores", type=int, default=site.cores, help="cores that a learner trains on")
    parser.add_argument("--line", type=float, nargs="+", default=LINES, help="a learner's lines, bits per second each way")
    parser.add_argument("--envs", type=int, default=site.envs, help="environments per actor")
    parser.add_argument("--steps", type=int, default=site.steps, help="steps per rollout")
    args = parser.parse_args()
    print(tables(json.loads(FIGURES.read_text()), Site(args.cores, envs=args.envs, steps=args.steps), args.line))


if __name__ == "__main__":
    main()

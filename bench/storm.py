#!/usr/bin/env python3
"""How long it takes until all actors are back that lost their learner together.

    bench/storm.py [--actors 256] [--halt 4] [--load 10] [--times 1]

A learner trains with many actors on this machine. It is halted (SIGSTOP) for longer than a connection may be silent, so that all of
them lose it, while some processes begin that keep every core busy. Then it goes on, and it is measured how long it takes until all
actors are members again. Exit code 1 if that takes longer than --patience, 30 s. Touches only processes that it has started, and
files in a temporary directory. PROGRAM names the program where it is not target/release/leadtime.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from processes import PROGRAM, end_all, free_port, need_program, spawn

# Seconds until all actors are there for the first time, and for which the run is left in peace then.
PATIENCE, PEACE = 150, 3
# How long all actors have to stay to be back, in seconds: the last ones may not have noticed their loss yet.
STEADY = 4
# The pause between two looks, in seconds: asking takes the learner's time, too.
LOOK_EVERY = 0.5
# As many environments as actors, at most; updates that take less than a second.
LEARNING = ["learner.n_minibatches=64", "learner.mode=lag", "learner.lag=1", "learner.n_steps=64", "learner.total_steps=1000000000"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actors", type=int, default=256)
    parser.add_argument("--halt", type=float, default=4, help="seconds for which the learner is halted")
    parser.add_argument("--load", type=int, default=10, help="busy processes beside the run, from the halt on")
    parser.add_argument("--patience", type=float, default=30, help="the most seconds that it may take until all are back")
    parser.add_argument("--times", type=int, default=1, help="runs, one after the other")
    parser.add_argument("--task", default="cartpole")
    return parser.parse_args()


class Run:
    """A learner and its actors as processes, in a directory of their own."""

    def __init__(self, place, options):
        self.place, self.processes = place, []
        self.page = f"127.0.0.1:{free_port()}"
        learner = f"tcp/127.0.0.1:{free_port()}"
        n_envs = max(options.actors, 64)
        settings = [*LEARNING, f"learner.n_envs={n_envs}", f"run.actors_min={options.actors}", "evaluation.during_training=0"]
        settings = [word for setting in settings for word in ("--set", setting)]
        self.learner = self.start(
            "learner", PROGRAM, "learner", "-c", options.task, "--name", "storm", "--runs", place, "--seed", "1", "--listen", learner, "--status", self.page, *settings
        )
        for i in range(options.actors):
            # Actors give way, as they would on machines of their own.
            self.start(f"actor-{i}", "nice", PROGRAM, "actor", "--connect", learner, "--id", f"a{i}", "--connect-timeout", "120s")

    def start(self, name, *words):
        self.processes.append(spawn(self.place, name, *words))
        return self.processes[-1]

    def standing(self):
        """Members and updates; `None` while the learner does not answer."""
        try:
            with urllib.request.urlopen(f"http://{self.page}/metrics", timeout=1) as answer:
                text = answer.read().decode()
        except OSError:
            return None
        found = [re.search(rf"^{name}(?:{{[^}}]*}})? ([\d.e+]+)$", text, re.M) for name in ("leadtime_actors", "leadtime_updates_total")]
        return tuple(int(float(it[1])) for it in found) if all(found) else None

    def wait(self, condition, seconds):
        """Seconds until the condition holds, and what held last; `None` if it took too long."""
        started = time.monotonic()
        while True:
            standing, waited = self.standing(), time.monotonic() - started
            if standing and condition(*standing):
                return waited, standing
            if waited > seconds or self.learner.poll() is not None:
                return None, standing
            time.sleep(LOOK_EVERY)

    def steady(self, n_actors, seconds):
        """Seconds until all actors are there to stay, some having been lost before; `None` if that takes too long."""
        started, since = time.monotonic(), None
        while self.learner.poll() is None:
            standing, now = self.standing(), time.monotonic()
            if not (standing and standing[0] >= n_actors and self.n_lost()):
                since = None
            elif since is None:
                since = now
            if since is None and now - started > seconds:
                return None
            if since is not None and now - since > STEADY:
                return since - started
            time.sleep(LOOK_EVERY)
        return None

    def n_lost(self):
        """How often the learner has lost an actor."""
        return (self.place / "learner.log").read_text(errors="replace").count("actor left")

    def end(self):
        end_all(self.processes, patience=0)


def storm(place, options):
    """Halts a run's learner; returns the seconds from then on until all actors are members again, or `None`."""
    run, busy = Run(place, options), []
    try:
        waited, standing = run.wait(lambda actors, updates: actors >= options.actors and updates >= 2, PATIENCE)
        if waited is None:
            sys.exit(f"error: {standing} actors and updates after {PATIENCE} s: see {place}")
        time.sleep(PEACE)
        os.kill(run.learner.pid, signal.SIGSTOP)
        time.sleep(options.halt)
        busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.load)]
        os.kill(run.learner.pid, signal.SIGCONT)
        back = run.steady(options.actors, options.patience)
        print(f"actors and updates now {run.standing()}, lost {run.n_lost()} times", flush=True)
        return back
    finally:
        end_all(busy, patience=0)
        run.end()


def main():
    options = arguments()
    need_program()
    failed = False
    for _ in range(options.times):
        with tempfile.TemporaryDirectory(prefix="storm-", ignore_cleanup_errors=True) as place:
            back = storm(Path(place), options)
        told = f"after {back:.1f} s" if back is not None else f"not within {options.patience:.0f} s"
        print(f"all {options.actors} actors back {told}", flush=True)
        failed |= back is None
    sys.exit(failed)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""What it costs a run to be looked at, on the same cores.

    bench/observed.py [--seconds 50] [--turn 2.6] [--pages 5] [--tls]

One learner and one actor train on the default task, while in turns nobody looks, /metrics is scraped once a second, pages of a
watcher are open without the playthrough, and with it; `--kinds all` is scraped and one page with it at once. Each turn is compared with the turns before and after it in which nobody
looks, so what changes over the run and on the machine counts for both. A page is a stream of events that is read (`curl`): the browser
that draws it is somewhere else. Prints steps a second, the mean of the shares with its standard error, and which share of all cores those who
look take. Single updates vary by a tenth: a percent needs turns of 8 s for some 25 minutes. Touches only processes that it has started, and files in a temporary directory. PROGRAM names the program where it is not target/release/leadtime.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

from processes import PROGRAM, end_all, free_port, need_program, spawn

# Seconds until the run is at its pace, and at the beginning of a turn that do not count: a watcher starts in them.
WARM_UP, SETTLE = 4, 1.0
KINDS = ["scraped", "pages", "played"]


def seconds_of(processes):
    """Processor time that processes have used so far."""
    fields = [Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split() for process in processes]
    return sum(int(field[11]) + int(field[12]) for field in fields) / os.sysconf("SC_CLK_TCK")


class Place:
    """A run and who looks at it, as processes, in a directory of their own."""

    def __init__(self, path, options):
        self.path, self.options, self.processes = path, options, []
        self.scraping = threading.Event()
        threading.Thread(target=self.scrape, daemon=True).start()
        scheme = "tls" if options.tls else "tcp"
        self.learner, self.status, self.page = f"{scheme}/127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
        if options.tls:
            self.finish("certs", "init", "pki")
            self.finish("certs", "issue", "pki", "learner:l1@127.0.0.1", "actor:a1", "observer:o1")
        learner = self.start("learner", "-c", options.task, "--name", "r", "--seed", "1", "--set", "learner.total_steps=1000000000", "--listen", self.learner,
                             "--status", self.status, *self.identity("l1"), *(["--acl", "pki/acl.json5"] if options.tls else []))
        actor = self.start("actor", "--connect", self.learner, "--id", "a1", *self.identity("a1"))
        self.run = [learner, actor]

    def identity(self, name):
        return ["--tls", f"pki/{name}"] if self.options.tls else []

    def finish(self, *words):
        subprocess.run([str(PROGRAM), *words], cwd=self.path, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def start(self, *words, program=PROGRAM):
        self.processes.append(spawn(self.path, "all", program, *words, stdout=subprocess.DEVNULL if program == "curl" else None))
        return self.processes[-1]

    def scrape(self):
        """Reads the status page once a second, whenever it is asked to."""
        while self.scraping.wait():
            with urllib.request.urlopen(f"http://{self.status}/metrics", timeout=5) as answer:
                answer.read()
            time.sleep(1)

    def look(self, kind):
        """Starts those who look."""
        if kind in ("scraped", "all"):
            self.scraping.set()
        if kind == "scraped":
            return []
        play = ["--play", "off"] if kind == "pages" else []
        watcher = self.start("watch", "--connect", self.learner, "--http", self.page, *play, *self.identity("o1"))
        reading = ["-sN", "--retry", "20", "--retry-connrefused", "--retry-delay", "0", f"http://{self.page}/events"]
        return [watcher, *(self.start(*reading, program="curl") for _ in range(1 if kind == "all" else self.options.pages))]

    def lines(self):
        """How many updates the run has made so far."""
        return (self.path / "runs/r/metrics.jsonl").read_bytes().count(b"\n")

    def rate(self, first):
        """Steps a second in the updates since the first one."""
        lines = (self.path / "runs/r/metrics.jsonl").read_text().splitlines()[first:]
        speeds = [json.loads(line)["system/steps_per_second"] for line in lines if line.endswith("}")]
        return statistics.harmonic_mean(speeds)

    def turn(self, kind):
        """Steps a second while somebody looks, or nobody (`None`), and the share of all cores that this takes."""
        looking = self.look(kind) if kind else []
        time.sleep(SETTLE)
        first, used, began = self.lines(), seconds_of(looking), time.monotonic()
        time.sleep(self.options.turn - SETTLE)
        rate, used = self.rate(first), seconds_of(looking) - used
        share = used / (time.monotonic() - began) / os.cpu_count()
        self.scraping.clear()
        self.end(looking)
        return rate, share

    def end(self, processes):
        end_all(processes)
        self.processes = [process for process in self.processes if process not in processes]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=50, help="for the whole of it")
    parser.add_argument("--turn", type=float, default=2.6, help="seconds of one turn")
    parser.add_argument("--pages", type=int, default=5)
    parser.add_argument("--tls", action="store_true", help="encrypted, with a list of who may do what")
    parser.add_argument("--task", default="lander")
    parser.add_argument("--kinds", default=",".join(KINDS))
    options = parser.parse_args()
    need_program()
    kinds, deadline = options.kinds.split(","), time.monotonic() + options.seconds
    with tempfile.TemporaryDirectory(prefix="observed-", ignore_cleanup_errors=True) as path:
        place = Place(Path(path), options)
        try:
            while not (Path(path) / "runs/r/metrics.jsonl").exists() or place.lines() < 3:
                if place.run[0].poll() is not None or time.monotonic() > deadline:
                    sys.exit(f"error: the run does not begin: {re.sub(chr(10), ' ', (Path(path) / 'all.log').read_text()[-2000:])}")
                time.sleep(0.05)
            time.sleep(WARM_UP)
            before, shares, alone = place.turn(None)[0], {}, []
            for i in range(10**6):
                if time.monotonic() + 2 * options.turn + 2 > deadline:
                    break
                kind = kinds[i % len(kinds)]
                (watched, used), (after, _) = place.turn(kind), place.turn(None)
                shares.setdefault(kind, []).append((watched, 2 * watched / (before + after), used))
                alone.append(before)
                before = after
        finally:
            place.end(place.processes)
    print(f"alone    {statistics.median(alone):8.0f} steps/s, {min(alone):.0f} to {max(alone):.0f}")
    for kind, found in shares.items():
        rates, parts, used = zip(*found)
        error = f"{100 * statistics.stdev(parts) / len(parts) ** 0.5:.1f}" if len(parts) > 1 else "?"
        print(f"{kind:8} {statistics.median(rates):8.0f} steps/s, {100 * statistics.mean(parts):.1f} % of alone (standard error {error}, {len(parts)} turns); "
              f"takes {100 * statistics.median(used):.2f} % of all cores")


if __name__ == "__main__":
    main()

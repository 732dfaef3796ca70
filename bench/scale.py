#!/usr/bin/env python3
"""How a run scales with its actors, its cores and its line; see scale.sh.

Every measurement is a run of its own: a learner and actors as separate processes, each with the cores that the system gives it.
Once all actors are there and a few updates are done, the CPU of every thread is read from /proc, and again after some seconds, both
times at the end of an update. With root, learner and actors are in network namespaces of their own with a cable between them, so
that bytes are counted by the kernel; a slow line is a relay in the actors' namespace.
"""

import argparse
import json
import os
import re
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from processes import free_port
from reckoning import FIGURES, Site, amount, least_lag, tables

PAGE = Path(__file__).resolve().parent.parent / "docs/scale.md"
CORES = len(os.sched_getaffinity(0))
LEARNER, ACTORS = "10.78.0.1", "10.78.0.2"
# Milliseconds that each byte is on the slow line, each way: hosts of one region, and hosts of two continents.
DELAY, FAR = 5, 50
# The share of the machine that other work may take.
QUIET = 0.1
# Seconds of CPU that a step of the slow world takes.
SLOW_STEP = 100e-6
# Rounds of arithmetic that are tried to find how many such a step has.
TRIED = 50_000
# The number of actors with which perf looks where the CPU goes.
PROFILED = 8
# Updates before anything is measured, and the least in which it is.
WARM, LEAST = 3, 4
# Seconds that a run may take until it is warm, and that its end may take.
PATIENCE, FAREWELL = 180, 20
# Samples a second that perf takes.
SAMPLES = 499
# What a thread does, by how its name begins; all others decide: they decode, check, count, and write what the run writes.
WORK = {"learner-train": "training", "actor-collect": "acting", "actor-restore": "acting"}
TRANSPORT = ("tx-", "rx-", "acc-", "net-", "app-", "link-", "actor-publish")
# Functions that encode, decode and checksum: within training and acting, too.
CODEC = re.compile(r"bincode|crc32c|safetensors|serde|codec|leadtime_proto")
# Every task with 256 environments, so that the learner trains on the same data however many actors send it: 16,384 steps in minibatches of 256.
LEARNING = ["learner.n_envs=256", "learner.n_minibatches=64", "learner.mode=lag", "learner.lag=1", "learner.n_steps=64"]
# The slow world: 4,096 steps in minibatches of 256. CartPole as small as many of its users have it: 1,024 steps.
SLOW = ["learner.n_envs=64", "learner.n_minibatches=16", "learner.n_steps=64"]
SMALL = ["learner.n_envs=16", "learner.n_minibatches=4", "learner.n_steps=64"]
# CartPole across an ocean, and the lags that are tried there.
LONG, LONG_LAGS = ["learner.n_envs=16", "learner.n_minibatches=16", "learner.n_steps=256"], (1, 4, 8, 16, 24)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--program", type=Path, help="slow_world, which has every world and command of leadtime, too")
    what.add_argument("--again", action="store_true", help="measure nothing: make the tables of the figures that are there")
    parser.add_argument("--quick", action="store_true", help="few and short measurements, to see that everything works")
    parser.add_argument("--seconds", type=float, help="how long each is measured (default 15; with --quick 2)")
    parser.add_argument("--write", action="store_true", help="write figures and tables into their files")
    return parser.parse_args()


def ip(*words):
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


class Hosts:
    """A host for the learner and one for the actors, with a cable between them; without root, both are this machine."""

    def __init__(self):
        self.names, self.problem = [], ""
        if os.geteuid() != 0 or not shutil.which("ip"):
            self.problem = "that needs root and `ip`"
            return
        try:
            for side in ("learner", "actors"):
                name = f"scale{os.getpid()}-{side}"
                ip("netns", "add", name)
                self.names.append(name)
                ip("-n", name, "link", "set", "lo", "up")
            ip("link", "add", "eth0", "netns", self.names[0], "type", "veth", "peer", "name", "eth0", "netns", self.names[1])
            for name, address in zip(self.names, (LEARNER, ACTORS)):
                ip("-n", name, "addr", "add", f"{address}/24", "dev", "eth0")
                ip("-n", name, "link", "set", "eth0", "up")
        except subprocess.CalledProcessError as error:
            self.remove()
            self.problem = f"no network namespaces can be made here: {error.stderr.strip()}"

    def at(self, side):
        """Returns what a command for that host begins with."""
        return [] if self.problem else ["ip", "netns", "exec", self.names[side]]

    def remove(self):
        for name in self.names:
            subprocess.run(["ip", "netns", "delete", name], stderr=subprocess.DEVNULL)


def cpu(pid):
    """Returns the seconds of CPU that the threads of a process have used, by what they do."""
    used = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        try:
            name, nanoseconds = (thread / "comm").read_text(), int((thread / "schedstat").read_text().split()[0])
        except OSError:
            continue  # It has ended.
        work = kind_of(name)
        used[work] = used.get(work, 0.0) + nanoseconds / 1e9
    return used


def kind_of(thread):
    work = next((work for start, work in WORK.items() if thread.startswith(start)), None)
    return work or ("transport" if thread.startswith(TRANSPORT) else "deciding")


def carried(pid):
    """Returns the bytes that a process's host has received and sent over its cable."""
    numbers = re.search(r"eth0: *(.*)", Path(f"/proc/{pid}/net/dev").read_text())[1].split()
    return int(numbers[0]), int(numbers[8])


def memory(pid):
    """Returns megabytes: the process's share of what it has in memory, and all of it."""
    sizes = dict(re.findall(r"^(Pss|Rss): +(\d+)", Path(f"/proc/{pid}/smaps_rollup").read_text(), flags=re.M))
    return int(sizes["Pss"]) / 1024, int(sizes["Rss"]) / 1024


def add(sum_of, used, sign=1):
    for work, seconds in used.items():
        sum_of[work] = sum_of.get(work, 0.0) + sign * seconds


class Failed(Exception):
    """A run that cannot be measured."""


class Run:
    """A learner and its actors, from their start to their end."""

    def __init__(self, bench, task, n_actors, settings, delay=0):
        self.place, program = Path(tempfile.mkdtemp(dir=bench.place)), bench.program
        self.is_local = bool(bench.hosts.problem)
        address = f"127.0.0.1:{free_port()}" if self.is_local else f"{LEARNER}:7447"
        changes = [f"run.actors_min={n_actors}", "evaluation.during_training=0", "learner.total_steps=1000000000", *settings]
        self.learner = self.start(bench.hosts.at(0), "learner", [
            program, "learner", "-c", task, "--name", "run", "--runs", self.place, "--seed", 1, "--listen", f"tcp/{address}",
            *(word for change in changes for word in ("--set", change))])
        self.line = None
        if delay:
            near = "127.0.0.1:7448"
            self.line = self.start(bench.hosts.at(1), "line", [program, "line", near, address, delay])
            address = near
        # More actors than cores stand for other machines, which do not keep a learner from its core.
        polite = ["nice", "-n", "10"] if n_actors > CORES else []
        self.actors = [self.start([*bench.hosts.at(1), *polite], "actors", [
            program, "actor", "--connect", f"tcp/{address}", "--id", f"a{i}", "--connect-timeout", f"{PATIENCE}s"])
            for i in range(1, n_actors + 1)]

    def start(self, host, name, words):
        with open(self.place / f"{name}.log", "ab") as log:
            return subprocess.Popen([*host, *map(str, words)], stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self.place,
                                    env={**os.environ, "NO_COLOR": "1", "RUST_LOG": "info" if name == "learner" else "warn"})

    def last(self):
        """Returns the last line of the run's metrics; nothing before the first."""
        try:
            with open(self.place / "run/metrics.jsonl", "rb") as file:
                file.seek(max(0, os.fstat(file.fileno()).st_size - 8_192))
                lines = file.read().split(b"\n")[:-1]
                return json.loads(lines[-1]) if lines else None
        except FileNotFoundError:
            return None

    def wait_for(self, what, look):
        """Waits until there is something to see, and returns it."""
        until = time.time() + PATIENCE
        while not (seen := look()):
            if time.time() > until or any(child.poll() is not None for child in [self.learner, *self.actors]):
                logs = "".join(log.read_text()[-2_000:] for log in self.place.glob("*.log"))
                raise Failed(f"no {what}, and the processes say:\n{logs}")
            time.sleep(0.005)
        return seen

    def wait(self, update):
        """Waits for the end of this update or a later one, and returns its metrics."""
        return self.wait_for(f"update {update}", lambda: (last := self.last()) and last["update"] >= update and last)

    def wait_for_actors(self):
        """Waits until the learner knows all actors."""
        log = self.place / "learner.log"
        self.wait_for("actors", lambda: log.read_text().count("actor joined") >= len(self.actors))

    def look(self):
        """Reads everything at the end of the coming update."""
        last = self.wait((self.last() or {"update": 0})["update"] + 1)
        acting = {}
        now, learner = time.time(), cpu(self.learner.pid)
        bytes_carried = (0, 0) if self.is_local else carried(self.learner.pid)
        for actor in self.actors:
            add(acting, cpu(actor.pid))
        return now, last, learner, acting, bytes_carried

    def end(self):
        """Ends every process; the learner tells its actors."""
        self.learner.send_signal(signal.SIGINT)
        until = time.time() + FAREWELL
        for child in [self.learner, *self.actors]:
            try:
                child.wait(max(0.1, until - time.time()))
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        if self.line:
            self.line.kill()
            self.line.wait()
        shutil.rmtree(self.place)


class Bench:
    def __init__(self, program):
        self.program, self.hosts = program.resolve(), Hosts()
        self.place = Path(tempfile.mkdtemp(prefix="leadtime-scale-"))

    def remove(self):
        self.hosts.remove()
        shutil.rmtree(self.place, ignore_errors=True)

    def measure(self, task, n_actors, settings, seconds, delay=0, profile=False):
        """Measures one run for these seconds at least."""
        run = Run(self, task, n_actors, settings, delay)
        try:
            run.wait(WARM)
            began, first, learner, acting, before = run.look()
            time.sleep(seconds)
            run.wait(first["update"] + LEAST - 1)
            ended, last, learner_after, acting_after, after = run.look()
            add(learner_after, learner, -1)
            add(acting_after, acting, -1)
            received, sent = (b - a for a, b in zip(before, after))
            sizes = [memory(actor.pid) for actor in run.actors[:: max(1, n_actors // 16)]]
            return {
                "task": task, "actors": n_actors, "settings": settings, "delay": delay, "seconds": ended - began,
                "steps": last["steps"] - first["steps"], "updates": last["update"] - first["update"], "learner": learner_after,
                "acting": acting_after, "received": received or None, "sent": sent or None,
                "actor_megabytes": [round(statistics.mean(size), 1) for size in zip(*sizes)],
                "learner_megabytes": round(memory(run.learner.pid)[1], 1),
                "samples": self.sampled(run, seconds) if profile else None,
            }
        finally:
            run.end()

    def idle(self, n_actors, seconds):
        """Returns seconds of the learner's CPU per second and actor while nothing happens: a run that waits for one more actor."""
        run = Run(self, "cartpole", n_actors, [*LEARNING, f"run.actors_min={n_actors + 1}"])
        try:
            run.wait_for_actors()
            # Greetings are over.
            time.sleep(2)
            began, before = time.time(), cpu(run.learner.pid)
            time.sleep(seconds)
            ended, used = time.time(), cpu(run.learner.pid)
            add(used, before, -1)
            return sum(used.values()) / (ended - began) / n_actors
        finally:
            run.end()

    def sampled(self, run, seconds):
        """Counts samples of where learner and actors are, by what the thread does, and those of them that encode or decode."""
        if not shutil.which("perf"):
            return None
        data, ids = run.place / "perf.data", ",".join(str(child.pid) for child in [run.learner, *run.actors])
        command = ["perf", "record", "-q", "-e", "cpu-clock", "-F", str(SAMPLES), "-o", data, "-p", ids, "--", "sleep", str(seconds)]
        if subprocess.run(command, capture_output=True).returncode != 0:
            return None
        script = subprocess.run(["perf", "script", "-i", data, "-F", "comm,ip,sym"], capture_output=True, text=True)
        counts = {}
        for line in script.stdout.splitlines():
            thread, _, function = (line.split(None, 2) + ["", "", ""])[:3]
            work = kind_of(thread)
            is_codec = work != "transport" and CODEC.search(function)
            add(counts, {"codec" if is_codec else work: 1})
        return counts

    def bare(self, rounds, n_steps):
        """Returns seconds of CPU per step of the slow world by itself: the least of three."""
        steps = []
        for _ in range(3):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([self.program, "bare", str(n_steps), str(rounds)], check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            steps.append((after.ru_utime - before.ru_utime) / n_steps)
        return min(steps)

    def all(self, quick, seconds):
        """Measures everything; returns the figures."""
        began, before = time.time(), busy()

        def measure(part, what, *how, **more):
            print(f"{time.time() - began:6.0f} s  {part}: {what}", file=sys.stderr, flush=True)
            try:
                figures[part].append(self.measure(*how, **more))
            except (Failed, OSError) as error:
                print(f"FAILED {error}", file=sys.stderr)
                figures["failed"].append(f"{part}: {what}")

        figures = {"processor": processor(), "cores": CORES, "seconds": seconds, "learner": [], "slow": [], "line": [], "failed": []}
        n_steps = 2_000 if quick else 10_000
        rounds = round(SLOW_STEP / self.bare(TRIED, n_steps) * TRIED)
        world = [f"world.rounds={rounds}"]
        figures["bare"] = self.bare(rounds, n_steps)
        figures["idle"] = self.idle(PROFILED if quick else 256, seconds)
        for task in ["lander"] if quick else ["slow", "lander", "cartpole"]:
            for n_actors in (1, PROFILED) if quick else (1, PROFILED, 64, 256):
                settings = LEARNING + (world if task == "slow" else [])
                measure("learner", f"{task}, {n_actors} actors", task, n_actors, settings, seconds, profile=n_actors == PROFILED)
        for _ in range(1 if quick else 3):
            for n_actors in powers(CORES):
                measure("slow", f"{n_actors} actors", "slow", n_actors, SLOW + world, seconds)
        # Again, because other work on the machine only makes it longer.
        figures["bare"] = min(figures["bare"], self.bare(rounds, n_steps))
        if self.hosts.problem:
            print(f"no bytes and no line: {self.hosts.problem}", file=sys.stderr)
        else:
            self.lines(measure, world, quick, seconds)
        return figures | {"others": others(time.time() - began, before, busy())}

    def lines(self, measure, world, quick, seconds):
        """Measures runs with and without a slow line."""
        lags = [["learner.mode=lag", f"learner.lag={lag}"] for lag in (1, 2, 4, 8)]
        small = [(SMALL, mode) for mode in (lags[:1] if quick else [["learner.mode=sync"], *lags])]
        slow = [] if quick else [(SLOW + world, mode) for mode in [["learner.mode=sync"], *lags[:2]]]
        for settings, mode in slow + small:
            task = "cartpole" if settings is SMALL else "slow"
            for delay in (0, DELAY):
                measure("line", f"{task}, {' '.join(mode)}, {delay} ms", task, CORES, settings + mode, seconds, delay)
        for lag in () if quick else LONG_LAGS:
            for delay in (0, FAR):
                measure("line", f"cartpole, lag {lag}, {delay} ms", "cartpole", 1, [*LONG, "learner.mode=lag", f"learner.lag={lag}"], seconds, delay)


def busy():
    """Returns seconds of CPU that all processes, and other machines on this processor, have used, and those of this measurement alone."""
    user, nice, system, _, _, _, _, steal = map(int, Path("/proc/stat").read_text().splitlines()[0].split()[1:9])
    own = [resource.getrusage(whose) for whose in (resource.RUSAGE_CHILDREN, resource.RUSAGE_SELF)]
    return (user + nice + system + steal) / os.sysconf("SC_CLK_TCK"), sum(used.ru_utime + used.ru_stime for used in own)


def others(took, before, after):
    """Returns the share of the machine that other work has taken, between two looks at how busy it was."""
    whole, own = (b - a for a, b in zip(before, after))
    return max(0.0, (whole - own) / (took * CORES))


def processor():
    model = re.search(r"^model name\s*: (.*)", Path("/proc/cpuinfo").read_text(), flags=re.M)
    return f"{CORES} cores ({model[1] if model else 'unknown'}), Linux {os.uname().release}"


def machine(figures):
    """Says where it was measured, for how long, and how much other work was going on there."""
    text = f"{figures['processor']}; each run was measured for {figures['seconds']:g} s. Other work took {100 * figures['others']:.0f} % of the machine"
    return text + ("." if is_quiet(figures) else ": CPU time says something all the same, steps per second do not, and are left out.")


def is_quiet(figures):
    return figures["others"] <= QUIET


def learner_table(cells, idle):
    lines = [f"An actor that is connected and does nothing costs the learner {1e6 * idle:.0f} us of CPU per second.", "",
             "| task | actors | the learner's CPU per million steps | of it training | deciding | transport | to the learner, bytes per "
             "step | from it | memory per actor, MB | of the learner, MB |", "|---|---|---|---|---|---|---|---|---|---|"]
    for cell in cells:
        per_million = {work: 1e6 * seconds / cell["steps"] for work, seconds in cell["learner"].items()}
        own, whole = cell["actor_megabytes"]
        lines.append(f"| `{cell['task']}` | {cell['actors']} | **{sum(per_million.values()):.2f} s** | {per_million['training']:.2f} | "
                     f"{per_million['deciding']:.2f} | {per_million['transport']:.2f} | {per_step(cell, 'received')} | "
                     f"{per_step(cell, 'sent')} | {own:.0f} ({whole:.0f}) | {cell['learner_megabytes']:.0f} |")
    return "\n".join(lines)


def per_step(cell, direction):
    return amount(cell[direction] / cell["steps"]) if cell[direction] else "–"


def share_table(cells):
    lines = ["| task | actors | CPU per step | acting | training | deciding | transport | codec, sampled |", "|---|---|---|---|---|---|---|---|"]
    for cell in cells:
        used = dict(cell["learner"])
        add(used, cell["acting"])
        whole = sum(used.values())
        shares = [f"{100 * used.get(work, 0) / whole:.1f} %" for work in ("acting", "training", "deciding", "transport")]
        counts = cell["samples"] or {}
        codec = f"{100 * counts.get('codec', 0) / sum(counts.values()):.1f} %" if counts else "–"
        lines.append(f"| `{cell['task']}` | {cell['actors']} | {amount(1e6 * whole / cell['steps'])} us | {' | '.join(shares)} | {codec} |")
    return "\n".join(lines)


def slow_table(figures):
    cells, bare = figures["slow"], figures["bare"]
    lines = [f"A step of the bare loop takes {1e6 * bare:.1f} us of CPU: {1 / bare:,.0f} steps/s on one core.", "",
             "| actors | steps/s (median, range) | of the bare loop on as many cores | of all CPU, the world's own steps |", "|---|---|---|---|"]
    for actors in dict.fromkeys(cell["actors"] for cell in cells):
        same = [cell for cell in cells if cell["actors"] == actors]
        rates = [cell["steps"] / cell["seconds"] for cell in same]
        whole = statistics.median((sum(cell["learner"].values()) + sum(cell["acting"].values())) / cell["steps"] for cell in same)
        middle = statistics.median(rates)
        wall = f"{middle:,.0f} ({min(rates):,.0f} to {max(rates):,.0f}) | {100 * middle * bare / min(actors, figures['cores']):.0f} %"
        lines.append(f"| {actors} | {wall if is_quiet(figures) else '– | –'} | {100 * bare / whole:.0f} % |")
    return "\n".join(lines)


def line_table(figures):
    if not is_quiet(figures):
        return "Left out: the machine was busy."
    cells = figures["line"]
    lines = ["| task | settings | steps/s without a line | ms each way | steps/s with it | kept | an update without a line | least lag, reckoned |",
             "|---|---|---|---|---|---|---|---|"]
    for near in (cell for cell in cells if not cell["delay"]):
        same = (cell for cell in cells if cell["delay"] and (cell["task"], cell["settings"]) == (near["task"], near["settings"]))
        far = next(same, None)
        if not far:
            continue
        rates = [cell["steps"] / cell["seconds"] for cell in (near, far)]
        update = near["seconds"] / near["updates"]
        mode = ", ".join(f"`{setting}`" for setting in near["settings"] if re.search(r"mode|lag", setting))
        lines.append(f"| `{near['task']}`, {near['steps'] // near['updates']:,} steps an update | {mode} | {rates[0]:,.0f} | {far['delay']} | {rates[1]:,.0f} | "
                     f"{100 * rates[1] / rates[0]:.0f} % | {1_000 * update:.0f} ms | {least_lag(2e-3 * far['delay'], update)} |")
    return "\n".join(lines)


def powers(end):
    """Returns 1, 2, 4, ... up to `end`, and `end`."""
    return sorted({*(1 << i for i in range(end.bit_length()) if 1 << i < end), end})


def write(part, text):
    """Puts a part into the page, between its markers."""
    begin, end = f"<!-- begin bench/scale.sh: {part} -->\n", "<!-- end -->"
    before, rest = PAGE.read_text().split(begin)
    PAGE.write_text(f"{before}{begin}{text}\n{rest[rest.index(end):]}")


def main():
    args = arguments()
    # What is to be removed in the end is removed then, too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    if args.again:
        figures = json.loads(FIGURES.read_text())
    else:
        bench = Bench(args.program)
        try:
            figures = bench.all(args.quick, args.seconds or (2 if args.quick else 15))
        except Failed as error:
            sys.exit(str(error))
        finally:
            bench.remove()
    profiled = [cell for cell in figures["learner"] if cell["actors"] == PROFILED]
    parts = {"machine": machine(figures), "learner": learner_table(figures["learner"], figures["idle"]), "shares": share_table(profiled),
             "slow": slow_table(figures), "line": line_table(figures), "reckoning": tables(figures, Site())}
    if args.write and not args.again:
        FIGURES.write_text(json.dumps(figures, indent=1) + "\n")
    for part, text in parts.items():
        print(f"\n{text}")
        if args.write:
            write(part, text)
    sys.exit("".join(f"failed: {what}\n" for what in figures["failed"]) or None)


if __name__ == "__main__":
    main()

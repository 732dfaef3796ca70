#!/usr/bin/env python3
"""A learner and its actors under everything that goes wrong on machines that other people use; see drill.sh.

One run is left in peace, over a unix socket. Then the same run is carried out by eight actors over TLS, with access by
certificate, through a relay, while it is hit at random: processes are killed or stopped, the network is cut, the disk is
full, certificates of a minute are renewed too late, strangers try to take part or flood the address. In the end both must have the
same weights, the books must balance, and nothing may be left behind. Touches only processes that it has started, and
files in its own directory.
"""

import argparse
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from processes import free_port

HOST = "127.0.0.1"
# The life of an actor's certificate, how long before its end it is made anew, and how often that is looked at.
LIFETIME, BEFORE, RENEW_EVERY = 60, 35, 10
# Seconds after which a process has had and lost connections, megabytes by which what it has allocated may grow from then on in any
# of its lives, and that it may have allocated at most.
SETTLED, GROWTH, MOST = 60, 6, 32
# Each thread's allocations come from a pool of its own otherwise, of which each fills to a height of its own. That takes a learner with
# eight actors twenty minutes and 16 MB, and hides what would not end.
ALLOCATOR = {"MALLOC_ARENA_MAX": "1"}
# Seconds that any command, and the run once the blows are over, may take.
PATIENCE = 1_200
# How a process may end by itself: in good order, by a certificate that has ended, without its learner.
GOOD_ENDS = {0, 2, 3}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", required=True, type=Path)
    parser.add_argument("--place", required=True, type=Path, help="an empty directory for everything that is made")
    parser.add_argument("--mode", choices=["sync", "lag"], default="lag")
    parser.add_argument("--task", default="lander")
    parser.add_argument("--steps", type=int, default=20_000_000)
    parser.add_argument("--actors", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=10, help="how long the blows last")
    parser.add_argument("--pause", type=float, default=3, help="mean seconds between blows")
    parser.add_argument("--blows", type=int, default=1, help="seed of the blows")
    return parser.parse_args()


class Relay:
    """Carries connections to the learner; while it is cut, nothing passes in either direction."""

    def __init__(self, target):
        self.target = target
        self.is_cut = False
        self.server = socket.create_server((HOST, 0), backlog=256)
        self.port = self.server.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                near, _ = self.server.accept()
            except OSError:
                # Too many open files, during a flood.
                time.sleep(0.1)
                continue
            try:
                far = socket.create_connection((HOST, self.target), timeout=2)
                far.settimeout(None)
            except OSError:
                near.close()
                continue
            for source, sink in [(near, far), (far, near)]:
                threading.Thread(target=self.carry, args=(source, sink), daemon=True).start()

    def carry(self, source, sink):
        try:
            while data := source.recv(1 << 16):
                while self.is_cut:
                    time.sleep(0.02)
                sink.sendall(data)
        except OSError:
            pass
        for end in (source, sink):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass


class Process:
    """A process of the run, started again whenever it has ended."""

    def __init__(self, drill, name, words):
        self.drill, self.name, self.words = drill, name, words
        self.child, self.stopped_until, self.start_at = None, None, 0.0
        self.memory, self.starts, self.started, self.own_ends = [], 0, 0.0, []

    def start(self):
        with open(self.drill.place / f"{self.name}.log", "ab") as log:
            self.child = self.drill.start(self.words, log)
        self.starts, self.started = self.starts + 1, time.time()
        self.memory.append([])

    def is_alive(self):
        return self.child is not None and self.child.poll() is None

    def look(self, now):
        """Samples memory, wakes it when its time has come, starts it again; returns its exit code if it has just ended."""
        if self.child is None:
            if now >= self.start_at:
                self.start()
            return None
        code = self.child.poll()
        if code is not None:
            # One that the learner has sent home is not wanted any more.
            pause = float("inf") if code == 0 else random.uniform(0, 3)
            self.child, self.stopped_until, self.start_at = None, None, now + pause
            if code != -signal.SIGKILL:
                self.own_ends.append(code)
            return code
        if self.stopped_until and now >= self.stopped_until:
            os.kill(self.child.pid, signal.SIGCONT)
            self.stopped_until = None
        if (megabytes := resident(self.child.pid)) is not None:
            self.memory[-1].append((now - self.started, *megabytes))
        return None

    def kill(self):
        os.kill(self.child.pid, signal.SIGKILL)

    def stop(self, until):
        os.kill(self.child.pid, signal.SIGSTOP)
        self.stopped_until = until

    def growth(self):
        """Returns of the life in which it grew most its seconds and the megabytes allocated once it had settled and at its end; of all
        lives the most that it had allocated, and took."""
        lives = [life for life in self.memory if life and life[-1][0] > 2 * SETTLED]
        spans = [(life[-1][0], next(own for at, own, _ in life if at >= SETTLED), life[-1][1]) for life in lives]
        seconds, first, last = max(spans, key=lambda span: span[2] - span[1], default=(0, 0, 0))
        samples = [sample for life in self.memory for sample in life]
        return seconds, first, last, *(max((sample[i] for sample in samples), default=0) for i in (1, 2))


def resident(pid):
    """Returns the megabytes that a process has allocated, and all that it takes, the used parts of its program included."""
    try:
        lines = [line.split() for line in Path(f"/proc/{pid}/status").read_text().splitlines()]
    except OSError:
        return None
    kilobytes = {words[0]: int(words[1]) for words in lines if words[0] in ("RssAnon:", "VmRSS:")}
    # One that has just ended has none.
    return (kilobytes["RssAnon:"] / 1024, kilobytes["VmRSS:"] / 1024) if len(kilobytes) == 2 else None


class Drill:
    def __init__(self, args):
        self.args, self.place = args, args.place.resolve()
        self.runs, self.certificates = self.place / "runs", self.place / "certificates"
        self.temporary = self.place / "tmp"
        for folder in (self.runs, self.temporary):
            folder.mkdir(parents=True)
        self.children, self.began = [], time.time()
        self.counts, self.counting, self.intruders = {}, threading.Lock(), []
        self.random = random.Random(args.blows)
        random.seed(args.blows)
        self.told = set()

    def start(self, words, log):
        child = subprocess.Popen([self.args.program, *map(str, words)], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                 start_new_session=True, env={**os.environ, "TMPDIR": str(self.temporary), "NO_COLOR": "1", **ALLOCATOR})
        self.children.append(child)
        return child

    def run(self, *words):
        return subprocess.run([self.args.program, *map(str, words)], stdin=subprocess.DEVNULL, capture_output=True, text=True,
                              timeout=PATIENCE, env={**os.environ, "TMPDIR": str(self.temporary), "NO_COLOR": "1"})

    def must(self, *words):
        done = self.run(*words)
        if done.returncode != 0:
            sys.exit(f"{' '.join(map(str, words))}: {done.stderr}")
        return done

    def say(self, text):
        print(f"{time.time() - self.began:7.1f} s  {text}", flush=True)

    def count(self, blow):
        with self.counting:
            self.counts[blow] = self.counts.get(blow, 0) + 1

    def task(self, name):
        return ["-c", self.args.task, "--name", name, "--runs", self.runs, "--seed", 1,
                "--set", f"learner.mode={self.args.mode}", "--set", f"learner.total_steps={self.args.steps}"]

    def calm(self):
        self.say("the run in peace")
        self.must("up", *self.task("calm"), "--actors", 2, "-q")

    def prepare(self):
        """Makes certificates, the list of who may do what, and a stranger with an authority of its own."""
        known = self.certificates
        self.must("certs", "init", known)
        self.must("certs", "issue", known, "learner", "learner", "--host", HOST)
        for i in range(1, self.args.actors + 1):
            self.must("certs", "issue", known, "actor", f"a{i}", "--lifetime", f"{LIFETIME}s")
        self.must("certs", "issue", known, "observer", "o1", "--host", HOST)
        self.must("certs", "acl", known, "-o", known / "access.json5")
        self.must("certs", "init", self.place / "stranger")
        self.must("certs", "issue", self.place / "stranger", "actor", "a1", "--host", HOST)
        port = free_port()
        self.relay = Relay(port)
        self.learner = Process(self, "learner", [
            "learner", *self.task("wild"), "--listen", f"tls/{HOST}:{port}", "--tls", known / "learner",
            "--acl", known / "access.json5"])
        self.actors = [Process(self, f"a{i}", [
            "actor", "--connect", f"tls/{HOST}:{self.relay.port}", "--id", f"a{i}", "--tls", known / f"a{i}",
            "--connect-timeout", "30s", "--reconnect-timeout", "45s"])
            for i in range(1, self.args.actors + 1)]

    def wild(self):
        self.say(f"the run under blows, {self.args.minutes:g} minutes of them")
        everybody = [self.learner, *self.actors]
        end = time.time() + 60 * self.args.minutes
        next_blow, cut_until, full_until = time.time() + 5, 0.0, 0.0
        next_renewal = time.time() + RENEW_EVERY
        # Nobody should need longer than this once the blows are over.
        last = end + PATIENCE
        while time.time() < last:
            now = time.time()
            for process in everybody:
                code = process.look(now)
                if code is not None and process is self.learner and code == 0:
                    return True
            if self.relay.is_cut and now >= cut_until:
                self.relay.is_cut = False
            if full_until and now >= full_until:
                full_until = 0.0
                (self.runs / "filler").unlink(missing_ok=True)
            if now >= next_renewal:
                next_renewal = now + RENEW_EVERY
                self.must("certs", "renew", self.certificates, "--before", f"{BEFORE}s")
            if now < end and now >= next_blow:
                next_blow = now + self.random.expovariate(1 / self.args.pause)
                blow = self.random.choices(
                    ["kill", "stop", "cut", "full disk", "late renewal", "stranger", "false name", "flood"],
                    [30, 25, 10, 4, 2, 8, 8, 4])[0]
                target = self.learner if self.random.random() < 0.2 else self.random.choice(self.actors)
                if blow in ("kill", "stop"):
                    if not target.is_alive() or target.stopped_until:
                        continue
                    who = "learner" if target is self.learner else "actor"
                    self.count(f"{blow} {who}")
                    if blow == "kill":
                        target.kill()
                    else:
                        target.stop(now + self.random.uniform(1, 8 if who == "learner" else 20))
                elif blow == "cut":
                    self.relay.is_cut, cut_until = True, now + self.random.uniform(1, 10)
                    self.count(blow)
                elif blow == "full disk":
                    if os.path.ismount(self.runs) and not full_until:
                        full_until = now + self.random.uniform(3, 15)
                        fill(self.runs / "filler")
                        self.count(blow)
                elif blow == "late renewal":
                    # All of them end, and a moment later there are new ones.
                    if next_renewal < now + RENEW_EVERY:
                        next_renewal = now + LIFETIME + self.random.uniform(1, 10)
                        self.count(blow)
                elif blow in ("stranger", "false name"):
                    shown = self.place / "stranger" / "a1" if blow == "stranger" else self.certificates / "o1"
                    name = "a1" if blow == "stranger" else "a2"
                    self.intruders.append(threading.Thread(target=self.intrude, args=(blow, shown, name)))
                    self.intruders[-1].start()
                else:
                    threading.Thread(target=self.flood, daemon=True).start()
                    self.count(blow)
            time.sleep(0.05)
        return False

    def fat(self):
        growths = {process.name: process.growth() for process in [self.learner, *self.actors]}
        return {name: it for name, it in growths.items() if it[2] - it[1] > GROWTH or it[3] > MOST}

    def intrude(self, blow, tls, name):
        """Tries to take part as somebody who may not; nobody must let it in."""
        done = self.run("actor", "--connect", f"tls/{HOST}:{self.relay.port}", "--id", name, "--tls", tls,
                        "--connect-timeout", "5s")
        self.count(blow)
        if done.returncode == 0:
            self.count(f"{blow} LET IN")
        self.told.add(f"{blow}, exit {done.returncode}: {done.stderr.strip().splitlines()[-1:] or ['']}"[:300])

    def flood(self):
        """Opens connections that say nothing, or nonsense."""
        ends = []
        for i in range(200):
            try:
                end = socket.create_connection((HOST, self.relay.port), timeout=1)
                if i % 2:
                    end.sendall(os.urandom(4_096))
                ends.append(end)
            except OSError:
                break
        time.sleep(5)
        for end in ends:
            end.close()

    def conclude(self, is_done):
        """Checks what must hold at the end; returns what does not."""
        for intruder in self.intruders:
            intruder.join(PATIENCE)
        for actor in self.actors:
            if actor.is_alive() and actor.stopped_until:
                os.kill(actor.child.pid, signal.SIGCONT)
        # One that was stopped or cut off at the end has not heard of it, and looks for the learner a while.
        patience = time.time() + 90
        while time.time() < patience and any(actor.is_alive() for actor in self.actors):
            time.sleep(0.1)
        stayed = [actor.name for actor in self.actors if actor.is_alive()]
        for process in [self.learner, *self.actors]:
            if process.is_alive():
                process.kill()
                process.child.wait()
        time.sleep(1)
        orphans = [child.pid for child in self.children if child.poll() is None]
        crashed = {it.name: it.own_ends for it in [self.learner, *self.actors] if set(it.own_ends) - GOOD_ENDS}
        left = sorted(os.listdir(self.temporary))
        same = self.run("runs", "compare", "calm", "wild", "--runs", self.runs)
        record = json.loads((self.runs / "wild" / "run.json").read_text())
        books = (record.get("result") or {}).get("books") or {}
        wrong = [text for text, holds in [
            ("the run did not finish", is_done),
            ("the books do not balance", books.get("balanced") is True),
            ("the weights differ from those of the run in peace", "weights: equal" in same.stdout),
            (f"actors that did not leave: {stayed}", not stayed),
            (f"processes left behind: {orphans}", not orphans),
            (f"files left in the temporary directory: {left}", not left),
            (f"processes that ended by themselves with other codes than {GOOD_ENDS}: {crashed}", not crashed),
            (f"processes that grow: {self.fat()}", not self.fat()),
            ("somebody was let in who may not", not any("LET IN" in blow for blow in self.counts)),
        ] if not holds]
        report(self, books, record)
        return wrong


def fill(path):
    """Writes until the disk is full."""
    try:
        with open(path, "wb") as file:
            while True:
                file.write(b"\0" * (1 << 16))
                file.flush()
    except OSError:
        pass


def report(drill, books, record):
    print(f"\nmode {drill.args.mode}, {drill.args.actors} actors, {drill.args.task}, {drill.args.steps} steps")
    for blow, n in sorted(drill.counts.items()):
        print(f"  {n:5}  {blow}")
    for process in [drill.learner, *drill.actors]:
        seconds, first, last, most, all_ = process.growth()
        ends = f", ended by itself with {process.own_ends}" if process.own_ends else ""
        print(f"  {process.name:8} {process.starts:3} starts; allocated {first:.1f} MB after {SETTLED} s and {last:.1f} MB at the end, after {seconds:.0f} s, "
              f"of the life in which it grew most; {most:.1f} MB at most, {all_:.0f} MB with the used parts of the program{ends}")
    for told in sorted(drill.told):
        print(f"  told: {told}")
    kept = {key: books.get(key) for key in ("published", "trained", "refused", "superseded", "rolled_back", "duplicates")}
    print(f"  books: {kept}, resumed {record.get('resumed')} times")


def main():
    args = arguments()
    if args.place.exists() and any(args.place.iterdir()):
        sys.exit(f"{args.place} is not empty")
    drill = Drill(args)
    is_mounted = os.geteuid() == 0 and subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=96m", "none", drill.runs], stderr=subprocess.DEVNULL).returncode == 0
    if not is_mounted:
        drill.say("the disk is not filled: a disk of its own can be made by root only")
    try:
        drill.calm()
        drill.prepare()
        wrong = drill.conclude(drill.wild())
    finally:
        for child in drill.children:
            if child.poll() is None:
                child.kill()
                child.wait()
        if is_mounted:
            shutil.copytree(drill.runs, drill.place / "kept", ignore=shutil.ignore_patterns("filler", "checkpoints"),
                            dirs_exist_ok=True)
            subprocess.run(["umount", drill.runs])
    print("\n" + ("\n".join(wrong) if wrong else "everything holds: equal weights, balanced books, nothing left behind"))
    sys.exit(1 if wrong else 0)


main()

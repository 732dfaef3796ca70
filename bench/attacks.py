#!/usr/bin/env python3
"""What a stranger on a network without TLS can do to a run, and what the honest members notice of it.

    pip install eclipse-zenoh==1.10.2 crc32c blake3 pynacl
    bench/attacks.py [ATTACK...] [--seconds 5] [--router]
    bench/attacks.py mutate --seconds 900 --updates 40000

For each attack a learner and two actors train a small task on this machine. They are left in peace, attacked, and left in peace
again. Prints updates a second of the three stretches, the learner's largest memory, what became of the actors (of a third one that
joins during the attack, too), and whether the run ended with the weights of an undisturbed one and balanced books. Touches only processes that it
has started, and files in a temporary directory. PROGRAM names the program where it is not target/release/leadtime.
"""

import argparse
import contextlib
import json
import os
import random
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import zenoh

from mutations import Mutations
from processes import PROGRAM, end_all, free_port, need_program, spawn
from stranger import ROLLOUT, STOP, Network, Start, assign, header, numbers

RUN = "-c cartpole --seed 5 --set learner.n_envs=8 --set learner.n_steps=64 --set learner.n_minibatches=4 --set learner.mode=sync --set evaluation.during_training=0"
STEPS_PER_UPDATE = 8 * 64
# Questions of a connection whose answers are not read: the library starts a thread for each.
UNREAD = 40
# Changed messages that `mutate` sends, if there is time for them, and with which seed.
N_MUTATED, SEED = 1_000_000, 7


# --- the attacks: each lasts until `end`, by time.monotonic() ------------------------------------------------------


def sequence(network, end):
    """Sends rubbish under the next numbers of live actors, as their credit tells them."""
    credits = {}
    take = lambda sample: credits.__setitem__(str(sample.key_expr).split("/")[-1], numbers(bytes(sample.payload)[:-64]))
    subscriber = network.session.declare_subscriber(f"{network.root}/credit/*", take)
    while time.monotonic() < end:
        for actor, (start, _, acknowledged, _) in list(credits.items()):
            for ahead in range(1, 9):
                key = f"{network.root}/traj/cartpole/{actor}"
                head = header(ROLLOUT, b"rubbish", start, acknowledged + ahead)
                public = network.publics.get(actor, network.start.public)
                network.session.put(key, b"rubbish" + public + os.urandom(32), attachment=head)
        time.sleep(0.002)
    subscriber.undeclare()


def on_live_keys(send):
    def attack(network, end):
        """Sends what has no header, so that nobody can be charged for it, on the keys of live actors."""
        keys = []
        for actor, start in network.actors.items():
            keys += [f"{network.root}/{key}" for key in (f"traj/cartpole/{actor}", f"credit/{actor}", f"alive/actor/{actor}/{start:016x}")]
        while time.monotonic() < end:
            for key in keys:
                send(network.session, key)
            time.sleep(0.002)
    return attack


def orders(*controls):
    def attack(network, end):
        while time.monotonic() < end:
            for control in controls:
                network.order(control)
            time.sleep(0.5)
    return attack


def readers(n):
    def attack(network, end):
        """Subscribes to everything and does not read on."""
        others = [Network(network.endpoint) for _ in range(n)]
        stop = lambda _: time.sleep(max(0, end - time.monotonic()))
        network.held.extend(other.session.declare_subscriber("leadtime/**", stop) for other in others)
        network.held.extend(others)
        time.sleep(max(0, end - time.monotonic()))
    return attack


def ghosts(n):
    def attack(network, end):
        """Members with nobody behind: presence and hello, and no answer to any order."""
        starts = [Start() for _ in range(n)]
        for i, ghost in enumerate(starts):
            network.show(f"{network.root}/alive/actor/ghost-{i}/{ghost.number:016x}")
        while time.monotonic() < end:
            for i, ghost in enumerate(starts):
                network.greet(ghost, f"ghost-{i}")
            time.sleep(0.05)
    return attack


def silent(network, end):
    """300 connections on which nothing is ever said."""
    host, port = network.endpoint.removeprefix("tcp/").split(":")
    for _ in range(300):
        network.held.append(socket.create_connection((host, int(port)), timeout=5))
    time.sleep(max(0, end - time.monotonic()))


def fat(network, end):
    """Questions of 31 MB on four connections, and small ones on six, whose answers are not read."""
    wait = lambda _: time.sleep(max(0, end - time.monotonic()))

    def work(key, body):
        other = Network(network.endpoint)
        network.held.append(other)
        for _ in range(UNREAD):
            if time.monotonic() < end:
                other.ask(key, body, take=wait, timeout=20)
    places = [("weights/cartpole/latest", b"")] * 6 + [("ctl/hello", bytes(31 << 20))] * 4
    threads = [threading.Thread(target=work, args=place, daemon=True) for place in places]
    [thread.start() for thread in threads]
    time.sleep(max(0, end - time.monotonic()))


def other_run(network, end):
    """Shows the learner of a run that is not there."""
    network.show("leadtime/1/other/alive/learner/learner/0000000000000001")
    time.sleep(max(0, end - time.monotonic()))


def frames(network, end):
    """Connections on which bits are flipped on the way to the other side: in what the network library itself reads."""
    draws = random.Random(SEED)
    host, port = network.endpoint.removeprefix("tcp/").split(":")
    server = socket.create_server(("127.0.0.1", 0))
    network.held.append(server)

    def carry(source, sink, is_changed):
        with contextlib.suppress(OSError):
            while data := bytearray(source.recv(1 << 16)):
                if is_changed and draws.random() < 0.2:
                    for _ in range(draws.randrange(1, 4)):
                        data[draws.randrange(len(data))] ^= 1 << draws.randrange(8)
                sink.sendall(data)
        for side in (source, sink):
            with contextlib.suppress(OSError):
                side.shutdown(socket.SHUT_RDWR)

    def accept():
        with contextlib.suppress(OSError):
            while True:
                near = server.accept()[0]
                far = socket.create_connection((host, int(port)))
                for way in ((near, far, True), (far, near, False)):
                    threading.Thread(target=carry, args=way, daemon=True).start()

    def work():
        own = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        settings = {"mode": "client", "connect": {"endpoints": [own], "timeout_ms": 1000}, "scouting": {"multicast": {"enabled": False}}}
        while time.monotonic() < end:
            with contextlib.suppress(zenoh.ZError):
                with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))) as session:
                    session.liveliness().declare_token(f"{network.root}/alive/actor/frames/{draws.getrandbits(64):016x}")
                    session.declare_subscriber(f"{network.root}/credit/*", lambda _: None)
                    for _ in range(50):
                        session.put(f"{network.root}/traj/cartpole/frames", b"rubbish" * 20, attachment=bytes(48))
                        session.get(f"{network.root}/weights/cartpole/latest", lambda _: None, timeout=1)
    for task in (accept, work, work, work, work):
        threading.Thread(target=task, daemon=True).start()
    time.sleep(max(0, end - time.monotonic()))


def mutate(network, end):
    """Genuine messages of all kinds, changed; see mutations.py."""
    network.mutations = Mutations(network, SEED)
    network.mutations.listen()
    # Orders and hellos are heard when somebody joins.
    network.mutations.hear_all(patience=30)
    network.mutations.attack(N_MUTATED, end)


ATTACKS = {
    "sequence": sequence,
    "garbage": on_live_keys(lambda session, key: session.put(key, b"garbage")),
    "delete": on_live_keys(lambda session, key: session.delete(key)),
    "stop": orders(STOP),
    "far": orders(assign(2**48, []), assign(2**40, [])),
    "snapshot": orders(assign(2**40, [(0, 3, b"\x01\x02")])),
    "many": orders(assign(2**40, [(i, 0, b"") for i in range(20_000)])),
    "reader": readers(1),
    "readers": readers(4),
    "ghost": ghosts(1),
    "ghosts": ghosts(10),
    "ghosts100": ghosts(100),
    "silent": silent,
    "fat": fat,
    "other-run": other_run,
    "frames": frames,
    "mutate": mutate,
}

# --- the run that is attacked --------------------------------------------------------------------------------------


def leave(held):
    """Gives up what the library holds for us."""
    held.close() if isinstance(held, zenoh.Session) else held.undeclare()


class Trial:
    """A learner and its actors."""

    def __init__(self, path, steps, has_router):
        self.path, self.actors, self.others, self.peaks = path, {}, {}, {}
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.router = [self.start("router", "router", "--listen", self.endpoint)] if has_router else []
        at = "--connect" if has_router else "--listen"
        self.learner = self.start("learner", "learner", *RUN.split(), "--name", "r", "--set", f"learner.total_steps={steps}", at, self.endpoint)
        for name in ("a1", "a2"):
            self.join(name)

    def start(self, name, *words):
        return spawn(self.path, name, PROGRAM, *words)

    def join(self, name):
        self.actors[name] = self.start(name, "actor", "--connect", self.endpoint, "--id", name, "--connect-timeout", "30s")

    def processes(self):
        routers = {"router": router for router in self.router}
        return {"learner": self.learner, **routers, **self.actors, **self.others}

    def updates(self):
        metrics = self.path / "runs/r/metrics.jsonl"
        return metrics.read_bytes().count(b"\n") if metrics.exists() else 0

    def memory(self):
        """Megabytes of every process that lives."""
        found = {}
        for name, process in self.processes().items():
            try:
                status = Path(f"/proc/{process.pid}/status").read_text()
            except OSError:
                continue
            found |= {name: int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmRSS")}
        return found

    def watch(self, end, while_=lambda: True):
        """Notes memory until then, or until the learner ends."""
        while time.monotonic() < end and self.learner.poll() is None and while_():
            time.sleep(0.05)
            for name, megabytes in self.memory().items():
                self.peaks[name] = max(self.peaks.get(name, 0), megabytes)

    def rate(self, *stretches):
        """Updates a second of what is watched."""
        began, before = time.monotonic(), self.updates()
        for stretch in stretches:
            stretch()
        return (self.updates() - before) / (time.monotonic() - began)

    def wait(self, seconds):
        """Waits for the end, and returns the exit codes: of the learner, of the actors; `None` of one that had to be killed."""
        deadline, codes = time.monotonic() + seconds, []
        for process in [self.learner, *self.actors.values()]:
            try:
                codes.append(process.wait(max(0.1, deadline - time.monotonic())))
            except subprocess.TimeoutExpired:
                codes.append(None)
            deadline = max(deadline, time.monotonic() + 6)
        self.kill()
        return codes

    def kill(self):
        end_all(self.processes().values(), patience=0)

    def result(self):
        return json.loads((self.path / "runs/r/run.json").read_text()).get("result") or {}


def peace(path, steps, has_router):
    """The weights of an undisturbed run, and its updates a second."""
    trial, began = Trial(path, steps, has_router), time.monotonic()
    codes = trial.wait(1800)
    if codes != [0, 0, 0]:
        sys.exit(f"error: an undisturbed run ended with {codes}: {(path / 'learner.log').read_text()[-2000:]}")
    return trial.result()["weights_sha256"], trial.updates() / (time.monotonic() - began)


def attack(path, name, steps, has_router, weights, seconds):
    """Attacks a run, and returns the outcome as a row of the table."""
    # Behind a router without a list everybody hears everything; a learner that listens passes no rollouts on.
    trial = Trial(path, steps, has_router or name == "mutate")
    try:
        deadline = time.monotonic() + 30
        while trial.updates() < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        if name == "mutate":
            trial.others["observer"] = trial.start("observer", "watch", "--connect", trial.endpoint, "--run", "r", "--http", "127.0.0.1:0")
        pause = min(5, seconds / 2)
        rates = [trial.rate(lambda: trial.watch(time.monotonic() + pause))]
        network, end, before = Network(trial.endpoint), time.monotonic() + seconds, trial.memory()
        thread = threading.Thread(target=ATTACKS[name], args=(network, end), daemon=True)
        thread.start()
        first = lambda: trial.watch(time.monotonic() + 1)
        rates.append(trial.rate(first, lambda: trial.join("late"), lambda: trial.watch(end, thread.is_alive)))
        thread.join(5)
        for held in [*network.held, network.session]:
            {Network: lambda it: it.session.close(), socket.socket: socket.socket.close}.get(type(held), leave)(held)
        rates.append(trial.rate(lambda: trial.watch(time.monotonic() + pause)))
        after, others = trial.memory(), {name: process.poll() for name, process in trial.processes().items()}
        codes = trial.wait(1800)
        result = trial.result()
        same = "equal" if result.get("weights_sha256") == weights else "OTHER" if result else "NO END"
        balanced = "balanced" if result.get("books", {}).get("balanced") else "-"
        row = f"{name:10} {rates[0]:7.1f} {rates[1]:7.1f} {rates[2]:7.1f}   {trial.peaks['learner']:5.0f} MB   {str(codes):22} {same:7} {balanced}"
        return row + (details(trial, network.mutations, before, after, others, result) if name == "mutate" else "")
    finally:
        trial.kill()


def details(trial, mutations, before, after, ends, result):
    """What was sent, what became of it, and what the processes made of it."""
    lines = ["", f"  sent {mutations.n:,} with seed {SEED}, {mutations.n_moles:,} members of our own: " + listed(mutations.sent), "  of them " + listed(mutations.ways)]
    lines.append("  refused by the learner: " + listed(result.get("books", {}).get("refusals", {})))
    for name, process in trial.processes().items():
        log = (trial.path / f"{name}.log").read_text(errors="replace")
        told = Counter()
        for line in log.splitlines():
            if "message refused" in line and (found := re.search(r"kind=\"?(\w+)\"? n=(\d+)", line)):
                told[found[1]] += int(found[2])
        refused = f", refused at least {listed(told)}" if told else ""
        lines.append(
            f"  {name:9} {before.get(name, 0):5.0f} MB before, {trial.peaks.get(name, 0):5.0f} at most, {after.get(name, 0):5.0f} after, "
            f"{log.count('panicked')} panics, {'alive' if ends[name] is None else f'ended with {ends[name]}'} when it was over{refused}"
        )
    return "\n".join(lines)


def listed(counts):
    return ", ".join(f"{n:,} {name}" for name, n in sorted(counts.items(), key=lambda it: -it[1]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("attacks", nargs="*", metavar="ATTACK", help=f"of {', '.join(ATTACKS)}; all of them by default")
    parser.add_argument("--seconds", type=float, default=5, help="for which a run is attacked")
    parser.add_argument("--updates", type=int, default=4000, help="of each run: enough to outlast the attack")
    parser.add_argument("--router", action="store_true", help="all dial a router without a list, instead of a learner that listens")
    options = parser.parse_args()
    unknown = set(options.attacks) - set(ATTACKS)
    if unknown:
        sys.exit(f"error: no attack {unknown}")
    need_program()
    steps = options.updates * STEPS_PER_UPDATE
    with tempfile.TemporaryDirectory(prefix="attacks-", ignore_cleanup_errors=True) as place:
        place = Path(place)
        (place / "peace").mkdir()
        weights, rate = peace(place / "peace", steps, options.router)
        print(f"undisturbed: {rate:.1f} updates a second\n{'attack':10} {'before':>7} {'during':>7} {'after':>7}   {'memory':>8}   {'exit codes':22} weights books", flush=True)
        for name in options.attacks or ATTACKS:
            (place / name).mkdir()
            print(attack(place / name, name, steps, options.router, weights, options.seconds), flush=True)


if __name__ == "__main__":
    main()

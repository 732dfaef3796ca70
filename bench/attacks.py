#!/usr/bin/env python3
"""What a stranger on a network without TLS can do to a run, and what the honest members notice of it.

    pip install eclipse-zenoh==1.10.2 crc32c blake3 pynacl
    bench/attacks.py [ATTACK...] [--seconds 5] [--router]

For each attack a learner and two actors train a small task on this machine. They are left in peace, attacked, and left in peace
again. Prints updates a second of the three stretches, the learner's largest memory, what became of the actors (of a third one that
joins during the attack, too), and whether the run ended with the weights of an undisturbed one and balanced books. Touches only processes that it
has started, and files in a temporary directory. PROGRAM names the program where it is not target/release/leadtime.
"""

import argparse
import functools
import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import nacl.bindings as sodium
import zenoh
from blake3 import blake3
from crc32c import crc32c

from processes import PROGRAM, end_all, free_port, need_program, spawn

# What messages hold, as in proto/src/header.rs.
HELLO, CONTROL, ROLLOUT = 1, 3, 5
RUN = "-c cartpole --seed 5 --set learner.n_envs=8 --set learner.n_steps=64 --set learner.n_minibatches=4 --set learner.mode=sync --set evaluation.during_training=0"
STEPS_PER_UPDATE = 8 * 64
# Questions of a connection whose answers are not read: the library starts a thread for each.
UNREAD = 40


def number(n):
    """As the codec writes whole numbers."""
    for size, tag, form in ((1 << 16, 251, "<H"), (1 << 32, 252, "<I"), (1 << 64, 253, "<Q")):
        if n < 251:
            return bytes([n])
        if n < size:
            return bytes([tag]) + struct.pack(form, n)
    raise ValueError(n)


def numbers(message):
    """Reads a message that holds whole numbers only."""
    found = []
    while message:
        size = {251: 2, 252: 4, 253: 8}.get(message[0], 0)
        found.append(int.from_bytes(message[1 : 1 + size], "little") if size else message[0])
        message = message[1 + size :]
    return found


def text(words):
    return number(len(words.encode())) + words.encode()


@functools.cache
def protocol():
    """The version of the messages that the program speaks: others are refused unread."""
    return int(subprocess.check_output([PROGRAM, "version", "--protocol"]))


def header(schema, payload, start, sequence=0, epoch=0, version=0):
    return struct.pack("<4sIIIQQQQ", b"LDTM", schema, crc32c(payload), protocol(), start, sequence, epoch, version)


class Start:
    """The keys of a start of the stranger's own, as in crates/link/src/proof.rs."""

    PURPOSE = "leadtime 2026-12-01 messages between a learner and an actor"

    def __init__(self):
        self.public, self.secret = sodium.crypto_sign_keypair()
        self.number = struct.unpack("<Q", blake3(self.public).digest()[:8])[0]
        self.hellos = 0

    def signed(self, head, body):
        """A message for all, with its proof."""
        signature = sodium.crypto_sign(blake3(head + body).digest(), self.secret)[: sodium.crypto_sign_BYTES]
        return body + self.public + signature

    def proved(self, peer, head, body):
        """A message for the start with this public key, with its proof."""
        to = sodium.crypto_sign_ed25519_pk_to_curve25519(peer)
        shared = sodium.crypto_scalarmult(sodium.crypto_sign_ed25519_sk_to_curve25519(self.secret), to)
        key = blake3(shared + min(self.public, peer) + max(self.public, peer), derive_key_context=self.PURPOSE).digest()
        return body + self.public + blake3(head + body, key=key).digest()


def hello(actor, start):
    return text("stranger") + text(actor) + number(start) + text("any") + number(0) + number(1)


def assign(epoch, envs):
    given = (number(env) + number(iteration) + number(len(snapshot)) + snapshot for env, iteration, snapshot in envs)
    return number(0) + number(epoch) + number(len(envs)) + b"".join(given) + number(0)


STOP = number(1) + text("a stranger says so") + b"\x01"


class Network:
    """A stranger's place on the network."""

    def __init__(self, endpoint):
        settings = {"mode": "client", "connect": {"endpoints": [endpoint]}, "scouting": {"multicast": {"enabled": False}}}
        self.endpoint, self.session = endpoint, zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
        self.actors, self.held, self.start, self.publics = {}, [], Start(), {}
        for reply in self.session.liveliness().get("leadtime/1/*/alive/*/*/*", timeout=2):
            if reply.ok is not None:
                _, _, run, _, role, name, start = str(reply.ok.key_expr).split("/")
                self.root = f"leadtime/1/{run}"
                if role == "learner":
                    self.learner = int(start, 16)
                else:
                    self.actors[name] = int(start, 16)
        # Public keys stand behind what is published, in front of a proof. A learner that listens passes no rollouts on: there the
        # stranger puts its own key in their place, and its proofs do not hold.
        behind = lambda sample: self.publics.setdefault(str(sample.key_expr).split("/")[-1], bytes(sample.payload)[-64:-32])
        self.held.append(self.session.declare_subscriber(f"{self.root}/traj/**", behind))

    def show(self, key):
        self.held.append(self.session.liveliness().declare_token(key))

    def ask(self, key, payload, head=None, take=None, timeout=5):
        body = {"payload": payload, "attachment": head} if head else {"payload": payload}
        take = take or (lambda reply: None)
        self.session.get(f"{self.root}/{key}", take, timeout=timeout, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE, **body)

    def order(self, control):
        """In the learner's name, and in the stranger's own with a proof that holds where the actor's public key is known."""
        for actor, start in self.actors.items():
            place, peer = f"ctl/actor/{actor}?incarnation={start}", self.publics.get(actor, self.start.public)
            for number in (self.learner, self.start.number):
                head = header(CONTROL, control, number)
                self.ask(place, self.start.proved(peer, head, control), head)

    def greet(self, ghost, actor):
        ghost.hellos += 1
        body = hello(actor, ghost.number)
        head = header(HELLO, body, ghost.number, ghost.hellos)
        self.ask("ctl/hello", ghost.signed(head, body), head)


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
}

# --- the run that is attacked --------------------------------------------------------------------------------------


def leave(held):
    """Gives up what the library holds for us."""
    held.close() if isinstance(held, zenoh.Session) else held.undeclare()


class Trial:
    """A learner and its actors."""

    def __init__(self, path, steps, has_router):
        self.path, self.actors, self.peak = path, {}, 0
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

    def updates(self):
        metrics = self.path / "runs/r/metrics.jsonl"
        return metrics.read_bytes().count(b"\n") if metrics.exists() else 0

    def watch(self, end):
        """Updates a second until then, or until the learner ends."""
        began, before = time.monotonic(), self.updates()
        while time.monotonic() < end and self.learner.poll() is None:
            time.sleep(0.05)
            try:
                status = Path(f"/proc/{self.learner.pid}/status").read_text()
            except OSError:
                continue
            self.peak = max(self.peak, *(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")), 0)
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
        end_all([self.learner, *self.actors.values(), *self.router], patience=0)

    def result(self):
        return json.loads((self.path / "runs/r/run.json").read_text()).get("result") or {}


def peace(path, steps, has_router):
    """The weights of an undisturbed run, and its updates a second."""
    trial, began = Trial(path, steps, has_router), time.monotonic()
    codes = trial.wait(300)
    if codes != [0, 0, 0]:
        sys.exit(f"error: an undisturbed run ended with {codes}: {(path / 'learner.log').read_text()[-2000:]}")
    return trial.result()["weights_sha256"], trial.updates() / (time.monotonic() - began)


def attack(path, name, steps, has_router, weights, seconds):
    """Attacks a run, and returns the outcome as a row of the table."""
    trial = Trial(path, steps, has_router)
    try:
        deadline = time.monotonic() + 30
        while trial.updates() < 3 and time.monotonic() < deadline:
            time.sleep(0.02)
        rates = [trial.watch(time.monotonic() + seconds / 2)]
        network, end = Network(trial.endpoint), time.monotonic() + seconds
        thread = threading.Thread(target=ATTACKS[name], args=(network, end), daemon=True)
        thread.start()
        rates.append(trial.watch(time.monotonic() + 1))
        trial.join("late")
        rates[-1] = (rates[-1] + (seconds - 1) * trial.watch(end)) / seconds
        thread.join(5)
        for held in [*network.held, network.session]:
            {Network: lambda it: it.session.close(), socket.socket: socket.socket.close}.get(type(held), leave)(held)
        rates.append(trial.watch(time.monotonic() + seconds / 2))
        codes = trial.wait(120)
        result = trial.result()
        same = "equal" if result.get("weights_sha256") == weights else "OTHER" if result else "NO END"
        balanced = "balanced" if result.get("books", {}).get("balanced") else "-"
        return f"{name:10} {rates[0]:7.1f} {rates[1]:7.1f} {rates[2]:7.1f}   {trial.peak // 1024:5} MB   {str(codes):22} {same:7} {balanced}"
    finally:
        trial.kill()


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

"""A stranger on a network without TLS: the bytes of messages, keys of its own, and a place beside the members of a run."""

import functools
import json
import os
import struct
import subprocess

import nacl.bindings as sodium
import zenoh
from blake3 import blake3
from crc32c import crc32c

from processes import PROGRAM

# What messages hold, as in proto/src/header.rs.
HELLO, CONTROL, ROLLOUT = 1, 3, 5


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

    def shared(self, peer):
        """What a start with this public key and this one share."""
        to = sodium.crypto_sign_ed25519_pk_to_curve25519(peer)
        secret = sodium.crypto_scalarmult(sodium.crypto_sign_ed25519_sk_to_curve25519(self.secret), to)
        return blake3(secret + min(self.public, peer) + max(self.public, peer), derive_key_context=self.PURPOSE).digest()

    def proved(self, peer, head, body):
        """A message for the start with this public key, with its proof."""
        return body + self.public + blake3(head + body, key=self.shared(peer)).digest()


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

"""A worker in Python's standard library alone: CartPole, and everything that can go wrong with a worker.

    python3 tests/worker/fake.py [MODE [FILE]]

A mode misbehaves in the process that finds FILE missing and makes it; the worker that is started in its place is a good one. Without
FILE every process misbehaves. `never-closes` writes into FILE when each process was asked to end.
"""

import json
import math
import os
import pickle
import random
import signal
import socket
import struct
import sys
import threading
import time

HELLO, BEGIN, STEP, STEPPED, SNAPSHOT, SNAPSHOTTED, LOG, FAILED, ALIVE = range(1, 10)
MODE, FILE = (sys.argv[1:] + ["", ""])[:2]
AFTER = 40  # Steps frames before a worker misbehaves.


class CartPole:
    """Gymnasium's CartPole-v1 in 64-bit numbers."""

    def reset(self, seed):
        draws = random.Random(seed)
        self.state = [draws.uniform(-0.05, 0.05) for _ in range(4)]
        self.steps = 0
        return self.state

    def step(self, action):
        x, v, angle, turn = self.state
        force = 10.0 if action else -10.0
        cos, sin = math.cos(angle), math.sin(angle)
        pushed = (force + 0.05 * turn * turn * sin) / 1.1
        swing = (9.8 * sin - cos * pushed) / (0.5 * (4.0 / 3.0 - 0.1 * cos * cos / 1.1))
        slide = pushed - 0.05 * swing * cos / 1.1
        self.state = [x + 0.02 * v, v + 0.02 * slide, angle + 0.02 * turn, turn + 0.02 * swing]
        self.steps += 1
        fallen = abs(self.state[0]) > 2.4 or abs(self.state[2]) > 0.2095
        return self.state, 1.0, fallen, self.steps >= 200


def send(out, kind, body=b""):
    out.sendall(struct.pack("<IB", len(body), kind) + body)


def failed(out, slot, text):
    send(out, FAILED, struct.pack("<H", slot) + text.encode())


def lifeline():
    while os.read(0, 100):
        pass
    os._exit(0)


def misbehaves():
    """Tells whether this process is one that does."""
    if not MODE or not FILE:
        return bool(MODE)
    try:
        os.close(os.open(FILE, os.O_CREAT | os.O_EXCL))
        return True
    except FileExistsError:
        return False


def main():
    config = json.loads(os.environ["LEADTIME_WORKER_CONFIG"])
    bad = MODE if misbehaves() else ""
    threading.Thread(target=lifeline, daemon=True).start()
    if bad == "ends-at-once":
        sys.exit("no module named my_envs")
    if bad == "killed-at-once":
        os.kill(os.getpid(), signal.SIGKILL)
    out = socket.socket(socket.AF_UNIX)
    out.connect(os.environ["LEADTIME_WORKER_SOCKET"])
    incoming = out.makefile("rb")
    if bad == "killed-before-hello":
        os.kill(os.getpid(), signal.SIGKILL)
    if bad == "garbage-hello":
        out.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        time.sleep(60)
    if bad == "cannot-import":
        failed(out, 0xFFFF, "ModuleNotFoundError: No module named 'my_envs'")
        return
    names = {"heads": ["action"], "metrics": config["metrics"], "versions": {"fake": config["env"].get("version", "1")}}
    send(out, HELLO, struct.pack("<4sHHIBBB", b"LDWK", 1, config["batch"], 4, 1, 2, 0) + json.dumps(names).encode())
    print("a worker prints this", flush=True)
    envs, n_frames, n_shared, noise = {}, 0, 0, random.Random(str(time.time_ns()))
    while True:
        header = incoming.read(5)
        if len(header) < 5:
            if MODE == "closes":
                time.sleep(0.2)
                os.rename(FILE, FILE + ".closed")
            if MODE == "never-closes":
                with open(FILE, "a") as asked:
                    asked.write(f"{time.monotonic()}\n")
                time.sleep(600)
            return
        length, kind = struct.unpack("<IB", header)
        body = incoming.read(length)
        if kind == SNAPSHOT:
            env = envs[struct.unpack("<H", body)[0]]
            # As one whose pickle is what it was made with.
            send(out, SNAPSHOTTED, pickle.dumps(CartPole() if bad == "empty-pickle" else env))
            continue
        n, at = struct.unpack_from("<H", body)[0], 2
        rows, rewards, ends, rest = [], [], [], b""
        for _ in range(n):
            if kind == BEGIN:
                slot, seed, size, pickled = struct.unpack_from("<HIII", body, at)
                base, actions = body[at + 14 : at + 14 + pickled], body[at + 14 + pickled : at + 10 + size]
                at += 10 + size
                if bad == "cannot-reset":
                    failed(out, slot, "ValueError: no display")
                    rows += [0.0] * 4
                    rewards.append(0.0)
                    ends.append(3)
                    continue
                if bad == "makes-slowly" and slot == 1 and slot not in envs:
                    time.sleep(1.5)
                env = envs[slot] = pickle.loads(base) if base else CartPole()
                observation = getattr(env, "state", [0.0] * 4) if base else env.reset(seed)
                for action in actions:
                    observation = env.step(action)[0]
                if bad == "is-elsewhere":
                    observation = env.state = [noise.random() for _ in range(4)]
                reward, end = 0.0, 0
            else:
                slot, seed, action = struct.unpack_from("<HIB", body, at)
                at += 7
                env = envs[slot]
                if bad in ("raises", "raises-and-moves") and n_frames >= AFTER and slot == 0 or bad == "raises-at-once":
                    failed(out, slot, "IndexError: list index out of range (my_envs.py:40)")
                    rows += [0.0] * 4
                    rewards.append(0.0)
                    ends.append(3)
                    # A pole that has fallen and goes on: it must be put back.
                    env.state = [9.0] * 4
                    bad = "is-elsewhere" if bad == "raises-and-moves" else bad if not FILE else ""
                    continue
                observation, reward, fallen, late = env.step(action)
                end = 1 if fallen else 2 if late else 0
                if end:
                    rest += struct.pack("<4f", *observation)
                    rest += struct.pack(f"<{len(config['metrics'])}f", *[float(env.steps >= 200)] * len(config["metrics"]))
                    observation = env.reset(seed)
            if bad == "shares":
                # What all environments of the process count together.
                n_shared += 1
                observation = [float(n_shared), *observation[1:]]
            if bad == "numbered":
                observation = [float(slot), *observation[1:]]
            if bad == "random" and kind == STEP:
                observation = [noise.random()] * 4
                env.state = observation
            if bad == "nan" and n_frames >= AFTER:
                observation = [0.0, 0.0, 0.0, math.nan]
            if bad == "huge-reward" and n_frames >= AFTER:
                reward = 2e9
            rows += observation
            rewards.append(reward)
            ends.append(end)
        n_frames += kind == STEP
        if n_frames == AFTER and kind == STEP:
            if bad == "hangs":
                time.sleep(600)
            if bad == "exits":
                print("out of fuel", flush=True)
                sys.exit(7)
            if bad == "garbage":
                out.sendall(os.urandom(4096))
                continue
            if bad == "huge-frame":
                out.sendall(struct.pack("<IB", 2**31, STEPPED))
                time.sleep(600)
        send(out, STEPPED, struct.pack("<H", n) + struct.pack(f"<{4 * n}f", *rows) + struct.pack(f"<{n}f", *rewards) + bytes(ends)
             + struct.pack(f"<{n}Q", *[2**64 - 1] * n) + rest)


main()

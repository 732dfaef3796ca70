"""CPU time per step of an environment in a bare loop, and of leadtime.worker that steps the same for an actor that costs nothing.

    python3 bench/python_worker.py [ID] [ENVIRONMENTS] [STEPS]

Runs from the repository's root and needs gymnasium only.
"""

import json
import os
import random
import resource
import socket
import struct
import subprocess
import sys
import tempfile
import time

import gymnasium

NAME, N, STEPS = (sys.argv[1:] + ["CartPole-v1", "16", "200000"][len(sys.argv) - 1 :])[:3]
N, STEPS = int(N), int(STEPS)


def bare():
    env = gymnasium.make(NAME, disable_env_checker=True)
    draws, n_choices = random.Random(1), int(env.action_space.n)
    env.reset(seed=1)
    actions = [draws.randrange(n_choices) for _ in range(4096)]
    started, wall = time.process_time(), time.monotonic()
    for i in range(STEPS):
        _, _, terminated, truncated, _ = env.step(actions[i % 4096])
        if terminated or truncated:
            env.reset(seed=i)
    return STEPS / (time.process_time() - started), STEPS / (time.monotonic() - wall)


def through_worker():
    with tempfile.TemporaryDirectory() as place:
        path = place + "/socket"
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(path)
        listener.listen()
        os.environ["LEADTIME_WORKER_SOCKET"] = path
        os.environ["LEADTIME_WORKER_CONFIG"] = json.dumps({"env": {"id": NAME}, "metrics": [], "batch": N})
        listener.settimeout(60)
        process = subprocess.Popen([sys.executable, "python/leadtime/worker.py"], stdin=subprocess.PIPE)
        worker, connection = process.pid, listener.accept()[0]
        end = connection.makefile("rb", 1 << 16)

        def ask(kind, body):
            connection.sendall(struct.pack("<IB", len(body), kind) + body)
            return answer()

        def answer():
            while True:
                length, kind = struct.unpack("<IB", end.read(5))
                body = end.read(length)
                if kind not in (7, 9):
                    return body

        n_choices = answer()[13]
        ask(2, struct.pack("<H", N) + b"".join(struct.pack("<HIII", slot, slot, 4, 0) for slot in range(N)))
        draws = random.Random(1)
        frames = [struct.pack("<H", N) + b"".join(struct.pack("<HIB", slot, draws.randrange(1 << 31), draws.randrange(n_choices))
                                                  for slot in range(N)) for _ in range(256)]
        with open(f"/proc/{worker}/stat") as stat:
            before = stat.read().split()
        wall, n_frames = time.monotonic(), STEPS // N
        for i in range(n_frames):
            ask(3, frames[i % 256])
        wall = time.monotonic() - wall
        with open(f"/proc/{worker}/stat") as stat:
            after = stat.read().split()
        ticks = sum(int(after[i]) - int(before[i]) for i in (13, 14))
        connection.shutdown(socket.SHUT_RDWR)
        process.wait()
        return n_frames * N / (ticks / os.sysconf("SC_CLK_TCK")), n_frames * N / wall


loop, loop_wall = bare()
worker, worker_wall = through_worker()
print(json.dumps({"environment": NAME, "environments": N, "bare steps/s of CPU": round(loop), "worker steps/s of CPU": round(worker),
                  "microseconds added": round(1e6 / worker - 1e6 / loop, 2), "bare steps/s": round(loop_wall),
                  "worker steps/s": round(worker_wall), "MB": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024}))

"""A robot that is spoken to: sends what it sees, prints what its listener is told, and why nobody speaks.

    pip install eclipse-zenoh==1.10.2
    leadtime serve deploy/policies/piloting.safetensors --listen tcp/127.0.0.1:7448
    python3 examples/live/client.py tcp/127.0.0.1:7448
"""
import json
import math
import secrets
import sys
import time

import zenoh

if len(sys.argv) < 2:
    sys.exit("which notifier? client.py tcp/HOST:PORT [SECONDS PER STEP]")
ENDPOINT = sys.argv[1]
STEP = float(sys.argv[2]) if len(sys.argv) > 2 else 0.3
CLIENT, KEY = "robot-1", "leadtime/live/1/notifier/robot-1"
START = secrets.token_hex(8)
here, opener = set(), None


def seen(step):
    """What a lander sees that drifts down: x, y, their speeds, tilt, spin, legs."""
    x = 0.4 * math.sin(step / 15)
    return [x, max(0.0, 1.4 - step / 80), 0.1 * math.cos(step / 15), -0.2, 0.0, 0.0, 0.0, 0.0]


def on_say(sample):
    said = json.loads(sample.payload.to_string())
    if said["event"] == "start":
        print(f"{said['step']:3}  {said.get('text', '')}  ({said['topic']}, understood after {said['k']} of {said['l']} words)")
    elif said["event"] == "cut":
        print(f"{said['step']:3}  ... cut after {said['heard']} words")


def on_status(sample):
    status = json.loads(sample.payload.to_string())
    if status["state"] in ("stale", "lost", "closed") or status["told"]:
        print(f"     {status['state']}: {status['why']} {status['told']}")


def on_presence(sample):
    start, has_come = str(sample.key_expr).rsplit("/", 1)[1], sample.kind == zenoh.SampleKind.PUT
    (here.add if has_come else here.discard)(start)
    # One that is started again may show its new token before the old one goes.
    if opener and opener not in here and (has_come or start == opener or not here):
        print("     the notifier was started again: ask it for a session again" if here else "     the notifier is gone: nobody speaks")


config = zenoh.Config.from_json5(json.dumps({
    "mode": "client", "connect": {"endpoints": [ENDPOINT]}, "scouting": {"multicast": {"enabled": False}}}))
try:
    session = zenoh.open(config)
except zenoh.ZError:
    sys.exit(f"nobody answers at {ENDPOINT}: start `leadtime serve` there first")
with session:
    # Kept as long as it speaks: without it, nobody knows that this robot is there.
    token = session.liveliness().declare_token(f"{KEY}/alive/{START}")
    session.declare_subscriber(f"{KEY}/say", on_say)
    session.declare_subscriber(f"{KEY}/status", on_status)
    session.liveliness().declare_subscriber("leadtime/live/1/notifier/alive/*", on_presence, history=True)
    question = {"protocol": 1, "domain": "lander", "seconds_per_step": STEP, "incarnation": START, "seed": 1}
    reply = next(iter(session.get(f"{KEY}/open", payload=json.dumps(question))), None)
    if reply is None:
        sys.exit(f"no notifier is at work at {ENDPOINT}: a learner and a router answer there, too")
    if reply.ok is None:
        said = reply.err.payload.to_string()
        # The network's word for one that is there and stands still.
        sys.exit("the notifier does not answer" if said == "Timeout" else f"refused: {said}")
    answer = json.loads(reply.ok.payload.to_string())
    opener = answer.get("start")
    print(f"session {answer['session']}: {answer['obs_dim']} numbers, topics {', '.join(answer['topics'])}")
    sights = session.declare_publisher(
        f"{KEY}/obs", encoding="application/json", priority=zenoh.Priority.REAL_TIME, express=True)
    for step in range(100):
        sights.put(json.dumps({"seq": step + 1, "t": time.monotonic(), "obs": seen(step), "end": step == 99}))
        time.sleep(STEP)

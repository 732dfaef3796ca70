"""Reproduces the decisions of a policy with numpy: python3 decide.py POLICY.safetensors STEPS.jsonl

The steps come from `leadtime eval POLICY --action greedy --episodes-to STEPS.jsonl`; docs/policy-file.md has the formulas.
"""
import json, sys
import numpy as np

data = open(sys.argv[1], "rb").read()
start = 8 + int.from_bytes(data[:8], "little")
header = json.loads(data[8:start])
spec = json.loads(header.pop("__metadata__")["architecture"])
types = {"F32": "<f4", "F64": "<f8"}
tensors = {}
for name, entry in header.items():
    begin, end = (start + offset for offset in entry["data_offsets"])
    tensors[name] = np.frombuffer(data[begin:end], types[entry["dtype"]]).reshape(entry["shape"])
encoder = spec["encoder"]
if encoder != "Identity" and "Lstm" not in encoder:
    sys.exit("this policy attends to entities: docs/policy-file.md has the formulas")
layers = [f"actor.{i}" for i in range(len(spec["hidden"]))]

def dense(layer, x):
    return tensors[layer + ".weight"] @ x + tensors[layer + ".bias"]

def lstm(x, hidden, cell):
    if "encoder.projection.weight" in tensors:
        x = np.tanh(dense("encoder.projection", x))
    gates = np.split(dense("encoder.input", x) + dense("encoder.state", hidden), 4)
    enter, keep, leave = (1 / (1 + np.exp(-gates[i])) for i in (0, 1, 3))
    cell = keep * cell + enter * np.tanh(gates[2])
    return leave * np.tanh(cell), cell

def logits(step):
    global state
    x = np.array(step["observation"])
    if spec["normalize_observations"]:
        mean, scale = tensors["normalizer.mean"], 1 / np.sqrt(tensors["normalizer.variance"] + 1e-8)
        x = (x.astype(np.float32) - mean.astype(np.float32)) * scale.astype(np.float32)
        x = np.clip(x, -10, 10).astype(float)
    if encoder != "Identity":
        if step["step"] == 0:
            state = np.zeros((2, encoder["Lstm"]["state"]))
        state = lstm(x, *state)
        x = state[0]
    for layer in layers:
        x = np.tanh(dense(layer, x))
    return dense("actor.head", x)

def greedy(logits, offered):
    action, first = [], 0
    for index, head in enumerate(spec["actions"]["heads"]):
        allowed = np.array(offered[first : first + head["n_choices"]])
        for rule in spec["actions"]["conditionals"]:
            if rule["head"] == index:
                bits = rule["allowed"][action[rule["given"]]]
                allowed &= [bits >> choice & 1 == 1 for choice in range(len(allowed))]
        action.append(int(np.argmax(np.where(allowed, logits[first : first + len(allowed)], -np.inf))))
        first += len(allowed)
    return action

steps = [json.loads(line) for line in open(sys.argv[2])]
computed = [logits(step) for step in steps]
error = max(np.abs(ours - step["logits"]).max() for ours, step in zip(computed, steps))
same = sum(greedy(ours, step["offered"]) == step["action"] for ours, step in zip(computed, steps))
print(f"{same} of {len(steps)} decisions reproduced; logits differ by {error:.1e} at most")
sys.exit(0 if same == len(steps) and error < 1e-4 else 1)

"""Checks of leadtime.export: run with the package, onnx and onnxruntime installed, from the repository's root.

The logits of every shipped policy, and their states, are those of leadtime.policy within 1e-5, on a walk of observations. Those of
a policy with attention are the program's, as crates/policy/tests/recorded_attention.rs recorded them, and a number far from zero is
normalised as in crates/policy/src/normalizer.rs.
"""

import json
import os
import tempfile
from pathlib import Path

import numpy as np
import onnxruntime

from leadtime.export import to_onnx
from leadtime.policy import Policy, load

POLICIES = ["deploy/policies/piloting", "deploy/policies/piloting_hard", "deploy/policies/driving", "deploy/policies/cooking",
            "tests/data/attention"]
STEPS = 250


def exported(policy):
    with tempfile.TemporaryDirectory() as place:
        path = os.path.join(place, "policy.onnx")
        to_onnx(policy, path)
        return onnxruntime.InferenceSession(path)


# A path may be of either kind.
for given in ("tests/data/attention.safetensors", Path("tests/data/attention.safetensors")):
    assert exported(given).get_outputs()[0].name == "logits"


for name in POLICIES:
    policy = load(f"{name}.safetensors")
    session = exported(policy)
    draws, state = np.random.default_rng(7), policy.begin()
    attention = policy.spec["encoder"].get("EgoAttention") if isinstance(policy.spec["encoder"], dict) else None
    worst, steps = 0.0, []
    for _ in range(STEPS):
        x = draws.normal(size=policy.obs_dim).astype(np.float32)
        if attention:
            # Cars that are there and cars that are not, and now and then nobody.
            width = attention["n_entities"] * attention["n_features"] + attention["action_dim"]
            for frame in range(attention["n_frames"]):
                first = slice(frame * width, frame * width + attention["n_entities"] * attention["n_features"], attention["n_features"])
                x[first] = draws.random(attention["n_entities"]) < draws.choice([0.0, 0.3, 0.9])
        feed = {"observation": x[None]}
        if state is not None:
            feed["state"] = state[None].astype(np.float32)
        found = dict(zip([output.name for output in session.get_outputs()], session.run(None, feed)))
        logits, state = policy.logits(x, state)
        scale = max(1.0, float(np.abs(logits).max()))
        worst = max(worst, float(np.abs(found["logits"][0] - logits).max()) / scale)
        if state is not None:
            worst = max(worst, float(np.abs(found["next_state"][0] - state).max()))
        steps.append((x, logits))
        assert found["value"].shape == (1, 1)
    if state is None:
        batch = session.run(["logits"], {"observation": np.stack([x for x, _ in steps])})[0]
        assert batch.shape == (STEPS, len(steps[0][1]))
        assert np.allclose(batch, [logits for _, logits in steps], atol=1e-4)
    assert worst < 1e-5, (name, worst)
    print(f"{name}: {STEPS} steps within {worst:.1e}")

session = exported(load("tests/data/attention.safetensors"))
with open("tests/data/attention.jsonl") as lines:
    recorded = [json.loads(line) for line in lines]
observations = np.array([step["observation"] for step in recorded], np.float32)
logits, values = session.run(["logits", "value"], {"observation": observations})
for step, of_step, value in zip(recorded, logits, values):
    far = max(np.abs(of_step - step["logits"]).max(), abs(value[0] - step["value"]))
    assert far < 1e-5, (step["case"], far)
print(f"attention, {len(recorded)} cases: the program's numbers")

heads = [{"name": "a", "n_choices": 2}]
spec = {"obs_dim": 1, "normalize_observations": True, "encoder": "Identity", "hidden": [], "actions": {"heads": heads}}
weight, bias = np.array([[1], [-1]], np.float32), np.zeros(2, np.float32)
far = Policy(spec, {"normalizer.mean": np.array([10_000.0003]), "normalizer.variance": np.array([1e-4]),
                    "actor.head.weight": weight, "actor.head.bias": bias,
                    "critic.head.weight": weight[:1], "critic.head.bias": bias[:1]}, {})
logits = exported(far).run(["logits"], {"observation": np.array([[10_000.01]], np.float32)})[0]
assert np.abs(logits - [0.976514, -0.976514]).max() < 1e-5, logits
print("a number far from zero: the program's")

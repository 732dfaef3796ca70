"""Checks of leadtime.export: run with the package, onnx and onnxruntime installed, from the repository's root.

The logits of every shipped policy, and their states, are those of leadtime.policy within 1e-5, on a walk of observations.
"""

import os
import tempfile

import numpy as np
import onnxruntime

from leadtime.export import to_onnx
from leadtime.policy import load

POLICIES = ["piloting", "piloting_hard", "driving", "cooking"]
STEPS = 250

for name in POLICIES:
    policy = load(f"deploy/policies/{name}.safetensors")
    with tempfile.TemporaryDirectory() as place:
        path = os.path.join(place, "policy.onnx")
        to_onnx(policy, path)
        session = onnxruntime.InferenceSession(path)
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

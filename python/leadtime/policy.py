"""Policies of Leadtime in numpy: no Rust and no framework is needed to act with one.

    from leadtime.policy import load

    policy = load("deploy/policies/piloting.safetensors")
    state = policy.begin()
    choices, state = policy.act(observation, state=state, mask=info["action_mask"], greedy=True)

The formulas are those of docs/policy-file.md. Logits agree with the program's within rounding, not in every bit.
"""

import hashlib
import json
from dataclasses import dataclass, field

import numpy as np

TYPES = {"F32": "<f4", "F64": "<f8"}
LONGEST_HEADER = 100 << 20
PRESENT = 0.5  # Least presence of a row that is there.
ABSENT = -1e9  # The score of a row that is not.


class PolicyError(ValueError):
    """A file is no policy that can be used here."""


def load(path):
    """Reads a policy file."""
    with open(path, "rb") as file:
        data = file.read()
    try:
        start = 8 + int.from_bytes(data[:8], "little")
        if not 8 < start <= min(len(data), LONGEST_HEADER):
            raise ValueError("it is no safetensors file")
        header = json.loads(data[8:start])
        metadata = header.pop("__metadata__", {})
        tensors = read_tensors(header, data[start:])
        if "architecture" not in metadata:
            raise ValueError("it does not say what its networks look like")
        policy = Policy(json.loads(metadata["architecture"]), tensors, metadata)
        logits, _ = policy.logits(np.zeros(policy.obs_dim), policy.begin())
        n_choices = sum(head["n_choices"] for head in policy.spec["actions"]["heads"])
        if logits.shape != (n_choices,):
            raise ValueError(f"it has {logits.size} logits for {n_choices} choices")
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise PolicyError(f"{path} is no policy of Leadtime: {error}") from error
    if metadata.get("weights_sha256", digest_of(tensors)) != digest_of(tensors):
        raise PolicyError(f"{path} is damaged: its weights are not those that were written; take the file from a copy")
    return policy


def read_tensors(header, data):
    """Reads the tensors of a safetensors file, which lie one behind the other."""
    tensors, covered = {}, 0
    for name, entry in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
        begin, end = entry["data_offsets"]
        if begin != covered or end > len(data):
            raise ValueError(f"the tensor {name} is not where its file has room for it")
        tensors[name], covered = np.frombuffer(data[begin:end], TYPES[entry["dtype"]]).reshape(entry["shape"]), end
        if not np.isfinite(tensors[name]).all():
            raise ValueError(f"the tensor {name} holds a value that is not finite")
    if covered != len(data):
        raise ValueError(f"{len(data) - covered} bytes follow the last tensor")
    return tensors


def digest_of(tensors):
    """Returns the SHA-256 over names and numbers that `weights_sha256` has."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(name.encode())
        digest.update(tensors[name].tobytes())
    return digest.hexdigest()


def normalizer_of(tensors):
    """Returns what an observation is reduced by, and then multiplied with: in 32 bits, as the program has them."""
    scale = 1 / np.sqrt(tensors["normalizer.variance"] + 1e-8)
    return tensors["normalizer.mean"].astype(np.float32), scale.astype(np.float32)


def softmax(x):
    e = np.exp(x - x.max())
    return e / e.sum()


@dataclass
class Policy:
    """A policy: what its file says of it, and how it acts."""

    spec: dict
    tensors: dict = field(repr=False)
    metadata: dict = field(repr=False)

    @property
    def obs_dim(self):
        """Length of an observation."""
        return self.spec["obs_dim"]

    @property
    def heads(self):
        """The heads of an action: each with its name and those of its choices."""
        if "actions" in self.metadata:
            return [(head["name"], head["choices"]) for head in json.loads(self.metadata["actions"])]
        return [(head["name"], [str(i) for i in range(head["n_choices"])]) for head in self.spec["actions"]["heads"]]

    @property
    def observation(self):
        """Names of the numbers of an observation, or None where the file does not have them."""
        names = self.metadata.get("observation")
        return json.loads(names) if names else None

    def begin(self):
        """Returns the state at the start of an episode."""
        encoder = self.spec["encoder"]
        return np.zeros((2, encoder["Lstm"]["state"])) if "Lstm" in encoder else None

    def logits(self, observation, state=None):
        """Returns the logits of all choices, head after head, and the state after this step."""
        x = np.asarray(observation, float)
        if x.shape != (self.obs_dim,):
            raise ValueError(f"an observation has {self.obs_dim} numbers, this one has shape {x.shape}")
        if self.spec["normalize_observations"]:
            mean, scale = normalizer_of(self.tensors)
            x = np.clip((x.astype(np.float32) - mean) * scale, -10, 10).astype(float)
        encoder = self.spec["encoder"]
        if "Lstm" in encoder:
            state = self._lstm(x, *(self.begin() if state is None else state))
            x = state[0]
        elif "EgoAttention" in encoder:
            x = self._attention(x, encoder["EgoAttention"])
        elif encoder != "Identity":
            raise ValueError(f"it has an encoder that is not known here: {encoder}")
        for i in range(len(self.spec["hidden"])):
            x = np.tanh(self._dense(f"actor.{i}", x))
        return self._dense("actor.head", x), state

    def act(self, observation, mask=None, state=None, rng=None, greedy=False):
        """Chooses an action: a choice per head, and the state after this step.

        ``mask`` has a number per choice, 0 for one that is not offered: head after head, or an array for each. Choices are drawn with ``rng`` (a numpy Generator)
        unless ``greedy``.
        """
        if not greedy and rng is None:
            raise ValueError("choices are drawn with a generator: give rng, or greedy=True")
        logits, state = self.logits(observation, state)
        if not np.isfinite(logits).all():
            raise ValueError("the observation, or the state, holds a number that is not finite")
        mask = None if mask is None else self._whole(mask)
        action, first = [], 0
        for index, head in enumerate(self.spec["actions"]["heads"]):
            n = head["n_choices"]
            of_head = logits[first : first + n]
            offered = np.ones(n, bool) if mask is None else np.asarray(mask[first : first + n], bool)
            rule = next((rule for rule in self.spec["actions"]["conditionals"] if rule["head"] == index), None)
            bits = rule["allowed"][action[rule["given"]]] if rule else -1
            conditional = np.array([bits >> choice & 1 == 1 for choice in range(n)])
            # Where both leave nothing, the rule alone decides, as in the program; without one, everything is left.
            offered = offered & conditional if (offered & conditional).any() else conditional
            of_head = np.where(offered, of_head, -np.inf)
            action.append(int(np.argmax(of_head)) if greedy else int(rng.choice(n, p=softmax(of_head))))
            first += n
        return action, state

    def _whole(self, mask):
        """Returns a mask as one array, head after head."""
        sizes = [head["n_choices"] for head in self.spec["actions"]["heads"]]
        shapes = list(map(np.shape, mask)) if isinstance(mask, (tuple, list)) else []
        if shapes and shapes == [(n,) for n in sizes]:
            return np.concatenate(mask)
        # Parts of several lengths have no shape together.
        shape = shapes if len(set(shapes)) > 1 else np.shape(mask)
        if shape != (sum(sizes),):
            raise ValueError(f"a mask has {sum(sizes)} entries, head after head; this one has shape {shape}")
        return mask

    def _dense(self, layer, x):
        return self.tensors[layer + ".weight"] @ x + self.tensors[layer + ".bias"]

    def _lstm(self, x, hidden, cell):
        if "encoder.projection.weight" in self.tensors:
            x = np.tanh(self._dense("encoder.projection", x))
        gates = self._dense("encoder.input", x) + self._dense("encoder.state", hidden)
        enter, keep, new, leave = np.split(gates, 4)
        enter, keep, leave = (1 / (1 + np.exp(-gate)) for gate in (enter, keep, leave))
        cell = keep * cell + enter * np.tanh(new)
        return np.stack([leave * np.tanh(cell), cell])

    def _attention(self, x, spec):
        n_rows, n_features, n_action = spec["n_entities"], spec["n_features"], spec["action_dim"]
        width = n_rows * n_features + n_action
        frames, rest = np.split(x, [spec["n_frames"] * width])
        parts = []
        for frame in frames.reshape(spec["n_frames"], width):
            rows, own_action = np.split(frame, [n_rows * n_features])
            parts += [self._attend(rows.reshape(n_rows, n_features), spec["n_heads"]), own_action]
        return np.concatenate([*parts, rest])

    def _attend(self, rows, n_heads):
        def embed(who, x):
            for layer in (f"encoder.{who}.0", f"encoder.{who}.1"):
                x = np.maximum(x @ self.tensors[layer + ".weight"].T + self.tensors[layer + ".bias"], 0)
            return x

        embedded = np.concatenate([embed("ego", rows[:1]), embed("others", rows[1:])])
        own = embedded[0]
        # In 32 bits, as in the program: the normaliser's small constant must not make 0.5 less.
        there = rows[:, 0].astype(np.float32) >= PRESENT
        query = self.tensors["encoder.query.weight"] @ own
        keys, values = (embedded @ self.tensors[f"encoder.{name}.weight"].T for name in ("key", "value"))
        d = len(query) // n_heads
        heads = []
        for head in range(n_heads):
            part = slice(head * d, (head + 1) * d)
            # Where no row is there, all have the same score, and equal weights.
            weights = softmax(np.where(there, keys[:, part] @ query[part] / np.sqrt(d), ABSENT))
            heads.append(weights @ values[:, part])
        return (self.tensors["encoder.combine.weight"] @ np.concatenate(heads) + own) / 2

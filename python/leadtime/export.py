"""Policies of Leadtime as ONNX, for runtimes that know nothing of Leadtime; needs the package ``onnx``.

    python3 -m leadtime.export deploy/policies/piloting.safetensors piloting.onnx

The graph has inputs ``observation`` [B, D] and, where the policy has a memory, ``state`` [B, 2, H], which is 0 when an episode
starts; and outputs ``logits`` [B, C] of all choices, head after head, ``value`` [B, 1], and ``state`` of the next step as
``next_state``. Masks and the rule l >= k come after it: ``docs/policy-file.md``, steps 4 to 7. Opset 17.
"""

import json
import sys

import numpy as np

from leadtime.policy import ABSENT, PRESENT, load, normalizer_of

OPSET = 17


class Graph:
    """Collects nodes; every operation returns the name of its result."""

    def __init__(self, helper, from_array):
        self.helper, self.from_array, self.nodes, self.constants = helper, from_array, [], []

    def constant(self, array, dtype=np.float32):
        name = f"c{len(self.constants)}"
        self.constants.append(self.from_array(np.ascontiguousarray(array, dtype), name))
        return name

    def op(self, kind, *inputs, name=None, **attributes):
        name = name or f"n{len(self.nodes)}"
        self.nodes.append(self.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def shaped(self, x, *shape):
        return self.op("Reshape", x, self.constant(shape, np.int64))

    def part(self, x, axis, start, end):
        return self.op("Slice", x, *(self.constant([n], np.int64) for n in (start, end, axis)))

    def linear(self, x, weight, bias=None, name=None):
        """Applies a layer to the last axis."""
        weight = self.constant(np.asarray(weight).T)
        if bias is None:
            return self.op("MatMul", x, weight, name=name)
        return self.op("Add", self.op("MatMul", x, weight), self.constant(bias), name=name)


def graph_of(policy):
    from onnx import TensorProto, helper, numpy_helper

    tensors, spec = policy.tensors, policy.spec
    graph = Graph(helper, numpy_helper.from_array)

    def dense(layer, x, name=None):
        return graph.linear(x, tensors[layer + ".weight"], tensors[layer + ".bias"], name)

    x = "observation"
    if spec["normalize_observations"]:
        mean, scale = (graph.constant(numbers) for numbers in normalizer_of(tensors))
        x = graph.op("Mul", graph.op("Sub", x, mean), scale)
        x = graph.op("Clip", x, graph.constant(-10), graph.constant(10))
    state, encoder = None, spec["encoder"]
    if "Lstm" in encoder:
        width = encoder["Lstm"]["state"]
        hidden, cell = (graph.shaped(graph.part("state", 1, i, i + 1), -1, width) for i in (0, 1))
        if "encoder.projection.weight" in tensors:
            x = graph.op("Tanh", dense("encoder.projection", x))
        gates = graph.op("Add", dense("encoder.input", x), dense("encoder.state", hidden))
        enter, keep, new, leave = (graph.part(gates, 1, i * width, (i + 1) * width) for i in range(4))
        enter, keep, leave = (graph.op("Sigmoid", gate) for gate in (enter, keep, leave))
        cell = graph.op("Add", graph.op("Mul", keep, cell), graph.op("Mul", enter, graph.op("Tanh", new)))
        x = graph.op("Mul", leave, graph.op("Tanh", cell))
        state = graph.op("Concat", *(graph.shaped(half, -1, 1, width) for half in (x, cell)), axis=1, name="next_state")
    elif "EgoAttention" in encoder:
        x = attention(graph, dense, tensors, encoder["EgoAttention"], x, policy.obs_dim)
    elif encoder != "Identity":
        raise ValueError(f"it has an encoder that is not known here: {encoder}")
    heads = {}
    for network, output in (("actor", "logits"), ("critic", "value")):
        y = x
        for i in range(len(spec["hidden"])):
            y = graph.op("Tanh", dense(f"{network}.{i}", y))
        heads[output] = dense(f"{network}.head", y, output)

    def value(name, *shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", *shape])

    inputs, outputs = [value("observation", policy.obs_dim)], [value("logits", sum(head["n_choices"] for head in spec["actions"]["heads"])),
                                                               value("value", 1)]
    if state:
        inputs.append(value("state", 2, width))
        outputs.append(value("next_state", 2, width))
    return helper.make_graph(graph.nodes, "leadtime", inputs, outputs, graph.constants)


def attention(graph, dense, tensors, spec, x, obs_dim):
    n_frames, n_rows, n_features, n_action = (spec[key] for key in ("n_frames", "n_entities", "n_features", "action_dim"))
    width, n_heads = spec["width"], spec["n_heads"]
    of_frame, d = n_rows * n_features + n_action, spec["width"] // spec["n_heads"]
    frames = graph.shaped(graph.part(x, 1, 0, n_frames * of_frame), -1, n_frames, of_frame)
    rows = graph.shaped(graph.part(frames, 2, 0, n_rows * n_features), -1, n_frames, n_rows, n_features)
    actions = graph.part(frames, 2, n_rows * n_features, of_frame)

    def embed(who, part):
        return graph.op("Relu", dense(f"encoder.{who}.1", graph.op("Relu", dense(f"encoder.{who}.0", part))))

    own = embed("ego", graph.part(rows, 2, 0, 1))
    embedded = graph.op("Concat", own, embed("others", graph.part(rows, 2, 1, n_rows)), axis=2)
    own = graph.shaped(own, -1, n_frames, width)
    there = graph.op("GreaterOrEqual", graph.shaped(graph.part(rows, 3, 0, 1), -1, n_frames, 1, 1, n_rows), graph.constant(PRESENT))
    query = graph.shaped(graph.linear(own, tensors["encoder.query.weight"]), -1, n_frames, n_heads, 1, d)

    def seen(name, order):
        parts = graph.shaped(graph.linear(embedded, tensors[f"encoder.{name}.weight"]), -1, n_frames, n_rows, n_heads, d)
        return graph.op("Transpose", parts, perm=order)

    scores = graph.op("Mul", graph.op("MatMul", query, seen("key", [0, 1, 3, 4, 2])), graph.constant(1 / np.sqrt(d)))
    # Where no row is there, all have the same score, and equal weights.
    weights = graph.op("Softmax", graph.op("Where", there, scores, graph.constant(ABSENT)), axis=-1)
    mixed = graph.shaped(graph.op("MatMul", weights, seen("value", [0, 1, 3, 2, 4])), -1, n_frames, width)
    encoded = graph.op("Add", graph.linear(mixed, tensors["encoder.combine.weight"]), own)
    encoded = graph.op("Mul", encoded, graph.constant(0.5))
    frames = graph.shaped(graph.op("Concat", encoded, actions, axis=2), -1, n_frames * (width + n_action))
    return graph.op("Concat", frames, graph.part(x, 1, n_frames * of_frame, obs_dim), axis=1)


def to_onnx(policy, path):
    """Writes a policy (a path, or what ``leadtime.policy.load`` returns) as an ONNX file."""
    try:
        import onnx
        from onnx import helper
    except ImportError as error:
        raise ImportError("the export needs the package onnx: pip install 'leadtime[export]'") from error
    policy = policy if hasattr(policy, "act") else load(policy)
    model = helper.make_model(graph_of(policy), opset_imports=[helper.make_opsetid("", OPSET)], producer_name="leadtime", ir_version=8)
    helper.set_model_props(model, {"heads": json.dumps(policy.heads), "observation": json.dumps(policy.observation)})
    onnx.checker.check_model(model)
    onnx.save(model, path)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("python3 -m leadtime.export POLICY.safetensors OUT.onnx")
    to_onnx(*sys.argv[1:])

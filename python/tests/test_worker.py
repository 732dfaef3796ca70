"""Checks of leadtime.worker: run with the package, gymnasium and the program `leadtime` installed.

What a space becomes and what is refused is checked by speaking the protocol; the page of docs/worlds/python.md is trained by the program.
"""

import contextlib
import hashlib
import importlib
import io
import json
import logging
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import textwrap
import threading
import time
import types
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium import spaces

from leadtime import worker

PAGE = Path(__file__).resolve().parents[2] / "docs/worlds/python.md"


class Toy(gymnasium.Env):
    """Shows the seed and the number of steps; what is wrong with it is said when it is made."""

    def __init__(self, action_space=None, observation_space=None, fault=None, length=5):
        self.action_space = action_space or spaces.Discrete(3, start=-1)
        self.observation_space = observation_space or spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.fault, self.length = fault, length

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.first, self.n, self.seen = float(self.np_random.random()), 0, []
        self.n_episodes = getattr(self, "n_episodes", 0) + 1
        if self.fault == "space" and self.n_episodes > 1:
            self.action_space = spaces.Discrete(4)
        return self.look(), {"action_mask": np.array([1, 0, 1])} if self.fault == "mask" else {}

    def look(self):
        if isinstance(self.observation_space, spaces.Box):
            wrong = {"shape": np.zeros(3), "dtype": np.array(["a", "b"]), "nan": np.array([0, np.nan])}
            return wrong.get(self.fault, np.array([self.first, self.n]))
        self.observation_space.seed(self.n)
        return self.observation_space.sample()

    def step(self, action):
        self.seen.append(action)
        self.n += 1
        if self.fault == "raise" and self.n == 2:
            raise IndexError("nothing there")
        over = self.n >= self.length
        info = {"success": True, "fuel": 0.5, "action_mask": (np.array([0, 1, 1]),)} if self.fault != "no-fuel" else {"success": True}
        return self.look(), "much" if self.fault == "reward" else 1, over, over, info


class Pair:
    """A worker in a thread, and the actor's end of its connection."""

    def __init__(self, make, config=None):
        self.place = tempfile.TemporaryDirectory()
        path = self.place.name + "/socket"
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(path)
        listener.listen()
        self.connection = worker.Connection(path)
        self.end = listener.accept()[0].makefile("rwb")
        self.worker = worker.Worker(self.connection, make, config or {"metrics": ["success", "fuel"], "batch": 4})
        threading.Thread(target=self.worker.work, daemon=True).start()

    def ask(self, kind, body):
        self.end.write(struct.pack("<IB", len(body), kind) + body)
        self.end.flush()
        failures = []
        while True:
            length, kind = struct.unpack("<IB", self.end.read(5))
            body = self.end.read(length)
            if kind == worker.FAILED:
                failures.append(body[2:].decode())
            elif kind != worker.ALIVE:
                return body, failures

    def begin(self, slot=0, seed=7, base=b"", actions=b""):
        length = 4 + len(base) + len(actions)
        body, failures = self.ask(worker.BEGIN, struct.pack("<HHIII", 1, slot, seed, length, len(base)) + base + actions)
        return self.read(body), failures

    def begun(self):
        self.begin()
        return self

    def step(self, choices, slot=0, seed=8):
        body, failures = self.ask(worker.STEP, struct.pack("<HHI", 1, slot, seed) + bytes(choices))
        return self.read(body), failures

    def read(self, body):
        n = self.worker.observe.dim
        row, at = np.frombuffer(body, "<f4", n, 2), 2 + 4 * n
        reward, end, mask = struct.unpack_from("<fBQ", body, at)
        return row, reward, end, mask, np.frombuffer(body[at + 13 :], "<f4")


class Heard(logging.Handler):
    """What is logged meanwhile."""

    def __enter__(self):
        self.lines = []
        logging.getLogger().addHandler(self)
        logging.getLogger().setLevel(logging.INFO)
        return self.lines

    def __exit__(self, *error):
        logging.getLogger().removeHandler(self)

    def emit(self, record):
        self.lines.append(record.getMessage())


def refused(make, config=None):
    try:
        Pair(make, config)
    except worker.Refused as error:
        return str(error)
    raise AssertionError("it was not refused")


def test_an_action_is_a_choice_per_head_in_whatever_space():
    multi = spaces.MultiDiscrete([2, 3])
    for space, heads, choices, action in [
        (spaces.Discrete(3, start=-1), [("action", 3)], [2], 1),
        (multi, [("action_0", 2), ("action_1", 3)], [1, 2], [1, 2]),
        (spaces.MultiBinary(3), [("action_0", 2), ("action_1", 2), ("action_2", 2)], [1, 0, 1], [1, 0, 1]),
        (spaces.Tuple([spaces.Discrete(2), multi]), [("action_0", 2), ("action_1_0", 2), ("action_1_1", 3)], [1, 0, 2], (1, [0, 2])),
        (spaces.Dict(a=spaces.Discrete(2), b=spaces.Discrete(4, start=1)), [("action_a", 2), ("action_b", 4)], [1, 3], {"a": 1, "b": 4}),
    ]:
        pair = Pair(lambda index: Toy(action_space=space))
        assert pair.worker.heads == heads, pair.worker.heads
        pair.begin()
        pair.step(choices)
        taken = pair.worker.envs[0].seen[0]
        assert space.contains(taken), taken
        parts = taken.values() if isinstance(taken, dict) else taken if isinstance(taken, tuple) else [taken]
        assert all(isinstance(part, (np.int64, np.int8, np.ndarray)) for part in parts), "as `sample` gives them"
        flat = json.loads(json.dumps(taken, default=lambda x: x.tolist()))
        assert flat == json.loads(json.dumps(action)), (flat, action)


def test_an_observation_is_what_gymnasium_flattens():
    for space in [spaces.Box(0, 1, (2, 3), np.float64), spaces.Discrete(4), spaces.MultiDiscrete([2, 3]), spaces.MultiBinary(2),
                  spaces.Dict(b=spaces.Discrete(2), a=spaces.Box(0, 1, (2,), np.float32)), spaces.Tuple([spaces.Discrete(2), spaces.MultiBinary(2)])]:
        flattener = worker.Flattener(space, spaces, np)
        space.seed(3)
        sample = space.sample()
        assert np.array_equal(flattener.row(sample), spaces.flatten(space, sample).astype(np.float32)), space


def test_what_cannot_be_is_said_in_a_sentence():
    too_many = spaces.MultiDiscrete([40, 30])
    assert "no continuous actions" in refused(lambda index: Toy(action_space=spaces.Box(0, 1, (2,))))
    assert "`action_1` has 30 choices, which makes 70" in refused(lambda index: Toy(action_space=too_many))
    assert "9 heads" in refused(lambda index: Toy(action_space=spaces.MultiBinary(9)))
    alike = spaces.Dict(a=spaces.MultiDiscrete([2, 3]), a_0=spaces.Discrete(2))
    assert "two heads of an action are `action_a_0`" in refused(lambda index: Toy(action_space=alike))
    for shape, n in (((0,), 0), ((512, 513, 1), 262656)):
        told = refused(lambda index: Toy(observation_space=spaces.Box(0, 1, shape)))
        assert told == f"an observation has {n} numbers; 1 to 262144 are possible", told
    told = refused(lambda index: gymnasium.make_vec("CartPole-v1", num_envs=2))
    assert told.endswith("VectorEnv, which is no gymnasium.Env; it has to make one environment, and is called for each"), told
    told = refused(worker.maker("my_envs", {}))
    assert "doesn't exist. A function is named with its module, `my_envs:make`" in told, told
    # It is known, and its package is missing.
    gymnasium.register("Unbuilt-v3", lambda: (_ for _ in ()).throw(gymnasium.error.DependencyNotInstalled("no engine is installed")))
    assert refused(worker.maker("Unbuilt", {})) == "DependencyNotInstalled: no engine is installed"
    assert "the observation space is" in refused(lambda index: Toy(observation_space=spaces.Sequence(spaces.Discrete(2))))
    assert "shape (3,), not (2,)" in refused(lambda index: Toy(fault="shape"))
    assert "an observation has dtype <U1, which is no number" in refused(lambda index: Toy(fault="dtype"))
    (_, _, end, _, _), failures = Pair(lambda index: Toy(fault="space")).begin()
    assert end == worker.DID_FAIL and "the action space is Discrete(4), and was" in failures[0], failures
    pair = Pair(lambda index: Toy(fault="reward"))
    pair.begin()
    (_, _, end, _, _), failures = pair.step([0])
    assert end == worker.DID_FAIL and failures == ["the reward is 'much', which is no number"], failures

    class Old(Toy):
        def reset(self):
            return np.zeros(2)

    assert "needs Gymnasium 0.26 or newer" in refused(lambda index: Old())

    class Four(Toy):
        def step(self, action):
            return super().step(action)[:4]

    pair = Pair(lambda index: Four())
    pair.begin()
    _, failures = pair.step([0])
    assert "`step` returns 4 values, not five" in failures[0], failures


def test_what_is_offered_is_said_in_info_or_in_the_observation_in_the_form_of_the_action_space():
    multi = spaces.MultiDiscrete([2, 3])
    both, nested = spaces.Dict(b=spaces.Discrete(2), a=multi), spaces.Tuple([spaces.Discrete(2), spaces.Dict(a=multi)])

    class Masked(Toy):
        def reset(self, **options):
            return super().reset(**options)[0], self.fault.get("info", {})

        def step(self, action):
            return (*super().step(action)[:4], self.fault.get("info", {}))

        def look(self):
            return self.fault.get("seen", np.zeros(2, np.float32))

    def made(space, **fault):
        seen = {key: spaces.Box(0, 1, (len(value),)) for key, value in fault["seen"].items()} if "seen" in fault else {}
        return lambda index: Masked(space, spaces.Dict(seen) if seen else None, fault)

    two, three = [1, 0], np.array([0, 1, 1])
    for space, mask, bits in [(multi, [1, 0, 0, 1, 1], 0b11001), (multi, (two, three), 0b11001), (both, {"b": three[1:], "a": (two, three)}, 0b1100111),
                              (both, {"b": None, "a": (two, three)}, 0b1100111), (nested, (two, {"a": (two, three)}), 0b1100101),
                              (spaces.Dict(a=spaces.MultiBinary(3)), {"a": np.array([0, 1, 2], np.int8)}, 0b111001),
                              (spaces.Dict(a=spaces.MultiBinary(2)), {"a": np.array([0, 1, 1, 1])}, 0b1110)]:
        pair = Pair(made(space, info={"action_mask": mask}), {"metrics": [], "batch": 4})
        for shown, failures in (pair.begin(), pair.step([0] * len(pair.worker.heads))):
            assert shown[3] == bits and not failures, (space, mask, bin(shown[3]), failures)
    # As PettingZoo and RLlib have it: beside what is observed.
    seen = {"action_mask": np.array([0, 1, 1]), "observation": np.array([0.5])}
    pair = Pair(made(spaces.Discrete(3), seen=seen), {"metrics": [], "batch": 4})
    for shown, failures in (pair.begin(), pair.step([1])):
        assert shown[3] == 0b110 and shown[0].tolist() == [0, 1, 1, 0.5] and not failures, (shown, failures)
    # What `info` says comes first.
    pair = Pair(made(spaces.Discrete(3), seen=seen, info={"action_mask": [1, 0, 0]}), {"metrics": [], "batch": 4})
    assert pair.begin()[0][3] == pair.step([0])[0][3] == 0b001
    for space, fault, told in [(spaces.Discrete(2), {"seen": seen}, "`action_mask` has 3 entries for 2 choices"),
                               (both, {"info": {"action_mask": {"b": two}}}, "`action_mask` has no `a`, and the action space has"),
                               (multi, {"info": {"action_mask": {"b": two}}}, "`action_mask` is a dict, and the space is MultiDiscrete([2 3])"),
                               # Each is as long as the whole should be.
                               (both, {"info": {"action_mask": {"a": (two, two), "b": three}}}, "`b` of `action_mask` has 3 entries for 2 choices"),
                               (nested, {"info": {"action_mask": (two, {"a": (three, two)})}},
                                "`a` of part 1 of `action_mask` has arrays of [3, 2] entries for heads of [2, 3] choices"),
                               (multi, {"info": {"action_mask": ([1, 0, 1], two)}}, "`action_mask` has arrays of [3, 2] entries for heads of [2, 3] choices"),
                               (multi, {"info": {"action_mask": []}}, "`action_mask` has 0 entries for 5 choices"),
                               (spaces.Discrete(3), {"seen": {"action_mask": np.zeros(3)}}, "`action_mask` offers no choice of `action`")]:
        assert refused(made(space, **fault)).startswith(told), (space, fault)


def test_arguments_that_do_not_fit_are_told_as_what_is_called():
    module = types.ModuleType("called_here")

    class Crossing(Toy):
        def __init__(self, busy):
            super().__init__()

    def three(config, index, further):
        return Toy()

    def one(config, *, further):
        return Toy()

    def inside(config):
        return Crossing()

    def keys(**config):
        return Toy(length=len(config))

    for name, make in [("Crossing", Crossing), ("three", three), ("one", one), ("inside", inside), ("keys", keys)]:
        setattr(module, name, make)
    sys.modules["called_here"] = module

    def told(target, config):
        try:
            worker.maker(target, config)(0)
        except worker.FAILURES as error:
            # Without the frame of this file, which is the worker's elsewhere.
            return worker.sentence(error.with_traceback(error.__traceback__.tb_next))
        raise AssertionError(target)

    try:
        missing = told("called_here:Crossing", {})
        assert re.search(r"Crossing.__init__\(\) missing 1 required positional argument: 'busy': it gets the keys of `env` as arguments, which has \[\]$", missing), missing
        assert "unexpected keyword argument 'bsuy'" in told("called_here:Crossing", {"bsuy": 1})
        further = told("called_here:three", {})
        assert re.search(r"three\(\) missing 1 required positional argument: 'further': it gets `config` and `index`$", further), further
        assert told("called_here:one", {}).endswith("'further': it gets `config`")
        assert worker.maker("called_here:keys", {"make": 1, "name": 2})(0).length == 2
        own = told("called_here:inside", {})
        assert re.search(r"^TypeError: .*Crossing.__init__\(\) missing .* 'busy' \(test_worker.py:\d+\)$", own), own
        # No line of the worker's own, which is not at fault.
        assert "worker.py" not in told("CartPole-v1", {"length": 3}), told("CartPole-v1", {"length": 3})
    finally:
        del sys.modules["called_here"]


def test_an_odd_info_is_named_and_no_line_of_the_log_fails_a_step():
    class Odd(Toy):
        def reset(self, **options):
            observation, info = super().reset(**options)
            return observation, None if self.fault == "no-info" else {"action_mask": [0, 0, 0]} if self.fault == "no-choice" else info

        def step(self, action):
            observation, reward, terminated, truncated, info = super().step(action)
            found = {"list": [1], "nothing": None}
            if self.fault in found:
                return observation, reward, terminated, truncated, found[self.fault]
            if self.fault == "no-tuple":
                return None
            if self.fault == "log":
                logging.getLogger("odd").warning("%s and %s", 1)
            if self.fault == "unwritable":
                class Unwritable(Exception):
                    def __str__(self):
                        raise ValueError
                raise Unwritable
            if self.fault == "surrogate":
                raise ValueError("na\udcef")
            return observation, 10**5000 if self.fault == "huge" else reward, terminated, truncated, {"success": self.fault, "fuel": 1e39}

    assert refused(lambda index: Odd(fault="no-info")) == "the info of `reset` is None, which is no dict"
    assert "offers no choice of `action`" in refused(lambda index: Odd(fault="no-choice"))
    for fault, told in [("list", "the info of `step` is [1], which is no dict"), ("nothing", "the info of `step` is None, which is no dict"),
                        ("no-tuple", "`step` returns None, not five: the environment needs Gymnasium 0.26 or newer"),
                        ("yes", "`success` of info is 'yes', which is no number"), ("unwritable", "Unwritable (test_worker.py:"),
                        ("surrogate", "ValueError: na\\udcef (test_worker.py:")]:
        pair = Pair(lambda index: Odd(fault=fault, length=1))
        pair.begin()
        with contextlib.redirect_stderr(io.StringIO()):
            (_, _, end, _, _), failures = pair.step([0])
        assert end == worker.DID_FAIL and len(failures) == 1 and failures[0].startswith(told), (fault, failures)
    # The actor names numbers that are too large.
    (_, reward, end, _, _), failures = Pair(lambda index: Odd(fault="huge")).begun().step([0])
    assert end == 0 and reward > 2e38 and not failures, (reward, failures)
    (_, _, end, _, rest), failures = Pair(lambda index: Odd(fault=1, length=1)).begun().step([0])
    assert end == worker.TERMINATED and rest[2] == 1 and rest[3] > 2e38 and not failures, (rest, failures)
    handler, printed = worker.LogHandler(None), io.StringIO()
    handler.setLevel(logging.WARNING)
    logging.getLogger().addHandler(handler)
    try:
        with contextlib.redirect_stderr(printed):
            (_, _, end, _, _), failures = Pair(lambda index: Odd(fault="log")).begun().step([0])
    finally:
        logging.getLogger().removeHandler(handler)
    assert end == 0 and not failures and "not enough arguments" in printed.getvalue(), (failures, printed.getvalue())


def test_what_a_step_returns_is_taken_for_what_it_is_or_refused_by_name():
    box, pair = spaces.Box(0, 1, (2,)), spaces.MultiDiscrete([2, 3])

    class Told(Toy):
        def step(self, action):
            if self.fault == "exit":
                sys.exit("gave up")
            return tuple(self.fault.get(i, value) for i, value in enumerate(super().step(action)))

        def look(self):
            return self.observation_space.sample()

    def step(fault, space=box):
        with contextlib.redirect_stderr(io.StringIO()):
            return Pair(lambda index: Told(fault=fault, observation_space=space)).begun().step([0])

    for fault, told in [({2: np.array([True, False])}, "`terminated` is array([ True, False]), which is neither true nor false"),
                        ({2: float("nan")}, "`terminated` is nan, which is neither true nor false"),
                        ({3: "False"}, "`truncated` is 'False', which is neither true nor false"),
                        ({1: "1.5"}, "the reward is '1.5', which is no number")]:
        (_, _, end, _, _), failures = step(fault)
        assert end == worker.DID_FAIL and failures == [told], failures
    for fault, expected in [({2: np.bool_(False), 3: None}, worker.NONE), ({2: np.array([True])}, worker.TERMINATED), ({3: 1}, worker.TRUNCATED)]:
        (_, _, end, _, _), failures = step(fault)
        assert end == expected and not failures, (fault, end, failures)
    _, failures = step("exit")
    assert re.fullmatch(r"SystemExit: gave up \(test_worker.py:\d+\)", failures[0]), failures

    pixels = spaces.Tuple([spaces.Box(0, 255, (2,), np.uint8)])
    both, in_turn = spaces.Dict(a=box, b=spaces.Discrete(3)), spaces.Tuple([box, pair])
    # Gymnasium would take the second last number for -1, and make more numbers of three than the space has.
    for space, seen, told in [(both, {"a": [0, 0], "b": -1}, "`b` of an observation is -1, which is not in Discrete(3)"),
                              (both, {"a": [0, 0, 0], "b": 1}, "`a` of an observation has shape (3,), not (2,)"),
                              (both, {"a": [0, 0]}, "an observation has no `b`, and the observation space has"),
                              (both, [0, 0], "an observation is [0, 0], which is no dict"),
                              (in_turn, ([0, 0],), "an observation is ([0, 0],), not a tuple of 2"),
                              (in_turn, ([0, 0], np.array([1, 3])), "part 1 of an observation is array([1, 3]), which is not in MultiDiscrete([2 3])"),
                              (in_turn, ([0, 0], [1]), "part 1 of an observation is [1], which is not in MultiDiscrete([2 3])"),
                              (both, {"a": [0, 0], "b": 1.5}, "`b` of an observation is 1.5, which is not in Discrete(3)"),
                              # It would make 44 of 300, and 0 of no number.
                              (pixels, (np.array([0, 300]),), "part 0 of an observation is array([ 0, 300]), which is not of uint8, the type of its Box"),
                              (pixels, ([0, -1],), "part 0 of an observation is [0, -1], which is not of uint8, the type of its Box"),
                              (pixels, ([0, float("nan")],), "part 0 of an observation is [0, nan], which is not of uint8, the type of its Box")]:
        _, failures = step({0: seen}, space)
        assert failures == [told], failures
    # What it flattens well is taken, even what it does not count as part of the space.
    wide, one = spaces.Tuple([box, spaces.Box(0, 1, (2,))]), spaces.Dict(a=spaces.Box(0, 1, (1,)), b=spaces.Discrete(2))
    small = spaces.Tuple([spaces.Discrete(3), spaces.MultiDiscrete([2, 3], dtype=np.int8), spaces.MultiBinary(2)])
    for space, seen, expected in [(both, {"a": [0, 0], "b": 1, "further": None}, [0, 0, 0, 1, 0]),
                                  (pixels, ([0, 255.0],), [0, 255]),
                                  (wide, np.array([[0, 1], [1, 0]]), [0, 1, 1, 0]),
                                  (one, {"a": 0.5, "b": np.bool_(True)}, [0.5, 0, 1]),
                                  (one, {"a": [[0.5]], "b": np.array([1])}, [0.5, 0, 1]),
                                  (small, [np.int64(2), np.array([1, 2]), np.array([1.0, 0.0])], [0, 0, 1, 0, 1, 0, 0, 1, 1, 0])]:
        (row, _, _, _, _), failures = step({0: seen}, space)
        assert not failures and row.tolist() == expected, (seen, failures, row)


def test_what_makes_an_environment_gets_what_it_takes():
    def named(*, length=5):
        return Toy(length=length)

    def any_name(**config):
        return Toy(**config)

    def in_a_row(*arguments):
        return Toy(**arguments[0])

    def nothing():
        return Toy()

    module = types.ModuleType("made_here")
    vars(module).update(named=named, any_name=any_name, in_a_row=in_a_row, nothing=nothing, toy=Toy, both=lambda config, index: Toy(**config), wrong=3)
    sys.modules["made_here"] = module
    for name in ("named", "any_name", "in_a_row", "toy", "both"):
        assert worker.maker(f"made_here:{name}", {"length": 9})(0).length == 9, name
    assert worker.maker("made_here:nothing", {})(0).length == 5
    for name, config, told in [("nothing", {"length": 9}, "`made_here:nothing` takes no argument, and `env` has ['length']"),
                               ("wrong", {}, "`made_here:wrong` is 3, and no function")]:
        try:
            worker.maker(f"made_here:{name}", config)
        except worker.Refused as error:
            assert told in str(error), error
        else:
            raise AssertionError(name)


def test_a_child_of_an_environment_says_nothing_to_the_actor():
    with tempfile.TemporaryDirectory() as place:
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(place + "/socket")
        listener.listen()
        connection = worker.Connection(place + "/socket")
        end, printed = listener.accept()[0], os.pipe()
        child = os.fork()
        if child == 0:
            os.dup2(printed[1], 2)
            try:
                worker.LogHandler(connection).emit(logging.makeLogRecord({"levelno": logging.INFO, "msg": "from a child"}))
                connection.send(worker.ALIVE)
            finally:
                os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1
        assert os.read(printed[0], 100) == b"from a child\n"
        connection.send(worker.ALIVE)
        assert end.recv(100) == struct.pack("<IB", 0, worker.ALIVE)


def test_a_warning_is_one_line_without_colours():
    sent = []
    connection = types.SimpleNamespace(is_ours=lambda: True, send=lambda kind, *parts: sent.append(b"".join(parts)))
    text = worker.warning(UserWarning("\x1b[33mWARN: it is\nold\x1b[0m"), UserWarning, "/envs/road.py", 3)
    worker.LogHandler(connection).emit(logging.makeLogRecord({"levelno": logging.WARNING, "msg": text}))
    assert sent == [b"\x02UserWarning: WARN: it is old (road.py:3)"], sent


def test_what_wraps_an_environment_or_is_imported_by_it_is_part_of_its_code():
    with tempfile.TemporaryDirectory() as place:
        for name in ("__init__", "pay"):
            Path(place, "road_envs").mkdir(exist_ok=True)
            Path(place, f"road_envs/{name}.py").write_text("FACTOR = 1\n")
        Path(place, "road_alone.py").write_text("FACTOR = 1\n")
        sys.path.insert(0, place)
        try:
            import road_alone  # noqa: F401
            import road_envs.pay  # noqa: F401

            before = worker.versions_of(gymnasium.make("CartPole-v1"))
            Path(place, "road_envs/pay.py").write_text("FACTOR = -1\n")
            after = worker.versions_of(gymnasium.make("CartPole-v1"))
        finally:
            sys.path.remove(place)
            for name in ("road_alone", "road_envs", "road_envs.pay"):
                del sys.modules[name]
        assert before["road_envs"].startswith("sha256 ") and before["road_envs"] != after["road_envs"], (before, after)
        assert before["road_alone"] == after["road_alone"] == "sha256 " + hashlib.sha256(b"FACTOR = 1\n").hexdigest()[:12]
        assert before["gymnasium"] == gymnasium.__version__ and not {"leadtime", "json"} & set(before), before


def test_environments_are_closed_when_nobody_asks_any_more():
    closed = []

    class Closing(Toy):
        def close(self):
            closed.append(self.index)
            if self.index == 0:
                raise OSError("gone")

    def make(index):
        env = Closing()
        env.index = index
        return env

    pair = Pair(make).begun()
    pair.begin(slot=1)
    with contextlib.redirect_stderr(io.StringIO()) as printed:
        pair.worker.close()
    assert closed == [0, 1] and "`close` fails: OSError: gone" in printed.getvalue(), (closed, printed.getvalue())


def test_what_an_environment_has_started_ends_with_the_actor_even_where_the_environment_hangs():
    for reset in ("return super().reset(seed=seed)", "time.sleep(1_000)"):
        with tempfile.TemporaryDirectory() as place:
            Path(place, "simulator.py").write_text(textwrap.dedent(f"""\
                import subprocess, sys, time
                from gymnasium.envs.classic_control import CartPoleEnv

                class make(CartPoleEnv):
                    def __init__(self):
                        super().__init__()
                        self.simulator = subprocess.Popen(["sleep", "1000"])

                    def reset(self, seed=None):
                        print("resets", file=sys.stderr)
                        {reset}
                """))
            listener = socket.socket(socket.AF_UNIX)
            listener.bind(place + "/socket")
            listener.listen()
            config = json.dumps({"env": {}, "metrics": [], "batch": 1})
            process = subprocess.Popen(
                [sys.executable, worker.__file__, "simulator:make"], cwd=place, stdin=subprocess.PIPE, stderr=subprocess.PIPE,
                env=os.environ | {"LEADTIME_WORKER_SOCKET": place + "/socket", "LEADTIME_WORKER_CONFIG": config}, start_new_session=True)
            end = listener.accept()[0]
            while process.stderr.readline() != b"resets\n":
                assert process.poll() is None
            end.close()
            # The simulator holds this pipe, too: it is read to its end once both are gone.
            process.communicate(timeout=60)


def test_the_end_of_an_episode_has_its_last_observation_metrics_and_the_next_first_one():
    pair = Pair(lambda index: Toy(length=2))
    (first, _, _, mask, _), _ = pair.begin(seed=1)
    assert mask == worker.EVERYTHING and first[1] == 0
    (row, reward, end, mask, _), _ = pair.step([0])
    assert (row[1], reward, end, mask) == (1, 1, 0, 0b110)
    (row, _, end, mask, rest), _ = pair.step([0], seed=1)
    # Terminated wins over truncated.
    assert end == worker.TERMINATED and mask == worker.EVERYTHING
    assert np.array_equal(row, first), "the next episode has the seed that came with the step"
    assert rest.tolist() == [first[0], 2.0, 1.0, 0.5]
    _, failures = Pair(lambda index: Toy(fault="no-fuel", length=1)).begin()
    pair = Pair(lambda index: Toy(fault="no-fuel", length=1))
    pair.begin()
    (_, _, end, _, _), failures = pair.step([0])
    assert end == worker.DID_FAIL and "`fuel`" in failures[0], failures


def test_an_exception_is_one_line_with_file_and_line():
    pair = Pair(lambda index: Toy(fault="raise"))
    pair.begin()
    pair.step([0])
    (_, _, end, _, _), failures = pair.step([0])
    assert end == worker.DID_FAIL
    assert re.fullmatch(r"IndexError: nothing there \(test_worker.py:\d+\)", failures[0]), failures


def test_a_syntax_error_names_its_own_line_and_not_the_importers():
    with tempfile.TemporaryDirectory() as place:
        Path(place, "broken_here.py").write_text("def make(\n")
        sys.path.insert(0, place)
        try:
            importlib.import_module("broken_here")
        except SyntaxError as error:
            # Without the frame of this file, which is the worker's elsewhere.
            told = worker.sentence(error.with_traceback(error.__traceback__.tb_next))
        finally:
            sys.path.remove(place)
    assert told.endswith("(broken_here.py, line 1)"), told


def test_environments_that_fail_alike_print_one_traceback():
    printed = io.StringIO()
    pair = Pair(lambda index: Toy(fault="raise"))
    with contextlib.redirect_stderr(printed):
        for slot in range(3):
            pair.begin(slot)
            pair.step([0], slot)
            _, failures = pair.step([0], slot)
            assert "nothing there" in failures[0], failures
    assert printed.getvalue().count("Traceback") == 1, printed.getvalue()


def test_an_observation_may_be_a_part_of_a_larger_array():
    class Strided(Toy):
        def look(self):
            return np.array([[self.n, 9], [self.first, 9]], np.float32)[::-1, 0]

    pair = Pair(lambda index: Strided(length=2))
    (first, *_), _ = pair.begin(seed=1)
    (row, _, end, _, _), failures = pair.step([0])
    assert row.tolist() == [first[0], 1] and end == worker.NONE and not failures, (row, failures)
    (row, _, end, _, rest), failures = pair.step([0], seed=1)
    assert np.array_equal(row, first) and rest[:2].tolist() == [first[0], 2] and not failures, (row, rest, failures)


def test_environments_that_share_an_array_show_what_each_of_them_has_seen():
    shared = np.zeros(2, np.float32)

    class Sharing(Toy):
        def look(self):
            shared[:] = self.first, self.n
            return shared

    pair = Pair(lambda index: Sharing())
    firsts = [pair.begin(slot, seed)[0][0][0] for slot, seed in ((0, 1), (1, 2))]
    frame = struct.pack("<H", 2) + b"".join(struct.pack("<HI", slot, 8) + bytes([0]) for slot in (0, 1))
    body, failures = pair.ask(worker.STEP, frame)
    rows = np.frombuffer(body, "<f4", 4, 2).reshape(2, 2)
    assert rows.tolist() == [[firsts[0], 1], [firsts[1], 1]] and not failures, (rows, failures)


def test_a_first_observation_that_no_rollout_may_hold_is_refused():
    told = refused(lambda index: Toy(fault="nan"))
    assert told == "`reset` returns nan at index 1 of the observation; allowed: up to 1e+09 either way", told


def test_what_is_float64_or_leaves_its_box_is_told_once():
    class Wide(Toy):
        def look(self):
            return np.array([0.5, 7.0 + self.n])

    box = spaces.Box(0, 1, (2,), np.float32)
    with Heard() as lines:
        pair = Pair(lambda index: Wide(observation_space=box))
        pair.begin()
        for _ in range(3):
            pair.step([0])
    assert len(lines) == 2 and "float64" in lines[0] and "observation[1] leaves its Box (0 to 1)" in lines[1], lines


def test_an_environment_is_put_back_by_its_actions_and_by_a_pickle():
    pair = Pair(lambda index: gymnasium.make("CartPole-v1"), {"metrics": [], "batch": 4})
    pair.begin(seed=3)
    rows = [pair.step([choice])[0][0] for choice in (0, 1, 1)]
    (again, *_), failures = pair.begin(slot=1, seed=3, actions=bytes([0, 1, 1]))
    assert not failures and again.tobytes() == rows[-1].tobytes()
    pickled, _ = pair.ask(worker.SNAPSHOT, struct.pack("<H", 0))
    further = pair.step([0])[0][0]
    (again, *_), failures = pair.begin(slot=2, seed=3, base=pickled, actions=bytes([0]))
    assert not failures and again.tobytes() == further.tobytes()
    (*_,), failures = pair.begin(slot=2, seed=3, actions=bytes([1] * 60))
    assert "ends after" in failures[0], failures


def test_a_pickle_that_fits_no_snapshot_is_refused_by_its_size():
    pair = Pair(lambda index: Toy())
    pair.begin()
    for weight, fits in ((100_000, True), (300_000, False)):
        pair.worker.envs[0].weight = b"x" * weight
        pickled, failures = pair.ask(worker.SNAPSHOT, struct.pack("<H", 0))
        assert (len(pickled) > weight, failures == []) == (fits, fits), (weight, len(pickled), failures)
    assert re.fullmatch(r"its pickle has 3\d{5} bytes, and at most 196608 fit a snapshot; .*\"replay\".*", failures[0]), failures


def run(directory, *arguments, code=0):
    finished = subprocess.run(["leadtime", *arguments], cwd=directory, capture_output=True, text=True, timeout=300)
    assert finished.returncode == code, (arguments, finished.returncode, finished.stdout, finished.stderr)
    return finished


def test_the_page_of_the_documents_trains():
    text = PAGE.read_text()
    code, settings = (re.search(f"```{kind}\n(.*?)```", text, re.S)[1] for kind in ("python", "toml"))
    with tempfile.TemporaryDirectory() as place:
        Path(place, "crossing.py").write_text(code)
        Path(place, "crossing.toml").write_text(settings)
        checked = run(place, "check", "-c", "crossing.toml").stdout
        assert "equal in every byte" in checked and "crossing sha256" in checked, checked
        for name, actors in (("one", "1"), ("three", "3")):
            run(place, "up", "-c", "crossing.toml", "--actors", actors, "--steps", "8192", "--name", name)
        compared = run(place, "runs", "compare", "one", "three").stdout
        assert "weights: equal" in compared, compared
        # On two hosts: what the learner's has, the actor's need not have, but for the code.
        with tempfile.TemporaryDirectory() as other:
            Path(other, "crossing.py").write_text(code)
            at = f"unixsock-stream/{place}/learner.sock"
            learner = subprocess.Popen(["leadtime", "learner", "-c", "crossing.toml", "--listen", at, "--steps", "8192", "--name", "two-hosts"],
                                       cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            run(other, "actor", "--connect", at, "--worker", "python3 -m leadtime.worker crossing:make", "--workers", "2")
            assert learner.wait(300) == 0
        compared = run(place, "runs", "compare", "one", "two-hosts").stdout
        assert "weights: equal" in compared, compared
        evaluated = json.loads(run(place, "eval", "one", "--episodes", "50", "--json").stdout)
        assert "success" in json.dumps(evaluated)
        # What is wrong is one sentence, and the worker's own.
        Path(place, "crossing.py").write_text(code.replace("import numpy as np", "import numpy as np, nobody_has_this"))
        began = time.monotonic()
        failed = run(place, "up", "-c", "crossing.toml", code=2).stderr
        # Three seconds are promised. A busy machine takes longer; a retry takes much longer.
        assert time.monotonic() - began < 25, f"{time.monotonic() - began} s"
        assert "ModuleNotFoundError: No module named 'nobody_has_this' (crossing.py:2)" in failed, failed


def workers_of(root):
    """Lists the processes of leadtime.worker below a process; the shells that started them are none."""
    below, found = {}, []
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            # After the name, which may hold anything: the state, and the parent.
            parent = int(status.read_text().rpartition(")")[2].split()[1])
            below.setdefault(parent, []).append(int(status.parent.name))
    waiting = [root]
    while waiting:
        children = below.get(waiting.pop(), [])
        waiting += children
        for child in children:
            with contextlib.suppress(OSError):
                arguments = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
                if b"leadtime.worker" in arguments:
                    found.append(child)
    return found


def waited_for(condition, what):
    """Returns what a condition returns once that is true."""
    deadline = time.monotonic() + 60
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.01)
    return value


def test_cartpole_of_gymnasium_learns_the_same_with_one_worker_and_with_three_of_which_one_is_killed():
    settings = ["-c", "python", "--set", "world.env.id=CartPole-v1", "--seed", "3", "--steps", "30000"]
    with tempfile.TemporaryDirectory() as place:
        run(place, "up", *settings, "--actors", "1", "--name", "one")
        journal, log = Path(place, "runs/three/metrics.jsonl"), Path(place, "log")

        def updates():
            return journal.read_text().count("\n") if journal.exists() else 0

        with log.open("w") as told:
            up = subprocess.Popen(["leadtime", "up", *settings, "--actors", "3", "--set", "run.actors_min=3", "--name", "three"], cwd=place, stdout=told, stderr=told)
        try:
            waited_for(lambda: updates() >= 5, "five updates")
            workers = workers_of(up.pid)
            assert len(workers) == 3, workers
            os.kill(workers[0], signal.SIGKILL)
            killed_at = updates()
            waited_for(lambda: updates() > killed_at, "a further update")
            assert up.wait(300) == 0, log.read_text()
        finally:
            up.kill()
            up.wait()
        assert killed_at < updates() - 1 and "is started again" in log.read_text(), log.read_text()
        compared = run(place, "runs", "compare", "one", "three").stdout
        assert "weights: equal" in compared, compared


def test_gymnasiums_own_environments_keep_the_promise():
    with tempfile.TemporaryDirectory() as place:
        found = run(place, "check", "-c", "python", "--set", "world.env.id=CartPole-v1").stdout
        assert "equal in every byte" in found, found
        try:
            import Box2D  # noqa: F401
        except ImportError:
            print("LunarLander is skipped: no Box2D here")
            return
        lander = ["check", "-c", "python", "--set", "world.env.id=LunarLander-v3"]
        assert "equal in every byte" in run(place, *lander).stdout
        refused = run(place, *lander, "--set", "world.snapshot=pickle", code=2).stderr
        assert "a pickle of the environment is not all of it" in refused, refused


if __name__ == "__main__":
    os.environ["PATH"] = os.path.dirname(sys.executable) + os.pathsep + os.environ["PATH"]
    for name, test in list(globals().items()):
        if name.startswith("test_"):
            test()
            print(f"{name.removeprefix('test_').replace('_', ' ')}: ok")

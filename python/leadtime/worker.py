"""Steps Gymnasium environments for Leadtime, which starts this program by itself:

    [world]
    worker = "python3 -m leadtime.worker my_envs:make"       # my_envs.make(config, index) -> gymnasium.Env
    worker = "python3 -m leadtime.worker CartPole-v1"        # an id that Gymnasium knows
    worker = "python3 -m leadtime.worker"                    # the id is in env = { id = "CartPole-v1" }

``config`` is the table ``env`` of the configuration; ``index`` tells environments of one worker apart, for ports and files: what
an environment computes must not depend on it. ``info["action_mask"]`` says what is offered: a bool per choice, heads concatenated,
or an array for each part of a MultiDiscrete, Dict or Tuple, as its ``sample`` takes them. Without it, ``action_mask`` of an observation that is a Dict does, which stays
part of the observation. ``info["success"]`` and the numbers that ``metrics`` names are read at the end of an episode.

An observation is flattened as ``gymnasium.spaces.flatten`` does. An action is one choice per head: a Discrete is a head, a
MultiDiscrete one per dimension, a MultiBinary one of two choices per bit; Dict and Tuple have those of their parts. The protocol
is described in ``crates/worker/src/protocol.rs``.
"""

import hashlib
import importlib
import inspect
import json
import logging
import math
import os
import pickle
import platform
import random
import re
import select
import signal
import socket
import struct
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Mapping

VERSION = 1
HELLO, BEGIN, STEP, STEPPED, SNAPSHOT, SNAPSHOTTED, LOG, FAILED, ALIVE = range(1, 10)
ITSELF = 0xFFFF
MOST_TEXT = 8 << 10
MOST_HEADS, MOST_CHOICES = 8, 64
MOST_NUMBERS = 1 << 18  # Of an observation; crates/worker/src/settings.rs has the same bound.
MOST_PICKLE = 192 << 10  # Bytes; crates/worker/src/launch.rs has the same bound.
EVERYTHING = 2**64 - 1
MOST_OBSERVED = 1e9  # The largest number that a rollout may hold, either way.
SIGN_OF_LIFE = 1.0  # Seconds of silence after which the actor is told that environments still work; crates/worker/src/link.rs has the same.
LINES_PER_SECOND = 10
MOST_TRACEBACKS = 20
MOST_SHOWN = 80  # Characters of a value in a sentence.
CLOSING = 2.0  # Seconds that environments have for their `close` when the actor is gone; crates/worker/src/process.rs has the same.
LARGEST = 3e38  # About the largest number of 32 bits; the actor refuses it by name.
ENGINES = ("Box2D", "mujoco", "ale_py", "pettingzoo", "torch", "jax")  # What computes may decide what is computed.
COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # With which Gymnasium writes its warnings.
NONE, TERMINATED, TRUNCATED, DID_FAIL = range(4)
FAILURES = (Exception, SystemExit)  # Of an environment; a library that parses arguments or gives up calls `sys.exit`.


class Refused(Exception):
    """Something about the environment that Leadtime cannot work with; the text is for people."""


class Connection:
    """The way to the actor. Frames are written whole, also by other threads."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(path)
        self.incoming = self.socket.makefile("rb", 1 << 16)
        self.lock = threading.Lock()
        self.last = time.monotonic()
        self.process = os.getpid()

    def is_ours(self):
        """Returns whether this is the process that opened the connection, and not one that an environment has forked off."""
        return os.getpid() == self.process

    def receive(self):
        header = self.incoming.read(5)
        if len(header) < 5:
            return None, b""
        length, kind = struct.unpack("<IB", header)
        return kind, self.incoming.read(length)

    def send(self, kind, *parts):
        if not self.is_ours():
            # A child that goes on after an environment's exception would answer in the middle of what its parent says.
            os._exit(1)
        body = b"".join(parts)
        with self.lock:
            self.socket.sendall(struct.pack("<IB", len(body), kind) + body)
        self.last = time.monotonic()

    def is_lost(self):
        """Returns whether the actor is gone, and has not only said that it asks no more."""
        poll = select.poll()
        poll.register(self.socket, 0)
        return any(events & select.POLLHUP for _, events in poll.poll(0))

    def failed(self, slot, error):
        self.send(FAILED, struct.pack("<H", slot), as_bytes(sentence(error)))

    def live(self):
        """Tells the actor now and then that it is worth waiting."""
        if time.monotonic() - self.last > SIGN_OF_LIFE:
            self.send(ALIVE)


class LogHandler(logging.Handler):
    """Sends what is logged to the actor's log, a few lines a second."""

    def __init__(self, connection):
        super().__init__()
        self.connection, self.second, self.n_lines = connection, 0, 0

    def emit(self, record):
        second = int(time.monotonic())
        self.n_lines = self.n_lines + 1 if second == self.second else 1
        self.second = second
        if self.n_lines <= LINES_PER_SECOND:
            level = min(max(record.levelno // 10 - 1, 0), 3)
            try:
                text = as_bytes(COLOUR.sub("", self.format(record)))
            except Exception:
                # As everywhere in Python: a line that cannot be written fails nothing but itself.
                self.handleError(record)
                return
            if self.connection.is_ours():
                self.connection.send(LOG, bytes([level]), text)
            else:
                # Of a child of an environment: what it prints goes to the log as well, and cannot get into an answer.
                os.write(2, text + b"\n")


def as_bytes(text):
    return text.encode(errors="backslashreplace")[:MOST_TEXT]


def shown(value):
    """Writes a value as a sentence quotes it, whatever it is."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = f"a {type(value).__name__}"
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + "..."


def warning(message, category, file, line, source=None):
    """Writes a warning of Python as one line, without the line of the source."""
    return f"{category.__name__}: {' '.join(str(message).split())} ({os.path.basename(file)}:{line})"


def number(value, what):
    """Returns a number that fits 32 bits."""
    if isinstance(value, (str, bytes)):
        raise Refused(f"{what} is {shown(value)}, which is no number")
    try:
        value = float(value)
    except OverflowError:
        return LARGEST
    except (TypeError, ValueError):
        raise Refused(f"{what} is {shown(value)}, which is no number") from None
    return max(min(value, LARGEST), -LARGEST) if math.isfinite(value) else value


def flag(value, what):
    """Returns whether something holds that an environment says in whatever it has for that."""
    try:
        if not isinstance(value, (str, bytes)) and value == value:
            return bool(value)
    except (TypeError, ValueError):
        pass
    raise Refused(f"{what} is {shown(value)}, which is neither true nor false")


def sentence(error):
    """Writes an exception as one line, with the file and the line of the user's own code where there is one."""
    if isinstance(error, Refused):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "site-packages" not in frame.filename and frame.filename != __file__
           and not frame.filename.startswith(("<", os.path.dirname(os.__file__)))]
    # A line of this file says nothing of what is wrong with theirs.
    place = (own or [frame for frame in frames if frame.filename != __file__])[-1:]
    where = "".join(f" ({os.path.basename(frame.filename)}:{frame.lineno})" for frame in place)
    # A SyntaxError says itself where it is.
    if isinstance(error, (ImportError, SyntaxError)) and not own:
        where = ""
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = ""
    return ": ".join(filter(None, (type(error).__name__, text))) + where


# --- What environments look like -----------------------------------------------------------------------------------------


def count(space, spaces):
    """Returns the heads of an action space: pairs of a name and a number of choices."""
    if isinstance(space, spaces.Discrete):
        return [("", int(space.n))]
    if isinstance(space, spaces.MultiDiscrete):
        return [(str(i), int(n)) for i, n in enumerate(space.nvec.flatten())]
    if isinstance(space, spaces.MultiBinary):
        return [(str(i), 2) for i in range(math.prod(space.shape))]
    if isinstance(space, (spaces.Dict, spaces.Tuple)):
        parts = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        return [("_".join(filter(None, (str(key), name))), n) for key, part in parts for name, n in count(part, spaces)]
    if isinstance(space, spaces.Box):
        raise Refused("the action space is a Box: Leadtime's policies choose among choices and have no continuous actions; a wrapper "
                      "can offer some values of each number as a MultiDiscrete")
    raise Refused(f"the action space is {space}; possible are Discrete, MultiDiscrete, MultiBinary, and Dict or Tuple of these")


def heads_of(space, spaces):
    heads = [("_".join(filter(None, ("action", name))), n) for name, n in count(space, spaces)]
    if not 1 <= len(heads) <= MOST_HEADS:
        raise Refused(f"an action has {len(heads)} heads; 1 to {MOST_HEADS} are possible")
    total = 0
    for name, n in heads:
        total += n
        if total > MOST_CHOICES:
            raise Refused(f"`{name}` has {n} choices, which makes {total} in all; at most {MOST_CHOICES} are possible")
    names = [name for name, _ in heads]
    for name in names:
        if names.count(name) > 1:
            raise Refused(f"two heads of an action are `{name}`: give a part of the action space another key")
    return heads


def decoder(space, spaces, np):
    """Returns what makes the environment's action of the choices of its heads."""
    if isinstance(space, spaces.Discrete):
        # Of the type that `sample` gives: some environments index or shift with it.
        actions = [space.dtype.type(int(space.start) + i) for i in range(int(space.n))]
        return lambda choices: actions[choices[0]]
    if isinstance(space, spaces.MultiDiscrete):
        start = np.asarray(getattr(space, "start", np.zeros_like(space.nvec)))
        return lambda choices: (np.frombuffer(choices, np.uint8).reshape(space.nvec.shape) + start).astype(space.dtype)
    if isinstance(space, spaces.MultiBinary):
        return lambda choices: np.frombuffer(choices, np.uint8).reshape(space.shape).astype(space.dtype)
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else None
    parts, first = [], 0
    for part in space.spaces.values() if keys is not None else space.spaces:
        n = len(count(part, spaces))
        parts.append((slice(first, first + n), decoder(part, spaces, np)))
        first += n
    if keys is not None:
        return lambda choices: {key: decode(choices[of]) for key, (of, decode) in zip(keys, parts)}
    return lambda choices: tuple(decode(choices[of]) for of, decode in parts)


def mask_of(offered, space, spaces, np, what="`action_mask`"):
    """Returns which choices are offered, of one array over all, an array per head, or what `sample` takes.

    The sizes of parts are looked at, and not of the whole alone: two that are exchanged would be read as something else.
    """
    heads = [n for _, n in count(space, spaces)]
    if offered is None:
        return np.ones(sum(heads), bool)
    if isinstance(offered, Mapping):
        if not isinstance(space, spaces.Dict):
            raise Refused(f"{what} is a dict, and the space is {space}")
        for key in space.spaces:
            if key not in offered:
                raise Refused(f"{what} has no `{key}`, and the action space has")
        parts = [(offered[key], part, f"`{key}` of {what}") for key, part in space.spaces.items()]
    elif isinstance(offered, (tuple, list)) and isinstance(space, spaces.Tuple) and len(offered) == len(space.spaces):
        parts = [(of_part, part, f"part {i} of {what}") for i, (of_part, part) in enumerate(zip(offered, space.spaces))]
    else:
        arrays = list(arrays_of(offered, np))
        flat, sizes = np.concatenate([[], *arrays]), [array.size for array in arrays]
        if isinstance(space, spaces.MultiBinary) and flat.size == len(heads):
            # 0 and 1 offer nothing else, 2 offers either.
            return np.stack([flat != 1, flat != 0], axis=-1).ravel()
        if flat.size != sum(heads):
            raise Refused(f"{what} has {flat.size} entries for {sum(heads)} choices")
        if len(sizes) == len(heads) and sizes != heads:
            raise Refused(f"{what} has arrays of {sizes} entries for heads of {heads} choices")
        return flat.astype(bool)
    return np.concatenate([mask_of(of_part, part, spaces, np, name) for of_part, part, name in parts])


def arrays_of(offered, np):
    """Yields the arrays of what is nested in whatever way; a list of numbers is one."""
    if isinstance(offered, (tuple, list)) and any(hasattr(part, "__len__") for part in offered):
        for part in offered:
            yield from arrays_of(part, np)
    else:
        yield np.ravel(offered)


class Flattener:
    """Makes rows of 32-bit numbers of observations."""

    def __init__(self, space, spaces, np):
        self.space, self.spaces, self.np, self.dtype = space, spaces, np, np.dtype(np.float32)
        try:
            self.dim = spaces.flatdim(space)
        except (NotImplementedError, ValueError):
            raise Refused(f"the observation space is {space}; possible are Box, Discrete, MultiDiscrete, MultiBinary, and Dict or "
                          "Tuple of these") from None
        if not 1 <= self.dim <= MOST_NUMBERS:
            raise Refused(f"an observation has {self.dim} numbers; 1 to {MOST_NUMBERS} are possible")
        is_box = isinstance(space, spaces.Box)
        # Beside what is observed, as other libraries have it.
        self.has_mask = isinstance(space, spaces.Dict) and "action_mask" in space.spaces
        self.flatten = None if is_box else spaces.flatten
        # Observations of this shape are a row as they are.
        self.shape = (self.dim,) if is_box and space.shape == (self.dim,) else None
        self.nothing = np.zeros(self.dim, np.float32)
        self.watches, self.told = is_box, False
        if is_box:
            self.low, self.high = (bound.flatten().astype(np.float32) for bound in (space.low, space.high))
            self.watches = bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())
            if len(space.shape) != 1:
                logging.info("observations of shape %s are flattened to %d numbers", space.shape, self.dim)

    def row(self, observation):
        np = self.np
        if self.flatten is not None:
            self.check(self.space, observation, "an observation")
            return np.asarray(self.flatten(self.space, observation), np.float32)
        values = np.asarray(observation)
        if values.shape != self.space.shape:
            raise Refused(f"an observation has shape {values.shape}, not {self.space.shape}")
        if values.dtype.kind not in "fiub":
            raise Refused(f"an observation has dtype {values.dtype}, which is no number")
        if values.dtype == np.float64 and not self.told:
            self.told = True
            logging.info("observations are float64; they are used as float32")
        # A copy: the environment may go on writing into its own.
        return np.array(values.ravel(), np.float32)

    def check(self, space, value, what):
        """Refuses what Gymnasium would flatten to other numbers, or to more or fewer of them.

        What it flattens well is taken, even where its `contains` is stricter: a truth value as a choice, whole numbers of another
        type, an array of one number instead of that number.
        """
        spaces, np = self.spaces, self.np
        if isinstance(space, spaces.Dict):
            if not isinstance(value, Mapping):
                raise Refused(f"{what} is {shown(value)}, which is no dict")
            for key, part in space.spaces.items():
                if key not in value:
                    raise Refused(f"{what} has no `{key}`, and the observation space has")
                self.check(part, value[key], f"`{key}` of {what}")
        elif isinstance(space, spaces.Tuple):
            if not isinstance(value, (tuple, list, np.ndarray)) or len(value) != len(space.spaces):
                raise Refused(f"{what} is {shown(value)}, not a tuple of {len(space.spaces)}")
            for i, part in enumerate(space.spaces):
                self.check(part, value[i], f"part {i} of {what}")
        elif isinstance(space, spaces.Box):
            if not self.fits(space, value):
                raise Refused(f"{what} has shape {np.shape(value)}, not {space.shape}")
            values = np.asarray(value)
            if space.dtype.kind in "biu" and values.dtype != space.dtype:
                with np.errstate(invalid="ignore"):
                    is_kept = np.array_equal(values.astype(space.dtype), values)
                if not is_kept:
                    raise Refused(f"{what} is {shown(value)}, which is not of {space.dtype}, the type of its Box")
        elif isinstance(space, (spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
            if not self.fits(space, value) or not self.is_choice(space, np.asarray(value)):
                raise Refused(f"{what} is {shown(value)}, which is not in {space}")
        elif not space.contains(value):
            raise Refused(f"{what} is {shown(value)}, which is not in {space}")

    def fits(self, space, value):
        """Returns whether a value has the shape of a space; that of one number may be any."""
        np = self.np
        return np.shape(value) == space.shape or np.size(value) == np.prod(space.shape, dtype=int) == 1

    def is_choice(self, space, value):
        """Returns whether the numbers of an array are among those of a space of choices."""
        if isinstance(space, self.spaces.MultiBinary):
            return value.dtype.kind in "biuf" and bool(((value == 0) | (value == 1)).all())
        n = space.n if isinstance(space, self.spaces.Discrete) else space.nvec
        return value.dtype.kind in "biu" and bool(((value >= space.start) & (value <= space.start + (n - 1))).all())

    def look(self, rows):
        """Tells once that observations leave their Box, which costs them nothing."""
        outside = (rows < self.low) | (rows > self.high)
        if outside.any():
            self.watches = False
            i = int(outside.any(axis=0).argmax())
            logging.warning("observation[%d] leaves its Box (%g to %g), which is not told again", i, self.low[i], self.high[i])


# --- How environments are made ------------------------------------------------------------------------------------------


def maker(target, config):
    """Returns what makes an environment of an index."""
    import gymnasium

    if target is None:
        if "id" not in config:
            raise Refused("which environment? Name a function (`python3 -m leadtime.worker my_envs:make`) or an id of Gymnasium "
                          "(`env = { id = \"CartPole-v1\" }`)")
        return from_registry(config["id"], {key: value for key, value in config.items() if key != "id"})
    module, colon, name = target.partition(":")
    if not colon or re.search(r"-v\d+$", name):
        return from_registry(target, config)
    make = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(make, part):
            raise Refused(f"module `{module}` has no `{name}`")
        make = getattr(make, part)
    if inspect.isclass(make) and issubclass(make, gymnasium.Env):
        return lambda index: called(make, **config)
    if not callable(make):
        raise Refused(f"`{target}` is {shown(make)}, and no function that makes an environment")
    parameters = inspect.signature(make).parameters.values()
    takes = len([p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)])
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        takes = 2
    if takes == 0 and any(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in parameters):
        return lambda index: called(make, **config)
    if takes == 0 and config:
        raise Refused(f"`{target}` takes no argument, and `env` has {sorted(config)}: let it take `config`, and `index` if it needs that")
    return lambda index: called(make, *(config, index)[:takes])


def called(make, /, *given, **named):
    """Makes an environment; where the arguments do not fit, it says which they were. A key of `env` may be `make`."""
    try:
        return make(*given, **named)
    except TypeError as error:
        # Of the call itself, and not of anything inside.
        if error.__traceback__.tb_next is not None:
            raise
        what = " and ".join(("`config`", "`index`")[: len(given)]) or f"the keys of `env` as arguments, which has {sorted(named)}"
        raise Refused(f"{error}: it gets {what}") from None


def from_registry(name, arguments):
    import gymnasium

    def make(index):
        try:
            return gymnasium.make(name, disable_env_checker=True, **arguments)
        except gymnasium.error.Error as error:
            # Of an id that nobody knows, and not of one that needs another package.
            is_unknown = isinstance(error, gymnasium.error.UnregisteredEnv) and not re.search(r":|-v\d+$", name)
            hint = f" A function is named with its module, `{name}:make`; an id ends with its version." if is_unknown else ""
            raise Refused(f"{type(error).__name__}: {' '.join(str(error).split())}{hint}") from None

    return make


def own_code():
    """Returns digests of the code that no package has: of each module beside Python's and the installed ones, by the first part of
    its name. A reward may be decided in the wrapper, or in a module that an environment imports, as well as in its own file."""
    library, files = os.path.dirname(os.__file__) + os.sep, {}
    for name, module in list(sys.modules.items()):
        file, top = getattr(module, "__dict__", {}).get("__file__"), name.partition(".")[0]
        if not isinstance(file, str) or top in ("__main__", "__mp_main__", "leadtime"):
            continue
        file = os.path.abspath(file)
        is_installed = file.startswith(library) or "site-packages" in file or "dist-packages" in file
        if not is_installed and os.path.isfile(file):
            files.setdefault(top, {})[name] = file
    return {top: "sha256 " + digest_of(of_top) for top, of_top in files.items()}


def digest_of(files):
    """Returns the digest of one file, or one over the names and digests of several."""
    parts = []
    for name, file in sorted(files.items()):
        with open(file, "rb") as source:
            parts.append((name, hashlib.sha256(source.read()).hexdigest()))
    whole = parts[0][1] if len(parts) == 1 else hashlib.sha256(repr(parts).encode()).hexdigest()
    return whole[:12]


def versions_of(env):
    """Returns what decides what is computed: versions of packages, and of the user's own files their digests."""
    from importlib import metadata

    import gymnasium
    import numpy

    found = {"python": platform.python_version(), "numpy": numpy.__version__, "gymnasium": gymnasium.__version__}
    top = type(env.unwrapped).__module__.partition(".")[0]
    for name in {top, *(engine for engine in ENGINES if engine in sys.modules)} - {"gymnasium"}:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            file = getattr(sys.modules.get(name), "__file__", None)
            if file and os.path.exists(file):
                found[name] = "sha256 " + digest_of({name: file})
    for name, digest in own_code().items():
        # A package that is installed from its folder has a version, which changes less often than its code.
        found[f"{name} files" if name in found and not found[name].startswith("sha256 ") else name] = digest
    return dict(sorted(found.items()))


# --- The worker ----------------------------------------------------------------------------------------------------------


def five(told):
    """Returns the five values of a step, in whatever they came."""
    values = told if isinstance(told, (tuple, list)) else None
    if values is not None and len(values) == 5:
        return values
    found = shown(told) if values is None else f"{len(values)} values"
    raise Refused(f"`step` returns {found}, not five: the environment needs Gymnasium 0.26 or newer")


class Worker:
    def __init__(self, connection, make, config):
        import gymnasium
        import numpy

        self.connection, self.make, self.np, self.gymnasium = connection, make, numpy, gymnasium
        self.metrics, self.batch = config["metrics"], config["batch"]
        self.envs, self.rows = {}, {}
        first = self.new(0)
        self.envs[0] = first
        spaces = gymnasium.spaces
        self.heads = heads_of(first.action_space, spaces)
        self.decode = decoder(first.action_space, spaces, numpy)
        self.observe = Flattener(first.observation_space, spaces, numpy)
        self.action_space, self.observation_space = first.action_space, first.observation_space
        self.n_choices = sum(n for _, n in self.heads)
        self.first_choices = numpy.cumsum([0] + [n for _, n in self.heads[:-1]])
        # What is wrong with every episode is told before a run begins.
        observation, info = self.reset(0, 0)
        row = self.observe.row(observation)
        odd = numpy.flatnonzero(~(abs(row) <= MOST_OBSERVED))
        if odd.size:
            raise Refused(f"`reset` returns {row[odd[0]]:g} at index {odd[0]} of the observation; allowed: up to {MOST_OBSERVED:g} either way")
        self.mask(info, observation)
        self.told = set()
        self.step_layout = struct.Struct(f"<HI{len(self.heads)}s")
        self.metric_layout = struct.Struct(f"<{len(self.metrics)}f")

    def hello(self):
        names = {"heads": [name for name, _ in self.heads], "metrics": self.metrics, "versions": versions_of(self.envs[0])}
        fixed = struct.pack("<4sHHIB", b"LDWK", VERSION, self.batch, self.observe.dim, len(self.heads))
        self.connection.send(HELLO, fixed, bytes(n for _, n in self.heads), b"\0", json.dumps(names).encode())

    def new(self, slot):
        env = self.make(slot)
        if not isinstance(env, self.gymnasium.Env):
            raise Refused(f"what should make an environment returned {type(env).__name__}, which is no gymnasium.Env; it has to make "
                          "one environment, and is called for each")
        return env

    def reset(self, slot, seed):
        env = self.envs.get(slot)
        if env is None:
            env = self.envs[slot] = self.new(slot)
        try:
            told = env.reset(seed=seed)
        except TypeError as error:
            if "seed" in str(error):
                raise Refused("`reset` takes no seed: the environment needs Gymnasium 0.26 or newer") from error
            raise
        if not (isinstance(told, tuple) and len(told) == 2):
            raise Refused("`reset` does not return (observation, info): the environment needs Gymnasium 0.26 or newer")
        if not isinstance(told[1], Mapping):
            raise Refused(f"the info of `reset` is {shown(told[1])}, which is no dict")
        for kind, space in (("action", self.action_space), ("observation", self.observation_space)):
            own = getattr(env, kind + "_space")
            if own is not space and own != space:
                raise Refused(f"the {kind} space is {own}, and was {space} at first")
        return told

    def mask(self, info, observation):
        offered = info.get("action_mask")
        if offered is None and self.observe.has_mask:
            offered = observation["action_mask"]
        if offered is None:
            return EVERYTHING
        np = self.np
        if isinstance(offered, np.ndarray) and offered.size == self.n_choices:
            flat = offered.ravel().astype(bool)
        else:
            flat = mask_of(offered, self.action_space, self.gymnasium.spaces, np)
        is_offered = np.logical_or.reduceat(flat, self.first_choices)
        if not is_offered.all():
            name = self.heads[int(is_offered.argmin())][0]
            raise Refused(f"`action_mask` offers no choice of `{name}`: offer at least one, such as one that does nothing")
        return int.from_bytes(np.packbits(flat, bitorder="little").tobytes(), "little")

    def summary(self, info):
        values = []
        for name in self.metrics:
            value = info.get(name, info.get("is_success") if name == "success" else None)
            if value is None:
                raise Refused(f"info has no `{name}` at the end of an episode, which `world.metrics` names")
            values.append(number(value, f"`{name}` of info"))
        return self.metric_layout.pack(*values)

    def begin(self, body):
        n, at = struct.unpack_from("<H", body)[0], 2
        rows, masks, ends = [], [], bytearray(n)
        for i in range(n):
            slot, seed, length, pickled = struct.unpack_from("<HIII", body, at)
            base, actions = body[at + 14 : at + 14 + pickled], body[at + 14 + pickled : at + 10 + length]
            at += 10 + length
            try:
                row, mask = self.restore(slot, seed, base, actions)
            except FAILURES as error:
                self.tell(slot, error)
                row, mask, ends[i] = self.observe.nothing, EVERYTHING, DID_FAIL
            rows.append(row)
            masks.append(mask)
            self.rows[slot] = row, mask
            self.connection.live()
        self.answer(rows, [0.0] * n, ends, masks, [])

    def restore(self, slot, seed, base, actions):
        if base:
            # The one before is not closed: the two may share what it has opened.
            self.envs[slot], row, mask = pickle.loads(base)
        else:
            observation, info = self.reset(slot, seed)
            row, mask = self.observe.row(observation), self.mask(info, observation)
        env, n_heads = self.envs[slot], len(self.heads)
        n_steps = len(actions) // n_heads
        for step in range(n_steps):
            choices = actions[step * n_heads : (step + 1) * n_heads]
            observation, _, terminated, truncated, info = env.step(self.decode(choices))
            if terminated or truncated:
                raise Refused(f"an episode that is played again ends after {step + 1} of {n_steps} steps: the environment does not "
                              "depend on its seed and its actions alone")
            self.connection.live()
        if n_steps:
            row, mask = self.observe.row(observation), self.mask(info, observation)
        return row, mask

    def step(self, body):
        n = struct.unpack_from("<H", body)[0]
        envs, decode, row_of, shape, monotonic = self.envs, self.decode, self.observe.row, self.observe.shape, time.monotonic
        ndarray, float32, has_mask = self.np.ndarray, self.observe.dtype, self.observe.has_mask
        rows, rewards, ends, masks, rest, last = [], [], bytearray(n), [EVERYTHING] * n, [], self.connection.last
        for i, (slot, seed, choices) in enumerate(self.step_layout.iter_unpack(memoryview(body)[2:])):
            try:
                told = envs[slot].step(decode(choices))
                if told.__class__ is not tuple or len(told) != 5:
                    told = five(told)
                observation, reward, terminated, truncated, info = told
                if info.__class__ is not dict and not isinstance(info, Mapping):
                    raise Refused(f"the info of `step` is {shown(info)}, which is no dict")
                # What most environments return. A copy: environments may share the array, and go on writing into it.
                if observation.__class__ is ndarray and observation.dtype is float32 and observation.shape == shape:
                    row = observation.copy()
                else:
                    row = row_of(observation)
                if reward.__class__ is not float:
                    reward = number(reward, "the reward")
                ended = b""
                if terminated.__class__ is not bool or truncated.__class__ is not bool:
                    terminated, truncated = flag(terminated, "`terminated`"), flag(truncated, "`truncated`")
                if terminated or truncated:
                    ended = row.tobytes() + self.summary(info)
                    self.connection.live()
                    observation, info = self.reset(slot, seed)
                    row = row_of(observation)
                if has_mask or "action_mask" in info:
                    masks[i] = self.mask(info, observation)
                if ended:
                    rest.append(ended)
                    ends[i] = TERMINATED if terminated else TRUNCATED
            except FAILURES as error:
                self.tell(slot, error)
                row, reward, ends[i] = self.observe.nothing, 0.0, DID_FAIL
            rows.append(row)
            rewards.append(reward)
            self.rows[slot] = row, masks[i]
            if monotonic() - last > SIGN_OF_LIFE:
                self.connection.send(ALIVE)
                last = self.connection.last
        self.answer(rows, rewards, ends, masks, rest)

    def answer(self, rows, rewards, ends, masks, rest):
        n = len(rows)
        seen = b"".join(rows)
        if self.observe.watches:
            self.observe.look(self.np.frombuffer(seen, self.np.float32).reshape(n, -1))
        try:
            paid = struct.pack(f"<{n}f", *rewards)
        except OverflowError:
            # More than a 32-bit number holds; the actor refuses it by name.
            paid = struct.pack(f"<{n}f", *(number(reward, "the reward") for reward in rewards))
        self.connection.send(STEPPED, struct.pack("<H", n), seen, paid, ends, struct.pack(f"<{n}Q", *masks), *rest)

    def snapshot(self, body):
        slot = struct.unpack_from("<H", body)[0]
        row, mask = self.rows[slot]
        try:
            pickled = pickle.dumps((self.envs[slot], self.np.array(row), mask), pickle.HIGHEST_PROTOCOL)
            if len(pickled) > MOST_PICKLE:
                raise Refused(f"its pickle has {len(pickled)} bytes, and at most {MOST_PICKLE} fit a snapshot; world.snapshot = \"replay\" "
                              "keeps its actions instead")
        except FAILURES as error:
            self.tell(slot, error)
            pickled = b""
        self.connection.send(SNAPSHOTTED, pickled)

    def tell(self, slot, error):
        if not self.connection.is_ours():
            raise error  # A child that an environment has forked off ends here, as it would anywhere.
        # One traceback of all that say the same, and not one for each of a hundred environments.
        if not isinstance(error, Refused) and sentence(error) not in self.told and len(self.told) < MOST_TRACEBACKS:
            self.told.add(sentence(error))
            traceback.print_exception(type(error), error, error.__traceback__)
            sys.stderr.flush()
        self.connection.failed(slot, error)

    def work(self):
        answers = {BEGIN: self.begin, STEP: self.step, SNAPSHOT: self.snapshot}
        while True:
            kind, body = self.connection.receive()
            if kind is None:
                return
            answers[kind](body)

    def close(self):
        """Lets environments tidy up: some have started programs, or have files to finish."""
        for env in self.envs.values():
            try:
                env.close()
            except FAILURES as error:
                print(f"`close` fails: {sentence(error)}", file=sys.stderr)


def end_with_the_actor():
    """The actor holds the other end of our standard input; when it is gone, so are we and what environments have started, whatever
    an environment does. Its connection is gone then, too, which lets environments close in the meantime."""
    try:
        while os.read(0, 1024):
            pass
    except OSError:
        pass
    time.sleep(CLOSING)
    os.killpg(0, signal.SIGKILL)


def main(arguments):
    path = os.environ.get("LEADTIME_WORKER_SOCKET")
    if path is None:
        print("leadtime.worker is started by Leadtime: write `worker = \"python3 -m leadtime.worker ...\"` in [world]", file=sys.stderr)
        return 2
    # What environments print is for people, and never part of the protocol.
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)
    threading.Thread(target=end_with_the_actor, daemon=True).start()
    connection = Connection(path)
    try:
        return serve(connection, arguments)
    finally:
        if connection.is_lost():
            # What environments have started is in our process group, which the actor would have killed.
            sys.stderr.flush()
            os.killpg(0, signal.SIGKILL)


def serve(connection, arguments):
    """Makes environments and steps them until nobody asks any more; returns the exit code."""
    logging.getLogger().addHandler(LogHandler(connection))
    logging.getLogger().setLevel(logging.INFO)
    logging.captureWarnings(True)
    warnings.formatwarning = warning
    try:
        config = json.loads(os.environ["LEADTIME_WORKER_CONFIG"])
        try:
            import gymnasium  # noqa: F401
            import numpy
        except ImportError as error:
            raise Refused(f"{type(error).__name__}: {error}: `pip install gymnasium` here, with {sys.executable}") from None
        # Of a process that others start anew, no environment may depend on them.
        random.seed(0)
        numpy.random.seed(0)
        worker = Worker(connection, maker(arguments[0] if arguments else None, config["env"]), config)
        worker.hello()
    except FAILURES as error:
        connection.failed(ITSELF, error)
        return 1
    try:
        worker.work()
    except (BrokenPipeError, ConnectionResetError):
        pass
    worker.close()
    return 0


if __name__ == "__main__":
    if sys.path[0] == os.path.dirname(os.path.abspath(__file__)):
        sys.path[0] = os.getcwd()
    sys.exit(main(sys.argv[1:]))

"""The worlds as Gymnasium environments.

    import gymnasium
    import leadtime.gym

    env = gymnasium.make("leadtime/Lander-v0", set={"human.reaction_delay": 3})
    envs = gymnasium.make_vec("leadtime/Lander-v0", num_envs=64, vectorization_mode="vector_entry_point")

``config`` is a built-in configuration (``leadtime config`` lists them) or a file, ``set`` changes keys of it, and
``evaluation=True`` takes the task as it is in evaluation. An action has one choice per head (initiate, topic, k, l).
``info["action_mask"]`` says which choices are offered; one that is not has no effect. A message cannot be understood after it
is over: with l below k it has k words. At the end of an episode ``info["metrics"]`` has its metrics, ``info["success"]`` whether
it succeeded.
"""

import json
import math

import numpy as np

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError(f"{error}: leadtime.gym needs Gymnasium, `pip install 'gymnasium>=1.1'`") from None

from leadtime._native import World, Worlds
from leadtime.checks import whole

IDS = {
    "leadtime/Lander-v0": "lander",
    "leadtime/LanderHard-v0": "lander_hard",
    "leadtime/Highway-v0": "highway",
    "leadtime/HighwayConflict-v0": "highway_conflict",
    "leadtime/Steakhouse-v0": "steakhouse",
    "leadtime/SteakhouseTiming-v0": "steakhouse_timing",
    "leadtime/Pilot-v0": "pilot",
    "leadtime/CartPole-v0": "cartpole",
    "leadtime/CueRecall-v0": "cue_recall",
}
SEEDS = 2**63


def toml(value):
    """Writes a value as TOML."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(str(key))} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} cannot be a setting")
    if isinstance(value, (int, float, np.integer, np.floating)):
        return repr(value.item() if isinstance(value, np.generic) else value)
    return json.dumps(str(value))


def changes(settings):
    """Writes a table of changes as the program's ``--set`` has them."""
    if not isinstance(settings, (dict, type(None))):
        raise ValueError(f"set {settings!r}; allowed: a dict of keys and values, such as {{\"human.reaction_delay\": {{\"fixed\": 3}}}}")
    return [f"{key}={toml(value)}" for key, value in (settings or {}).items()]


def make_spaces(world):
    """Returns the spaces of observations and actions, and whether an action is a single choice."""
    low, high = (np.array([quantity[i] for quantity in world.quantities], np.float32) for i in (2, 3))
    sizes = [len(choices) for _, choices in world.heads]
    single = len(sizes) == 1
    return spaces.Box(low, high, dtype=np.float32), spaces.Discrete(sizes[0]) if single else spaces.MultiDiscrete(sizes), single


def no_episode(action=None):
    """Stands for a step before the first episode."""
    raise gymnasium.error.ResetNeeded("there is no episode yet: call reset() first")


class Episodes:
    """Which episode comes next: the first of the run with a seed, and then its others in order."""

    def __init__(self):
        self._seed, self._next = None, 0

    def begin(self, seed, options, draw):
        """Returns run seed and number of the episode that begins; ``draw`` gives a seed where none was ever named."""
        seed = None if seed is None else whole(seed, "seed") % SEEDS
        # Others are passed over: the checkers of Gymnasium and PettingZoo give some that no environment knows.
        picked = whole(options["episode"], "options[\"episode\"]", SEEDS) if options and "episode" in options else None
        if seed is not None:
            self._seed, self._next = seed, 0
        elif self._seed is None:
            self._seed = int(draw())
        episode = self._next if picked is None else picked
        self._next = episode + 1
        return self._seed, episode


class LeadtimeEnv(gymnasium.Env):
    """One environment.

    ``reset(seed=s)`` begins the first episode of the run with that seed, and every further ``reset()`` its next one;
    ``options={"episode": n}`` picks one. They are the episodes of the program's environment 0, bit for bit.
    """

    # A step is a word.
    metadata = {"render_modes": ["rgb_array", "ansi"], "render_fps": 3}

    def __init__(self, config="lander", set=None, evaluation=False, render_mode=None):
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode {render_mode!r}; allowed: {self.metadata['render_modes']}")
        self.render_mode = render_mode
        self._made_of = config, changes(set), evaluation
        self._make_world()
        self.observation_space, self.action_space, self._single = make_spaces(self.world)
        self._episodes = Episodes()

    def _make_world(self):
        self.world = World(*self._made_of)
        if self.render_mode is not None:
            self.world.film()
        # This in place of a wrapper, which would cost a third of a short step.
        self._step = no_episode

    def __getstate__(self):
        """A copy goes on from the same moment, and draws the same episodes from then on; pictures begin there."""
        kept = {name: value for name, value in vars(self).items() if name not in ("world", "_step")}
        return kept | {"snapshot": None if self._step is no_episode else self.world.snapshot()}

    def __setstate__(self, kept):
        snapshot = kept.pop("snapshot")
        vars(self).update(kept)
        self._make_world()
        if snapshot is not None:
            self.world.restore(snapshot)
            self._step = self.world.step

    def reset(self, *, seed=None, options=None):
        begun = self._episodes.begin(seed, options, lambda: self.np_random.integers(SEEDS))
        super().reset(seed=None if seed is None else whole(seed, "seed"))
        self._step = self.world.step
        return self.world.reset(*begun)

    def step(self, action):
        return self._step(action)

    def render(self):
        """Returns the present moment: as pixels of shape ``[height, width, 3]``, or in a line what is heard and done."""
        if self.render_mode is None:
            gymnasium.logger.warn("nothing is drawn: make the environment with render_mode=\"rgb_array\" or \"ansi\"")
            return None
        if self._step is no_episode:
            no_episode()
        return self.world.picture() if self.render_mode == "rgb_array" else self.world.caption()

    def action_masks(self):
        """Returns the offered choices as booleans, head after head (what sb3-contrib's MaskablePPO asks for)."""
        return self.world.offered().astype(bool)

    def baseline(self, name="heuristic"):
        """Returns the action that a scripted policy of the world takes now."""
        choices = list(self.world.baseline(name))
        return choices[0] if self._single else np.array(choices)


class LeadtimeVectorEnv(gymnasium.vector.VectorEnv):
    """Many environments with one native call per step. An episode that ends is followed by the next one in the same step;
    its last observation is in ``infos["final_obs"]`` and its metrics in ``infos["final_info"]``.

    ``reset(seed=s)`` begins the first episodes of the run with that seed: those of the program's environments 0, 1, ...
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, num_envs=1, config="lander", set=None, evaluation=False, render_mode=None):
        if render_mode is not None:
            raise ValueError(f"render_mode {render_mode!r}: a vector draws nothing; a single environment does")
        self.render_mode = None
        self.num_envs = num_envs
        self.worlds = Worlds(config, changes(set), evaluation, num_envs)
        world = World(config, changes(set), evaluation)
        self.single_observation_space, self.single_action_space, _ = make_spaces(world)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._step = no_episode

    def reset(self, *, seed=None, options=None):
        if isinstance(seed, (list, tuple, np.ndarray)):
            raise ValueError("one seed names all environments: give a number")
        if options:
            raise ValueError(f"options {sorted(options)}: a vector takes none; a single environment takes `episode`")
        seed = None if seed is None else whole(seed, "seed")
        super().reset(seed=seed)
        if seed is None and self._step is no_episode:
            seed = int(self.np_random.integers(SEEDS))
        self._step = self.worlds.step
        return self.worlds.reset(None if seed is None else seed % SEEDS)

    def step(self, actions):
        return self._step(actions)


for name, configuration in IDS.items():
    if name not in gymnasium.registry:
        gymnasium.register(name, entry_point="leadtime.gym:LeadtimeEnv", vector_entry_point="leadtime.gym:LeadtimeVectorEnv",
                           kwargs={"config": configuration}, order_enforce=False, disable_env_checker=True)

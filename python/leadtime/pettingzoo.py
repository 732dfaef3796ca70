"""The worlds as PettingZoo environments for two who learn: a notifier, and the listener who hears it.

    from leadtime.pettingzoo import parallel_env

    env = parallel_env("lander")
    observations, infos = env.reset(seed=7)
    while env.agents:
        actions = {agent: env.action_space(agent).sample(infos[agent].get("action_mask")) for agent in env.agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)

The ``notifier`` has the observation, action, mask, reward and metrics of ``leadtime.gym``. The listener, ``person``, acts instead of the
model of a delayed human: in every step by their own plan (0), or they carry out a topic (1 for the first, 2 for the second, ...).
They see the world, how much they have heard of the message that runs, the topic that they have understood last, and how long
ago that was. When they understand a message is the model's; how soon they react and for how long is theirs. Their reward is the
world's; words cost the notifier.
"""

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from leadtime._native import Pair, World
from leadtime.gym import SEEDS, Episodes, changes, make_spaces

NOTIFIER, PERSON = "notifier", "person"


class parallel_env(ParallelEnv):
    """One environment for two. ``config``, ``set``, ``evaluation`` and ``reset`` are as in ``leadtime.gym``."""

    metadata = {"name": "leadtime_v0", "render_modes": []}
    render_mode = None

    def __init__(self, config="lander", set=None, evaluation=False):
        world = World(config, changes(set), evaluation)
        self.pair = Pair(config, changes(set), evaluation)
        self.possible_agents, self.agents = [NOTIFIER, PERSON], []
        observation, action, self._single = make_spaces(world)
        low, high = (np.array([quantity[i] for quantity in self.pair.person_quantities], np.float32) for i in (2, 3))
        self.observation_spaces = {NOTIFIER: observation, PERSON: spaces.Box(low, high, dtype=np.float32)}
        self.action_spaces = {NOTIFIER: action, PERSON: spaces.Discrete(1 + len(self.pair.topics))}
        self._sizes = [len(choices) for _, choices in world.heads]
        self._episodes = Episodes()

    def observation_space(self, agent):
        return self.observation_spaces[agent]

    def action_space(self, agent):
        return self.action_spaces[agent]

    def reset(self, seed=None, options=None):
        views = self.pair.reset(*self._episodes.begin(seed, options, lambda: seeding.np_random()[0].integers(SEEDS)))
        self.agents = list(self.possible_agents)
        return self._told(views)

    def step(self, actions):
        if not self.agents:
            raise ValueError("the episode is over: reset() begins the next one")
        for agent in self.possible_agents:
            if agent not in actions:
                raise ValueError(f"actions {sorted(actions)}: `{agent}` has none")
        if not self.action_spaces[PERSON].contains(actions[PERSON]):
            raise ValueError(f"the person's action {actions[PERSON]!r}; allowed: one of {self.action_spaces[PERSON]}")
        views, rewards, (terminated, truncated) = self.pair.step(actions[NOTIFIER], int(actions[PERSON]) - 1)
        observations, infos = self._told(views)
        if terminated or truncated:
            told = self.pair.ending()
            for info in infos.values():
                info.update(told)
            self.agents = []
        both = self.possible_agents
        return observations, dict(zip(both, rewards)), dict.fromkeys(both, terminated), dict.fromkeys(both, truncated), infos

    def action_masks(self):
        """Returns the notifier's offered choices as booleans, head after head."""
        return self._mask.astype(bool)

    def _told(self, views):
        notifier, person, self._mask = views
        mask = self._mask if self._single else tuple(np.split(self._mask, np.cumsum(self._sizes)[:-1]))
        # In the form in which Gymnasium's spaces draw: an array per head.
        return {NOTIFIER: notifier, PERSON: person}, {NOTIFIER: {"action_mask": mask}, PERSON: {}}

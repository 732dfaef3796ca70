"""A world for two is what PettingZoo asks for, and the listener in it counts."""

import unittest
import warnings

import gymnasium
import numpy as np
from pettingzoo.test import parallel_api_test, parallel_seed_test

import leadtime.gym
from leadtime.pettingzoo import parallel_env

WORLDS = ["lander", "highway", "steakhouse"]


def fly(env, motion, seed=3):
    """Plays an episode in which nothing is said; returns the rewards of the person and the last infos."""
    env.reset(seed=seed)
    rewards = []
    while env.agents:
        silence = np.zeros(env.action_space("notifier").shape, int)
        _, reward, _, _, infos = env.step({"notifier": silence, "person": motion})
        rewards.append(reward["person"])
    return rewards, infos


class PettingZoo(unittest.TestCase):
    def test_pettingzoo_finds_nothing_wrong(self):
        for config in WORLDS:
            with self.subTest(config), warnings.catch_warnings():
                warnings.simplefilter("error")
                parallel_api_test(parallel_env(config), num_cycles=1000)
                parallel_seed_test(lambda: parallel_env(config), num_cycles=50)

    def test_a_person_by_their_own_plan_is_the_unaided_one(self):
        together, infos = fly(parallel_env("lander"), 0)
        alone = gymnasium.make("leadtime/Lander-v0").unwrapped
        alone.reset(seed=3)
        rewards, done = [], False
        while not done:
            _, reward, terminated, truncated, info = alone.step(np.zeros(alone.action_space.shape, int))
            rewards.append(reward)
            done = terminated or truncated
        self.assertEqual(together, rewards)
        self.assertEqual(infos["person"]["metrics"], info["metrics"])

    def test_what_the_person_does_matters_and_what_cannot_be_is_refused(self):
        env = parallel_env("lander", set={"human.reaction_delay": 3}, evaluation=True)
        self.assertNotEqual(fly(env, 0)[0], fly(env, 1)[0])
        with self.assertRaisesRegex(ValueError, "reset"):
            env.step({"notifier": np.zeros(4, int), "person": 0})
        env.reset(seed=1)
        with self.assertRaisesRegex(ValueError, r"person's action 99; allowed: one of Discrete\(5\)"):
            env.step({"notifier": np.zeros(4, int), "person": 99})
        with self.assertRaisesRegex(ValueError, "`notifier` has none"):
            env.step({"person": 0})
        with self.assertRaisesRegex(ValueError, "no listener"):
            parallel_env("cartpole")


if __name__ == "__main__":
    unittest.main()

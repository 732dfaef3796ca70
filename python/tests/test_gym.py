"""The worlds from Python are those of the program, and what Gymnasium asks for."""

import copy
import json
import os
import pickle
import subprocess
import sys
import tempfile
import unittest
import warnings
from pathlib import Path
from types import MappingProxyType, SimpleNamespace

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

import leadtime
import leadtime.gym
from leadtime.gym import IDS, Episodes, LeadtimeVectorEnv, toml
from leadtime.notifier import LocalNotifier, tomllib
from leadtime.policy import load

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("LEADTIME", "leadtime")


# What is played of each task, so that there are 1,000 steps of it: shipped policies, and some that have hardly been trained.
SHIPPED = {"piloting": 40, "cooking": 40, "driving": 10}
UNTRAINED = {"pilot": 40, "cartpole": 40, "cue_recall": 200}
N_STEPS = 1000


def told(*arguments, folder):
    """Returns what the program prints."""
    finished = subprocess.run([PROGRAM, *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    if finished.returncode:
        raise AssertionError(f"{arguments}: exit code {finished.returncode}: {finished.stderr}")
    return finished.stdout


def untrained(task, folder):
    """Lets a policy of a task learn for one update, and returns its file."""
    name = task.replace("_", "-")
    told("up", "-c", task, "--actors", "1", "--stop-after", "1", "--name", name, folder=folder)
    return Path(folder) / "runs" / name / "policy.safetensors"


def steps_of(policy, folder, episodes):
    """Lets the program play a policy, and returns what it saw and did, step by step."""
    file = Path(folder) / "steps.jsonl"
    told("eval", policy, "--episodes", episodes, "--eval-seed", "11", "--action", "greedy", "--episodes-to", file, folder=folder)
    return [json.loads(line) for line in file.read_text().splitlines()]


def worlds_of(policy, folder, n):
    """Makes the environments in which the program evaluates a policy, as many as there are episodes."""
    file = Path(folder) / "own.toml"
    file.write_text(policy.metadata["config"])
    return LeadtimeVectorEnv(n, config=str(file), evaluation=True)


class Gym(unittest.TestCase):
    def test_its_import_brings_no_more_than_gymnasium_and_numpy(self):
        code = ("import json, sys, leadtime.gym; names = {name.partition('.')[0] for name in sys.modules}; "
                "print(json.dumps(sorted(name for name in names - sys.stdlib_module_names if not name.startswith('_'))))")
        brought = set(json.loads(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout))
        self.assertIn("leadtime", brought)
        theirs = {"gymnasium", "farama_notifications", "cloudpickle", "typing_extensions", "numpy", "cython_runtime"}
        self.assertEqual(brought - theirs, {"leadtime"})

    def test_gymnasium_finds_nothing_wrong_in_any_world(self):
        for name in IDS:
            with self.subTest(name), warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                env = gymnasium.make(name, disable_env_checker=True)
                # What has no picture says so when it is made.
                drawn = name != "leadtime/CueRecall-v0"
                check_env(env.unwrapped, skip_render_check=not drawn)
                texts = [str(warning.message) for warning in told if "gymnasium" in warning.filename]
                self.assertEqual([text for text in texts if "infinity" not in text], [])

    def test_stable_baselines_finds_nothing_wrong_in_any_world(self):
        try:
            from stable_baselines3.common.env_checker import check_env as check
        except ImportError:
            self.skipTest("stable-baselines3 is not installed: it needs torch, of 900 MB")
        for name in IDS:
            with self.subTest(name), warnings.catch_warnings():
                warnings.simplefilter("error")
                check(gymnasium.make(name, disable_env_checker=True).unwrapped)

    def test_a_script_of_the_world_speaks_in_its_terms(self):
        for name in ["leadtime/Lander-v0", "leadtime/Highway-v0", "leadtime/Steakhouse-v0"]:
            env = gymnasium.make(name).unwrapped
            spoke, done = False, False
            env.reset(seed=2)
            while not done:
                action = env.baseline()
                self.assertTrue(env.action_space.contains(action), name)
                _, _, terminated, truncated, info = env.step(action)
                spoke |= bool(action[0])
                done = terminated or truncated
            self.assertTrue(spoke and info["metrics"]["notifications"] > 0, name)

    def test_a_moment_is_drawn_and_told(self):
        env = gymnasium.make("leadtime/Lander-v0", render_mode="rgb_array")
        line = gymnasium.make("leadtime/Lander-v0", render_mode="ansi")
        pictures, lines = [], []
        for drawn, told in [(env, pictures), (line, lines)]:
            drawn.reset(seed=1)
            told.append(drawn.render())
            # Starts a message of the first topic, with the longest k and l.
            start = [1, *(drawn.action_space.nvec[1:] - 1)]
            for action in [start, [0, 0, 0, 0], [0, 0, 0, 0]]:
                drawn.step(np.array(action))
                told.append(drawn.render())
        self.assertTrue(all(picture.shape == pictures[0].shape and picture.dtype == np.uint8 for picture in pictures))
        self.assertTrue((pictures[0] != pictures[1]).any() and np.unique(pictures[0]).size > 20)
        self.assertEqual(lines[0], "own plan")
        # One more word with every step, in quotation marks.
        words = [len(text.split("\u201c")[1].split()) for text in lines[1:]]
        self.assertEqual(words, [1, 2, 3])
        with self.assertRaisesRegex(ValueError, "cannot be drawn"):
            gymnasium.make("leadtime/CueRecall-v0", render_mode="ansi")

    def test_the_same_seed_is_the_same_episode_and_the_next_one_is_another(self):
        env = gymnasium.make("leadtime/Lander-v0")
        first, _ = env.reset(seed=3)
        second, _ = env.reset()
        again, _ = env.reset(seed=3)
        picked, _ = env.reset(options={"episode": 1})
        self.assertTrue((first == again).all() and (second == picked).all() and (first != second).any())

    def test_a_copy_goes_on_from_the_same_moment(self):
        for copied in (copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))):
            env = gymnasium.make("leadtime/Lander-v0")
            with self.assertRaises(gymnasium.error.ResetNeeded):
                copied(env).step(env.action_space.sample())
            env.reset(seed=3)
            env.step(env.unwrapped.baseline())
            other = copied(env)
            for _ in range(300):
                action = env.unwrapped.baseline()
                (seen, *rest, info), (seen_too, *rest_too, info_too) = env.step(action), other.step(action)
                self.assertTrue((seen == seen_too).all() and rest == rest_too and info.keys() == info_too.keys())
                if any(rest[1:]):
                    self.assertTrue((env.reset()[0] == other.reset()[0]).all())

    def test_a_seed_and_an_episode_are_whole_numbers_of_any_type_and_nothing_else(self):
        episodes = Episodes()
        self.assertEqual(episodes.begin(np.int64(3), None, None), (3, 0))
        for seed, options, told in [(-1, None, "seed -1; allowed: a whole number from 0 on"), (1.0, None, "seed 1.0; "), ("1", None, "seed '1'; "),
                                    (8, {"episode": 1.7}, r'options\["episode"\] 1.7; '), (8, {"episode": 2**70}, f"allowed: a whole number from 0 to {2**63 - 1}")]:
            with self.assertRaisesRegex(ValueError, told):
                episodes.begin(seed, options, None)
        # What was refused has changed nothing.
        self.assertEqual(episodes.begin(None, {}, None), (3, 1))
        self.assertEqual(episodes.begin(None, {"episode": np.int32(7)}, None), (3, 7))
        env = gymnasium.make("leadtime/Lander-v0")
        envs = gymnasium.make_vec("leadtime/Lander-v0", num_envs=2, vectorization_mode="vector_entry_point")
        self.assertTrue((env.reset(seed=3)[0] == env.reset(seed=np.int64(3))[0]).all())
        self.assertTrue((envs.reset(seed=3)[0] == envs.reset(seed=np.uint32(3))[0]).all())
        for either in (env, envs):
            with self.assertRaisesRegex(ValueError, "seed -1; allowed"):
                either.reset(seed=-1)

    def test_a_vector_steps_as_its_environments_do_alone(self):
        for name, n in [("leadtime/CartPole-v0", 3), ("leadtime/Steakhouse-v0", 17)]:
            envs = gymnasium.make_vec(name, num_envs=n, vectorization_mode="vector_entry_point")
            envs.action_space.seed(5)
            observations, infos = envs.reset(seed=9)
            alone = gymnasium.make(name).unwrapped
            expected, info = alone.reset(seed=9)
            self.assertTrue((observations[0] == expected).all() and (infos["action_mask"][0] == info["action_mask"]).all())
            n_ended = 0
            for _ in range(300):
                actions = envs.action_space.sample()
                observations, rewards, terminated, truncated, infos = envs.step(actions)
                expected, reward, *ends, info = alone.step(actions[0])
                self.assertEqual((rewards[0], terminated[0], truncated[0]), (np.float32(reward), *ends))
                if any(ends):
                    n_ended += 1
                    self.assertTrue((infos["final_obs"][0] == expected).all())
                    name_of_metric = alone.world.metric_names[0]
                    self.assertEqual(infos["final_info"]["metrics"][name_of_metric][0], info["metrics"][name_of_metric])
                    expected, info = alone.reset()
                self.assertTrue((observations[0] == expected).all())
                self.assertTrue((infos["action_mask"][0] == info["action_mask"]).all())
            self.assertGreater(n_ended, 1)

    def test_a_vector_tells_of_its_ends_what_gymnasium_composes(self):
        envs = gymnasium.make_vec("leadtime/CartPole-v0", num_envs=5, vectorization_mode="vector_entry_point")
        envs.reset(seed=4)
        n_ended = 0
        for _ in range(60):
            observations, _, terminated, truncated, infos = envs.step(np.zeros(5, int))
            ended = terminated | truncated
            n_ended += ended.sum()
            self.assertEqual("final_info" in infos, bool(ended.any()))
            if not ended.any():
                continue
            expected = {}
            for i in np.flatnonzero(ended):
                told = {"metrics": {"success": 0.0}, "success": False}
                expected = envs._add_info(expected, {"final_obs": infos["final_obs"][i], "final_info": told}, i)
                self.assertGreater(abs(infos["final_obs"][i] - observations[i]).max(), 0)
            for name in ("final_info", "_final_info", "_final_obs"):
                np.testing.assert_equal(infos[name], expected[name], name)
            np.testing.assert_equal(list(infos["final_obs"]), list(expected["final_obs"]))
        self.assertGreater(n_ended, 10)

    def test_an_action_is_a_choice_per_head_in_any_form(self):
        env, seen = gymnasium.make("leadtime/Lander-v0"), []
        for action in [[1, 0, 1, 2], (1, 0, 1, 2), np.array([1, 0, 1, 2]), np.array([1, 0, 1, 2], np.int32), np.array([1, 9, 0, 9, 1, 9, 2, 9])[::2]]:
            env.reset(seed=3)
            seen.append(env.step(action)[0])
        self.assertTrue(all((other == seen[0]).all() for other in seen))
        for action in [[1, 0, 1], [1, 0, 1, 99], [-1, 0, 1, 2], [1.0, 0, 1, 2], 1, None, np.zeros((2, 4), int), np.zeros(4)]:
            with self.assertRaisesRegex(ValueError, r"allowed: one of each of \[0\.\.2, "):
                env.step(action)
        pole = gymnasium.make("leadtime/CartPole-v0")
        for action in [1, np.int64(1), np.array(1), [1], np.array([1]), True]:
            pole.reset(seed=3)
            self.assertEqual(pole.step(action)[1], 1.0)
        with self.assertRaisesRegex(ValueError, r"action 2; allowed: one of each of \[0\.\.2\]"):
            pole.step(2)

    def test_the_actions_of_a_vector_may_have_any_whole_numbers_in_any_order(self):
        envs = gymnasium.make_vec("leadtime/Lander-v0", num_envs=3, vectorization_mode="vector_entry_point")
        actions = np.array([[1, 0, 1, 2], [0, 0, 0, 0], [1, 1, 2, 3]])
        seen = []
        for given in [actions, np.asfortranarray(actions), actions.astype(np.uint8), actions.tolist(), np.asfortranarray(actions.astype(np.int32))]:
            envs.reset(seed=3)
            envs.step(given)
            seen.append(envs.step(np.zeros_like(actions))[0])
        self.assertTrue(all((other == seen[0]).all() for other in seen) and (seen[0][0] != seen[0][2]).any())
        # As many numbers in another order are no actions.
        for given, error in [(actions[:2], r"shape \[2, 4\]; allowed: \[3, 4\]$"), (actions.T, r"shape \[4, 3\]; allowed: \[3, 4\]$"),
                             (actions.T.tolist(), r"shape \[4, 3\]"), (actions.ravel(), r"shape \[12\]"), (actions + 9, "allowed: one of each of")]:
            with self.assertRaisesRegex(ValueError, error):
                envs.step(given)
        with self.assertRaisesRegex(TypeError, "float64"):
            envs.step(actions * 1.0)
        poles = gymnasium.make_vec("leadtime/CartPole-v0", num_envs=2, vectorization_mode="vector_entry_point")
        for given in ([0, 1], [[0], [1]]):
            poles.reset(seed=3)
            poles.step(given)
        with self.assertRaisesRegex(ValueError, r"shape \[1, 2\]; allowed: \[2, 1\] or \[2\]"):
            poles.step([[0, 1]])

    def test_nothing_is_stepped_or_drawn_before_an_episode_has_begun(self):
        env = gymnasium.make("leadtime/Lander-v0", render_mode="ansi")
        envs = gymnasium.make_vec("leadtime/CartPole-v0", num_envs=2, vectorization_mode="vector_entry_point")
        for too_early in [lambda: env.step([0, 0, 0, 0]), env.render, lambda: envs.step(np.zeros(2, int))]:
            with self.assertRaisesRegex(gymnasium.error.ResetNeeded, "call reset"):
                too_early()

    def test_an_episode_goes_on_from_a_snapshot(self):
        for name in IDS:
            env = gymnasium.make(name).unwrapped
            env.action_space.seed(1)
            env.reset(seed=1)
            env.step(env.action_space.sample())
            snapshot, actions = env.world.snapshot(), [env.action_space.sample() for _ in range(3)]
            first = [env.step(action)[0] for action in actions]
            env.world.restore(snapshot)
            self.assertTrue(np.array_equal(first, [env.step(action)[0] for action in actions]), name)

    def test_settings_are_the_program_s_and_so_are_its_errors(self):
        env = gymnasium.make("leadtime/Lander-v0", set={"human.reaction_delay": {"fixed": 3}, "notifier.history": 2})
        self.assertLess(env.observation_space.shape, gymnasium.make("leadtime/Lander-v0").observation_space.shape)
        for settings, says in [({"human.reaction_delay": 99}, "0 to 60 steps"), ({"human.delay": 1}, "human.delay"),
                               ("human.reaction_delay=3", "set 'human.reaction_delay=3'; allowed: a dict")]:
            with self.assertRaisesRegex(ValueError, says):
                gymnasium.make("leadtime/Lander-v0", set=settings)
        with self.assertRaisesRegex(ValueError, "no file or configuration"):
            gymnasium.make("leadtime/Lander-v0", config="moon")
        with tempfile.TemporaryDirectory() as place:
            os.mkfifo(pipe := f"{place}/pipe.toml")
            with self.assertRaisesRegex(ValueError, "pipe.toml: it is not a file"):
                gymnasium.make("leadtime/Lander-v0", config=pipe)
        with self.assertRaisesRegex(ValueError, "allowed: one of each of"):
            gymnasium.make("leadtime/CartPole-v0").unwrapped.world.step([7])
        self.assertIn("paper_lander", leadtime.configurations())

    def test_many_threads_may_step_one_vector(self):
        from concurrent.futures import ThreadPoolExecutor
        envs = gymnasium.make_vec("leadtime/CartPole-v0", num_envs=32, vectorization_mode="vector_entry_point")
        envs.reset(seed=1)
        actions = np.zeros(32, int)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda _: envs.step(actions), range(200)))


class Policy(unittest.TestCase):
    def test_the_shipped_policies_decide_in_python_as_in_the_program(self):
        for name, episodes in SHIPPED.items():
            with self.subTest(name), tempfile.TemporaryDirectory() as folder:
                file = ROOT / f"deploy/policies/{name}.safetensors"
                policy, state, far = load(file), None, 0.0
                steps = steps_of(file, folder, episodes)
                self.assertGreaterEqual(len(steps), N_STEPS)
                for step in steps:
                    state = policy.begin() if step["step"] == 0 else state
                    logits, _ = policy.logits(step["observation"], state)
                    expected = np.array(step["logits"])
                    far = max(far, (np.abs(logits - expected) / np.maximum(1, np.abs(expected))).max())
                    action, state = policy.act(step["observation"], mask=step["offered"], state=state, greedy=True)
                    if action != step["action"]:
                        self.assertLess(self.lead(policy, expected, action, step["action"]), 1e-4)
                self.assertLess(far, 1e-5)

    def lead(self, policy, logits, ours, theirs):
        """Returns by how much the first choice that differs is better: where two are equal but for rounding, either may be taken."""
        first = 0
        for head, one, other in zip(policy.spec["actions"]["heads"], ours, theirs):
            if one != other:
                return abs(logits[first + one] - logits[first + other])
            first += head["n_choices"]
        return 0.0

    def test_an_untrained_notifier_does_in_python_as_well_as_in_the_program(self):
        n = 120
        with tempfile.TemporaryDirectory() as folder:
            file = untrained("lander", folder)
            measured = json.loads(told("eval", file, "--episodes", n, "--eval-seed", "11", "--action", "sample", "--json", "--quiet", folder=folder))
            measures = {it["name"]: it["interval"] for it in measured["comparison"]["summaries"][0]["measures"]}
            policy, draws = load(file), np.random.default_rng(1)
            envs = worlds_of(policy, folder, n)
            observations, infos = envs.reset(seed=11)
            returns, ends = np.zeros(n), {}
            while len(ends) < n:
                actions = np.zeros((n, len(policy.heads)), int)
                for i in set(range(n)) - ends.keys():
                    actions[i], _ = policy.act(observations[i], mask=infos["action_mask"][i], rng=draws)
                observations, rewards, terminated, truncated, infos = envs.step(actions)
                for i in set(range(n)) - ends.keys():
                    returns[i] += rewards[i]
                    if terminated[i] or truncated[i]:
                        metrics = infos["final_info"]["metrics"]
                        ends[i] = {name: float(metrics[name][i]) for name in ("success", "notifications")}
        found = {"return": returns.mean()}
        for name in ("success", "notifications"):
            found[name] = np.mean([end[name] for end in ends.values()])
        for name, mean in found.items():
            # Both have drawn, so both are uncertain: twice the interval is what one pair in two hundred leaves.
            interval = measures[name]
            slack = (interval["high"] - interval["low"]) / 2
            self.assertTrue(interval["low"] - slack <= mean <= interval["high"] + slack, (name, mean, interval))

    def test_a_number_far_from_zero_is_normalised_as_in_the_program(self):
        # The same numbers as in crates/policy/src/normalizer.rs.
        actions = {"heads": [{"name": "a", "n_choices": 2}], "gate": None, "conditionals": []}
        spec = {"obs_dim": 1, "normalize_observations": True, "encoder": "Identity", "hidden": [], "actions": actions}
        tensors = {"normalizer.mean": np.array([10_000.0003]), "normalizer.variance": np.array([1e-4]),
                   "actor.head.weight": np.array([[1], [-1]], np.float32), "actor.head.bias": np.zeros(2, np.float32)}
        logits, _ = leadtime.policy.Policy(spec, tensors, {}).logits([10_000.01])
        self.assertLess(np.abs(logits - [0.976514, -0.976514]).max(), 1e-5)

    def test_attention_has_the_program_s_logits_whoever_is_present(self):
        # Recorded from the program: crates/policy/tests/recorded_attention.rs.
        policy = load(ROOT / "tests/data/attention.safetensors")
        for line in (ROOT / "tests/data/attention.jsonl").read_text().splitlines():
            step = json.loads(line)
            with self.subTest(step["case"]):
                logits, _ = policy.logits(step["observation"])
                self.assertLess(np.abs(logits - step["logits"]).max(), 1e-5)

    def test_episodes_in_python_are_those_of_the_program_bit_for_bit(self):
        for name, episodes in {**SHIPPED, **UNTRAINED}.items():
            with self.subTest(name), tempfile.TemporaryDirectory() as folder:
                file = untrained(name, folder) if name in UNTRAINED else ROOT / f"deploy/policies/{name}.safetensors"
                policy, steps = load(file), steps_of(file, folder, episodes)
                self.assertGreaterEqual(len(steps), N_STEPS)
                # Each episode of an evaluation is the first one of an environment of its own.
                envs = worlds_of(policy, folder, episodes)
                observations, infos = envs.reset(seed=11)
                at_once = {}
                for step in steps:
                    at_once.setdefault(step["step"], []).append(step)
                actions = np.zeros((episodes, len(policy.heads)), int)
                for _, now in sorted(at_once.items()):
                    for step in now:
                        i = step["episode"]
                        self.assertTrue((observations[i] == np.array(step["observation"], np.float32)).all(), step)
                        self.assertTrue((infos["action_mask"][i] == np.array(step["offered"])).all(), step)
                        actions[i] = step["action"]
                    observations, rewards, terminated, truncated, infos = envs.step(actions if len(policy.heads) > 1 else actions[:, 0])
                    for step in now:
                        i = step["episode"]
                        end = "terminated" if terminated[i] else "truncated" if truncated[i] else None
                        self.assertEqual((rewards[i], end), (np.float32(step["reward"]), step["end"]), step)

    def compare_notifier(self, policy, steps, words=None):
        """Shows a notifier of this process what the program's saw of the world, has it choose the same, and counts what it starts."""
        seen, n_started = [], 0

        def act(row, mask, **_):
            seen.append((row, mask))
            return steps[len(seen) - 1]["action"], None

        policy.act = act
        notifier = LocalNotifier(policy, words)
        sentences = {topic["topic"]: topic["utterances"] for topic in words["topics"]} if words else {}
        # A history of one pair names no time.
        now = "t." if "t.said.start" in policy.observation else ""
        of_world = [policy.observation.index(now + name) for name in notifier.observation]
        for step in steps:
            events = notifier.step([step["observation"][i] for i in of_world], episode=step["episode"])
            row, mask = seen[-1]
            self.assertTrue((row == np.array(step["observation"], np.float32)).all(), step)
            self.assertTrue((mask == step["offered"]).all(), step)
            self.assertEqual([event["last"] for event in events], [False] * (len(events) - 1) + [True])
            for event in events:
                self.assertLessEqual(event.get("heard", 0), event.get("l", 0))
                if event["event"] == "start":
                    n_started += 1
                if event["event"] == "start" and words:
                    cell = {"comprehension": event["k"], "conveyance": event["l"], "text": event["text"], "facts": []}
                    self.assertIn(cell, [{key: it[key] for key in cell} for it in sentences[event["topic"]]])
        return n_started

    def test_a_notifier_in_this_process_sees_what_the_program_s_sees_and_says_it_in_words(self):
        for name, episodes in SHIPPED.items():
            with self.subTest(name), tempfile.TemporaryDirectory() as folder:
                file = ROOT / f"deploy/policies/{name}.safetensors"
                policy = load(file)
                words = json.loads(told("taxonomy", "export", policy.metadata["domain"], "--format", "json", folder=folder))
                self.assertGreater(self.compare_notifier(policy, steps_of(file, folder, episodes), words), episodes / 2)

    def test_a_notifier_in_this_process_keeps_to_every_rule_of_speech(self):
        shown = tomllib.loads(told("config", "lander", folder=ROOT))
        cells = [["ascend", 2, 4], ["ascend", 4, 5], ["shift_left", 3, 3], ["shift_right", 2, 2], ["descend", 5, 5]]
        few = {"history": 1, "observe_utterance": False, "topics": ["descend", "ascend"], "k_max": 3}
        late = [["ascend", 4, 4], ["ascend", 2, 9], ["shift_left", 3, 3], ["shift_right", 2, 2], ["descend", 2, 5]]
        for human, choices in [({}, {}), ({"can_stop": True, "interrupt": "finish", "blocked_initiation": "mask"}, few),
                               ({}, {"cells": late, "k_max": 3}),
                               ({"occupies": False, "words_from": 0}, {}),
                               ({"comprehension": "immediate", "can_stop": True, "interrupt": "replace"}, {"cells": cells}),
                               ({}, {"notification": "topic_only", "words": [3, 5]})]:
            with self.subTest(human=human, choices=choices), tempfile.TemporaryDirectory() as folder:
                config = {**shown, "human": {**shown["human"], **human}, "notifier": {**shown["notifier"], **choices}}
                text = "".join(f"{key} = {toml(value)}\n" for key, value in config.items())
                file = Path(folder) / "own.toml"
                file.write_text(text)
                env, draws = leadtime.World(str(file), [], True), np.random.default_rng(1)
                policy = SimpleNamespace(metadata={"config": text}, obs_dim=env.obs_dim, heads=env.heads, begin=lambda: None,
                                         observation=[name for name, *_ in env.quantities])
                steps = []
                for episode in range(6):
                    row, info, done = *env.reset(1, episode), False
                    while not done:
                        action = [int(draws.integers(len(names))) for _, names in env.heads]
                        steps.append({"episode": episode, "observation": row, "offered": info["action_mask"], "action": action})
                        row, _, terminated, truncated, info = env.step(action)
                        done = terminated or truncated
                self.assertGreater(self.compare_notifier(policy, steps), 10)

    def test_a_notifier_in_this_process_says_what_is_true_and_falls_silent_when_asked(self):
        file = ROOT / "deploy/policies/piloting.safetensors"
        sentences = [{"comprehension": 3, "conveyance": 4, "text": "Go up - zone ahead.", "facts": ["zone_ahead"]},
                     {"comprehension": 2, "conveyance": 2, "text": "Go up.", "facts": []}]
        words = {"topics": [{"topic": topic, "utterances": sentences} for topic in ("ascend", "shift_left", "shift_right", "descend")]}

        def said(notifier, **step):
            return [(event["event"], event.get("word"), event.get("text")) for event in notifier.step(np.zeros(8), **step)]

        policy, actions = load(file), []
        policy.act = lambda row, mask, **_: (actions.pop(0), None)
        notifier = LocalNotifier(policy, words)
        # A message of four words, as a sentence of as many and as one of two, which keeps its pace.
        actions += [[1, 0, 2]] + [[0, 0, 0]] * 4 + [[1, 0, 2]] + [[0, 0, 0]] * 2
        text = "Go up - zone ahead."
        self.assertEqual(said(notifier, facts=["zone_ahead"]), [("start", 0, text)])
        self.assertEqual([said(notifier) for _ in range(4)], [[("word", 1, text)], [("word", 2, text)], [("word", 3, text)], [("end", 4, text)]])
        self.assertEqual([said(notifier) for _ in range(3)], [[("start", 0, "Go up.")], [("word", 0, "Go up.")], [("word", 1, "Go up.")]])
        self.assertTrue(notifier.speaks)
        # Another episode cuts it, the end as well; after it nothing is said.
        actions += [[1, 0, 2], [0, 0, 0], [0, 0, 0]]
        self.assertEqual(said(notifier, episode=2), [("cut", 1, "Go up."), ("start", 0, "Go up.")])
        self.assertEqual(said(notifier, episode=2), [("word", 0, "Go up.")])
        self.assertEqual(said(notifier, episode=2, end=True), [("cut", 0, "Go up.")])
        self.assertEqual([said(notifier, episode=2), said(notifier, episode=3)], [[("silent", None, None)]] * 2)
        self.assertEqual(actions, [])
        # What is never true is not said, and what has no words is.
        for facts, words in [(None, {"topics": [{"topic": it["topic"], "utterances": sentences[:1]} for it in words["topics"]]}), (None, None)]:
            actions[:] = [[1, 0, 2]]
            (event,) = LocalNotifier(policy, words).step(np.zeros(8), facts=facts)
            self.assertEqual((event["event"], event.get("k")), ("silent", None) if words else ("start", 4))
        with self.assertRaisesRegex(ValueError, "no sentences for `shift_left`"):
            LocalNotifier(policy, {"topics": [{"topic": "ascend", "utterances": sentences}]})
        with self.assertRaisesRegex(ValueError, "8 numbers, this one has shape"):
            notifier.step(np.zeros(7))
        with self.assertRaisesRegex(ValueError, "not finite"):
            notifier.step(np.full(8, np.nan))
        for odd in ("zone_ahead", {"zone_ahead": False}, MappingProxyType({"zone_ahead": False}), [3], True):
            with self.assertRaisesRegex(ValueError, "facts are a list of names"):
                notifier.step(np.zeros(8), facts=odd)
        with self.assertRaisesRegex(ValueError, "episode 1.5; allowed: a whole number from 0 on"):
            notifier.step(np.zeros(8), episode=1.5)
        policy.metadata = {**policy.metadata, "config": "", "domain": "cartpole"}
        with self.assertRaisesRegex(ValueError, "nobody is spoken to in `cartpole`"):
            LocalNotifier(policy)

    def test_the_same_seed_says_the_same(self):
        def starts(seed):
            notifier = LocalNotifier(ROOT / "deploy/policies/piloting.safetensors", greedy=False, seed=seed)
            return [event for step in range(60) for event in notifier.step([0.0, 1.4 - step / 40, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0])]

        self.assertEqual(starts(1), starts(1))
        self.assertNotEqual(starts(1), starts(2))

    def test_a_file_that_is_no_policy_is_refused(self):
        from leadtime.policy import PolicyError
        with tempfile.TemporaryDirectory() as folder:
            for i, content in enumerate([b"", b"\xff" * 40, (2).to_bytes(8, "little") + b"{}"]):
                file = Path(folder) / str(i)
                file.write_bytes(content)
                with self.assertRaisesRegex(PolicyError, "no policy of Leadtime"):
                    load(file)
        with self.assertRaisesRegex(ValueError, "give rng"):
            load(ROOT / "deploy/policies/piloting.safetensors").act(np.zeros(89))

    def test_a_policy_that_is_damaged_or_asked_something_impossible_says_so(self):
        import hashlib

        from leadtime.policy import PolicyError
        whole = (ROOT / "deploy/policies/piloting.safetensors").read_bytes()
        start = 8 + int.from_bytes(whole[:8], "little")
        header, numbers = json.loads(whole[8:start]), whole[start:]
        digest = hashlib.sha256()
        for name in sorted(set(header) - {"__metadata__"}):
            begin, end = header[name]["data_offsets"]
            digest.update(name.encode() + numbers[begin:end])
        header["__metadata__"]["weights_sha256"] = digest.hexdigest()
        head = json.dumps(header).encode()
        begin = header["actor.head.bias"]["data_offsets"][0]
        place = tempfile.TemporaryDirectory()
        self.addCleanup(place.cleanup)

        def loaded(numbers):
            file = Path(place.name) / "policy.safetensors"
            file.write_bytes(len(head).to_bytes(8, "little") + head + numbers)
            return load(file)

        policy, zeros = loaded(numbers), np.zeros(89)
        with self.assertRaisesRegex(PolicyError, "is damaged"):
            loaded(numbers[:begin] + bytes([numbers[begin] ^ 1]) + numbers[begin + 1:])
        with self.assertRaisesRegex(PolicyError, "actor.head.bias holds a value that is not finite"):
            loaded(numbers[:begin] + np.float32("nan").tobytes() + numbers[begin + 4:])
        with self.assertRaisesRegex(PolicyError, "7 bytes follow"):
            loaded(numbers + b"another")
        with self.assertRaisesRegex(PolicyError, "has room for it"):
            loaded(numbers[:-4])
        with self.assertRaisesRegex(ValueError, "not finite"):
            policy.act(np.full(89, np.nan), greedy=True)
        for mask in ([1, 1], [np.ones(2), np.ones(3)], np.ones((2, 5)), 1):
            with self.assertRaisesRegex(ValueError, "a mask has 10 entries, head after head; this one has shape "):
                policy.act(zeros, mask=mask, greedy=True)
        # Also as leadtime.pettingzoo has it: an array per head.
        mask = np.array([1, 0] * 5, bool)
        parts = np.split(mask, np.cumsum([len(choices) for _, choices in policy.heads])[:-1])
        for form in (tuple(parts), parts, mask.tolist()):
            self.assertEqual(policy.act(zeros, mask=form, greedy=True), policy.act(zeros, mask=mask, greedy=True))
        # What leaves nothing of a head takes nothing away, as in the program.
        nothing, _ = policy.act(zeros, mask=np.zeros(10, bool), greedy=True)
        self.assertEqual(nothing, policy.act(zeros, greedy=True)[0])
        policy.act(zeros, mask=np.zeros(10, bool), rng=np.random.default_rng(1))


if __name__ == "__main__":
    unittest.main()

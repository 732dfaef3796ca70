"""Stable-Baselines3's PPO on a world of Leadtime, with settings of its zoo for CartPole.

    pip install stable-baselines3 && python3 examples/python/sb3_ppo.py [SEED] [STEPS]
"""
import sys

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import leadtime.gym  # noqa: F401  registers the worlds

seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
n_steps = int(sys.argv[2]) if len(sys.argv) > 2 else 100_000

envs = make_vec_env("leadtime/CartPole-v0", n_envs=8, seed=seed)
model = PPO("MlpPolicy", envs, n_steps=32, batch_size=256, n_epochs=20, gamma=0.98, gae_lambda=0.8,
            learning_rate=lambda left: 1e-3 * left, clip_range=lambda left: 0.2 * left, seed=seed, device="cpu")
model.learn(n_steps)
mean, deviation = evaluate_policy(model, make_vec_env("leadtime/CartPole-v0", seed=1000 + seed), n_eval_episodes=20)
print(f"return of 20 greedy episodes after {n_steps} steps: {mean:.0f} (s.d. {deviation:.0f}; at most 500)")

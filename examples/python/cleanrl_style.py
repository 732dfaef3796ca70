"""PPO in one file, in the manner of CleanRL, on the native vector of a world of Leadtime.

    pip install torch && python3 examples/python/cleanrl_style.py [SEED] [STEPS] [WORLD]

An action has one choice per head. Choices that are not offered are masked, as `info["action_mask"]` says.
"""
import sys

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import leadtime.gym  # noqa: F401  registers the worlds

SEED, TOTAL, WORLD = (kind(given) for kind, given in zip((int, int, str), sys.argv[1:] + ["1", "100000", "leadtime/CartPole-v0"][len(sys.argv) - 1:]))
N_ENVS, N_STEPS, N_MINIBATCHES, N_EPOCHS = 8, 32, 1, 20
GAMMA, LAMBDA, CLIP, VALUE, MAX_NORM, LR = 0.98, 0.8, 0.2, 0.5, 0.5, 1e-3
N_LAST = 20

torch.manual_seed(SEED)
np.random.seed(SEED)
envs = gym.make_vec(WORLD, num_envs=N_ENVS, vectorization_mode="vector_entry_point")
space = envs.single_action_space
sizes = space.nvec.tolist() if isinstance(space, gym.spaces.MultiDiscrete) else [int(space.n)]
n_in = envs.single_observation_space.shape[0]


def layer(n_in, n_out, gain=2**0.5):
    made = nn.Linear(n_in, n_out)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def network(n_out, gain):
    return nn.Sequential(layer(n_in, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, n_out, gain))


actor, critic = network(sum(sizes), 0.01), network(1, 1.0)
parameters = [*actor.parameters(), *critic.parameters()]
optimizer = torch.optim.Adam(parameters, lr=LR, eps=1e-5)


def decide(obs, mask, action=None):
    logits = actor(obs).masked_fill(mask == 0, -1e8)
    heads = [torch.distributions.Categorical(logits=part) for part in logits.split(sizes, dim=-1)]
    action = torch.stack([head.sample() for head in heads], dim=-1) if action is None else action
    log_prob = sum(head.log_prob(action[..., i]) for i, head in enumerate(heads))
    return action, log_prob, critic(obs).squeeze(-1)


shape = (N_STEPS, N_ENVS)
all_obs, all_masks, actions = torch.zeros(*shape, n_in), torch.zeros(*shape, sum(sizes)), torch.zeros(*shape, len(sizes), dtype=torch.long)
log_probs, rewards, values, going_on, next_values = (torch.zeros(shape) for _ in range(5))
returns, running = [], np.zeros(N_ENVS)
seen, infos = envs.reset(seed=SEED)
n_updates = TOTAL // (N_STEPS * N_ENVS)
for update in range(n_updates):
    left = 1 - update / n_updates
    optimizer.param_groups[0]["lr"] = LR * left
    for t in range(N_STEPS):
        all_obs[t], all_masks[t] = torch.as_tensor(seen), torch.as_tensor(infos["action_mask"])
        with torch.no_grad():
            actions[t], log_probs[t], values[t] = decide(all_obs[t], all_masks[t])
        chosen = actions[t].numpy() if len(sizes) > 1 else actions[t, :, 0].numpy()
        seen, reward, terminated, truncated, infos = envs.step(chosen)
        rewards[t] = torch.as_tensor(reward)
        ended = terminated | truncated
        # What an episode that was cut short would still have been worth is in the value of its last observation.
        last = seen.copy()
        for i in np.flatnonzero(ended):
            last[i] = infos["final_obs"][i]
        going_on[t] = torch.as_tensor(~ended).float()
        with torch.no_grad():
            next_values[t] = critic(torch.as_tensor(last)).squeeze(-1) * torch.as_tensor(~terminated)
        running += reward
        returns += running[ended].tolist()
        running[ended] = 0
    advantages, after = torch.zeros(shape), torch.zeros(N_ENVS)
    for t in reversed(range(N_STEPS)):
        after = rewards[t] + GAMMA * next_values[t] - values[t] + GAMMA * LAMBDA * going_on[t] * after
        advantages[t] = after
    flat = [part.flatten(0, 1) for part in (all_obs, all_masks, actions, log_probs, advantages, advantages + values)]
    for _ in range(N_EPOCHS):
        for rows in torch.randperm(N_STEPS * N_ENVS).chunk(N_MINIBATCHES):
            obs, mask, action, old, advantage, target = (part[rows] for part in flat)
            _, log_prob, value = decide(obs, mask, action)
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            ratio, clip = (log_prob - old).exp(), CLIP * left
            policy_loss = -torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()
            optimizer.zero_grad()
            (policy_loss + VALUE * 0.5 * (value - target).pow(2).mean()).backward()
            nn.utils.clip_grad_norm_(parameters, MAX_NORM)
            optimizer.step()
print(f"mean return of the last {N_LAST} training episodes of {TOTAL} steps: {np.mean(returns[-N_LAST:]):.0f}")

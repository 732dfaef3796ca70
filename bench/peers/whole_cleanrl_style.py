"""Environment steps per second of a single-file PPO in the manner of CleanRL's `ppo.py` on LunarLander-v3.

    python3 bench/peers/whole_cleanrl_style.py [SECONDS]

4 environments x 128 steps, 4 minibatches, 4 epochs, two 64-64 tanh networks.
Needs: pip install torch "gymnasium[box2d]==1.4.0". Prints one JSON line. All threads of torch are allowed, as CleanRL does.
"""
import json
import sys
import time

try:
    import gymnasium as gym
    import numpy as np
    import torch
    from torch import nn
except ImportError as missing:
    print(f"skipped: {missing}; pip install torch 'gymnasium[box2d]==1.4.0'")
    sys.exit(0)

N_ENVS, N_STEPS, N_MINIBATCHES, N_EPOCHS = 4, 128, 4, 4
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, MAX_NORM, LR = 0.99, 0.95, 0.2, 0.01, 0.5, 0.5, 2.5e-4


def layer(n_in, n_out, gain=2 ** 0.5):
    linear = nn.Linear(n_in, n_out)
    nn.init.orthogonal_(linear.weight, gain)
    nn.init.constant_(linear.bias, 0.0)
    return linear


def estimate_advantages(rewards, values, dones, next_value, next_done, gamma, lam):
    """Generalised advantage estimation over rollouts of shape [steps, environments]."""
    advantages, last = torch.zeros_like(rewards), torch.zeros_like(next_value)
    for t in reversed(range(len(rewards))):
        is_last = t == len(rewards) - 1
        live = 1.0 - (next_done if is_last else dones[t + 1])
        following = next_value if is_last else values[t + 1]
        delta = rewards[t] + gamma * following * live - values[t]
        advantages[t] = last = delta + gamma * lam * live * last
    return advantages


class Agent(nn.Module):
    def __init__(self, n_in, n_out):
        super().__init__()
        self.critic = nn.Sequential(layer(n_in, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0))
        self.actor = nn.Sequential(layer(n_in, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, n_out, 0.01))

    def forward(self, x, action=None):
        distribution = torch.distributions.Categorical(logits=self.actor(x))
        action = distribution.sample() if action is None else action
        return action, distribution.log_prob(action), distribution.entropy(), self.critic(x)


def main():
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 30.0
    envs = gym.vector.SyncVectorEnv([lambda: gym.make("LunarLander-v3") for _ in range(N_ENVS)])
    torch.manual_seed(1)
    agent = Agent(8, 4)
    optimizer = torch.optim.Adam(agent.parameters(), lr=LR, eps=1e-5)
    obs = torch.zeros(N_STEPS, N_ENVS, 8)
    actions = torch.zeros(N_STEPS, N_ENVS)
    log_probs, rewards, dones, values = (torch.zeros(N_STEPS, N_ENVS) for _ in range(4))
    next_obs, next_done = torch.tensor(envs.reset(seed=1)[0]), torch.zeros(N_ENVS)
    steps, started = 0, time.time()
    while time.time() - started < seconds:
        for t in range(N_STEPS):
            obs[t], dones[t] = next_obs, next_done
            with torch.no_grad():
                action, log_prob, _, value = agent(next_obs)
            actions[t], log_probs[t], values[t] = action, log_prob, value.flatten()
            seen, reward, terminated, truncated, _ = envs.step(action.numpy())
            rewards[t] = torch.tensor(reward)
            next_obs = torch.tensor(seen)
            next_done = torch.tensor(np.logical_or(terminated, truncated), dtype=torch.float32)
        with torch.no_grad():
            next_value = agent.critic(next_obs).flatten()
            advantages = estimate_advantages(rewards, values, dones, next_value, next_done, GAMMA, LAMBDA)
            returns = advantages + values
        flat = [x.reshape(-1, *x.shape[2:]) for x in (obs, actions, log_probs, advantages, returns, values)]
        order = np.arange(N_ENVS * N_STEPS)
        for _ in range(N_EPOCHS):
            np.random.shuffle(order)
            for batch in order.reshape(N_MINIBATCHES, -1):
                b_obs, b_act, b_logp, b_adv, b_ret, b_val = (x[batch] for x in flat)
                _, logp, entropy, value = agent(b_obs, b_act)
                ratio = (logp - b_logp).exp()
                b_adv = (b_adv - b_adv.mean()) / (b_adv.std() + 1e-8)
                policy_loss = torch.max(-b_adv * ratio, -b_adv * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                value = value.flatten()
                clipped = b_val + (value - b_val).clamp(-CLIP, CLIP)
                value_loss = 0.5 * torch.max((value - b_ret) ** 2, (clipped - b_ret) ** 2).mean()
                loss = policy_loss - ENTROPY * entropy.mean() + VALUE * value_loss
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), MAX_NORM)
                optimizer.step()
        steps += N_ENVS * N_STEPS
    wall = time.time() - started
    print(json.dumps({"peer": "CleanRL-style PPO", "env_steps": steps, "seconds": round(wall, 1),
                      "steps_per_second": round(steps / wall)}))


if __name__ == "__main__":
    main()

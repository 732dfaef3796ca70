"""PyTorch eager on one thread at the shape of `crates/policy/benches/inference.rs` and `crates/ppo/benches/update.rs`.

    python3 bench/peers/ppo_torch.py [--json]

60 inputs, actor 60-64-64 with heads 2+4+4+4, separate critic 60-64-64-1. Prints observations per second of the forward
pass and samples per second of the PPO update (forward, loss, backward, gradient clip, Adam), as CleanRL writes it; and
observations per second of the steakhouse notifier: 242 inputs, projection 32, an LSTM of 128, heads 2+5+4+4 and the value.
Says so and leaves with 0 where PyTorch is missing.
"""
import json
import sys
import time

try:
    import torch
    from torch import nn
except ImportError:
    print("PyTorch is not installed: skipped")
    sys.exit(0)

torch.set_num_threads(1)
torch.manual_seed(1)
HEADS = [2, 4, 4, 4]


def layer(n_in, n_out, gain):
    made = nn.Linear(n_in, n_out)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def stack(n_out, gain):
    hidden = [layer(60, 64, 2**0.5), nn.Tanh(), layer(64, 64, 2**0.5), nn.Tanh()]
    return nn.Sequential(*hidden, layer(64, n_out, gain))


actor, critic = stack(sum(HEADS), 0.01), stack(1, 1.0)
parameters = [*actor.parameters(), *critic.parameters()]
optimizer = torch.optim.Adam(parameters, lr=2.5e-4, eps=1e-5)


class Recurrent(nn.Module):
    """Projection, one LSTM for actor and critic, heads and value: one step of it."""

    def __init__(self):
        super().__init__()
        self.projection = layer(242, 32, 2**0.5)
        self.lstm = nn.LSTM(32, 128)
        self.heads = layer(128, 15, 0.01)
        self.value = layer(128, 1, 1.0)

    def forward(self, observations, state):
        hidden, state = self.lstm(torch.tanh(self.projection(observations)).unsqueeze(0), state)
        return self.heads(hidden[0]), self.value(hidden[0]), state


def lstm_step(network, observations, state):
    with torch.inference_mode():
        network(observations, state)


def evaluate(observations):
    logits = torch.split(actor(observations), HEADS, dim=1)
    return [torch.distributions.Categorical(logits=part) for part in logits], critic(observations)


def forward(observations):
    with torch.no_grad():
        actor(observations), critic(observations)


def update(batch):
    observations, actions, old_log_probs, advantages, returns, old_values = batch
    heads, values = evaluate(observations)
    log_probs = sum(head.log_prob(actions[:, i]) for i, head in enumerate(heads))
    entropy = sum(head.entropy() for head in heads).mean()
    logratio = log_probs - old_log_probs
    ratio = logratio.exp()
    with torch.no_grad():
        (-logratio).mean(), ((ratio - 1) - logratio).mean(), ((ratio - 1).abs() > 0.2).float().mean().item()
    advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
    policy_loss = torch.max(-advantages * ratio, -advantages * ratio.clamp(0.8, 1.2)).mean()
    values = values.view(-1)
    clipped = old_values + torch.clamp(values - old_values, -0.2, 0.2)
    value_loss = 0.5 * torch.max((values - returns) ** 2, (clipped - returns) ** 2).mean()
    loss = policy_loss - 0.01 * entropy + 0.5 * value_loss
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(parameters, 0.5)
    optimizer.step()


def rate(run, n, seconds=2.0):
    """Units per second: the best of five slices, since other work only ever slows a slice down."""
    for _ in range(5):
        run()
    best = 0.0
    for _ in range(5):
        start, count = time.perf_counter(), 0
        while time.perf_counter() - start < seconds / 5:
            run()
            count += 1
        best = max(best, count * n / (time.perf_counter() - start))
    return best


def main():
    results = {"torch": torch.__version__, "inference": {}, "lstm": {}, "update": {}}
    for n in [1, 4, 16, 64, 256, 1024]:
        observations = torch.rand(n, 60) * 2 - 1
        results["inference"][n] = rate(lambda: forward(observations), n)
    network = Recurrent()
    for n in [1, 4, 16, 64, 256, 1024]:
        observations, state = torch.rand(n, 242) * 2 - 1, (torch.zeros(1, n, 128), torch.zeros(1, n, 128))
        results["lstm"][n] = rate(lambda: lstm_step(network, observations, state), n)
    for n in [128, 512, 1200, 4096]:
        observations = torch.rand(n, 60) * 2 - 1
        with torch.no_grad():
            heads, values = evaluate(observations)
            actions = torch.stack([head.sample() for head in heads], dim=1)
            log_probs = sum(head.log_prob(actions[:, i]) for i, head in enumerate(heads))
        batch = (observations, actions, log_probs, torch.randn(n), torch.randn(n), values.view(-1))
        results["update"][n] = rate(lambda: update(batch), n)
    if "--json" in sys.argv:
        print(json.dumps(results))
        return
    print(f"PyTorch {results['torch']}, one thread")
    for kind, unit in [("inference", "obs/s"), ("lstm", "obs/s"), ("update", "samples/s")]:
        for n, value in results[kind].items():
            print(f"{kind:10} {n:5} {value / 1e3:9.1f} k {unit}")


main()

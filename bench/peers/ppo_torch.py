"""PyTorch eager on one thread at the shape of `crates/policy/benches/inference.rs` and `crates/ppo/benches/update.rs`.

    python3 bench/peers/ppo_torch.py [inference lstm update, default all] [--json]

60 inputs, actor 60-64-64 with heads 2+4+4+4, separate critic 60-64-64-1. Prints observations per second of the forward
pass and samples per second of the PPO update (forward, loss, backward, gradient clip, Adam), as CleanRL writes it; and
the same of the steakhouse notifier, 242 inputs, projection 32, an LSTM of 128, heads 2+5+4+4 and the value, which is
trained on sequences of 64 steps, each in one call of `nn.LSTM`; and the update behind ego attention, as rl-agents writes
it, to four frames of ten entities of seven numbers. Says so and leaves with 0 where PyTorch is missing.
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
KINDS = ["inference", "lstm", "update"]
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
SEQUENCE = 64


class Plain(nn.Module):
    """Actor and critic side by side."""

    def __init__(self):
        super().__init__()
        self.actor, self.critic, self.n_inputs, self.head_sizes = actor, critic, 60, HEADS

    def forward(self, observations):
        return self.actor(observations), self.critic(observations)


class Recurrent(nn.Module):
    """Projection, one LSTM for actor and critic, heads and value."""

    n_inputs, head_sizes = 242, [2, 5, 4, 4]

    def __init__(self):
        super().__init__()
        self.projection = layer(242, 32, 2**0.5)
        self.lstm = nn.LSTM(32, 128)
        self.heads = layer(128, 15, 0.01)
        self.value = layer(128, 1, 1.0)

    def step(self, observations, state):
        hidden, state = self.lstm(torch.tanh(self.projection(observations)).unsqueeze(0), state)
        return self.heads(hidden[0]), self.value(hidden[0]), state

    def forward(self, observations):
        """Whole sequences from zero, one behind the other."""
        projected = torch.tanh(self.projection(observations)).view(-1, SEQUENCE, 32).transpose(0, 1)
        hidden, _ = self.lstm(projected)
        hidden = hidden.transpose(0, 1).reshape(-1, 128)
        return self.heads(hidden), self.value(hidden)


class Attentive(nn.Module):
    """Ego attention per frame, its outputs and what is beside them as features of actor and critic."""

    n_frames, n_entities, n_features, action_dim, width, n_heads, rest = 4, 10, 7, 13, 64, 2, 5
    head_sizes = HEADS

    def __init__(self):
        super().__init__()
        embedding = lambda: nn.Sequential(nn.Linear(7, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU())
        self.ego, self.others = embedding(), embedding()
        self.key, self.value, self.query, self.combine = (nn.Linear(64, 64, bias=False) for _ in range(4))
        self.frame = self.n_entities * self.n_features + self.action_dim
        self.n_inputs = self.n_frames * self.frame + self.rest
        features = self.n_frames * (self.width + self.action_dim) + self.rest
        stack = lambda n: nn.Sequential(nn.Linear(features, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n))
        self.actor, self.critic = stack(sum(HEADS)), stack(1)

    def forward(self, observations):
        m = observations.shape[0]
        frames = observations[:, : self.n_frames * self.frame].reshape(m * self.n_frames, self.frame)
        entities = frames[:, : self.n_entities * self.n_features].view(-1, self.n_entities, self.n_features)
        ego = self.ego(entities[:, :1])
        everybody = torch.cat([ego, self.others(entities[:, 1:])], dim=1)
        by_head = lambda x, n: x.view(-1, n, self.n_heads, self.width // self.n_heads).transpose(1, 2)
        key, value = by_head(self.key(everybody), self.n_entities), by_head(self.value(everybody), self.n_entities)
        scores = by_head(self.query(ego), 1) @ key.transpose(2, 3) / (self.width // self.n_heads) ** 0.5
        absent = (entities[:, :, 0] < 0.5).view(-1, 1, 1, self.n_entities)
        taken = scores.masked_fill(absent, -1e9).softmax(-1) @ value
        encoded = (self.combine(taken.transpose(1, 2).reshape(-1, self.width)) + ego[:, 0]) / 2
        encoded = torch.cat([encoded, frames[:, self.n_entities * self.n_features :]], dim=1)
        features = torch.cat([encoded.view(m, -1), observations[:, self.n_frames * self.frame :]], dim=1)
        return self.actor(features), self.critic(features)


def lstm_step(network, observations, state):
    with torch.inference_mode():
        network.step(observations, state)


def evaluate(network, observations):
    logits, values = network(observations)
    parts = torch.split(logits, network.head_sizes, dim=1)
    return [torch.distributions.Categorical(logits=part) for part in parts], values


def forward(observations):
    with torch.no_grad():
        actor(observations), critic(observations)


def update(network, optimizer, batch):
    observations, actions, old_log_probs, advantages, returns, old_values = batch
    heads, values = evaluate(network, observations)
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
    nn.utils.clip_grad_norm_(network.parameters(), 0.5)
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
    wanted = [argument for argument in sys.argv[1:] if argument != "--json"] or KINDS
    if not set(wanted) <= set(KINDS):
        sys.exit(f"allowed: {' '.join(KINDS)}")
    results = {"torch": torch.__version__}
    network = Recurrent()
    batches = [1, 4, 16, 64, 256, 1024]
    for kind in [kind for kind in wanted if kind != "update"]:
        results[kind] = {}
        for n in batches:
            observations, state = torch.rand(n, 242) * 2 - 1, (torch.zeros(1, n, 128), torch.zeros(1, n, 128))
            plain = observations[:, :60].contiguous()
            run = (lambda: lstm_step(network, observations, state)) if kind == "lstm" else (lambda: forward(plain))
            results[kind][n] = rate(run, n)
    kinds = {"update": Plain(), "update lstm": network, "update attention": Attentive()} if "update" in wanted else {}
    for kind, trained in kinds.items():
        results[kind] = {}
        optimizer = torch.optim.Adam(trained.parameters(), lr=2.5e-4, eps=1e-5)
        for n in [128, 512, 1200, 4096]:
            n = n // SEQUENCE * SEQUENCE if trained is network else n
            observations = torch.rand(n, trained.n_inputs) * 2 - 1
            with torch.no_grad():
                heads, values = evaluate(trained, observations)
                actions = torch.stack([head.sample() for head in heads], dim=1)
                log_probs = sum(head.log_prob(actions[:, i]) for i, head in enumerate(heads))
            batch = (observations, actions, log_probs, torch.randn(n), torch.randn(n), values.view(-1))
            results[kind][n] = rate(lambda: update(trained, optimizer, batch), n)
    if "--json" in sys.argv:
        print(json.dumps(results))
        return
    print(f"PyTorch {results['torch']}, one thread")
    for kind, rates in list(results.items())[1:]:
        for n, value in rates.items():
            print(f"{kind:16} {n:5} {value / 1e3:9.1f} k {'samples' if 'update' in kind else 'obs'}/s")


main()

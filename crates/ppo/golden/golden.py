"""Golden numbers of this crate's tests: `python3 crates/ppo/golden/golden.py` (numpy; torch for `loss` and `adam`).

Writes gae.rs, vtrace.rs, loss.rs and adam.rs beside itself. `gae` is CleanRL's loop (ppo.py), `vtrace` the sum of Espeholt et al. 2018, eq. 1,
written out, `loss` and `adam` are CleanRL's lines run by PyTorch's autograd and optimiser.
"""
import pathlib
import numpy as np

HERE = pathlib.Path(__file__).parent
rng = np.random.default_rng(2018)


def rust(name, values, kind="f32"):
    values = np.asarray(values)
    text = ", ".join(number(v) if kind == "f32" else str(int(v)) for v in values.ravel())
    return f"const {name}: [{kind}; {values.size}] = [{text}];\n"


def number(value):
    return np.format_float_positional(np.float32(value), unique=True, trim="0")


def write(name, text):
    (HERE / f"{name}.rs").write_text("// As golden.py wrote them.\n" + text)


def gae():
    n = 8
    rewards = rng.normal(size=n).astype(np.float32)
    values = rng.normal(size=n).astype(np.float32)
    next_value = np.float32(rng.normal())
    done_after = np.zeros(n, dtype=np.float32)
    done_after[[2, 5]] = 1.0
    advantages = np.zeros(n, dtype=np.float32)
    last = np.float32(0)
    for t in reversed(range(n)):
        next_non_terminal = np.float32(1.0) - done_after[t]
        following = next_value if t == n - 1 else values[t + 1]
        delta = rewards[t] + np.float32(0.99) * following * next_non_terminal - values[t]
        advantages[t] = last = delta + np.float32(0.99) * np.float32(0.95) * next_non_terminal * last
    text = rust("REWARDS", rewards) + rust("VALUES", values) + rust("ADVANTAGES", advantages)
    write("gae", text + f"const NEXT_VALUE: f32 = {number(next_value)};\n")


def vtrace():
    n, gamma = 7, 0.97
    rewards, values, log_rhos = rng.normal(size=n), rng.normal(size=n), 0.7 * rng.normal(size=n)
    next_value = rng.normal()
    bootstrap = {2: 0.0, 4: 1.5}
    after = np.append(values[1:], next_value)
    for t, value in bootstrap.items():
        after[t] = value
    rho = np.minimum(1.0, np.exp(log_rhos))
    delta = rho * (rewards + gamma * after - values)

    def target(s):
        total, product = values[s], 1.0
        for t in range(s, n):
            total += gamma ** (t - s) * product * delta[t]
            product *= rho[t]
            if t in bootstrap:
                break
        return total

    targets = np.array([target(s) for s in range(n)])
    targets_after = np.append(targets[1:], next_value)
    for t, value in bootstrap.items():
        targets_after[t] = value
    pg = rho * (rewards + gamma * targets_after - values)
    text = rust("REWARDS", rewards) + rust("VALUES", values) + rust("LOG_RHOS", log_rhos)
    text += rust("VALUE_TARGETS", targets) + rust("PG_ADVANTAGES", pg)
    write("vtrace", text + f"const NEXT_VALUE: f32 = {number(next_value)};\n")


def loss():
    import torch

    n, choices, clip, entropy_coef, value_coef = 9, 5, 0.2, 0.01, 0.5
    logits = torch.tensor(rng.normal(size=(n, choices)).astype(np.float32), requires_grad=True)
    values = torch.tensor(rng.normal(size=n).astype(np.float32), requires_grad=True)
    actions = torch.tensor(rng.integers(0, choices, size=n))
    distribution = torch.distributions.Categorical(logits=logits)
    old_log_probs = (distribution.log_prob(actions) + 0.3 * torch.tensor(rng.normal(size=n).astype(np.float32))).detach()
    raw = torch.tensor(rng.normal(size=n).astype(np.float32))
    old_values = (values + 0.3 * torch.tensor(rng.normal(size=n).astype(np.float32))).detach()
    returns = torch.tensor(rng.normal(size=n).astype(np.float32))
    # CleanRL ppo.py, the body of the minibatch loop.
    logratio = distribution.log_prob(actions) - old_log_probs
    ratio = logratio.exp()
    with torch.no_grad():
        old_approx_kl = (-logratio).mean()
        approx_kl = ((ratio - 1) - logratio).mean()
        clipfrac = ((ratio - 1.0).abs() > clip).float().mean()
    advantages = (raw - raw.mean()) / (raw.std() + 1e-8)
    pg_loss = torch.max(-advantages * ratio, -advantages * torch.clamp(ratio, 1 - clip, 1 + clip)).mean()
    unclipped = (values - returns) ** 2
    clipped = (old_values + torch.clamp(values - old_values, -clip, clip) - returns) ** 2
    v_loss = 0.5 * torch.max(unclipped, clipped).mean()
    entropy = distribution.entropy().mean()
    total = pg_loss - entropy_coef * entropy + v_loss * value_coef
    total.backward()
    text = rust("LOGITS", logits.detach()) + rust("VALUES", values.detach()) + rust("ACTIONS", actions, "u8")
    text += rust("OLD_LOG_PROBS", old_log_probs) + rust("ADVANTAGES", raw) + rust("OLD_VALUES", old_values)
    text += rust("RETURNS", returns) + rust("LOGIT_GRADIENT", logits.grad) + rust("VALUE_GRADIENT", values.grad)
    scalars = [total, pg_loss, v_loss, entropy, old_approx_kl, approx_kl, clipfrac]
    text += "/// Total, policy loss, value loss, entropy, `old_approx_kl`, `approx_kl`, clip fraction.\n"
    write("loss", text + rust("EXPECTED", [float(s.detach()) for s in scalars]))


def adam():
    import torch

    weights = [torch.nn.Parameter(torch.tensor(rng.normal(size=s).astype(np.float32))) for s in [(3, 2), (3,)]]
    text = rust("WEIGHT", weights[0].detach()) + rust("BIAS", weights[1].detach())
    optimizer = torch.optim.Adam(weights, lr=2.5e-4, eps=1e-5)
    gradients = []
    for step in range(5):
        for w in weights:
            scale = 1e-4 if step == 2 else 0.4
            w.grad = torch.tensor((scale * rng.normal(size=tuple(w.shape))).astype(np.float32))
            gradients.append(w.grad.clone().ravel())
        torch.nn.utils.clip_grad_norm_(weights, 0.5)
        optimizer.param_groups[0]["lr"] = 1e-2 * (1 - step / 5)
        optimizer.step()
    text += rust("GRADIENTS", torch.cat(gradients))
    write("adam", text + rust("WEIGHT_AFTER", weights[0].detach()) + rust("BIAS_AFTER", weights[1].detach()))


for make in (gae, vtrace, loss, adam):
    make()

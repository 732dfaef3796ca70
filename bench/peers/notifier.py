"""The piloting notifier, trained to .9 success by Leadtime and by its peers: environment steps, seconds, steps per second.

    python3 bench/peers/notifier.py [leadtime leadtime-two cleanrl cleanrl-sync sb3 sample-factory] [--seeds 1 2 3] [--results FOLDER] [--steps 2400000] [--stop]

The task, the network and the settings are those of `leadtime config lander`. `leadtime` is `leadtime up` with one actor, `leadtime-two` with two,
which train the same weights;
`cleanrl` a single file in the manner of CleanRL's `ppo.py`, on the native vector of 64 environments, and `cleanrl-sync` on Gymnasium's
`SyncVectorEnv` of 64 single ones, as CleanRL has it; `sb3` MaskablePPO of
sb3-contrib on 64 single ones; `sample-factory` its asynchronous PPO on two workers with 32 each, without masks and with a learning rate that
does not fall, because it knows neither. For all alike, .9 success means: of the last 100 training episodes 90 were successes, at the end of
an update. The peers are looked at before they learn from its rollouts, Leadtime's journal has it after that. No system evaluates while
it trains. A peer's seconds count from the start of the training, without imports; Leadtime's from the start of the command.

Every training is a process of its own, one after the other, and writes FOLDER/SYSTEM-SEED.json (default target/notifier). What has its
file is not trained again, so the script may be ended and started again. It ends with a table of what is in FOLDER. torch has one
thread, which is faster for networks as small as these (beside other load twenty times); --threads says otherwise. --stop ends a training
once it has .9; one that never gets there counts with all its steps and seconds, and the mean is marked ≥. On two idle cores three seeds
take half a minute of Leadtime, four minutes of CleanRL, ten on `SyncVectorEnv`, thirteen of Stable-Baselines3, eleven of Sample Factory.

Needs: the package `leadtime` (python/build.sh), the program, and for the peers: pip install torch stable-baselines3 sb3-contrib. Sample Factory
holds Gymnasium below 1.0 and needs an environment of its own, with the package, too (`pip install --no-deps`); its results may go into
the same FOLDER.
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import deque
from pathlib import Path

TASK, N_ENVS, N_STEPS, N_MINIBATCHES, N_EPOCHS = "leadtime/Lander-v0", 64, 64, 16, 4
GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, MAX_NORM, LR = 0.999, 0.95, 0.2, 0.004, 0.5, 0.5, 1.5e-3
REWARD_SCALE, INITIATE_BIAS, WANTED, LAST = 0.01, -1.0, 0.9, 100
ENDING = 30.0  # Seconds that Leadtime may take to end after it was asked to.


class Progress:
    """Notes when the last episodes were successful enough."""

    def __init__(self):
        self.started, self.steps = time.time(), 0
        self.last, self.reached = deque(maxlen=LAST), None

    def episode(self, success):
        self.last.append(bool(success))

    def update(self):
        if self.reached is None and len(self.last) == LAST and sum(self.last) >= WANTED * LAST:
            self.reached = (self.steps, time.time() - self.started)

    def result(self):
        return result(self.steps, time.time() - self.started, sum(self.last) / max(1, len(self.last)), self.reached)


def result(steps, seconds, last_success, reached):
    needed_steps, needed = reached or (None, None)
    return {"steps_to_.9": needed_steps, "seconds_to_.9": needed and round(needed, 1), "steps": steps, "seconds": round(seconds, 1),
            "steps_per_second": round(steps / seconds), "last_success": round(last_success, 2)}


def leadtime_two(args, seed):
    return leadtime(args, seed, n_actors=2)


def leadtime(args, seed, n_actors=1):
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        command = [args.program, "up", "-c", "lander", "--actors", str(n_actors), "--seed", str(seed), "--runs", folder,
                   "--name", "r", "--set", f"learner.total_steps={args.steps}", "--set", "evaluation.during_training=0"]
        started = time.time()
        said = open(folder + "/said", "w+")
        child = subprocess.Popen(command, stdout=said, stderr=said)
        journal, reached, last, seconds, n_read, is_over = Path(folder) / "r/metrics.jsonl", None, None, None, 0, False
        try:
            while not is_over:
                is_over = child.poll() is not None
                # Whole lines only, and from its name every time: the file is replaced when the run begins.
                text = journal.read_text() if journal.exists() else ""
                lines = [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()[n_read:]]
                for line in lines:
                    n_read, last, seconds = n_read + 1, line, time.time() - started
                    enough = line["episodes/finished"] >= LAST and line.get("episodes/success", 0) >= WANTED
                    if reached is None and enough:
                        reached = (line["steps"], seconds)
                if reached and args.stop and not is_over:
                    # Once: a second signal would end it before its children, which write into the folder.
                    child.terminate()
                    break
                time.sleep(0.05)
        finally:
            try:
                child.wait(ENDING)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        if last is None:
            said.seek(0)
            sys.exit(f"{' '.join(command)} ended with {child.returncode}:\n{said.read()}")
        return result(last["steps"], seconds, last["episodes/success"], reached)


def cleanrl_sync(args, seed):
    return cleanrl(args, seed, vectorization_mode="sync")


def cleanrl(args, seed, vectorization_mode="vector_entry_point"):
    import gymnasium as gym
    import numpy as np
    import torch
    from torch import nn
    from whole_cleanrl_style import estimate_advantages, layer

    import leadtime.gym  # noqa: F401

    # The native vector resets in the same step, too.
    how = {"vector_kwargs": {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}} if vectorization_mode == "sync" else {}
    envs = gym.make_vec(TASK, num_envs=N_ENVS, vectorization_mode=vectorization_mode, **how)
    sizes = envs.single_action_space.nvec.tolist()
    n_in = envs.single_observation_space.shape[0]
    torch.manual_seed(seed)
    np.random.seed(seed)

    def network(n_out, gain):
        return nn.Sequential(layer(n_in, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, n_out, gain))

    actor, critic = network(sum(sizes), 0.01), network(1, 1.0)
    with torch.no_grad():
        actor[-1].bias[1] = INITIATE_BIAS
    parameters = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(parameters, lr=LR, eps=1e-5)

    def decide(x, mask, action=None):
        logits = torch.where(mask, actor(x), torch.tensor(-1e8))
        heads = [torch.distributions.Categorical(logits=part) for part in logits.split(sizes, dim=-1)]
        if action is None:
            action = torch.stack([head.sample() for head in heads], dim=-1)
        log_prob = sum(head.log_prob(action[..., i]) for i, head in enumerate(heads))
        return action, log_prob, sum(head.entropy() for head in heads), critic(x).squeeze(-1)

    obs = torch.zeros(N_STEPS, N_ENVS, n_in)
    actions = torch.zeros(N_STEPS, N_ENVS, len(sizes), dtype=torch.long)
    masks = torch.zeros(N_STEPS, N_ENVS, sum(sizes), dtype=torch.bool)
    log_probs, rewards, dones, values = (torch.zeros(N_STEPS, N_ENVS) for _ in range(4))
    progress = Progress()
    seen, infos = envs.reset(seed=seed)
    next_obs, next_mask, next_done = torch.tensor(seen), torch.tensor(infos["action_mask"], dtype=torch.bool), torch.zeros(N_ENVS)
    n_updates = args.steps // (N_ENVS * N_STEPS)
    for update in range(n_updates):
        optimizer.param_groups[0]["lr"] = LR * (1 - update / n_updates)
        for t in range(N_STEPS):
            obs[t], masks[t], dones[t] = next_obs, next_mask, next_done
            with torch.no_grad():
                action, log_prob, _, value = decide(next_obs, next_mask)
            actions[t], log_probs[t], values[t] = action, log_prob, value
            seen, reward, terminated, truncated, infos = envs.step(action.numpy())
            progress.steps += N_ENVS
            ended = np.flatnonzero(terminated | truncated)
            reward = reward * REWARD_SCALE
            for i in ended:
                progress.episode(infos["final_info"]["success"][i])
                if truncated[i]:
                    # The discounted value of what was cut off, as the program adds it.
                    with torch.no_grad():
                        reward[i] += GAMMA * critic(torch.tensor(infos["final_obs"][i])).item()
            rewards[t] = torch.tensor(reward, dtype=torch.float32)
            next_obs, next_mask = torch.tensor(seen), torch.tensor(infos["action_mask"], dtype=torch.bool)
            next_done = torch.tensor(terminated | truncated, dtype=torch.float32)
        progress.update()
        if progress.reached and args.stop:
            break
        with torch.no_grad():
            next_value = critic(next_obs).squeeze(-1)
            advantages = estimate_advantages(rewards, values, dones, next_value, next_done, GAMMA, LAMBDA)
            returns = advantages + values
        flat = [x.reshape(-1, *x.shape[2:]) for x in (obs, masks, actions, log_probs, advantages, returns)]
        order = np.arange(N_ENVS * N_STEPS)
        for _ in range(N_EPOCHS):
            np.random.shuffle(order)
            for batch in order.reshape(N_MINIBATCHES, -1):
                b_obs, b_mask, b_act, b_logp, b_adv, b_ret = (x[batch] for x in flat)
                _, logp, entropy, value = decide(b_obs, b_mask, b_act)
                ratio = (logp - b_logp).exp()
                b_adv = (b_adv - b_adv.mean()) / (b_adv.std() + 1e-8)
                policy_loss = torch.max(-b_adv * ratio, -b_adv * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = policy_loss - ENTROPY * entropy.mean() + VALUE * 0.5 * ((value - b_ret) ** 2).mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(parameters, MAX_NORM)
                optimizer.step()
    return progress.result()


def sb3(args, seed):
    import gymnasium as gym
    from sb3_contrib import MaskablePPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import make_vec_env
    from torch import nn

    import leadtime.gym  # noqa: F401

    progress = None

    class Told(BaseCallback):
        def _on_step(self):
            progress.steps = self.num_timesteps
            for info in self.locals["infos"]:
                if "success" in info:
                    progress.episode(info["success"])
            return not (progress.reached and args.stop)

        def _on_rollout_end(self):
            progress.update()

    class Scaled(gym.Wrapper):
        def step(self, action):
            observation, reward, terminated, truncated, info = self.env.step(action)
            return observation, reward * REWARD_SCALE, terminated, truncated, info

        def action_masks(self):
            return self.env.unwrapped.action_masks()

    envs = make_vec_env(lambda: Scaled(gym.make(TASK)), n_envs=N_ENVS, seed=seed)
    model = MaskablePPO(
        "MlpPolicy", envs, learning_rate=lambda left: LR * left, n_steps=N_STEPS, batch_size=N_ENVS * N_STEPS // N_MINIBATCHES,
        n_epochs=N_EPOCHS, gamma=GAMMA, gae_lambda=LAMBDA, clip_range=CLIP, ent_coef=ENTROPY, vf_coef=VALUE / 2,
        max_grad_norm=MAX_NORM, seed=seed, device="cpu",
        policy_kwargs={"net_arch": {"pi": [64, 64], "vf": [64, 64]}, "activation_fn": nn.Tanh})
    model.policy.action_net.bias.data[1] = INITIATE_BIAS
    progress = Progress()
    model.learn(args.steps, callback=Told())
    return progress.result()


def sample_factory_world(_name, args, env_config, render_mode=None):
    """Makes an environment for Sample Factory, which holds Gymnasium below 1.0 and knows no masks: what is not offered has no effect."""
    import gymnasium as gym
    import numpy as np
    from leadtime import World

    class Notifier(gym.Env):
        def __init__(self):
            self.world, self.episode = World("lander", [], False), 0
            self.observation_space = gym.spaces.Box(-np.inf, np.inf, (self.world.obs_dim,), np.float32)
            self.action_space = gym.spaces.Tuple([gym.spaces.Discrete(len(choices)) for _, choices in self.world.heads])
            self.seed = 1000 * args.seed + (env_config.env_id if env_config else 999)

        def reset(self, *, seed=None, options=None):
            observation, info = self.world.reset(self.seed, self.episode)
            self.episode += 1
            return observation, info

        def step(self, action):
            observation, reward, terminated, truncated, info = self.world.step([int(choice) for choice in action])
            if terminated or truncated:
                info["episode_extra_stats"] = {"success": float(info["success"])}
            return observation, reward, terminated, truncated, info

    return Notifier()


def sample_factory_model(cfg, obs_space, action_space):
    """Makes Sample Factory's networks, which begin by being quiet as all others do."""
    import torch
    from sample_factory.model.actor_critic import default_make_actor_critic_func

    model = default_make_actor_critic_func(cfg, obs_space, action_space)
    with torch.no_grad():
        model.action_parameterization.distribution_linear.bias[1] = INITIATE_BIAS
    return model


def sample_factory(args, seed):
    from sample_factory.algo.runners.runner import AlgoObserver
    from sample_factory.algo.utils.context import global_model_factory
    from sample_factory.cfg.arguments import parse_full_cfg, parse_sf_args
    from sample_factory.envs.env_utils import register_env
    from sample_factory.train import make_runner

    register_env("notifier", sample_factory_world)
    global_model_factory().register_actor_critic_factory(sample_factory_model)
    with tempfile.TemporaryDirectory() as folder:
        argv = ["--algo=APPO", "--env=notifier", "--experiment=bench", f"--train_dir={folder}", "--device=cpu", f"--seed={seed}",
                f"--train_for_env_steps={args.steps}", "--num_workers=2", f"--num_envs_per_worker={N_ENVS // 2}", f"--rollout={N_STEPS}",
                f"--batch_size={N_ENVS * N_STEPS // N_MINIBATCHES}", f"--num_batches_per_epoch={N_MINIBATCHES}", f"--num_epochs={N_EPOCHS}",
                "--use_rnn=False", "--encoder_mlp_layers", "64", "64", "--nonlinearity=tanh", "--actor_critic_share_weights=False",
                f"--gamma={GAMMA}", f"--gae_lambda={LAMBDA}", f"--ppo_clip_ratio={CLIP}", "--ppo_clip_value=1e9",
                f"--exploration_loss_coeff={ENTROPY}", f"--value_loss_coeff={VALUE / 2}", f"--max_grad_norm={MAX_NORM}",
                f"--learning_rate={LR}", "--adam_eps=1e-5", f"--reward_scale={REWARD_SCALE}",
                "--value_bootstrap=True", "--normalize_input=False", "--normalize_returns=False", "--with_wandb=False",
                f"--stats_avg={LAST}", "--decorrelate_experience_max_seconds=0", "--save_every_sec=100000"]
        parser, _ = parse_sf_args(argv)
        cfg, runner = make_runner(parse_full_cfg(parser, argv))
        progress = Progress()

        class Told(AlgoObserver):
            def on_training_step(self, runner, iteration):
                progress.steps = sum(runner.env_steps.values())
                if "success" in runner.policy_avg_stats:
                    progress.last = runner.policy_avg_stats["success"][0]
                progress.update()
                if progress.reached and args.stop:
                    cfg.train_for_env_steps = 0

        runner.register_observer(Told())
        runner.init()
        progress.started = time.time()
        runner.run()
        return progress.result()


SYSTEMS = {"leadtime": (leadtime, "`leadtime up`, one actor"), "leadtime-two": (leadtime_two, "`leadtime up`, two actors"), "cleanrl": (cleanrl, "CleanRL-style PPO, native vector"),
           "cleanrl-sync": (cleanrl_sync, "CleanRL-style PPO, `SyncVectorEnv` as in CleanRL"),
           "sb3": (sb3, "Stable-Baselines3 MaskablePPO"), "sample-factory": (sample_factory, "Sample Factory, 2 workers x 32")}


def train(args, system, seed):
    """Trains in this process, and writes the result."""
    about = {"system": system, "seed": seed, "total_steps": args.steps, "cores": os.cpu_count()}
    if not system.startswith("leadtime"):
        try:
            import torch
        except ImportError as missing:
            print(f"skipped: {missing}")
            return
        torch.set_num_threads(args.threads)
        about |= {"torch": torch.__version__, "threads": args.threads}
    try:
        about |= SYSTEMS[system][0](args, seed)
    except ImportError as missing:
        print(f"skipped: {missing}")
        return
    file = Path(args.results, f"{system}-{seed}.json")
    file.with_suffix(".new").write_text(json.dumps(about) + "\n")
    file.with_suffix(".new").rename(file)
    print(json.dumps(about), flush=True)


def needed(run, what):
    """Steps or seconds to .9; a training that did not get there counts with all that it had, which is less than it needs."""
    return run[what] if run[f"{what}_to_.9"] is None else run[f"{what}_to_.9"]


def over_seeds(values, is_bound=False, unit=1):
    """Writes median and mean over seeds, with the least and the greatest."""
    values = [value / unit for value in values]
    median, mean, least, most = (f"{value:,.0f}" if value >= 10 else f"{value:.1f}"
                                 for value in (statistics.median(values), statistics.mean(values), min(values), max(values)))
    return f"{median}, {'≥ ' * is_bound}{mean} ({least}–{most})" if len(values) > 1 else mean


def table(folder):
    runs = [json.loads(file.read_text()) for file in sorted(Path(folder).glob("*.json"))]
    of = {system: [run for run in runs if run["system"] == system] for system in SYSTEMS}
    ours = [needed(run, "seconds") for run in of["leadtime"]]
    print("\n| median, mean over seeds (least–greatest) | got there | steps/s | thousand steps to .9 | seconds to .9 | seconds, times ours | success at the end |")
    print("|---|---|---|---|---|---|---|")
    for system, found in of.items():
        if not found:
            continue
        steps, seconds = ([needed(run, what) for run in found] for what in ("steps", "seconds"))
        n_there = sum(run["seconds_to_.9"] is not None for run in found)
        is_bound = n_there < len(found)
        times = f"{statistics.median(seconds) / statistics.median(ours):.1f}, {'≥ ' * is_bound}{statistics.mean(seconds) / statistics.mean(ours):.1f}" if ours else "–"
        cells = [SYSTEMS[system][1], f"{n_there} of {len(found)}", over_seeds([run["steps_per_second"] for run in found]),
                 over_seeds(steps, is_bound, 1000), over_seeds(seconds, is_bound), times, f"{statistics.mean(run['last_success'] for run in found):.2f}"]
        print("| " + " | ".join(cells) + " |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("systems", nargs="*", metavar="SYSTEM", help=f"{', '.join(SYSTEMS)}; all of them unless some are named")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--results", default="target/notifier", metavar="FOLDER")
    parser.add_argument("--steps", type=int, default=2_400_000)
    parser.add_argument("--program", default="target/release/leadtime")
    parser.add_argument("--threads", type=int, default=1, help="threads of torch")
    parser.add_argument("--stop", action="store_true", help="end a training once it has .9")
    parser.add_argument("--here", action="store_true", help="train in this process; the script calls itself so")
    args = parser.parse_args()
    if unknown := set(args.systems) - set(SYSTEMS):
        parser.error(f"no system {', '.join(sorted(unknown))}; there are {', '.join(SYSTEMS)}")
    Path(args.results).mkdir(parents=True, exist_ok=True)
    if args.here:
        return train(args, args.systems[0], args.seeds[0])
    for seed in args.seeds:
        for system in args.systems or SYSTEMS:
            if Path(args.results, f"{system}-{seed}.json").exists():
                continue
            same = ["--results", args.results, "--steps", str(args.steps), "--program", args.program, "--threads", str(args.threads)]
            command = [sys.executable, __file__, system, "--here", "--seeds", str(seed), *same, *["--stop"] * args.stop]
            if subprocess.run(command).returncode:
                sys.exit(1)
    table(args.results)


if __name__ == "__main__":
    main()

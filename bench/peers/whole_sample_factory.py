"""Environment steps per second of Sample Factory's asynchronous PPO on LunarLander-v3, two rollout workers on two cores.

    python3 bench/peers/whole_sample_factory.py [SECONDS]

Needs: pip install sample-factory "gymnasium[box2d]". Prints one JSON line.
"""
import json
import sys
import tempfile
import time

try:
    import gymnasium as gym
    from sample_factory.cfg.arguments import parse_full_cfg, parse_sf_args
    from sample_factory.envs.env_utils import register_env
    from sample_factory.train import run_rl
except ImportError as missing:
    print(f"skipped: {missing}; pip install sample-factory 'gymnasium[box2d]'")
    sys.exit(0)


# What it makes on two cores, roughly.
STEPS_PER_SECOND = 5_000


def make(_name, _cfg, _env_config, render_mode=None):
    # Sample Factory holds Gymnasium below 1.0, whose lander is numbered 2; the difference (wind, at rest) is not in speed.
    name = "LunarLander-v3" if "LunarLander-v3" in gym.registry else "LunarLander-v2"
    return gym.make(name, render_mode=render_mode)


def main():
    # It may train on long after `train_for_seconds`, so it is told steps: as many as two cores make in that time.
    n_steps = STEPS_PER_SECOND * int(sys.argv[1] if len(sys.argv) > 1 else "60")
    register_env("lander", make)
    with tempfile.TemporaryDirectory() as folder:
        argv = ["--algo=APPO", "--env=lander", "--experiment=bench", f"--train_dir={folder}", "--device=cpu",
                f"--train_for_env_steps={n_steps}", "--num_workers=2", "--num_envs_per_worker=8", "--rollout=128",
                "--batch_size=512", "--num_batches_per_epoch=4", "--num_epochs=4", "--use_rnn=False",
                "--encoder_mlp_layers", "64", "64", "--nonlinearity=tanh", "--with_wandb=False",
                "--normalize_input=False", "--normalize_returns=False"]
        parser, _ = parse_sf_args(argv)
        cfg = parse_full_cfg(parser, argv)
        started = time.time()
        run_rl(cfg)
        wall = time.time() - started
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
        import glob
        events = EventAccumulator(glob.glob(f"{folder}/bench/.summary/*")[0])
        events.Reload()
        points = [e.value for e in events.Scalars("perf/_fps")]
        points = points[len(points) // 3:]
        print(json.dumps({"peer": "Sample Factory", "seconds": round(wall, 1),
                          "steps_per_second": round(sum(points) / max(1, len(points)))}))


if __name__ == "__main__":
    main()

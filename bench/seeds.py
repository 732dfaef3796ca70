"""How many seeds of a profile learn: trains fresh seeds, and counts those within .05 of the best.

    python3 bench/seeds.py [PROFILE ...] [--seeds 20] [--first 30001] [--results FOLDER] [--leadtime PROGRAM]

Profiles: lander, paper-lander, hard, one-layout, varying (reaction delay N(2, 1)), driving, cooking, and smoke-lander, smoke-highway,
smoke-steakhouse, which are `leadtime smoke`. Without a name, all of them. The seeds chose nothing: searches and tables use others.

The success of a training is that of its last policy on the held-out episodes, with sampled choices; of a smoke, that of its evaluation, and
it must end with exit code 0. Every training is a process of its own with one actor, one after the other, and writes
FOLDER/PROFILE-SEED.json (default target/seeds). What has its file is not trained again, so the script may be ended and started again. It
ends with a table of what is in FOLDER, and with exit code 1 if a profile has a seed that is not near its best.
"""
import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

NEAR = 0.05
ONE_LAYOUT = ["world.zone_jitter=[0.001, 0.001]"]
VARYING = ['human.reaction_delay={ normal = { mean = 2.0, deviation = 1.0, drawn = "per_episode" } }']
# The configuration of `leadtime up`, and what is changed in it.
TRAININGS = {
    "lander": ("lander", []),
    "paper-lander": ("paper_lander", []),
    "hard": ("paper_lander_hard", []),
    "one-layout": ("lander", ONE_LAYOUT),
    "varying": ("paper_lander", VARYING),
    "driving": ("paper_highway", []),
    "cooking": ("steakhouse", []),
}
SMOKES = {f"smoke-{domain}": domain for domain in ("lander", "highway", "steakhouse")}


def train(leadtime, profile, seed, folder):
    """Trains one seed and returns its success; None if the program failed."""
    if profile in SMOKES:
        command = [leadtime, "smoke", "--domain", SMOKES[profile], "--seed", str(seed), "--runs", folder, "--json"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        return smoke_success(json.loads(done.stdout)) if done.returncode == 0 else None
    config, settings = TRAININGS[profile]
    command = [leadtime, "up", "-c", config, "--actors", "1", "--seed", str(seed), "--runs", folder, "--name", "run"]
    command += [argument for setting in settings for argument in ("--set", setting)]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    if done.returncode != 0:
        return None
    lines = (Path(folder) / "run" / "held_out.jsonl").read_text().splitlines()
    return json.loads(lines[-1])["held_out/success"]


def smoke_success(results):
    """Returns the trained policy's success in what `smoke --json` prints."""
    summaries = results["comparison"]["summaries"]
    trained = next(summary for summary in summaries if summary["player"] == "trained")
    success = next(measure for measure in trained["measures"] if measure["name"] == "success")
    return success["interval"]["estimate"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [*TRAININGS, *SMOKES]
    parser.add_argument("profiles", nargs="*", metavar="PROFILE", default=known)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=30001)
    parser.add_argument("--results", type=Path, default=Path("target/seeds"))
    parser.add_argument("--leadtime", default="target/release/leadtime")
    options = parser.parse_args()
    unknown = set(options.profiles) - set(known)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    options.results.mkdir(parents=True, exist_ok=True)
    for profile in options.profiles:
        for seed in range(options.first, options.first + options.seeds):
            result = options.results / f"{profile}-{seed}.json"
            if result.exists():
                continue
            started = time.time()
            with tempfile.TemporaryDirectory() as folder:
                success = train(options.leadtime, profile, seed, folder)
            seconds = round(time.time() - started, 1)
            result.write_text(json.dumps({"success": success, "seconds": seconds}) + "\n")
            print(f"{profile} {seed}: {success} in {seconds} s", file=sys.stderr, flush=True)
    sys.exit(0 if report(options.results, options.profiles) else 1)


def report(folder, profiles):
    """Prints the table, and returns whether every seed is near its profile's best."""
    print("| profile | seeds | near the best | success, worst to best | median | seconds each |")
    print("|---|---|---|---|---|---|")
    all_near = True
    for profile in profiles:
        results = [json.loads(path.read_text()) for path in sorted(folder.glob(f"{profile}-[0-9]*.json"))]
        values = sorted(result["success"] or 0.0 for result in results)
        if not values:
            continue
        near = sum(value >= values[-1] - NEAR for value in values)
        all_near &= near == len(values)
        seconds = sorted(result["seconds"] for result in results)[len(results) // 2]
        print(f"| `{profile}` | {len(values)} | {near} | {values[0]:.3f} to {values[-1]:.3f} | {values[len(values) // 2]:.3f} | {seconds:.0f} |")
    return all_near


if __name__ == "__main__":
    main()

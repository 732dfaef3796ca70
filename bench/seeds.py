"""How many seeds of a profile learn: trains fresh seeds, and counts those within .05 of the best.

    python3 bench/seeds.py [PROFILE ...] [--seeds 20] [--first 30001] [--jobs 1] [--results FOLDER] [--leadtime PROGRAM]

Profiles: lander, paper-lander, hard, one-layout, varying (reaction delay N(2, 1)), driving, cooking, and smoke-lander, smoke-highway,
smoke-steakhouse, which are `leadtime smoke`. Without a name, all of them. The training seeds chose nothing: searches and tables use
others. The episodes of the evaluation are those of the searches.

A training learns if it is within .05 of its profile's best. Its success is what `leadtime eval RUN --episodes 1000 --eval-seed 5900000` has:
that of its best policy, with sampled choices. (The 200 held-out episodes of a training tell .95 from .98 only by chance.) A smoke learns
if it ends with exit code 0; its success is that of its own evaluation. Every training is a process of its own with one actor, `--jobs` of
them at a time, and writes FOLDER/PROFILE-SEED.json (default target/seeds). What this program has written there is not trained again, so
the script may be ended and started again; what another build has written is. It ends with a table of these seeds, and with exit code 1
if one has not learned.
"""
import argparse
import hashlib
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

NEAR = 0.05
# Exit codes of a program that was told to end.
INTERRUPTED = (130, 143)
# A layout that never changes is learned on every seed with these settings (docs/results/search.md, section 13).
ONE_LAYOUT = ["world.zone_jitter=[0.001, 0.001]", "learner.entropy_coef=0.02", "learner.total_steps=3200000"]
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
        return success_of(command, "trained")
    config, settings = TRAININGS[profile]
    command = [leadtime, "up", "-c", config, "--actors", "1", "--seed", str(seed), "--runs", folder, "--name", "run"]
    command += [argument for setting in settings for argument in ("--set", setting)]
    if ended(subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)) != 0:
        return None
    command = [leadtime, "eval", "run", "--runs", folder, "--episodes", "1000", "--eval-seed", "5900000", "--json"]
    return success_of(command, "policy")


def ended(process):
    """Returns the exit code of a program; one that a signal ended says nothing about its seed."""
    if process.returncode < 0 or process.returncode in INTERRUPTED:
        sys.exit(f"interrupted: {' '.join(map(str, process.args))}")
    return process.returncode


def success_of(command, player):
    """Runs `eval --json` or `smoke --json` and returns a player's success; None if the program failed."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    if ended(done) != 0:
        return None
    summaries = json.loads(done.stdout)["comparison"]["summaries"]
    measures = next(summary["measures"] for summary in summaries if summary["player"] == player)
    return next(measure["interval"]["estimate"] for measure in measures if measure["name"] == "success")


def result_of(options, profile, seed):
    """Returns what this program has found for a seed; None if it has not been asked."""
    path = options.results / f"{profile}-{seed}.json"
    result = json.loads(path.read_text()) if path.exists() else {}
    return result if result.get("program") == options.program else None


def train_into(options, profile, seed):
    """Trains one seed and writes its result, unless the result is there already."""
    if result_of(options, profile, seed):
        return
    result = options.results / f"{profile}-{seed}.json"
    started = time.time()
    with tempfile.TemporaryDirectory() as folder:
        success = train(options.leadtime, profile, seed, folder)
    seconds = round(time.time() - started, 1)
    result.write_text(json.dumps({"success": success, "seconds": seconds, "program": options.program}) + "\n")
    print(f"{profile} {seed}: {success} in {seconds} s", file=sys.stderr, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = [*TRAININGS, *SMOKES]
    parser.add_argument("profiles", nargs="*", metavar="PROFILE", default=known)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=30001)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, default=Path("target/seeds"))
    parser.add_argument("--leadtime", default="target/release/leadtime")
    options = parser.parse_args()
    unknown = set(options.profiles) - set(known)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    program = shutil.which(options.leadtime)
    if program is None:
        parser.error(f"no program {options.leadtime}: build it, or name it with --leadtime")
    options.program = hashlib.sha256(Path(program).read_bytes()).hexdigest()[:16]
    options.results.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.seeds)
    wanted = [(profile, seed) for profile in options.profiles for seed in seeds]
    with ThreadPoolExecutor(options.jobs) as pool:
        # The list, so that what went wrong in a thread is raised here.
        list(pool.map(lambda pair: train_into(options, *pair), wanted))
    sys.exit(0 if report(options, seeds) else 1)


def report(options, seeds):
    """Prints the table, and returns whether every seed has learned."""
    print("| profile | seeds | learned | success, worst to best | median | seconds each |")
    print("|---|---|---|---|---|---|")
    all_learned = True
    for profile in options.profiles:
        results = [result for seed in seeds if (result := result_of(options, profile, seed))]
        values = sorted(result["success"] or 0.0 for result in results)
        if not values:
            continue
        least = 0.0 if profile in SMOKES else values[-1] - NEAR - 1e-9
        learned = sum(result["success"] is not None and result["success"] >= least for result in results)
        all_learned &= learned == len(results)
        seconds = statistics.median(result["seconds"] for result in results)
        print(f"| `{profile}` | {len(values)} | {learned} | {values[0]:.3f} to {values[-1]:.3f} | {statistics.median(values):.3f} | {seconds:.0f} |")
    return all_learned


if __name__ == "__main__":
    main()

"""Rates of benches and runs, a line each: what `bench/side_by_side.sh` prints.

    python3 bench/rates.py benches FOLDER    every bench that criterion measured there (CRITERION_HOME), in the order of the measurements:
                                             units per second, by the median time of its samples
    python3 bench/rates.py run FILE          steps per second of a run by its metrics.jsonl: the median over the second half of its updates, so
                                             the time of starting does not count
    python3 bench/rates.py rounds FILE       medians of lines `NAME<tab>RATE`, one per round; a peer of NAME is called `NAME, PEER`
"""
import json
import statistics
import sys
from pathlib import Path


def shown(rate, unit=""):
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if rate >= size:
            digits = 2 if rate < 10 * size else 1 if rate < 100 * size else 0
            return f"{rate / size:.{digits}f} {letter}{unit}"
    return f"{rate:.0f} {unit}".rstrip()


def benches(folder):
    measured = sorted(Path(folder).rglob("new/benchmark.json"), key=lambda path: path.stat().st_mtime_ns)
    for path in measured:
        bench = json.loads(path.read_text())
        seconds = json.loads((path.parent / "estimates.json").read_text())["median"]["point_estimate"] / 1e9
        [(unit, amount)] = (bench["throughput"] or {"Elements": 1}).items()
        print(f"{bench['full_id']:60} {shown(amount / seconds, 'B/s' if unit == 'Bytes' else '')}")


def run(file):
    lines = [json.loads(line) for line in Path(file).read_text().splitlines()]
    rates = [rate for rate in (line.get("system/steps_per_second") for line in lines) if rate]
    if rates:
        print(round(statistics.median(rates[len(rates) // 2 :])))


def rounds(file):
    rates = {}
    for line in Path(file).read_text().splitlines():
        name, rate = line.split("\t")
        rates.setdefault(name, []).append(float(rate))
    medians = {name: statistics.median(found) for name, found in rates.items()}
    for name, found in rates.items():
        ours = medians.get(name.split(", ")[0])
        beside = f"; ours {ours / medians[name]:.1f} times" if ", " in name and ours and medians[name] else ""
        span = f"median of {len(found)} ({shown(min(found))} to {shown(max(found))})"
        print(f"{name:60} {shown(medians[name])}, {span}{beside}")


if __name__ == "__main__":
    {"benches": benches, "run": run, "rounds": rounds}[sys.argv[1]](sys.argv[2])

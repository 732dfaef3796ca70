"""Runs the commands of README and docs and compares what they print with what the text says; see check.sh."""

import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FULL = "--full" in sys.argv
PROGRAM = sys.argv[-1]
# Commands of these pages run.
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs/worlds").glob("*.md")),
         ROOT / "deploy/policies/README.md"]
# Commands of these pages are long trainings on record: only their options are checked.
RECORDS = sorted((ROOT / "docs/results").glob("*.md"))
# What needs something that is not there, and why it is not run.
SKIPPED = {"http://": "a language model's server", "tls/": "certificates", "$": "variables of a script",
           "cargo install": "it would install", "HOST": "another machine", "tensorboard": "another program"}
# What a command must print, whatever else.
EXPECTED = {"runs compare one four": "weights: equal", "check ": "configuration", "describe ": "Observation",
            "decide.py": "decisions reproduced", "conformance ": "passed", "eval ": "success"}
SECONDS = 300


def commands(page):
    """Lists the commands of a page: lines of console blocks, and code in the text."""
    text = re.sub(r"<!-- begin .*?<!-- end -->", "", page.read_text(), flags=re.S)
    blocks = re.findall(r"```(?:console|bash)\n(.*?)```", text, flags=re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    inline = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.S))
    found = []
    for line in lines + inline:
        line = re.sub(r"\s+#\s.*", "", line).strip()
        line = re.sub(r"^cargo run --release( --example corridor)? -- ?", r"leadtime ", line)
        if line.startswith(("leadtime ", "python3 ")):
            found.append(line)
    return list(dict.fromkeys(found))


def shortened(line, scratch):
    """Returns the arguments of a command, made short enough to be run here."""
    for name, value in [("RUN...", "one"), ("RUN", "one"), (" A B", " one four"), ("NAME", "one"), ("DOMAIN", "lander"),
                        ("7447", str(free_port()))]:
        line = re.sub(rf"(?<![\w/.-]){re.escape(name)}(?![\w/-])" if name.isupper() else re.escape(name), value, line)
    redirect = re.search(r" > (\S+)$", line)
    words = shlex.split(line[: redirect.start()] if redirect else line)
    command = words[1] if len(words) > 1 else ""
    if words[0] == "python3":
        return [sys.executable, *words[1:]], None
    if command in ("up", "train", "learner"):
        words += ["--stop-after", "1"]
    if command == "smoke":
        words += [] if "--quick" in words else ["--quick"]
        if "corridor" in words:
            words = words[:2] + ["--quick"]
    if command == "compare" and len(words) > 2 and "--plan" not in words:
        words += ["--plan"]
    if command == "probe":
        words = [re.sub("^one$", "varied", word) for word in words]
    if "--episodes" in words:
        at = words.index("--episodes") + 1
        words[at] = str(min(int(words[at]), 50))
    return [PROGRAM, *words[1:]], redirect and scratch / redirect.group(1)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def run(arguments, scratch, to=None):
    done = subprocess.run(arguments, cwd=scratch, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=SECONDS)
    if to:
        to.write_text(done.stdout)
    return done


def prepare(scratch):
    """Makes what the pages' commands speak of: two equal runs, one with varied listeners, a file of one's own."""
    for name in ("deploy", "tests", "docs", "examples", "crates"):
        if name == "docs":
            shutil.copytree(ROOT / name, scratch / name)
        else:
            (scratch / name).symlink_to(ROOT / name)
    delay = 'human.reaction_delay={uniform={low=0,high=5,drawn="per_episode"}}'
    for name, more in [("one", []), ("four", []), ("varied", ["--set", delay])]:
        made = run([PROGRAM, "up", "-c", "lander", "--name", name, "--set", "learner.total_steps=40000", *more], scratch)
        assert made.returncode == 0, made.stderr
    (scratch / "my.toml").write_text('base = "lander"\n')


def pair(scratch):
    """Runs learner and actor as README has them, in two processes."""
    port = free_port()
    learner = subprocess.Popen([PROGRAM, "learner", "-c", "lander", "--listen", f"tcp/127.0.0.1:{port}", "--stop-after", "2"],
                               cwd=scratch, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    actor = run([PROGRAM, "actor", "--connect", f"tcp/127.0.0.1:{port}"], scratch)
    told, _ = learner.communicate(timeout=SECONDS)
    return learner.returncode == 0 and actor.returncode == 0, told + actor.stderr


def tables(scratch):
    """Trains the three worlds as README does, and compares its tables with the results."""
    readme = (ROOT / "README.md").read_text()
    wrong = []
    for domain, cells in [("lander", r"\| success: on the pad.*?\| (.*) \|"), ("highway", r"\| `highway`:.*?\| (.*) \|"),
                          ("steakhouse", r"\| `steakhouse`:.*?\| (.*) \|")]:
        row = re.search(cells, readme).group(1).split(" | ")
        done = run([PROGRAM, "smoke", "--domain", domain, "--json"], scratch)
        summaries = json.loads(done.stdout)["comparison"]["summaries"]
        for said, summary in zip(row, summaries):
            measure = next(it for it in summary["measures"] if it["name"] == "success")
            estimate = measure["interval"]["estimate"]
            figure = float(re.search(r"[\d.]+", said).group())
            if abs(figure - estimate) > 0.0051:
                wrong.append(f"README says {said} for {summary['name']} in {domain}, smoke gives {estimate:.3f}")
    return wrong


def main():
    failures, n_run, n_options, skipped = [], 0, 0, []
    os.environ.pop("RUST_LOG", None)
    with tempfile.TemporaryDirectory(prefix="leadtime-docs-") as directory:
        scratch = Path(directory)
        prepare(scratch)
        for page in [*PAGES, *RECORDS]:
            for line in commands(page):
                place = f"{page.relative_to(ROOT)}: {line}"
                reason = next((why for what, why in SKIPPED.items() if what in line), None)
                if reason or re.match(r"leadtime (actor|learner)\b", line):
                    skipped.append(f"{place} ({reason or 'run as a pair'})")
                    continue
                arguments, to = shortened(line, scratch)
                is_mention = len(arguments) == 2 and arguments[1] not in ("smoke", "runs", "config", "compare", "check")
                if page in RECORDS or is_mention:
                    arguments, n_options = [*arguments, "--help"], n_options + 1
                else:
                    n_run += 1
                done = run(arguments, scratch, to)
                told = done.stdout + done.stderr
                wanted = next((text for part, text in EXPECTED.items() if part in line), "")
                if done.returncode != 0:
                    failures.append(f"{place}\n    exit {done.returncode}: {told.strip()[-300:]}")
                elif wanted not in (told + (to.read_text() if to else "")) and "--help" not in arguments:
                    failures.append(f"{place}\n    does not print `{wanted}`")
        good, told = pair(scratch)
        if not good:
            failures.append(f"learner and actor in two terminals:\n    {told.strip()[-300:]}")
        if FULL:
            failures += tables(scratch)
    print(f"{n_run} commands run, the options of {n_options} checked, {len(skipped)} not run:")
    print("".join(f"  {line}\n" for line in skipped), end="")
    for failure in failures:
        print(f"FAILED {failure}")
    sys.exit(1 if failures else 0)


main()

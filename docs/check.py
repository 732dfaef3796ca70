"""Runs the commands of README and docs and compares what they print with what the text says; see check.sh."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from importlib.util import find_spec
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
           "cargo install": "it would install", "HOST": "another machine", "tensorboard": "another program", "corridor": "an example with a build of its own", "bench/": "a benchmark"}
if not find_spec("numpy"):
    SKIPPED["python3"] = "no numpy here"
# What a command must print, whatever else.
EXPECTED = {"leadtime runs compare one four": "weights: equal", "leadtime check ": "configuration",
            "leadtime describe ": "bservation", "python3 examples/decide.py": "decisions reproduced",
            "leadtime conformance ": "passed", "leadtime eval ": "success", "leadtime probe ": "d_r"}
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
        if re.match(r"(leadtime|python3) \S|\{.*leadtime ", line):
            # What stands in brackets may be left out.
            found.append(re.sub(r" \[-[^\]]*\]", "", line))
    return list(dict.fromkeys(found))


def shortened(line):
    """Returns a command that can be run here, and soon."""
    for name, value in [(r"\bRUN\.\.\.", "made"), (r"\bRUN\b", "made"), (r"\bNAME\b", "made"), (r"\bA B\b", "made again"),
                        (r"\bDOMAIN\b", "lander"), (r"\b7447\b", str(free_port())), (r"^python3", sys.executable)]:
        line = re.sub(name, value, line)
    more = ""
    if re.match(r"leadtime (up|train)\b", line) and "cartpole" not in line:
        more = " --stop-after 1"
    elif line.startswith("leadtime smoke") and "--quick" not in line:
        more = " --quick"
    elif re.match(r"leadtime compare \S", line) and "--plan" not in line:
        more = " --plan"
    elif line.startswith("leadtime probe"):
        line = line.replace(" made", " varied")
    line = re.sub(r"--episodes (\d+)", lambda number: f"--episodes {min(int(number[1]), 50)}", line)
    return line + more


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def run(line, scratch):
    return subprocess.run(["bash", "-c", line], cwd=scratch, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=SECONDS)


def prepare(scratch):
    """Makes what the pages' commands speak of: two equal runs, one with varied listeners, a file of one's own."""
    for name in ("deploy", "tests", "docs", "examples", "crates", "bench"):
        if name == "docs":
            shutil.copytree(ROOT / name, scratch / name)
        else:
            (scratch / name).symlink_to(ROOT / name)
    delay = """--set 'human.reaction_delay={uniform={low=0,high=5,drawn="per_episode"}}'"""
    for name, more in [("made", ""), ("again", ""), ("varied", delay)]:
        made = run(f"leadtime up -c lander --name {name} --set learner.total_steps=40000 {more}", scratch)
        assert made.returncode == 0, made.stderr
    (scratch / "words").mkdir()
    for name in ("own.toml", "words/taxonomy.toml"):
        shutil.copy(ROOT / "crates/taxonomy/data/lander/taxonomy.toml", scratch / name)
    (scratch / "my.toml").write_text('base = "lander"\n')


def write_examples(page, scratch):
    """Writes the files that a page shows: a TOML block whose first line is a comment with the file's name."""
    for name, text in re.findall(r"```toml\n# (\S+\.toml)\n(.*?)```", page.read_text(), flags=re.S):
        (scratch / name).write_text(text)


def pair(scratch):
    """Runs learner and actor as README has them, in two processes."""
    port = free_port()
    arguments = ["learner", "-c", "lander", "--name", "pair", "--listen", f"tcp/127.0.0.1:{port}", "--stop-after", "2"]
    learner = subprocess.Popen([PROGRAM, *arguments], cwd=scratch, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    actor = run(f"leadtime actor --connect tcp/127.0.0.1:{port}", scratch)
    told, _ = learner.communicate(timeout=SECONDS)
    return learner.returncode == 0 and actor.returncode == 0, told + actor.stderr


def tables(scratch):
    """Trains the three worlds as README does, and compares its tables with the results."""
    readme = (ROOT / "README.md").read_text()
    wrong = []
    for domain, cells in [("lander", r"\| success: on the pad.*?\| (.*) \|"), ("highway", r"\| `highway`:.*?\| (.*) \|"),
                          ("steakhouse", r"\| `steakhouse`:.*?\| (.*) \|")]:
        row = re.search(cells, readme).group(1).split(" | ")
        done = run(f"leadtime smoke --domain {domain} --json", scratch)
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
        # A level deeper, because a command may make a neighbour of the current directory.
        scratch = Path(directory) / "here"
        (scratch / "bin").mkdir(parents=True)
        completions = Path(directory) / ".local/share/bash-completion/completions"
        completions.mkdir(parents=True)
        os.environ["HOME"] = directory
        (scratch / "bin/leadtime").symlink_to(PROGRAM)
        os.environ["PATH"] = f"{scratch}/bin:{os.environ['PATH']}"
        prepare(scratch)
        for page in [*PAGES, *RECORDS]:
            write_examples(page, scratch)
            for line in commands(page):
                place = f"{page.relative_to(ROOT)}: {line}"
                reason = next((why for what, why in SKIPPED.items() if what in line), None)
                if reason or re.match(r"leadtime (actor|learner)\b", line):
                    skipped.append(f"{place} ({reason or 'run as a pair'})")
                    continue
                is_mention = re.fullmatch(r"leadtime \w+", line) and not re.search(r"smoke|runs|config|compare|check", line)
                is_run = page not in RECORDS and not is_mention
                done = run(shortened(line) if is_run else f"{line} --help", scratch)
                n_run, n_options = n_run + is_run, n_options + (not is_run)
                told = done.stdout + done.stderr
                wanted = next((text for start, text in EXPECTED.items() if line.startswith(start)), "")
                if done.returncode != 0:
                    failures.append(f"{place}\n    exit {done.returncode}: {told.strip()[-300:]}")
                elif is_run and wanted not in told and ">" not in line:
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

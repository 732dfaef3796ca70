"""Runs the commands of README and docs and compares what they print with what the text says; see check.sh.

A block of commands that is not to be run has `<!-- not run: WHY -->` above it. A block with lines that begin with `$ ` shows what
its commands print, and is compared with it; a line `...` stands for any lines.
"""

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
WRITE = "--write" in sys.argv
PROGRAM = Path(sys.argv[-1])
CORRIDOR = PROGRAM.parent / "examples/corridor"
# The commands of these pages are run.
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs/worlds").glob("*.md")),
         ROOT / "deploy/policies/README.md"]
# Those of these pages are long trainings on record, or mentions: only their options are checked.
RECORDS = [ROOT / "ARCHITECTURE.md", ROOT / "bench/README.md", *sorted((ROOT / "docs/results").glob("*.md")),
           *sorted((ROOT / "docs/decisions").glob("*.md"))]
# What needs something that is not there, and why it is not run.
SKIPPED = {"http://": "a language model's server", "<": "a form", "TASK": "a form", "tls/": "certificates", "$": "variables of a script",
           "HOST": "another machine", "examples/live/client": "needs a notifier; .ci/run lets both meet", "-m leadtime": "the Python package",
           "-c python": "the Python package and Gymnasium"}
if not find_spec("numpy"):
    SKIPPED["python3"] = "no numpy here"
if not CORRIDOR.exists():
    SKIPPED["corridor"] = "the example is not built"
# What a command must print where the page does not show it.
EXPECTED = {"leadtime runs compare one four": "weights: equal", "leadtime serve ": "One observation of", "leadtime check ": "configuration",
            "leadtime describe ": "bservation", "python3 examples/decide.py": "decisions reproduced",
            "leadtime conformance ": "passed", "leadtime eval --truth": "in turn, if true", "leadtime eval ": "success", "leadtime probe ": "d_r",
            "leadtime replay ": "replayed", "leadtime play examples/": ": session ",
            "leadtime smoke": "mechanics work", "leadtime report ": "Report:", "leadtime compare ": "trainings", "leadtime race": "whole trainings"}
SECONDS = 300
# A whole training, on a machine that has other work.
TRAINING_SECONDS = 3_600


def normal(line):
    """Writes a line as a command of the programs at hand; None if it is none."""
    line = re.sub(r"\s+#\s.*", "", line).strip()
    line = re.sub(r"^cargo run --release --example corridor -- ?", "corridor ", line)
    line = re.sub(r"^cargo run --release -- ?", "leadtime ", line)
    # Only the example knows its world.
    line = re.sub(r"^leadtime (?=.*\bcorridor\b)", "corridor ", line)
    # What stands in brackets may be left out.
    line = re.sub(r" \[-[^\]]*\]", "", line)
    return line if re.match(r"(leadtime|corridor|python3|cp|printf|mkdir) \S|\{ ", line) else None


def commands(page):
    """Lists the commands of a page with what they are shown to print, if they are, and why they are not to be run, if so."""
    text = re.sub(r"<!-- begin .*?<!-- end -->", "", page.read_text(), flags=re.S)
    found, kept = {}, {}
    for why, block in re.findall(r"(?:<!-- not run: ([^>]*) -->\s*)?```(?:console|bash)\n(.*?)```", text, flags=re.S):
        block = block.replace("\\\n", " ")
        if why:
            kept.update((normal(line), why) for line in block.splitlines())
        elif "$ " in block:
            for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
                line, _, output = part.partition("\n")
                found[normal(line)] = output.strip("\n")
        else:
            for line in block.splitlines():
                found.setdefault(normal(line), None)
    for code in re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.S)):
        found.setdefault(normal(code) if code.startswith(("leadtime", "cargo", "python3")) else None, None)
    pairs = {line: (output, None) for line, output in found.items()} | {line: (None, why) for line, why in kept.items() if line not in found}
    pairs.pop(None, None)
    return pairs


def shortened(line):
    """Returns a command that can be run here, and soon."""
    # Nothing can be changed in a run that is finished.
    line = re.sub(r"\bNAME\b", "begun", line) if "--change" in line else line
    for name, value in [(r"\bRUN\.\.\.", "made"), (r"\bRUN\b", "made"), (r"-c NAME\b", "-c lander"), (r"-c FILE\b", "-c my.toml"), (r"\bNAME\b", "made"),
                        (r"\bA B\b", "made again"), (r"\bDOMAIN\b", "lander"), (r"\bPOLICY\b", "made"), (r"\b7447\b", str(free_port())), (r"\b8080\b", str(free_port())),
                        (r"^python3", sys.executable)]:
        line = re.sub(name, value, line)
    more = ""
    if re.match(r"\w+ (up|train)\b", line) and "cartpole" not in line:
        more = " --stop-after 1"
        line = re.sub(r" --stop-after \S+", "", line)
    elif re.match(r"\w+ smoke", line) and "--quick" not in line:
        more = " --quick"
    elif re.match(r"leadtime (compare \S|race\b)", line) and "--plan" not in line:
        more = " --plan"
    elif line.startswith("leadtime watch") and "--once" not in line:
        # The page is there until it is ended.
        line, more = re.sub(r" --(http|token|play) \S+", "", line), " --once"
    elif line.startswith("leadtime script-search"):
        more = "" if "--episodes" in line else " --episodes 50"
        more += "" if "--steps" in line else " --steps 20000"
    elif line.startswith("leadtime probe"):
        line = line.replace(" made", " varied")
    line = re.sub(r"--episodes (\d+)", lambda number: f"--episodes {min(int(number[1]), 50)}", line)
    return line + more


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def run(line, scratch, seconds=SECONDS):
    return subprocess.run(["bash", "-c", line], cwd=scratch, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                          timeout=seconds)


def shows(expected, printed):
    """Tells whether a page's output is what was printed."""
    parts = [re.escape(part.strip("\n")) for part in re.split(r"^\.\.\.$", expected, flags=re.M)]
    return re.fullmatch(r"[\s\S]*".join(parts), printed.strip("\n")) is not None


def prepare(scratch):
    """Makes what the pages' commands speak of: two equal runs, one with varied listeners, one that is not finished, files of one's own."""
    for name in ("deploy", "tests", "examples", "crates", "bench"):
        (scratch / name).symlink_to(ROOT / name)
    # Some commands write pictures there.
    shutil.copytree(ROOT / "docs", scratch / "docs")
    delay = """--set 'human.reaction_delay={uniform={low=0,high=5,drawn="per_episode"}}'"""
    for name, more in [("made", ""), ("again", ""), ("varied", delay), ("begun", "--stop-after 1")]:
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


def keep_smoke(domain, scratch):
    """Trains a world as README does, and keeps what the evaluation found; returns what went wrong, if anything."""
    command = f"leadtime smoke --domain {domain} --json"
    done = run(command, scratch, TRAINING_SECONDS)
    if done.returncode != 0:
        return [f"{command}\n    exit {done.returncode}: {(done.stdout + done.stderr).strip()[-300:]}"]
    comparison = json.loads(done.stdout)["comparison"]
    kept = {"command": command, "program": run("leadtime version", scratch).stdout.splitlines(), "comparison": comparison}
    (ROOT / f"docs/results/smoke_{domain}.json").write_text(json.dumps(kept) + "\n")
    return []


def check(line, output, is_run, scratch):
    """Runs a command; returns what is wrong, or nothing."""
    done = run(shortened(line) if is_run else f"{line} --help", scratch)
    told = done.stdout + done.stderr
    wanted = next((text for start, text in EXPECTED.items() if line.startswith(start)), "")
    if done.returncode != 0:
        return f"exit {done.returncode}: {told.strip()[-300:]}"
    if is_run and output is not None and not shows(output, done.stdout):
        return f"prints\n{done.stdout}"
    if is_run and output is None and wanted not in told and ">" not in line and "--json" not in line:
        return f"does not print `{wanted}`"
    return None


def check_pages(scratch):
    """Checks every command of every page; returns what is wrong, how many were run, of how many the options were read, and what was
    not run."""
    failures, n_run, n_options, skipped = [], 0, 0, []
    prepare(scratch)
    for page in [*PAGES, *RECORDS]:
        write_examples(page, scratch)
        for line, (output, reason) in commands(page).items():
            place = f"{page.relative_to(ROOT)}: {line}"
            reason = reason or next((why for what, why in SKIPPED.items() if what in line), None)
            if re.match(r"leadtime (actor|learner)\b", line):
                reason = reason or "run as a pair"
            if re.match(r"leadtime (serve|drive|record|replay .*--connect)\b", line) and "--describe" not in line:
                reason = reason or "run as a pair by the tests"
            if reason:
                skipped.append(f"{place} ({reason})")
                if not line.startswith("leadtime") or re.search(r"[<$|]", line):
                    continue
            if page in RECORDS and not line.startswith("leadtime"):
                continue
            is_mention = re.fullmatch(r"leadtime \w+", line) and not re.search(r"smoke|runs|config|compare|check", line)
            is_run = page not in RECORDS and not is_mention and not reason
            n_run, n_options = n_run + is_run, n_options + (not is_run)
            wrong = check(line, output, is_run, scratch)
            failures += [f"{place}\n    {wrong}"] if wrong else []
    good, told = pair(scratch)
    if not good:
        failures.append(f"learner and actor in two terminals:\n    {told.strip()[-300:]}")
    return failures, n_run, n_options, skipped


def main():
    failures, n_run, n_options, skipped = [], 0, 0, []
    os.environ.pop("RUST_LOG", None)
    with tempfile.TemporaryDirectory(prefix="leadtime-docs-") as directory:
        # A level deeper, because a command may make a neighbour of the current directory.
        scratch = Path(directory) / "here"
        (scratch / "bin").mkdir(parents=True)
        for program in (PROGRAM, CORRIDOR):
            (scratch / "bin" / program.name).symlink_to(program)
        os.environ["PATH"] = f"{scratch}/bin:{os.environ['PATH']}"
        os.environ["HOME"] = directory
        if WRITE:
            failures = [wrong for domain in ("lander", "highway", "steakhouse") for wrong in keep_smoke(domain, scratch)]
        else:
            failures, n_run, n_options, skipped = check_pages(scratch)
    print(f"{n_run} commands run, the options of {n_options} checked, {len(skipped)} not run:")
    print("".join(f"  {line}\n" for line in skipped), end="")
    for failure in failures:
        print(f"FAILED {failure}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()

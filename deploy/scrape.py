"""Lets Debian's prometheus scrape a run at work, and asks it for the run's updates. See check.sh.

    python3 deploy/scrape.py PROGRAM PROMETHEUS
"""

import contextlib
import json
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

# For the run to be there, and then for its numbers to be: both in seconds.
RUN_PATIENCE = 60
SCRAPE_PATIENCE = 60
RUN = "-c cartpole --seed 3 --name scraped --set learner.n_steps=64 --set learner.total_steps=1000000000 --status 127.0.0.1:0"
CONFIG = """\
global: {scrape_interval: 1s, scrape_timeout: 1s}
scrape_configs:
- job_name: leadtime
  static_configs: [{targets: ["%s"]}]
"""


def main(program, prometheus):
    with tempfile.TemporaryDirectory(prefix="lt-") as folder, contextlib.ExitStack() as started:
        folder = Path(folder)
        address = f"unixsock-stream/{folder}/l.sock"
        learner = start(started, folder, "learner", program, "learner", *RUN.split(), "--listen", address)
        found = until(RUN_PATIENCE, learner, lambda: re.search(r"status at http://([^/]+)/metrics", said(folder, "learner")))
        if not found:
            return f"the learner has no status page:\n{said(folder, 'learner')}"
        start(started, folder, "actor", program, "actor", "--connect", address)
        (folder / "prometheus.yml").write_text(CONFIG % found[1])
        at = f"127.0.0.1:{free_port()}"
        server = start(started, folder, "prometheus", prometheus, f"--config.file={folder}/prometheus.yml",
                       f"--storage.tsdb.path={folder}/data", f"--web.listen-address={at}")
        begun = time.monotonic()
        n_updates = until(SCRAPE_PATIENCE, server, lambda: asked(at, 'leadtime_updates_total{run="scraped"}'))
        if not n_updates:
            return f"no updates in prometheus after {SCRAPE_PATIENCE} s:\n{said(folder, 'prometheus')}"
        print(f"scraped by prometheus: {n_updates:.0f} updates after {time.monotonic() - begun:.1f} s")
        return None


def start(started, folder, name, *command):
    """Starts a process that ends with this one; what it says is in a file."""
    with open(folder / f"{name}.log", "w") as log:
        process = subprocess.Popen(command, cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    started.callback(end, process)
    return process


def end(process):
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def said(folder, name):
    return (folder / f"{name}.log").read_text(errors="replace")


def until(patience, process, look):
    """Looks until there is something, or the process has ended, or it takes too long."""
    deadline = time.monotonic() + patience
    while not (found := look()) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.1)
    return found


def asked(at, query):
    """Returns a number, or None while it is not there."""
    url = f"http://{at}/api/v1/query?" + urllib.parse.urlencode({"query": query})
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:
            found = json.load(answer)["data"]["result"]
    except (urllib.error.URLError, OSError, ValueError, KeyError):
        return None
    return float(found[0]["value"][1]) if found else None


def free_port():
    """The server cannot be asked which port it took, so it is given one."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

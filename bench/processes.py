"""What the measurements here need of processes: the program, a port, children that are started and ended."""

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(os.environ.get("PROGRAM", Path(__file__).resolve().parent.parent / "target/release/leadtime"))


def need_program():
    """Ends the script if there is no program to measure."""
    if not PROGRAM.exists():
        sys.exit(f"error: there is no {PROGRAM}; build it with `cargo build --release`, or set PROGRAM")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def spawn(place, name, *words, stdout=None):
    """Starts a process in a directory, with a log there; its standard output goes there, too, unless it is wanted elsewhere."""
    with (place / f"{name}.log").open("ab") as log:
        return subprocess.Popen([str(word) for word in words], cwd=place, stdin=subprocess.DEVNULL, stdout=stdout or log, stderr=log)


def end_all(processes, patience=5):
    """Asks processes to end, and kills those that take more than some seconds; with 0 all of them at once."""
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM if patience else signal.SIGKILL)
    for process in processes:
        try:
            process.wait(patience or None)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

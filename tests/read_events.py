"""Reads a run's event files with TensorBoard's own reader and compares them with metrics.jsonl.

    pip install tensorboard && python3 tests/read_events.py runs/NAME
"""

import json
import pathlib
import sys

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


def main(run: pathlib.Path) -> int:
    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    tags = events.Tags()["scalars"]
    n_compared = 0
    for tag in tags:
        expected = [(line["steps"], line[tag]) for line in lines if tag in line]
        found = [(event.step, event.value) for event in events.Scalars(tag)]
        assert [step for step, _ in found] == [step for step, _ in expected], tag
        for (_, value), (_, wanted) in zip(found, expected):
            assert abs(value - wanted) <= 1e-6 * max(1.0, abs(wanted)), (tag, value, wanted)
            n_compared += 1
    print(f"{len(tags)} tags, {n_compared} values agree")
    return 0 if tags else 1


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1])))

"""Reads a run's event files with TensorBoard's own reader and compares them with metrics.jsonl, held_out.jsonl and eval.json.

    pip install tensorboard && python3 tests/read_events.py runs/NAME
"""

import json
import pathlib
import sys

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2


def main(run: pathlib.Path) -> int:
    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    lines = [json.loads(line) for journal in ("metrics.jsonl", "held_out.jsonl") for line in (run / journal).read_text().splitlines()]
    everything = events.Tags()["scalars"]
    tags = [tag for tag in everything if not tag.startswith("eval/")]
    n_compared = 0
    for tag in tags:
        expected = [(line["steps"], line[tag]) for line in lines if tag in line]
        found = [(event.step, event.value) for event in events.Scalars(tag)]
        assert [step for step, _ in found] == [step for step, _ in expected], tag
        for (_, value), (_, wanted) in zip(found, expected):
            assert abs(value - wanted) <= 1e-6 * max(1.0, abs(wanted)), (tag, value, wanted)
            n_compared += 1
    measures = {}
    if (run / "eval.json").exists():
        summary = json.loads((run / "eval.json").read_text())["comparison"]["summaries"][0]
        measures = {f"eval/{m['name']}": m["interval"]["estimate"] for m in summary["measures"] if m["interval"]}
    assert sorted(measures) == sorted(set(everything) - set(tags))
    for tag, wanted in measures.items():
        [event] = events.Scalars(tag)
        assert abs(event.value - wanted) <= 1e-6 * max(1.0, abs(wanted)), (tag, event.value, wanted)
    content = events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    session = plugin_data_pb2.HParamsPluginData.FromString(content).session_start_info
    assert f"domain = \"{session.hparams['domain'].string_value}\"" in (run / "config.toml").read_text()
    print(f"{len(session.hparams)} settings, {len(measures)} measures, {len(tags)} tags, {n_compared} values agree")
    return 0 if tags else 1


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1])))

#!/usr/bin/env bash
# Lets the Python client be spoken to for 100 steps, and reads a recording of it. Usage: examples/live/check.sh PROGRAM PYTHON
set -euo pipefail
program=$(realpath "$1") python=$(realpath -s "$2")
cd "$(dirname "$0")/../.."
. examples/live/await.sh
place=$(mktemp -d)
# 100 steps of 20 ms hold several sentences only where a word takes a step.
"$program" serve deploy/policies/piloting.safetensors --listen tcp/127.0.0.1:0 --voice text 2>"$place/log" &
notifier=$! recorder=
trap 'kill $notifier $recorder 2>/dev/null; wait || true; rm -rf "$place"' EXIT
await "is at work at" "$place/log"
endpoint=$(sed -n 's/.* is at work at \(tcp[^ ]*\).*/\1/p' "$place/log")
"$program" record --connect "$endpoint" -o "$place/client.mcap" 2>"$place/recorded" &
recorder=$!
await "recording notifier" "$place/recorded"
"$python" examples/live/client.py "$endpoint" 0.02 | tee "$place/said"
grep -q "^session [0-9a-f]*: 8 numbers, topics ascend, " "$place/said"
n=$(grep -c "understood after" "$place/said")
[ "$n" -ge 3 ] || { echo "$n sentences in 100 steps"; exit 1; }
if grep -E "stale|lost|closed" "$place/said"; then exit 1; fi

# Two flushes later the recorder is killed: everything that the client was told can be read, and is said again.
sleep 2.5
kill -9 $recorder
wait $recorder || true
"$program" replay "$place/client.mcap" | tee "$place/replayed"
grep -q "the same is said, event by event" "$place/replayed"
if "$python" -c 'import mcap' 2>/dev/null; then
    "$python" examples/live/recording.py "$place/client.mcap" | tee "$place/read"
    heard=$(sed -n 's/^ *[0-9]*  \(.*\)  (.*understood after.*/\1/p' "$place/said")
    told=$(sed -n 's/^[0-9.]*  \(.*\)  (.* words)$/\1/p' "$place/read")
    [ "$heard" = "$told" ] || { echo "the recording holds something else than was heard"; exit 1; }
    # As they are recorded: a raw event, one without words, and what is no event.
    "$python" - "$place/raw.mcap" <<'END'
import json
import sys
from mcap.writer import Writer
with open(sys.argv[1], "wb") as file:
    writer = Writer(file)
    writer.start()
    schema = writer.register_schema("leadtime.live.Say", "jsonschema", b"{}")
    channel = writer.register_channel("say", "json", schema)
    for i, said in enumerate([
            {"event": "start", "topic_id": 2, "k": 1, "l": 3}, {"event": "start", "topic": "ascend", "k": 2, "l": 4}, {"x_raw": "6a756e6b"}]):
        writer.add_message(channel, log_time=i, publish_time=i, data=json.dumps(said).encode())
    writer.finish()
END
    "$python" examples/live/recording.py "$place/raw.mcap" | tee "$place/read"
    grep -qx "0.00  2  (2, 1 of 3 words)" "$place/read"
    grep -qx "0.00  ascend  (ascend, 2 of 4 words)" "$place/read"
    grep -qx " *3 say" "$place/read"
else
    echo "skipped: no package mcap for this Python"
fi

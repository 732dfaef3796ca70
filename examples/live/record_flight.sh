#!/usr/bin/env bash
# Records flight.mcap anew: three episodes of a simulated lander to which a shipped policy speaks. Draws docs/flight.png of it.
# A recording says the same again with its own policy alone, so it is made anew whenever that policy is replaced.
# Usage: examples/live/record_flight.sh PROGRAM
set -euo pipefail
program=$(realpath "$1")
# The recording names its policy as the notifier was given it: from here.
cd "$(dirname "$0")/../.."
. examples/live/await.sh
policy=deploy/policies/piloting_hard.safetensors
place=$(mktemp -d)
endpoint=unixsock-stream/$place/n.sock
"$program" serve "$policy" --listen "$endpoint" 2>"$place/log" &
notifier=$! recorder=
trap 'kill $notifier $recorder 2>/dev/null; wait || true; rm -rf "$place"' EXIT
await "is at work at" "$place/log"
"$program" record --connect "$endpoint" --live flight -o "$place/flight.mcap" 2>"$place/recorded" &
recorder=$!
await "recording notifier" "$place/recorded"
# By the clock: half a minute.
"$program" drive "$policy" --connect "$endpoint" --client flight --eval-seed 7 --episodes 3
sleep 1
kill -INT $recorder
wait $recorder
recorder=
"$program" replay "$place/flight.mcap" | tee "$place/replayed"
grep -q "the same is said, event by event" "$place/replayed"
# On a busy machine something may be lost on the way to the recorder.
if grep -E "lacks|missing|cannot be compared" "$place/replayed"; then exit 1; fi
mv "$place/flight.mcap" examples/live/flight.mcap
"$program" play examples/live/flight.mcap --frames 0..24 -o docs/flight.png

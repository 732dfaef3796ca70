"""What was said in a recording, read with nothing of Leadtime: also in one whose recorder was killed.

    pip install mcap==1.6.0
    leadtime record --connect tcp/127.0.0.1:7448 -o drive.mcap
    python3 examples/live/recording.py drive.mcap
"""
import json
import sys

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

counts = {}
with open(sys.argv[1], "rb") as file:
    # From the front, in the order of the file: one whose recorder was killed has no index at its end.
    messages = NonSeekingReader(file).iter_messages(log_time_order=False)
    try:
        for schema, channel, message in messages:
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            said = json.loads(message.data)
            if schema.name == "leadtime.live.Say" and said.get("event") == "start":
                # A raw event has only the number of its topic, and without words there is no text.
                topic = said.get("topic", said.get("topic_id"))
                told = f"({topic}, {said.get('k')} of {said.get('l')} words)"
                print(f"{message.log_time / 1e9:.2f}  {said.get('text') or topic}  {told}")
    except McapError as error:
        print(f"it ends here: {type(error).__name__}")
for topic, n in sorted(counts.items()):
    print(f"{n:6} {topic}")

"""Writes ros2.json: messages of ROS 2 in CDR as `rosbags` writes them, and its hashes of their types.

    pip install rosbags==0.11.9
    python3 crates/serve/tests/data/ros2.py            # writes the file beside this script
    python3 crates/serve/tests/data/ros2.py --check    # fails if rosbags would write another one
"""
import json
import random
import sys
from pathlib import Path

import numpy
from rosbags.typesys import Stores, get_typestore

FILE = Path(__file__).with_name("ros2.json")
ARRAY, LAYOUT, DIMENSION, STRING = (
    f"std_msgs/msg/{name}" for name in ("Float32MultiArray", "MultiArrayLayout", "MultiArrayDimension", "String"))


def main():
    store, draws = get_typestore(Stores.ROS2_JAZZY), random.Random(2026)
    letters = "abc xyz,.!?\"\\/{}[]:0123456789äöüé漢字🚗\n\t"

    def text(longest):
        return "".join(draws.choice(letters) for _ in range(draws.randint(0, longest)))

    def array():
        dimensions = [store.types[DIMENSION](label=text(9), size=draws.getrandbits(32), stride=draws.getrandbits(32))
                      for _ in range(draws.choice([0, 0, 1, 2, 3]))]
        # Any four bytes: NaN and infinity are somebody else's affair.
        numbers = draws.randbytes(4 * draws.randint(0, 40))
        message = store.types[ARRAY](layout=store.types[LAYOUT](dim=dimensions, data_offset=0),
                                     data=numpy.frombuffer(numbers, "<f4"))
        return {"numbers": numbers.hex(), "cdr": bytes(store.serialize_cdr(message, ARRAY)).hex()}

    def string():
        said = text(200)
        return {"text": said, "cdr": bytes(store.serialize_cdr(store.types[STRING](data=said), STRING)).hex()}

    golden = {"arrays": [array() for _ in range(50)], "texts": [string() for _ in range(50)],
              "hashes": {name: store.hash_rihs01(name) for name in (ARRAY, STRING)}}
    written = json.dumps(golden, indent=1) + "\n"
    if "--check" in sys.argv:
        assert FILE.read_text() == written, f"rosbags would write another {FILE}"
        print(f"{FILE.name}: rosbags writes the same {len(golden['arrays']) + len(golden['texts'])} messages")
    else:
        FILE.write_text(written)


main()

"""A stand-in for a robot with ROS 2 and ``rmw_zenoh``, and a real notifier: LEADTIME names the program.

Nothing of Leadtime is used on the robot's side: messages are those of ``rosbags``, keys and tokens are written as
``rmw_zenoh`` writes them, and as in ``rmw_zenoh`` a message without its attachment is an error.
"""
import json
import os
import queue
import struct
import subprocess
import time
import unittest
from pathlib import Path

import numpy
import zenoh
from rosbags.typesys import Stores, get_typestore

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("LEADTIME", "leadtime")
STORE = get_typestore(Stores.ROS2_JAZZY)
ARRAY, LAYOUT, STRING = (f"std_msgs/msg/{name}" for name in ("Float32MultiArray", "MultiArrayLayout", "String"))
DOMAIN, GID, PATIENCE = 42, bytes(range(16)), 30.0


def key(topic, message, distro):
    package, kind, name = message.split("/")
    hash_of_type = STORE.hash_rihs01(message) if distro == "jazzy" else "TypeHashNotSupported"
    return f"{DOMAIN}/{topic}/{package}::{kind}::dds_::{name}_/{hash_of_type}"


def attachment(sample):
    """Reads what is beside a message, as rmw_zenoh does: without it the message is thrown away."""
    if sample.attachment is None:
        raise ValueError("Unable to obtain attachment")
    number, sent, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    if length != 16 or number < 1:
        raise ValueError(f"an attachment with number {number} and a gid of {length} bytes")
    return number, sent, gid


class Robot:
    """A node that observes and hears."""

    def __init__(self, distro):
        self.program = subprocess.Popen(
            [PROGRAM, "serve", ROOT / "deploy/policies/piloting.safetensors", "--listen", "tcp/127.0.0.1:0", "--ros2",
             str(DOMAIN), "--ros2-distro", distro, "--ros2-topic", "car_1/leadtime", "--seconds-per-step", "0.05"],
            stderr=subprocess.PIPE, text=True)
        line = next(line for line in self.program.stderr if "is at work at" in line)
        endpoint = line.split("is at work at ")[1].split()[0]
        self.session = zenoh.open(zenoh.Config.from_json5(
            f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'))
        self.heard, self.number = queue.Queue(), 0
        for topic in ("say", "status"):
            self.session.declare_subscriber(key(f"car_1/leadtime/{topic}", STRING, distro),
                                            lambda sample, topic=topic: self.heard.put((topic, sample)))
        self.sights = self.session.declare_publisher(key("car_1/leadtime/obs", ARRAY, distro))

    def observe(self, values, beside=True):
        self.number += 1
        message = STORE.types[ARRAY](layout=STORE.types[LAYOUT](dim=[], data_offset=0), data=numpy.array(values, numpy.float32))
        mark = struct.pack("<qqB16s", self.number, time.time_ns(), 16, GID)
        self.sights.put(bytes(STORE.serialize_cdr(message, ARRAY)), attachment=mark if beside else None)

    def close(self):
        self.session.close()
        self.program.terminate()
        self.program.wait(10)
        self.program.stderr.close()


class Ros2(unittest.TestCase):
    def is_spoken_to(self, distro):
        robot = Robot(distro)
        self.addCleanup(robot.close)
        started, marks, statuses, deadline, step = [], {"say": [], "status": []}, [], time.monotonic() + PATIENCE, 0
        while len(started) < 4:
            self.assertLess(time.monotonic(), deadline, f"{started} of {statuses[-1:]}")
            robot.observe([0.0, max(0.0, 1.4 - step / 200), 0.0, -0.3, 0.0, 0.0, 0.0, 0.0])
            step += 1
            time.sleep(0.02)
            while not robot.heard.empty():
                topic, sample = robot.heard.get()
                marks[topic].append(attachment(sample))
                text = STORE.deserialize_cdr(sample.payload.to_bytes(), STRING).data
                event = json.loads(text)
                if topic == "status":
                    statuses.append(event)
                elif event["event"] == "start":
                    started.append(event["text"])
        for topic, given in marks.items():
            numbers, times, gids = zip(*given)
            self.assertEqual(list(numbers), list(range(numbers[0], numbers[0] + len(numbers))), topic)
            self.assertEqual(len(set(gids)), 1, topic)
            self.assertLess(abs(times[-1] - time.time_ns()), 60e9, topic)
        self.assertNotEqual(marks["say"][0][2], marks["status"][0][2])
        self.assertEqual(statuses[-1]["refused"], 0, statuses[-1])
        return robot

    def test_a_node_is_spoken_to_and_sees_the_notifier_in_its_graph(self):
        robot = self.is_spoken_to("jazzy")
        tokens = [str(reply.ok.key_expr).split("/") for reply in robot.session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")]
        self.assertEqual(sorted(token[5] for token in tokens), ["MP", "MP", "MS", "NN"])
        for token in tokens:
            self.assertEqual((token[0], token[6:9]), ("@ros2_lv", ["%", "%", "leadtime_notifier"]))
            if token[5] != "NN":
                topic, message, hash_of_type, qos = token[9:]
                name = topic.replace("%", "/")
                self.assertIn(name, ["/car_1/leadtime/obs", "/car_1/leadtime/say", "/car_1/leadtime/status"])
                type_of = ARRAY if name.endswith("obs") else STRING
                self.assertEqual("/".join([str(DOMAIN), name[1:], message, hash_of_type]), key(name[1:], type_of, "jazzy"))
                self.assertEqual(len(qos.split(":")), 6)

    def test_humble_has_other_keys(self):
        self.is_spoken_to("humble")


unittest.main()

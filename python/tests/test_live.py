"""``leadtime.live`` and a real notifier: LEADTIME names the program."""
import os
import re
import subprocess
import unittest
from pathlib import Path

from leadtime.live import Lost, Notifier, Refused

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("LEADTIME", "leadtime")
FALLING = [[0.0, 1.4 - step / 40, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0] for step in range(40)]


class Live(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.service = subprocess.Popen(
            [PROGRAM, "serve", ROOT / "deploy/policies/piloting.safetensors", "--listen", "tcp/127.0.0.1:0"],
            stderr=subprocess.PIPE, text=True)
        line = next(line for line in cls.service.stderr if "is at work at" in line)
        cls.endpoint = re.search(r"tcp/\S+", line.split("at work at")[1])[0]

    @classmethod
    def tearDownClass(cls):
        cls.service.terminate()
        cls.service.wait(10)
        cls.service.stderr.close()

    def hear(self, client, facts):
        with Notifier(self.endpoint, client, "lander", seed=7) as notifier:
            names = [fact["name"] for fact in notifier.answer["facts"]]
            self.assertIn("zone_below", names)
            events = [event for sight in FALLING for event in notifier.step(sight, facts=names if facts else None)]
        return [event["text"] for event in events if event["event"] == "start"]

    def test_the_same_observations_are_told_the_same_and_facts_decide_about_words_alone(self):
        silent, again, telling = (self.hear(name, facts) for name, facts in [("a", False), ("b", False), ("c", True)])
        self.assertGreater(len(silent), 2)
        self.assertEqual(silent, again)
        self.assertEqual(len(silent), len(telling))

    def test_who_is_refused_is_told_why(self):
        with self.assertRaisesRegex(Refused, "lander"):
            Notifier(self.endpoint, "d", "highway")
        with Notifier(self.endpoint, "e", "lander"):
            with self.assertRaisesRegex(Refused, "e"):
                Notifier(self.endpoint, "e", "lander")

    def test_what_cannot_be_used_is_no_step(self):
        with Notifier(self.endpoint, "f", "lander") as notifier:
            with self.assertRaisesRegex(Lost, "7 numbers; 8 are expected"):
                notifier.step([0.0] * 7, timeout=1.0)
            self.assertTrue(notifier.is_here)

    def test_where_nobody_is_nobody_is_found(self):
        with self.assertRaises(Lost):
            Notifier("tcp/127.0.0.1:1", "g", "lander", patience=0.5)


unittest.main()

"""``leadtime.live`` and a real notifier: LEADTIME names the program."""
import json
import os
import queue
import random
import re
import struct
import subprocess
import unittest
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import zenoh
from leadtime.live import Lost, Notifier, Refused
from leadtime.notifier import LocalNotifier

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("LEADTIME", "leadtime")
FALLING = [[0.0, 1.4 - step / 40, 0.0, -0.3, 0.0, 0.0, 0.0, 0.0] for step in range(40)]


def crc32c(data):
    """CRC-32C as its definition has it, bit by bit."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


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

    def test_a_notifier_in_this_process_says_the_same(self):
        policy = ROOT / "deploy/policies/cooking.safetensors"
        words = json.loads(subprocess.run([PROGRAM, "taxonomy", "export", "steakhouse", "--format", "json"], capture_output=True, check=True).stdout)
        service = subprocess.Popen([PROGRAM, "serve", policy, "--listen", "tcp/127.0.0.1:0", "--action", "greedy"], stderr=subprocess.PIPE, text=True)
        self.addCleanup(service.stderr.close)
        self.addCleanup(service.wait, 10)
        self.addCleanup(service.terminate)
        line = next(line for line in service.stderr if "is at work at" in line)
        own, draws, n_started = LocalNotifier(policy, words, greedy=True), np.random.default_rng(1), 0
        # Which of several sentences comes first is drawn, and a generator of numpy's draws otherwise.
        drawn = ("text", "words", "seq", "age", "at", "end")
        with Notifier(re.search(r"tcp/\S+", line.split("at work at")[1])[0], "k", "steakhouse") as served:
            for step in range(200):
                sight = draws.random(own.obs_dim).round(2)
                # Four episodes, of which the first ones end and the last is begun without an end.
                told = {"episode": step // 50, "end": step in (40, 99), "facts": [fact["name"] for fact in served.answer["facts"]][: step % 3]}
                ours, theirs = own.step(sight, **told), served.step(sight, **told)
                n_started += sum(event["event"] == "start" for event in ours)
                ours, theirs = ([{key: value for key, value in event.items() if key not in drawn} for event in events] for events in (ours, theirs))
                self.assertEqual(ours, theirs, step)
        self.assertGreater(n_started, 10)

    def test_who_is_refused_is_told_why(self):
        with self.assertRaisesRegex(Refused, "lander"):
            Notifier(self.endpoint, "d", "highway")
        with Notifier(self.endpoint, "e", "lander"):
            with self.assertRaisesRegex(Refused, "e"):
                Notifier(self.endpoint, "e", "lander")

    def test_what_cannot_be_used_is_no_step(self):
        with Notifier(self.endpoint, "f", "lander") as notifier:
            # It is told as soon as the notifier says so, long before an answer would be given up.
            with self.assertRaisesRegex(Refused, "7 numbers; 8 are expected"):
                notifier.step([0.0] * 7, timeout=600.0)
            self.assertTrue(notifier.is_here)
            with self.assertRaisesRegex(Refused, "send finite numbers"):
                notifier.step([float("nan")] * 8, timeout=600.0)
            self.assertEqual(notifier.step([0.0] * 8)[-1]["seq"], 3)

    def test_the_raw_wire_is_what_struct_reads_and_writes(self):
        with zenoh.open(zenoh.Config.from_json5(json.dumps(
                {"mode": "client", "connect": {"endpoints": [self.endpoint]}, "scouting": {"multicast": {"enabled": False}}}
        ))) as session:
            key, said = "leadtime/live/1/notifier/raw", queue.Queue()
            session.declare_subscriber(f"{key}/say", lambda sample: said.put(sample.payload.to_bytes()))
            question = {"protocol": 1, "domain": "lander", "clock": "observation", "encoding": "binary", "seed": 7}
            (reply,) = session.get(f"{key}/open", payload=json.dumps(question))
            answer = reply.ok.payload.to_bytes()
            self.assertLess(len(answer), 2_000)  # zenoh-pico has room for so much
            topics = json.loads(answer)["topics"]
            events = []
            for seq, sight in enumerate(FALLING, start=1):
                numbers = struct.pack("<8f", *sight)
                head = struct.pack("<4sHHQQQ", b"LDLV", 1, 0, seq, seq * 300_000_000, 0)
                beside = head + struct.pack("<II", crc32c(head + numbers), 0)
                session.put(f"{key}/obs", numbers, attachment=beside, encoding="application/octet-stream;leadtime.obs/1")
                last = False
                while not last:
                    event = struct.unpack("<IBBBBBBIQH", said.get(timeout=10))
                    utterance, what, topic, k, l, heard, flags, _step, of_seq, word = event
                    last = bool(flags & 1)
                    self.assertEqual(of_seq, seq)
                    if what:
                        self.assertTrue(topic < len(topics) and 0 < k <= l and heard <= l and utterance > 0, event)
                        events.append((what, utterance, heard, word))
        starts = [event for event in events if event[0] == 1]
        self.assertGreater(len(starts), 2)
        self.assertEqual([event[1] for event in starts], list(range(1, len(starts) + 1)))

    def other(self):
        return zenoh.open(zenoh.Config.from_json5(json.dumps(
            {"mode": "client", "connect": {"endpoints": [self.endpoint]}, "scouting": {"multicast": {"enabled": False}}})))

    def test_a_program_that_draws_the_same_at_every_start_is_another_client_each_time(self):
        sessions = []
        for _ in range(2):
            random.seed(1)
            with Notifier(self.endpoint, "j", "lander", seed=7) as notifier:
                self.assertTrue(notifier.step([0.0] * 8, timeout=5.0)[-1]["last"])
                sessions.append(notifier.answer["session"])
        self.assertNotEqual(*sessions)

    def test_a_notifier_that_stands_still_is_lost_and_has_refused_nothing(self):
        asked = []
        with self.other() as session:
            session.declare_queryable("leadtime/live/1/still/*/open", asked.append)
            with self.assertRaisesRegex(Lost, "no notifier `still` answers within 0.5 s"):
                Notifier(self.endpoint, "h", "lander", service="still", patience=0.5)
        self.assertTrue(asked)

    def test_a_session_is_its_notifiers_that_answered_whatever_tokens_come_and_go(self):
        def token(kind, start):
            return SimpleNamespace(kind=kind, key_expr=f"leadtime/live/1/notifier/alive/{start}")

        put, gone = zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE
        with Notifier(self.endpoint, "j", "lander") as notifier:
            notifier.step(FALLING[0])
            own = notifier.answer["start"]
            # One that was killed before: its token goes last.
            for kind in (put, gone, put):
                notifier._on_presence(token(kind, "another"))
                self.assertTrue(notifier.is_here)
                self.assertEqual(notifier.status["session"], notifier.answer["session"])
            # Anybody may show and take away as many as they like.
            for i in range(100):
                for kind in (put, gone):
                    notifier._on_presence(token(kind, f"{i}"))
            self.assertEqual(notifier._gone, frozenset())
            notifier._on_presence(token(gone, own))
            self.assertEqual((notifier.is_here, notifier.status), (False, {}))
            for send in (notifier.observe, notifier.step):
                with self.assertRaisesRegex(Lost, "was started again: open a new session"):
                    send(FALLING[1])
            notifier._on_presence(token(gone, "another"))
            # The real one would answer.
            notifier._sights = SimpleNamespace(put=lambda message: None)
            with self.assertRaisesRegex(Lost, "the notifier is gone"):
                notifier.step(FALLING[1], timeout=5.0)
            # Only the way to it was gone.
            notifier._on_presence(token(put, own))
            self.assertTrue(notifier.is_here)
            # One from before the answer had it.
            del notifier.answer["start"]
            self.assertTrue(notifier.is_here)

    def test_a_closed_session_says_why_and_not_what_was_wrong_before(self):
        with Notifier(self.endpoint, "l", "lander") as notifier:
            with self.assertRaisesRegex(Lost, "open a new session"):
                while True:
                    try:
                        notifier.step([0.0])
                    except Refused:
                        pass
            for send in (notifier.observe, notifier.step):
                with self.assertRaisesRegex(Lost, "open a new session"):
                    send(FALLING[0])
        with self.assertRaises(Lost):
            notifier.observe(FALLING[0])

    def test_names_and_facts_are_checked(self):
        for odd in ("lab/robot", "a*", "robot#1", "", "Robot", "a" * 49, 3):
            with self.assertRaisesRegex(ValueError, "a name has 1 to 48 of a-z, 0-9 and `-`"):
                Notifier(self.endpoint, odd, "lander")
            with self.assertRaisesRegex(ValueError, "service"):
                Notifier(self.endpoint, "m", "lander", service=odd)
        local = LocalNotifier(ROOT / "deploy/policies/piloting.safetensors")
        with Notifier(self.endpoint, "m", "lander") as notifier:
            for own in (notifier, local):
                for odd in ("zone_below", b"zone_below", {"zone_below": False}, [("zone_below", True)]):
                    with self.assertRaisesRegex(ValueError, "a list of names"):
                        own.step(FALLING[0], facts=odd)
                for odd in (-1, 1.5, "1"):
                    with self.assertRaisesRegex(ValueError, "allowed: a whole number from 0 on"):
                        own.step(FALLING[0], episode=odd)
                own.step(FALLING[0], facts={"zone_below"}, episode=np.int64(1))

    def test_where_nobody_is_nobody_is_found(self):
        with self.assertRaises(Lost):
            Notifier("tcp/127.0.0.1:1", "g", "lander", patience=0.5)


unittest.main()

"""Genuine messages of a run, of every kind, changed and sent again: the attack `mutate` of attacks.py.

A member of the run without a list reads what the others say, and asks what they ask. What it sends is one of those messages with
bits flipped, lengths claimed, cut, lengthened, or spliced with another one, in one of three ways:

    as it is      header and proof of the original, as damage on the way leaves them
    mended        with the checksum of what it is now, and the proof of the original
    signed        with the checksum of what it is now, and a proof by a start of the stranger's own that holds

Signed rollouts come from starts that the learner has welcomed and counts as members, under their next number, so that nothing stands
between them and the checks of what is in them. They have no environments, because they answer no orders: whatever they send, it
is of nothing that they were given. Other members answer every order, with a changed answer, and deliver nothing. So nobody
delivers what may train the policy, which no check can tell from an honest actor's work.
"""

import collections
import random
import re
import struct
import threading
import time

import nacl.bindings as sodium
import zenoh
from blake3 import blake3
from crc32c import crc32c

from stranger import Start, header, hello, number, numbers

# What messages hold, as in proto/src/header.rs.
HELLO, HELLO_REPLY, CONTROL, CONTROL_REPLY, ROLLOUT, CREDIT, ANNOUNCEMENT, WEIGHTS, METRICS, ABOUT, HISTORY = range(1, 12)
# Bytes of the proofs that stand behind bodies: signatures for all, tags for one, nothing.
SIGNED, TAGGED = 96, 64
PROOF = {HELLO: SIGNED, ANNOUNCEMENT: SIGNED} | {kind: TAGGED for kind in (HELLO_REPLY, CONTROL, CONTROL_REPLY, ROLLOUT, CREDIT)}
NAMES = dict(enumerate("hello hello_reply order order_reply rollout credit announcement weights metrics about history".split(), 1))
# How often each kind is sent where somebody can be sent it unasked: the rest are answers, as many as there are questions.
WEIGHT = {ROLLOUT: 10, CREDIT: 4, ANNOUNCEMENT: 4, METRICS: 2, HELLO: 2, CONTROL: 2, WEIGHTS: 1, ABOUT: 1, HISTORY: 1}
# The most of each kind that are kept, and the most questions that wait for an answer.
KEPT, WAITING = 64, 64
# Messages of a start of ours: it is cut off at 16, REFUSALS_BEFORE_CUT_OFF of proto/src/limits.rs. Starts at once, and seconds for
# which one is present after its last message, which its leaving would overtake.
LIFE, READY, LEAVING = 18, 32, 3


def mutated(draws, bytes_, other=b""):
    """Returns the bytes changed, in one to four ways."""
    changed = bytearray(bytes_)
    for _ in range(draws.choice((1, 1, 1, 2, 4))):
        at = draws.randrange(len(changed) + 1)
        way = draws.randrange(16)
        if way < 8 and changed:
            for _ in range(draws.randrange(1, 9)):
                changed[draws.randrange(len(changed))] ^= 1 << draws.randrange(8)
        elif way < 10 and changed:
            changed[at % len(changed)] = draws.choice((0, 1, 250, 251, 252, 253, 254, 255))
        elif way < 12:
            # A number where there may be a length, in the codec's own words.
            changed[at : at + 1] = number(1 << draws.randrange(64))
        elif way == 12:
            del changed[at:]
        elif way == 13:
            changed[at:at] = draws.randbytes(draws.randrange(1, 64))
        elif way == 14:
            del changed[at : at + draws.randrange(1, 16)]
        else:
            changed[at:] = other[draws.randrange(len(other) + 1) :]
    return bytes(changed)


class Mole:
    """A start of the stranger's own that the learner has made a member."""

    def __init__(self, name):
        self.name, self.start, self.sent, self.limit, self.token = name, Start(), 0, 1, None


class Mutations:
    """Listens on a network of a run, and sends what it has heard, changed."""

    def __init__(self, network, seed):
        self.network, self.session, self.root = network, network.session, network.root
        self.draws, self.lock = random.Random(seed), threading.Lock()
        self.caught = {kind: collections.deque(maxlen=KEPT) for kind in NAMES}
        self.sent, self.ways = collections.Counter(), collections.Counter()
        self.n, self.moles, self.n_moles, self.ready, self.leaving = 0, {}, 0, collections.deque(), collections.deque()
        self.waiting, self.is_on, self.learner_key = threading.Semaphore(WAITING), False, None
        self.starts, self.shared, self.held = {}, {}, []

    # --- what is heard -------------------------------------------------------------------------------------------

    def listen(self):
        """Keeps the last messages of every kind that pass by, questions too."""
        for key in ("traj/**", "credit/*", "weights/*", "metrics/**"):
            self.held.append(self.session.declare_subscriber(f"{self.root}/{key}", self.hear))
        self.held.append(self.session.declare_subscriber(f"{self.root}/credit/*", self.credited))
        for key in ("ctl/hello", "ctl/actor/*", "weights/*/latest", "about", "history"):
            self.held.append(self.session.declare_queryable(f"{self.root}/{key}", self.asked, allowed_origin=zenoh.Locality.REMOTE))

    def hear(self, message, key=None):
        """Keeps a message, unless it is one of ours."""
        head, payload = message.attachment, message.payload
        if head is None or payload is None or len(bytes(head)) != 48 or self.is_on:
            return
        head, payload = bytes(head), bytes(payload)
        kind = struct.unpack_from("<I", head, 4)[0]
        if kind in self.caught:
            self.caught[kind].append((str(key or message.key_expr), head, payload))
        if kind == ANNOUNCEMENT:
            self.learner_key = payload[-SIGNED : -SIGNED + 32]
        if kind == HELLO:
            self.starts[struct.unpack_from("<Q", head, 16)[0]] = payload[-SIGNED : -SIGNED + 32]

    def credited(self, message):
        """Notes how far a start of ours may send."""
        mole = self.moles.get(str(message.key_expr).split("/")[-1])
        found = numbers(bytes(message.payload)[:-TAGGED]) if mole else []
        if found and found[0] == mole.start.number:
            mole.limit = max(mole.limit, found[3])

    def asked(self, question):
        """Keeps a question of others, or answers it, with a few answers that are none."""
        if not self.is_on:
            # Other questions have nothing in them.
            return self.hear(question) if "/ctl/" in str(question.key_expr) else None
        key = str(question.key_expr)
        kind = HELLO_REPLY if key.endswith("hello") else CONTROL_REPLY if "/ctl/" in key else WEIGHTS if "/weights/" in key else ABOUT if key.endswith("about") else HISTORY
        for _ in range(2):
            with self.lock:
                head, payload, way = self.changed(kind, self.draws.choice(self.caught[kind]))
            try:
                question.reply(key, payload, attachment=head)
            except zenoh.ZError:
                return
            self.count(kind, way)

    def hear_all(self, patience):
        """Returns once every kind has been heard: what others are told only when they ask is asked for."""
        end = time.monotonic() + patience
        while not self.caught[ANNOUNCEMENT] and time.monotonic() < end:
            time.sleep(0.1)
        self.mole = Mole("mole")
        self.greet(self.mole, self.keep)
        # Answers to orders go to the learner alone: what they are made of is known.
        for body in (b"\x00\x01", b"\x01\x01\x01\x02", b"\x01" + number(2**40) + b"\x02\x00\x07"):
            head = header(CONTROL_REPLY, body, self.mole.start.number, 1)
            self.caught[CONTROL_REPLY].append(("", head, self.mole.start.proved(self.learner_key, head, body)))
        while (lacking := [NAMES[kind] for kind in NAMES if not self.caught[kind]]) and time.monotonic() < end:
            version, digest = self.newest()
            for key in ("about", "history?from=0;points=100", f"weights/cartpole/latest?version={version};sha256={digest}"):
                self.question(f"{self.root}/{key}", b"", None, self.keep)
            time.sleep(0.2)
        if lacking:
            raise TimeoutError(f"no {', no '.join(lacking)} heard")

    def keep(self, reply):
        if reply.ok is not None:
            self.hear(reply.ok)

    def newest(self):
        """Returns the newest version of the weights, and its digest, as the last announcement has them."""
        # Before the proof: versions as numbers, each with a digest of 32 bytes.
        body = self.caught[ANNOUNCEMENT][-1][2][:-SIGNED]
        digest, before = body[-32:], body[:-32]
        for size, tag, form in ((2, 251, "<H"), (4, 252, "<I")):
            if len(before) > size and before[-size - 1] == tag:
                return struct.unpack_from(form, before, len(before) - size)[0], digest.hex()
        return before[-1], digest.hex()

    # --- what is sent --------------------------------------------------------------------------------------------

    def count(self, kind, way):
        with self.lock:
            self.sent[NAMES[kind]] += 1
            self.ways[way] += 1
            self.n += 1

    def changed(self, kind, heard):
        """Makes a changed message: header, payload, and in which way."""
        draws, (_, head, payload) = self.draws, heard
        _, _, other = draws.choice(self.caught[draws.choice(list(NAMES))])
        n_proof = PROOF.get(kind, 0)
        way = draws.randrange(4)
        if way == 0:
            payload = mutated(draws, payload, other)
        else:
            body, proof = payload[: len(payload) - n_proof], payload[len(payload) - n_proof :]
            body = mutated(draws, body, other)
            payload = body + proof
            if way > 1:
                head = head[:8] + struct.pack("<I", crc32c(body)) + head[12:]
        if way == 3 and draws.random() < 0.5:
            head = mutated(draws, head, other[:48])
        return head, payload, "as it is" if way < 2 else "mended"

    def proved(self, kind, heard, start, sequence, to):
        """Makes a changed message of a start of ours, with a proof that holds: for one other, or for all."""
        draws, (_, head, payload) = self.draws, heard
        _, _, other = draws.choice(self.caught[draws.choice(list(NAMES))])
        body = payload[: len(payload) - PROOF[kind]]
        body = mutated(draws, body, other)
        epoch, version = struct.unpack_from("<QQ", head, 32)
        if draws.random() < 0.1:
            epoch, version = draws.getrandbits(64), draws.getrandbits(64)
        head = header(kind, body, start.number, sequence, epoch, version)
        if draws.random() < 0.05:
            head = head[:8] + draws.randbytes(4) + head[12:]
        if to is None:
            return head, start.signed(head, body)
        key = self.shared.get((start.number, to))
        if key is None:
            key = self.shared[start.number, to] = start.shared(to)
        return head, body + start.public + blake3(head + body, key=key).digest()

    def send(self, kind):
        """Sends one changed message of a kind."""
        draws = self.draws
        heard = key, _, _ = draws.choice(self.caught[kind])
        with self.lock:
            is_signed = kind in PROOF and draws.random() < 0.4
            mole = self.next_mole() if is_signed and kind == ROLLOUT else self.mole
            way = "signed"
            if is_signed and kind == ROLLOUT and mole is not None:
                mole.sent += 1
                head, payload = self.proved(kind, heard, mole.start, mole.sent, self.learner_key)
                key = f"{self.root}/traj/cartpole/{mole.name}"
            elif is_signed and kind == HELLO:
                self.mole.start.hellos += 1
                head, payload = self.proved(kind, heard, self.mole.start, self.mole.start.hellos, None)
            elif is_signed and kind == ANNOUNCEMENT:
                head, payload = self.proved(kind, heard, self.mole.start, 0, None)
            elif is_signed and kind in (CONTROL, CREDIT) and self.starts:
                # An order says which start is meant beside it, and credit within.
                to = draws.choice(list(self.starts.values()))
                head, payload = self.proved(kind, heard, self.mole.start, self.n, to)
            else:
                head, payload, way = self.changed(kind, heard)
        if kind in (HELLO, CONTROL, WEIGHTS, ABOUT, HISTORY):
            self.send_question(kind, key, head, payload)
        else:
            if draws.random() < 0.02:
                key = self.other_key(key)
            self.session.put(key, payload, attachment=head, congestion_control=zenoh.CongestionControl.BLOCK)
        self.count(kind, way)

    def other_key(self, key):
        """A key like this one, with something else in one place."""
        parts = key.split("/")
        at = self.draws.randrange(2, len(parts))
        parts[at] = re.sub(r"[/*$?#]", "-", mutated(self.draws, parts[at].encode(), b"%s").decode("latin-1")) or "-"
        return "/".join(parts)

    def send_question(self, kind, key, head, payload):
        draws = self.draws
        if kind == CONTROL:
            actor = key.split("/")[-1]
            start = self.network.actors.get(actor, 7)
            parameters = f"incarnation={start}"
        elif kind == HELLO:
            parameters = ""
        elif kind == WEIGHTS:
            parameters, payload = "version=3;sha256=" + "0" * 64, b""
        else:
            parameters, payload = "from=1;points=8", b""
        if kind in (WEIGHTS, ABOUT, HISTORY) or draws.random() < 0.05:
            changed = mutated(draws, parameters.encode()).decode("latin-1")
            parameters = re.sub(r"[#?/*$\0]", "-", changed)
        self.question(f"{key}?{parameters}" if parameters else key, payload, head, lambda _: None)

    def question(self, selector, payload, head, take):
        """Asks, if not too many questions wait already; then one has to be over first."""
        self.waiting.acquire()
        body = {"payload": payload, "attachment": head} if head else {}
        handler = zenoh.handlers.Callback(take, self.waiting.release)
        try:
            self.session.get(selector, handler, timeout=10, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE, **body)
        except zenoh.ZError:
            self.waiting.release()

    # --- members of our own --------------------------------------------------------------------------------------

    def greet(self, mole, take):
        """Shows presence, and says hello."""
        mole.token = self.session.liveliness().declare_token(f"{self.root}/alive/actor/{mole.name}/{mole.start.number:016x}")
        mole.start.hellos += 1
        body = hello(mole.name, mole.start.number)
        head = header(HELLO, body, mole.start.number, mole.start.hellos)
        self.question(f"{self.root}/ctl/hello", mole.start.signed(head, body), head, take)

    def raise_mole(self):
        """Brings a start of ours into the run; it sends when it is welcome."""
        self.n_moles += 1
        mole = Mole(f"mole-{self.n_moles}")
        self.moles[mole.name] = mole

        def answered(reply):
            if reply.ok is not None and mole not in self.ready:
                self.ready.append(mole)
        self.greet(mole, answered)

    def next_mole(self):
        """Returns a welcome start that has credit for one more, if there is one."""
        for _ in range(len(self.ready)):
            mole = self.ready.popleft()
            if mole.sent >= LIFE:
                self.leaving.append((time.monotonic() + LEAVING, self.moles.pop(mole.name)))
                self.shared.pop((mole.start.number, self.learner_key), None)
                continue
            self.ready.append(mole)
            if mole.sent < mole.limit:
                return mole
        return None

    def answer_orders(self):
        """A member that answers every order, with changed answers, and does nothing else."""
        mole = Mole("answerer")

        def answer(question):
            head = bytes(question.attachment or b"")
            if len(head) != 48:
                return
            sequence = struct.unpack_from("<Q", head, 24)[0]
            for _ in range(4):
                with self.lock:
                    reply = self.proved(CONTROL_REPLY, self.draws.choice(self.caught[CONTROL_REPLY]), mole.start, sequence, self.learner_key)
                try:
                    question.reply(question.key_expr, reply[1], attachment=reply[0])
                except zenoh.ZError:
                    return
                self.count(CONTROL_REPLY, "signed")
        self.held.append(self.session.declare_queryable(f"{self.root}/ctl/actor/{mole.name}", answer))
        self.greet(mole, lambda _: None)
        return mole

    def attack(self, n, end):
        """Sends changed messages until there are so many, or until then."""
        self.is_on = True
        kinds, weights = list(WEIGHT), list(WEIGHT.values())
        answerer, renewed, tokens = self.answer_orders(), time.monotonic() + 2, collections.deque()
        while self.n < n and time.monotonic() < end:
            for kind in self.draws.choices(kinds, weights, k=256):
                self.send(kind)
            for _ in range(min(8, READY - len(self.moles))):
                self.raise_mole()
            # Presence under keys that are none, and an answerer that is new: the one before has lost what it had.
            key = self.other_key(f"{self.root}/alive/actor/a1/{self.draws.getrandbits(64):016x}")
            try:
                tokens.append(self.session.liveliness().declare_token(key))
                self.count(HELLO, "as it is")
            except zenoh.ZError:
                pass
            if len(tokens) > 16:
                tokens.popleft().undeclare()
            while self.leaving and time.monotonic() > self.leaving[0][0]:
                self.leaving.popleft()[1].token.undeclare()
            if time.monotonic() > renewed:
                answerer.token.undeclare()
                self.held.pop().undeclare()
                answerer, renewed = self.answer_orders(), time.monotonic() + 2
        answerer.token.undeclare()
        moles = [*self.moles.values(), *(mole for _, mole in self.leaving)]
        for token in [*tokens, *(mole.token for mole in moles)]:
            token.undeclare()

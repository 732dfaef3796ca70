"""A notifier at work, as a robot, a car or a simulator sees it (needs the package ``eclipse-zenoh``, extra ``live``).

::

    from leadtime.live import Notifier

    with Notifier("tcp/127.0.0.1:7448", "robot-1", domain="lander") as notifier:
        for observation in sights:
            for said in notifier.step(observation, facts=["zone_below"]):
                if said["event"] == "start":
                    print(said["text"])

The messages and what happens when something is late, lost or broken: docs/live.md.
"""
import json
import queue
import re
import secrets
import time

import zenoh

from leadtime.checks import named, whole

# Events that wait to be read; beyond it the oldest go, because what was said long ago helps nobody.
MAX_EVENTS = 1024
# Seconds for which a notifier is looked for.
PATIENCE = 10.0
# What a service or a client may be called.
NAME = re.compile(r"[a-z0-9-]{1,48}")


class Refused(RuntimeError):
    """The notifier opens no session, or cannot use an observation; the sentence is its own."""


class Lost(ConnectionError):
    """The notifier is not there, or does not answer: fall back to your own rules."""


class Notifier:
    """A session with a notifier.

    With ``clock="observation"`` (the default here) every observation is a step, and :meth:`step` returns what is said about it.
    With ``clock="timer"`` send with :meth:`observe` as often as you like, and read :meth:`said`.
    """

    def __init__(self, endpoint, client, domain, *, service="notifier", clock="observation", seconds_per_step=0.3, seed=0,
                 patience=PATIENCE, config=None):
        for what, name in (("service", service), ("client", client)):
            if not (isinstance(name, str) and NAME.fullmatch(name)):
                raise ValueError(f"{what} {name!r}: a name has 1 to 48 of a-z, 0-9 and `-`")
        self._key = f"leadtime/live/1/{service}/{client}"
        self._said, self._status, self._n_statuses = queue.Queue(MAX_EVENTS), {}, 0
        # Starts of the notifier that are there, and that are gone, by their tokens: one that is started again may show its token before
        # the old one goes.
        self._here, self._gone, self.answer = frozenset(), frozenset(), {}
        self._patience, self._began = patience, time.monotonic()
        settings = {"mode": "client", "connect": {"endpoints": [endpoint]}, "scouting": {"multicast": {"enabled": False}}}
        try:
            self._session = zenoh.open(config or zenoh.Config.from_json5(json.dumps(settings)))
        except zenoh.ZError as error:
            raise Lost(f"nobody can be reached at {endpoint}: {error}") from None
        try:
            self.answer = self._open(service, domain, clock, seconds_per_step, seed)
        except BaseException:
            self._session.close()
            raise
        self._seq, self._clock = self.answer["last_seq"], clock
        self._sights = self._session.declare_publisher(
            f"{self._key}/obs", encoding="application/json", priority=zenoh.Priority.REAL_TIME, express=True)

    def _open(self, service, domain, clock, seconds_per_step, seed):
        # New at every start, also of a program that seeds the generator of `random`.
        start = secrets.token_hex(8)
        self._token = self._session.liveliness().declare_token(f"{self._key}/alive/{start}")
        alive = f"leadtime/live/1/{service}/alive/*"
        self._watched = self._session.liveliness().declare_subscriber(alive, self._on_presence, history=True)
        self._heard = self._session.declare_subscriber(f"{self._key}/say", self._on_say)
        self._told = self._session.declare_subscriber(f"{self._key}/status", self._on_status)
        question = {"protocol": 1, "domain": domain, "incarnation": start, "clock": clock,
                    "seconds_per_step": seconds_per_step, "seed": seed}
        deadline = time.monotonic() + self._patience
        while time.monotonic() < deadline:
            for reply in self._session.get(f"{self._key}/open", payload=json.dumps(question), timeout=self._patience):
                if reply.ok is not None:
                    return json.loads(reply.ok.payload.to_string())
                said = reply.err.payload.to_string()
                # The network's word for a notifier that is there and stands still; its own are sentences.
                if said != "Timeout":
                    raise Refused(said)
            time.sleep(0.05)
        raise Lost(f"no notifier `{service}` answers within {self._patience:g} s")

    def _on_presence(self, sample):
        start = {str(sample.key_expr).rsplit("/", 1)[1]}
        if sample.kind == zenoh.SampleKind.PUT:
            self._here, gone = self._here | start, self._gone - start
        else:
            self._here, gone = self._here - start, self._gone | start
        # Once it is known which start has answered, no other one matters: anybody may show thousands.
        self._gone = gone & {self.answer.get("start")} if self.answer else gone

    def _on_say(self, sample):
        event = json.loads(sample.payload.to_string())
        while True:
            try:
                return self._said.put_nowait(event)
            except queue.Full:
                try:
                    self._said.get_nowait()
                except queue.Empty:
                    pass

    def _on_status(self, sample):
        self._status = json.loads(sample.payload.to_string())
        self._n_statuses += 1

    def _why_lost(self):
        """Says why nothing is to be expected of this session at present; None if something is."""
        if not self.is_here:
            return "the notifier was started again: open a new session" if self._here else "the notifier is gone"
        if self._status.get("state") == "closed":
            return self._status.get("why") or "the session is closed: open a new one"
        return None

    @property
    def status(self):
        """The notifier's last status: its state, and why nothing is said. Empty before the first, and where it is not there."""
        return self._status if self.is_here else {}

    @property
    def is_here(self):
        """Whether the notifier is there that opened the session; one that was started again is another one."""
        # An older notifier does not say which start it is.
        return self.answer.get("start") not in self._gone

    def observe(self, observation, *, facts=None, episode=0, end=False):
        """Sends an observation, and returns its number.

        ``facts`` names what holds now, for sentences that presuppose something; ``None`` says nothing about it. Raises :class:`Lost`
        if the session is closed, or its notifier was started again: open a new one.
        """
        episode, facts = whole(episode, "episode"), named(facts)
        # One that is gone may only be out of reach, and come back.
        if (self.is_here or self._here) and (why := self._why_lost()):
            raise Lost(why)
        self._seq += 1
        message = {"seq": self._seq, "t": time.monotonic() - self._began, "obs": [float(x) for x in observation],
                   "episode": episode, "end": bool(end)}
        if facts is not None:
            message["facts"] = facts
        try:
            self._sights.put(json.dumps(message))
        except zenoh.ZError as error:
            raise Lost(f"nothing can be sent: {error}") from None
        return self._seq

    def said(self, timeout=0.0):
        """Yields what was said since the last call; waits so many seconds for the first event."""
        try:
            yield self._said.get(timeout=timeout) if timeout > 0 else self._said.get_nowait()
            while True:
                yield self._said.get_nowait()
        except queue.Empty:
            return

    def step(self, observation, *, facts=None, episode=0, end=False, timeout=PATIENCE):
        """Sends an observation and returns what is said about it: a list of events, which ends with the one marked ``last``.

        Raises :class:`Refused` with the notifier's sentence if it cannot use the observation, :class:`Lost` if no answer comes.
        """
        if self._clock != "observation":
            raise ValueError(f"clock {self._clock!r}: send with observe(), and read said()")
        n_refused, n_statuses = self._status.get("refused", 0), self._n_statuses
        seq, events, deadline = self.observe(observation, facts=facts, episode=episode, end=end), [], time.monotonic() + timeout
        while not (events and events[-1]["last"]):
            left = deadline - time.monotonic()
            try:
                event = self._said.get(timeout=min(max(left, 0.001), 0.05))
            except queue.Empty:
                if self._status.get("refused", 0) > n_refused and self._status.get("told"):
                    raise Refused(self._status["told"]) from None
                if why := self._why_lost():
                    raise Lost(why) from None
                if left > 0:
                    continue
                # What was said before this observation is not about it.
                is_new = self._n_statuses > n_statuses
                why = is_new and (self._status.get("told") or self._status.get("why")) or "nothing is known of it"
                raise Lost(f"no answer to observation {seq} within {timeout:g} s: {why}") from None
            if event["seq"] == seq:
                events.append(event)
        return events

    def close(self):
        """Ends the session: the notifier falls silent at once."""
        self._session.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

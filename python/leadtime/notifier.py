"""A notifier in this process: a policy, what it has seen and said, and its sentences. Needs numpy alone, and no network.

    from leadtime.notifier import LocalNotifier

    notifier = LocalNotifier("deploy/policies/piloting.safetensors", words="lander.json")
    for observation in sights:
        for said in notifier.step(observation, facts=["zone_below"]):
            if said["event"] == "start":
                print(said["text"])

It decides as ``leadtime serve`` does with ``clock = "observation"``: every observation is a step, and every word takes one. Nobody
looks at the time here: a notifier that is given no observation says nothing, and goes on with the next one as if no time had passed.

``words`` is what ``leadtime taxonomy export lander --format json`` prints; without it there are topic, k and l alone.
"""

import json
from dataclasses import dataclass

import numpy as np

from leadtime.checks import named, whole
from leadtime.policy import PolicyError, load

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

# What a policy's configuration leaves out.
RULES = {"comprehension": "words", "words_from": 1, "occupies": True, "interrupt": "until_comprehended",
         "blocked_initiation": "mask", "repeat": "restart", "can_stop": False}
CHOICES = {"notification": "incrementally_actionable", "words": [2, 3, 4, 5], "history": 4, "observe_utterance": True, "k_max": None, "cells": None}
SILENCE, START, STOP = range(3)


def loss(asked, heard):
    """Returns what hearing other k and l than those asked for costs, in sixths of a word by which it is understood later."""
    (k, l), (other_k, other_l) = asked, heard
    return 6 * max(other_k - k, 0) + 2 * max(k - other_k, 0) + abs(other_l - l)


def pieces(text):
    """Cuts a sentence into the pieces in which it is spoken, one a word: a mark that stands alone belongs to the word before it."""
    found = []
    for piece in text.split():
        if found and not any(map(str.isalnum, piece)):
            found[-1] += f" {piece}"
        else:
            found.append(piece)
    return found


@dataclass
class Said:
    """A message while it is spoken, and after it."""

    number: int
    topic: str
    k: int
    l: int
    text: str = ""
    stand_in: bool = False
    heard: int = 0
    understood: bool = False


class Sentences:
    """A database's sentences, which take turns in each cell; one that is not true now loses its turn."""

    def __init__(self, words, topics):
        if isinstance(words, dict):
            database = words
        else:
            with open(words, encoding="utf-8") as file:
                database = json.load(file)
        self._cells = {}
        for topic in database["topics"]:
            for sentence in topic["utterances"]:
                cell = sentence["comprehension"], sentence["conveyance"]
                cells = self._cells.setdefault(topic["topic"], {})
                cells.setdefault(cell, []).append((sentence["text"], frozenset(sentence["facts"])))
        missing = [topic for topic in topics if topic not in self._cells]
        if missing:
            raise ValueError(f"there are no sentences for `{missing[0]}`; the words are about {', '.join(self._cells)}")
        self._turns = {}

    def begin(self, draws):
        """Draws which sentence of each cell comes first in an episode."""
        self._turns = {(topic, cell): int(draws.integers(len(all_of_it)))
                       for topic, cells in self._cells.items() for cell, all_of_it in sorted(cells.items())}

    def find(self, topic, asked, facts):
        """Returns a true sentence for k and l, and whether it stands in for one of exactly these; None if there is none."""
        holding, cells = frozenset(facts or ()), self._cells[topic]
        sayable = [cell for cell, sentences in cells.items() if any(needs <= holding for _, needs in sentences)]
        if not sayable:
            return None
        cell = min(sayable, key=lambda cell: (cell != asked, loss(asked, cell), cell))
        sentences, first = cells[cell], self._turns[topic, cell]
        turn = next(i % len(sentences) for i in range(first, first + len(sentences)) if sentences[i % len(sentences)][1] <= holding)
        self._turns[topic, cell] = (turn + 1) % len(sentences)
        return sentences[turn][0], cell != asked


class LocalNotifier:
    """A notifier at work in this process.

    ``policy`` is a path, or what ``leadtime.policy.load`` returns; ``words`` a path or the object in it. Choices are drawn unless
    ``greedy``, which the policy's own configuration decides where it is left out. The same ``seed`` says the same.
    """

    def __init__(self, policy, words=None, *, greedy=None, seed=0):
        seed = whole(seed, "seed")
        self.policy = policy if hasattr(policy, "act") else load(policy)
        config = tomllib.loads(self.policy.metadata.get("config", ""))
        heads = dict(self.policy.heads)
        if "human" not in config or "initiate" not in heads:
            raise PolicyError(f"nobody is spoken to in `{self.policy.metadata.get('domain', 'this task')}`: a notifier is needed")
        self._rules, choices = RULES | config["human"], CHOICES | config.get("notifier", {})
        self._type, self._lengths, n_pairs = choices["notification"], choices["words"], choices["history"]
        #: Names of the topics that it speaks of.
        self.topics = list(heads["topic"])
        most = choices["k_max"]
        sayable = [(name, k, l) for name, k, l in choices["cells"] or [] if most is None or k <= most]
        self._cells = {topic: sorted((k, l) for name, k, l in sayable if name == topic) for topic in self.topics}
        n_action = 1 + len(self.topics) + 2 * len(self._lengths) + self._rules["can_stop"]
        n_utterance = 1 + len(self.topics) if choices["observe_utterance"] else 0
        pair, rest = divmod(self.policy.obs_dim - n_utterance, n_pairs)
        if rest or pair <= n_action:
            raise PolicyError(f"its {self.policy.obs_dim} numbers are not {n_pairs} pairs of an observation and an action")
        #: How many numbers an observation of the world has.
        self.obs_dim = pair - n_action
        self._history, self._n_utterance = np.zeros((n_pairs, pair), np.float32), n_utterance
        self._words = Sentences(words, self.topics) if words is not None else None
        self._greedy = config.get("evaluation", {}).get("action") == "greedy" if greedy is None else greedy
        self._seed, self._draws, self._state = seed, None, None
        self._episode, self._step, self._has_ended, self._n_said = None, 0, False, 0
        # What was said last; whether it still is; whether its next word has to be told of; what was done since the last observation.
        self._said, self._speaks, self._word_is_due, self._started, self._stopped = None, False, False, None, False
        self._events = []

    @property
    def observation(self):
        """Names of the numbers of an observation, or None where the policy's file does not have them."""
        names, pair = self.policy.observation, self._history.shape[1]
        newest = names and names[(len(self._history) - 1) * pair :][: self.obs_dim]
        return newest and [name.removeprefix("t.") for name in newest]

    @property
    def speaks(self):
        """Whether something is being said."""
        return self._speaks

    def step(self, observation, *, facts=None, episode=0, end=False):
        """Takes an observation of the world, and returns what is said about it: a list of events, of which the last is marked.

        Events are those of ``leadtime serve`` (docs/live.md, *What is said*), without what depends on time or network. ``facts``
        names what holds now, for sentences that presuppose something. Another ``episode`` forgets the past; after ``end`` nothing is
        said until one begins.
        """
        sight = np.asarray(observation, np.float32)
        if sight.shape != (self.obs_dim,):
            raise ValueError(f"an observation has {self.obs_dim} numbers, this one has shape {sight.shape}")
        if not np.isfinite(sight).all():
            raise ValueError("the observation holds a number that is not finite")
        episode, facts = whole(episode, "episode"), named(facts)
        self._events = []
        is_new = episode != self._episode
        if is_new or end:
            self._cut()
        if is_new:
            self._episode = episode
        if end:
            self._has_ended = True
        elif is_new:
            self._begin(sight, facts)
        elif not self._has_ended:
            self._go_on(sight, facts)
        if not self._events:
            self._tell("silent")
        for event in self._events:
            event["last"] = event is self._events[-1]
        return self._events

    def _begin(self, sight, facts):
        self._draws = np.random.default_rng([self._seed, self._episode])
        if self._words:
            self._words.begin(self._draws)
        self._state, self._step, self._has_ended = self.policy.begin(), 0, False
        self._started, self._stopped = None, False
        self._history[:] = 0
        self._history[:, : self.obs_dim] = sight
        self._decide(facts)

    def _go_on(self, sight, facts):
        self._step += 1
        if self._speaks:
            self._hear_word()
        self._history[:-1] = self._history[1:]
        self._history[-1] = 0
        self._history[-1, : self.obs_dim] = sight
        self._encode(self._history[-1, self.obs_dim :])
        self._started, self._stopped = None, False
        self._decide(facts)

    def _encode(self, out):
        """Writes what was done since the last observation: start, topic, k and l, and stop."""
        if self._stopped:
            out[-1] = 1
        if self._started:
            topic, k, l = self._started
            n_topics, n_lengths = len(self.topics), len(self._lengths)
            out[0] = out[1 + self.topics.index(topic)] = 1
            for words, first in ((k, 1 + n_topics), (l, 1 + n_topics + n_lengths)):
                out[first + min(range(n_lengths), key=lambda i: abs(self._lengths[i] - words))] = 1

    def _row(self):
        """Returns what the policy sees."""
        utterance = np.zeros(self._n_utterance, np.float32)
        if self._speaks and self._n_utterance:
            utterance[0] = self._said.heard / self._said.l
            utterance[1 + self.topics.index(self._said.topic)] = 1
        return np.concatenate([self._history.ravel(), utterance])

    def _may_start(self):
        rule = self._rules["interrupt"]
        return not self._speaks or rule == "replace" or rule == "until_comprehended" and self._said.understood

    def _decide(self, facts):
        may_stop, may_start = self._rules["can_stop"] and self._speaks, self._may_start()
        mask = np.ones(sum(len(choices) for _, choices in self.policy.heads), bool)
        mask[START] = may_start or self._rules["blocked_initiation"] != "mask"
        if self._rules["can_stop"]:
            mask[STOP] = may_stop
        action, self._state = self.policy.act(self._row(), mask=mask, state=self._state, rng=self._draws, greedy=self._greedy)
        message = self._message(action) if action[0] == START else None
        if message and self._speaks and self._rules["repeat"] == "continue" and message[0] == self._said.topic:
            message = None
        found = ("", False)
        if message and may_start and self._words:
            found = self._words.find(message[0], message[1:], facts)
        starts = bool(message and may_start and found)
        self._stopped = action[0] == STOP and may_stop
        if starts or self._stopped:
            self._cut()
        if self._word_is_due:
            self._tell("word")
        self._word_is_due = False
        self._started = message if starts else None
        if starts:
            self._n_said += 1
            self._said = Said(self._n_said, *message, *found, understood=self._comprehension(message[1]) == 0)
            self._speaks = True
            self._tell("start")

    def _message(self, action):
        """Returns topic, k and l of the choices that start a message."""
        topic, lengths = self.topics[action[1]], self._lengths
        if self._type == "topic_only":
            k = l = lengths[0]
        elif self._type == "complete_utterance":
            k = l = lengths[action[2]]
        else:
            k, l = lengths[action[2]], max(lengths[action[2]], lengths[action[3]])
        # Where only some can be said, the nearest of them is.
        k, l = min(self._cells.get(topic) or [(k, l)], key=lambda cell: loss((k, l), cell))
        return topic, k, l

    def _comprehension(self, k):
        """Returns the words after which a message is understood."""
        return 0 if self._rules["comprehension"] == "immediate" else max(k + self._rules["words_from"] - 1, 0)

    def _hear_word(self):
        said, needed = self._said, self._comprehension(self._said.k)
        said.heard += 1
        said.understood |= said.heard >= needed
        if said.heard >= (said.l if self._rules["occupies"] else max(needed, 1)):
            self._speaks = False
            self._tell("end")
        else:
            # Told once it is clear that it goes on.
            self._word_is_due = True

    def _cut(self):
        """Cuts what is said."""
        if self._speaks:
            self._speaks = self._word_is_due = False
            self._tell("cut")

    def _tell(self, what):
        event = {"step": self._step, "episode": self._episode, "event": what}
        if what != "silent":
            said, words = self._said, pieces(self._said.text)
            event |= {"utterance": said.number, "topic": said.topic, "k": said.k, "l": said.l, "heard": said.heard,
                      # A sentence of another length than the message's keeps its pace: both end together.
                      "word": said.heard * (len(words) or said.l) // said.l}
            if words:
                event |= {"text": said.text, "words": words}
            if said.stand_in:
                event["stand_in"] = True
        self._events.append(event)

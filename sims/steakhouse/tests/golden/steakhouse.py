#!/usr/bin/env python3
"""The cook, its listener and its kitchen once more, in Python's standard library alone: the source of the recorded
episodes in tests/data/steak_golden.json.gz. It shares no code with the Rust form.

    python3 sims/steakhouse/tests/golden/steakhouse.py --golden FILE.json   record the deterministic episodes anew
    python3 sims/steakhouse/tests/golden/steakhouse.py                      notifiers x start families, means over 100 seeds
    python3 sims/steakhouse/tests/golden/steakhouse.py --trace FAMILY       one silent episode, step by step
    python3 sims/steakhouse/tests/golden/steakhouse.py --check              no episode may stall
"""
import json, random, sys
from collections import deque

N, S, E, W, STAY, INTERACT = range(6)
DXY = {N: (0, -1), S: (0, 1), E: (1, 0), W: (-1, 0)}
NAMES = ["N", "S", "E", "W", "STAY", "INTERACT"]
UP, DOWN, LEFT, RIGHT, INFO = range(5)
TOPIC_DIR = {UP: N, DOWN: S, LEFT: W, RIGHT: E}
TOPICS = ["UP", "DOWN", "LEFT", "RIGHT", "INFO"]
ITEMS = [None, "onion", "meat", "plate", "hot_plate", "steak", "dish"]

LAYOUTS = {
    "ring": ["XXPXPXXXX",
             "B       M",
             "X  XXX  X",
             "B  XXX1 O",
             "X  XXX  X",
             "W       D",
             "XXWXXXSXX"],
    "steak_mid_2": ["XXXXXXXXXXXXXXX", "XXXOXMXXXPXXDXX", "XX           XX", "XX 1         XX", "XX           XX",
                    "XX   XBWXX   XX", "XX   XXSSX   XX", "XX           XX", "XX           XX", "XX           XX",
                    "XXXXXXXXXXXXXXX"],
}
CATALOGUE = [None] + [(c, 2, 2) for c in range(4)] + [(c, 2, 5) for c in range(4)] + [(c, 5, 5) for c in range(4)] + [(INFO, 3, 3)]
L_MAX, N_SLOT = 8, 6


class World:
    def __init__(self, rows, occ=None, cook=10, chop=2, wash=2, pos=None, ori=S):
        self.h, self.w = len(rows), len(rows[0])
        self.g = [list(r) for r in rows]
        self.lim = {"P": cook, "B": chop, "W": wash}
        for y in range(self.h):
            for x in range(self.w):
                if self.g[y][x] == "1": self.pos = (x, y); self.g[y][x] = " "
        if pos: self.pos = pos
        self.ori, self.held, self.delivered = ori, None, False
        # station slots: grills, then boards, then sinks; row-major inside a kind
        self.stations = [p for k in "PBW" for p in self.tiles(k)]
        self.content = {s: None for s in self.stations}          # None = empty, else progress counter
        self.content.update(occ or {})
        self.counter = {}                                         # counter tile -> item

    def tiles(self, ch): return [(x, y) for y in range(self.h) for x in range(self.w) if self.g[y][x] == ch]
    def t(self, p): return self.g[p[1]][p[0]] if 0 <= p[0] < self.w and 0 <= p[1] < self.h else "X"
    def kind(self, s): return self.g[s[1]][s[0]]

    def front(self):
        dx, dy = DXY[self.ori]
        return (self.pos[0] + dx, self.pos[1] + dy)

    def step(self, a):
        """returns True if the action itself had an effect"""
        eff = False
        if a == INTERACT: eff = self.interact()
        elif a in DXY:
            old = (self.pos, self.ori)
            self.ori = a
            if self.t(self.front()) == " ": self.pos = self.front()
            eff = old != (self.pos, self.ori)
        for s in self.stations:                                   # environment effect: grills cook
            if self.kind(s) == "P" and self.content[s] is not None and self.content[s] < self.lim["P"]: self.content[s] += 1
        return eff

    def interact(self):
        f = self.front(); k = self.t(f); h = self.held
        c = self.content.get(f); lim = self.lim.get(k)
        if k == "X":
            o = self.counter.pop(f, None)
            if h is not None: self.counter[f] = h
            self.held = o
            return h is not None or o is not None
        if k in "OMD":
            if h is not None: return False
            self.held = {"O": "onion", "M": "meat", "D": "plate"}[k]
        elif k == "P" and h == "meat" and c is None: self.content[f], self.held = 0, None
        elif k == "P" and h == "meat" and c < lim: self.content[f] = c + 1            # source quirk
        elif k == "P" and h == "hot_plate" and c is not None and c >= lim: self.content[f], self.held = None, "steak"
        elif k == "B" and h is None and c is not None and c < lim: self.content[f] = c + 1
        elif k == "B" and h == "onion" and c is None: self.content[f], self.held = 0, None
        elif k == "B" and h == "steak" and c is not None and c >= lim: self.content[f], self.held = None, "dish"
        elif k == "W" and h is None and c is not None and c < lim: self.content[f] = c + 1
        elif k == "W" and h is None and c is not None: self.content[f], self.held = None, "hot_plate"
        elif k == "W" and h == "plate" and c is None: self.content[f], self.held = 0, None
        elif k == "S" and h == "dish": self.held, self.delivered = None, True
        else: return False
        return True

    def fov(self):
        """2 deep x 3 wide block directly ahead, clipped to the grid, no occlusion"""
        (x, y), (dx, dy) = self.pos, DXY[self.ori]
        ps = [(x + dx * d - dy * l, y + dy * d + dx * l) for d in (1, 2) for l in (-1, 0, 1)]
        return [p for p in ps if 0 <= p[0] < self.w and 0 <= p[1] < self.h]

    def remaining(self):
        """INTERACTs still needed for one delivery, ignoring that hands hold one item (progress potential)"""
        if self.delivered: return 0
        best = lambda k: max((self.content[s] for s in self.stations if self.kind(s) == k and self.content[s] is not None), default=None)
        hold, ctr, lim = (lambda it: self.held == it), (lambda it: it in self.counter.values()), self.lim
        if hold("dish"): return 1
        if ctr("dish"): return 2
        b = best("B")
        gar = lim["B"] - min(b, lim["B"]) if b is not None else lim["B"] + (1 if hold("onion") else 2)
        if hold("steak"): return gar + 2
        if ctr("steak"): return gar + 3
        st = 0 if best("P") is not None else (1 if hold("meat") else 2)
        w = best("W")
        pl = 0 if hold("hot_plate") else 1 if ctr("hot_plate") else lim["W"] - min(w, lim["W"]) + 1 if w is not None else lim["W"] + (2 if hold("plate") else 3)
        return st + gar + pl + 3


class Human:
    """myopic rule-based cook with one believed content per station"""
    def __init__(self, world, rng, belief=None, tie=True, see_delay=1):
        self.w, self.rng, self.tie, self.see_delay = world, rng, tie, see_delay
        self.b = dict(belief) if belief is not None else {s: None for s in world.stations}
        self.seen = {s: 0 for s in world.stations}
        self.sub = self.goal = self.last_done = None
        self.look()

    # ---- belief -----------------------------------------------------------------------------------
    def look(self):
        f = set(self.w.fov())
        for s in self.w.stations:
            self.seen[s] = self.seen[s] + 1 if s in f else 0
            if self.seen[s] >= self.see_delay: self.b[s] = self.w.content[s]

    def tick(self):                                               # the cook knows that a grill cooks by itself
        for s in self.w.stations:
            if self.w.kind(s) == "P" and self.b[s] is not None and self.b[s] < self.w.lim["P"]: self.b[s] += 1

    def phase(self, b, s): return 0 if b[s] is None else (2 if b[s] >= self.w.lim[self.w.kind(s)] else 1)
    def st(self, b, k, ph): return [s for s in self.w.stations if self.w.kind(s) == k and self.phase(b, s) in ph]

    # ---- subtasks ---------------------------------------------------------------------------------
    def tiers(self, b):
        """tiers in falling priority; a tier lists its available (subtask, targets)"""
        w, h = self.w, self.w.held
        ctr = lambda it: [p for p in w.tiles("X") if w.counter.get(p) == it]
        P, B, K = (lambda *p: self.st(b, "P", p)), (lambda *p: self.st(b, "B", p)), (lambda *p: self.st(b, "W", p))
        put = [("discard", [p for p in w.tiles("X") if p not in w.counter])]
        if h == "meat":      return [[("drop_meat", P(0))] if P(0) else put]
        if h == "onion":     return [[("drop_onion", B(0))] if B(0) else put]
        if h == "plate":     return [[("drop_plate", K(0))] if K(0) else put]
        if h == "hot_plate": return [[("pickup_steak", P(2) or P(1))] if P(1, 2) else put]
        if h == "steak":     return [[("pickup_garnish", B(2))] if B(2) else put]
        if h == "dish":      return [[("deliver_dish", w.tiles("S"))]]
        plated = bool(ctr("steak"))
        chop = [("chop_onion", B(1))] if B(1) and not B(2) else []
        wash = [("wash_plate", K(1))] if K(1) and not K(2) and not plated and not ctr("hot_plate") else []
        return [
            [("pickup_dish", ctr("dish"))] if ctr("dish") else [],
            [("pickup_plated_steak", ctr("steak"))] if plated and B(2) else [],
            (chop if self.last_done in ("drop_onion", "chop_onion") else []) + (wash if self.last_done in ("drop_plate", "wash_plate") else []),
            [("pickup_meat", w.tiles("M") + ctr("meat"))] if not P(1, 2) and not plated else [],
            ([("pickup_onion", w.tiles("O") + ctr("onion"))] if not B(1, 2) else [])
            + ([("pickup_plate", w.tiles("D") + ctr("plate"))] if not K(1, 2) and not ctr("hot_plate") and not plated else []),
            chop + wash,
            [("pickup_hot_plate", K(2) + ctr("hot_plate"))] if (K(2) or ctr("hot_plate")) and B(2) and P(1, 2) else [],
        ]

    def options(self, b): return next((t for t in self.tiers(b) if t), [("wait", [])])

    # ---- motion -----------------------------------------------------------------------------------
    def plan(self, target):
        """breadth-first over (tile, orientation), order N,S,E,W: (moves incl. turns, first action)"""
        w, start = self.w, (self.w.pos, self.w.ori)
        at = lambda st: (st[0][0] + DXY[st[1]][0], st[0][1] + DXY[st[1]][1]) == target
        if at(start): return 0, INTERACT
        q, first, dist = deque([start]), {start: None}, {start: 0}
        while q:
            st = q.popleft()
            for a in (N, S, E, W):
                f = (st[0][0] + DXY[a][0], st[0][1] + DXY[a][1])
                nx = (f, a) if w.t(f) == " " else (st[0], a)
                if nx in first: continue
                first[nx], dist[nx] = (a if st == start else first[st]), dist[st] + 1
                if at(nx): return dist[nx], first[nx]
                q.append(nx)
        return None

    def act(self):
        opts = self.options(self.b)
        keep = [o for o in opts if o[0] == self.sub]
        if keep: name, targets = keep[0]
        else:
            name, targets = self.rng.choice(opts) if self.tie else opts[0]
            self.sub, self.goal = name, None
        if self.goal not in targets:
            self.goal = None
            costs = [(p[0], t) for t in targets for p in [self.plan(t)] if p is not None]
            if costs:
                m = min(c for c, _ in costs); best = [t for c, t in costs if c == m]
                self.goal = self.rng.choice(best) if self.tie else best[0]
        if self.goal is None: return STAY
        a = self.plan(self.goal)[1]
        if a == INTERACT and name == "pickup_steak" and self.phase(self.b, self.goal) == 1: return STAY   # wait at the grill
        return a

    def after(self, a, effect):
        if a == INTERACT and effect:
            self.last_done = self.sub
            if self.sub not in ("chop_onion", "wash_plate"): self.replan()

    def replan(self): self.sub = self.goal = None


PIPE = {"pickup_meat": "P", "drop_meat": "P", "pickup_onion": "B", "drop_onion": "B", "pickup_plate": "W", "drop_plate": "W"}


class Env:
    R_DELIVER, R_LATE, R_PROG, C_STEP, C_NOTIF, C_RED, SLACK = 20.0, 5.0, 0.5, 0.05, 0.2, 0.1, 8

    def __init__(self, layout="ring", occ=None, seed=0, T=100, d_r=0, d_f=3, aware=False, tie=True, pos=None, ori=S, see_delay=1, ref=True, **kw):
        self.rng = random.Random(seed)
        mk = lambda: World(LAYOUTS[layout], occ, pos=pos, ori=ori, **kw)
        self.T, self.d_r, self.d_f, self.t = T, d_r, d_f, 0
        self.t_ref = None
        if ref:                                                   # reference run: true belief, ties by first option, no notifier
            e = Env(layout, occ, 0, 200, aware=True, tie=False, pos=pos, ori=ori, ref=False, **kw)
            self.t_ref = e.run(lambda _: None)["steps"]
        self.w = mk()
        self.h = Human(self.w, self.rng, belief=dict(self.w.content) if aware else None, tie=tie, see_delay=see_delay)
        self.u = self.pending = self.ov = None
        self.since = 20
        self.n_notif = self.red_steps = self.red_pick = self.noop = 0
        self.log = []

    @property
    def deadline(self): return self.t_ref + self.SLACK if self.t_ref else self.T

    @staticmethod
    def discloses(c, l): return l >= (3 if c == INFO else 5)

    def step(self, act=None):
        w, h = self.w, self.h
        r, R0, t0 = -self.C_STEP, w.remaining(), self.t
        said = None
        self.since += 1
        if act is not None and self.u is None:                    # 1 notifier
            self.u = dict(c=act[0], k=act[1], l=act[2], t0=self.t)
            self.n_notif += 1; self.since = 0; r -= self.C_NOTIF; said = act
        over = self.ov is not None                                # 2 cook decides
        a = TOPIC_DIR[self.ov[0]] if over else h.act()
        sub = "override" if over else h.sub
        red = (sub in PIPE and bool(h.st(w.content, PIPE[sub], (1, 2)))) or sub == "discard"
        if red: self.red_steps += 1; r -= self.C_RED
        pos0 = w.pos
        eff = w.step(a)                                           # 3 world
        if a != STAY and not eff: self.noop += 1
        if red and a == INTERACT and eff and sub.startswith("pickup_"): self.red_pick += 1
        if over:
            self.ov[1] -= 1
            if self.ov[1] <= 0 or w.pos == pos0: self.ov = None; h.replan()
        else: h.after(a, eff)
        self.t += 1                                               # 4 clock, belief from own knowledge and sight
        h.tick(); h.look()
        if self.u:                                                # 5 utterance
            u = self.u; e = self.t - u["t0"]
            if e == u["l"]:
                if self.discloses(u["c"], u["l"]): h.b = dict(w.content); h.replan(); self.ov = None
                self.u = None
            if e == u["k"] and u["c"] in TOPIC_DIR: self.pending = (self.t + self.d_r, u["c"])
        if self.pending and self.pending[0] == self.t: self.ov, self.pending = [self.pending[1], self.d_f], None
        if w.delivered: r += self.R_DELIVER if self.t <= self.deadline else self.R_LATE
        r += self.R_PROG * (R0 - w.remaining())
        done = w.delivered or self.t >= self.T
        self.log.append(dict(t=t0, said=said, subtask=sub, action=NAMES[a], pos=list(w.pos), ori=NAMES[w.ori], held=w.held,
                             content=[w.content[s] for s in w.stations], belief=[h.b[s] for s in w.stations], aware=self.aware(),
                             override=[TOPICS[self.ov[0]], self.ov[1]] if self.ov else None, speaking=self.u is not None, redundant=red,
                             remaining=w.remaining(), reward=round(r, 6), done=done))
        return r, done

    def aware(self): return [int(self.h.phase(self.h.b, s) == self.h.phase(self.w.content, s)) for s in self.w.stations]

    def obs(self):
        w = self.w; o = [w.pos[0] / (w.w - 1), w.pos[1] / (w.h - 1)]
        o += [float(w.ori == d) for d in (N, S, E, W)] + [float(w.held == i) for i in ITEMS]
        for i in range(N_SLOT):
            if i < len(w.stations):
                s = w.stations[i]; p = self.h.phase(w.content, s)
                o += [float(p == q) for q in range(3)] + [(w.content[s] or 0) / w.lim[w.kind(s)], float(self.aware()[i])]
            else: o += [0.0] * 5
        o += [self.t / self.T, max(0.0, self.deadline - self.t) / self.T]
        u = self.u
        o += [float(u is not None)] + [float(u is not None and u["c"] == c) for c in range(5)]
        o += [(self.t - u["t0"]) / L_MAX, u["k"] / L_MAX, u["l"] / L_MAX] if u else [0.0] * 3
        o += [float(self.ov is not None), self.ov[1] / self.d_f if self.ov else 0.0, min(self.since, 20) / 20]
        return o

    def run(self, policy):
        ret, done = 0.0, False
        while not done:
            r, done = self.step(policy(self)); ret += r
        return dict(steps=self.t, ok=self.w.delivered, in_time=self.w.delivered and self.t <= self.deadline, ret=ret, notif=self.n_notif,
                    red=self.red_steps, pick=self.red_pick, noop=self.noop)


# ---- start families and simple notifiers ------------------------------------------------------------
def family(layout, name, r):
    w = World(LAYOUTS[layout]); of = lambda k: [s for s in w.stations if w.kind(s) == k]
    full = lambda k, p: {s: p for s in of(k)}
    if name == "empty": return {}
    if name == "grills": return full("P", 5)
    if name == "boards": return full("B", 1)
    if name == "sinks": return full("W", 1)
    if name == "all_partial": return {**full("P", 5), **full("B", 1), **full("W", 1)}
    if name == "all_ready": return {**full("P", 10), **full("B", 2), **full("W", 2)}
    if name == "first_of_each": return {of("P")[0]: 5, of("B")[0]: 1, of("W")[0]: 1}
    occ = {}
    while not occ:                                                # "random"
        occ = {s: r.randint(0, w.lim[w.kind(s)]) for s in w.stations if r.random() < 0.5}
    return occ


FAMILIES = ["empty", "grills", "boards", "sinks", "first_of_each", "all_partial", "all_ready", "random"]
silent = lambda e: None
def at(t, msg): return lambda e: msg if e.t == t else None


def wrong_belief(e):
    """would the cook's present subtask be pointless in truth?"""
    o = [x[0] for x in e.h.options(e.h.b)]
    sub = e.h.sub if e.h.sub in o else o[0]
    return sub in PIPE and bool(e.h.st(e.w.content, PIPE[sub], (1, 2)))


def true_dir(e):
    """topic of the move a fully informed cook would make now, INFO if it is no move"""
    g = Human.__new__(Human); g.__dict__.update(e.h.__dict__)
    g.b, g.sub, g.goal, g.tie = dict(e.w.content), None, None, False
    a = g.act()
    return next((c for c, d in TOPIC_DIR.items() if d == a), INFO)


def reactive(kind):
    def f(e):
        if e.u is not None or e.ov is not None or e.pending or all(e.aware()) or not wrong_belief(e): return None
        if kind == "info": return (INFO, 3, 3)
        c = true_dir(e)
        if c == INFO: return (INFO, 3, 3)
        return {"lead": (c, 2, 5), "last": (c, 5, 5), "short": (c, 2, 2)}[kind]
    return f


def chatter(i, p=0.1):
    r = random.Random(90000 + i)
    return lambda e: r.choice(CATALOGUE[1:]) if e.u is None and r.random() < p else None


def batch(fam, pol, n=300, layout="ring", random_start=False, **kw):
    rs = []
    for i in range(n):
        r = random.Random(5000 + i); occ = family(layout, fam, r); st = {}
        if random_start:
            w = World(LAYOUTS[layout]); free = w.tiles(" "); st = dict(pos=r.choice(free), ori=r.randrange(4))
        rs.append(Env(layout, occ, seed=i, **st, **kw).run(pol(i) if pol is chatter else pol))
    m = lambda k: sum(x[k] for x in rs) / n
    return dict(n=n, sd=(sum((x["steps"] - m("steps")) ** 2 for x in rs) / n) ** .5, lo=min(x["steps"] for x in rs), hi=max(x["steps"] for x in rs),
                **{k: m(k) for k in ("steps", "ok", "in_time", "ret", "notif", "red", "pick", "noop")})


POLICIES = [("silent", silent, {}), ("true belief", silent, dict(aware=True)), ("INFO 3/3 at t=0", at(0, (INFO, 3, 3)), {}), ("INFO 3/3 at t=8", at(8, (INFO, 3, 3)), {}),
            ("LEFT 2/5 at t=0", at(0, (LEFT, 2, 5)), {}), ("UP 2/5 at t=0", at(0, (UP, 2, 5)), {}), ("DOWN 2/5 at t=0", at(0, (DOWN, 2, 5)), {}), ("DOWN 2/2 at t=0", at(0, (DOWN, 2, 2)), {}),
            ("reactive INFO 3/3", reactive("info"), {}), ("reactive move 2/5", reactive("lead"), {}), ("same, d_r=2", reactive("lead"), dict(d_r=2)),
            ("reactive move 5/5", reactive("last"), {}), ("reactive move 2/2", reactive("short"), {}), ("chatter p=.1", chatter, {})]


def golden(path):
    fp = {"P": "grill", "B": "board", "W": "sink"}
    def ep(name, note, msgs, **kw):
        e = Env(tie=False, **kw)
        start = dict(layout=kw.get("layout", "ring"), pos=list(e.w.pos), ori=NAMES[e.w.ori], T=e.T, d_r=e.d_r, d_f=e.d_f, t_ref=e.t_ref, deadline=e.deadline,
                     stations=[[fp[e.w.kind(s)], list(s)] for s in e.w.stations], content=[e.w.content[s] for s in e.w.stations],
                     belief=[e.h.b[s] for s in e.w.stations], aware=e.aware(), limits=e.w.lim, obs=[round(x, 6) for x in e.obs()])
        out, done, ob = [], False, []
        while not done:
            _, done = e.step(msgs.get(e.t)); e.log[-1]["obs"] = [round(x, 6) for x in e.obs()]
        return dict(name=name, note=note, messages={str(k): [TOPICS[v[0]], v[1], v[2]] for k, v in msgs.items()}, start=start, steps=e.log,
                    total=dict(steps=e.t, delivered=e.w.delivered, in_time=e.t <= e.deadline and e.w.delivered, notifications=e.n_notif, redundant_steps=e.red_steps, redundant_pickups=e.red_pick, noop=e.noop))
    fa = lambda n, l="ring": family(l, n, random.Random(0))
    eps = [ep("empty_silent", "nothing occupied, belief true", {}, occ={}),
           ep("all_partial_silent", "every station holds unfinished work, belief all-empty", {}, occ=fa("all_partial")),
           ep("all_partial_true_belief", "same start, belief true", {}, occ=fa("all_partial"), aware=True),
           ep("all_partial_info", "INFO at t=0", {0: (INFO, 3, 3)}, occ=fa("all_partial")),
           ep("all_partial_left_lead", "LEFT k=2 l=5 at t=0", {0: (LEFT, 2, 5)}, occ=fa("all_partial")),
           ep("all_partial_down_lead", "timing of the figure: word 2 at t=2 moves, word 5 at t=5 corrects", {0: (DOWN, 2, 5)}, occ=fa("all_partial")),
           ep("all_partial_down_last", "reason first: comprehension and disclosure both at t=5", {0: (DOWN, 5, 5)}, occ=fa("all_partial")),
           ep("all_partial_up_blocked", "UP 2/2 while the cook is under the top wall: the move is blocked and ends the override", {5: (UP, 2, 2)}, occ=fa("all_partial")),
           ep("all_partial_delay", "d_r=2, d_f=2", {0: (DOWN, 2, 5), 12: (INFO, 3, 3)}, occ=fa("all_partial"), d_r=2, d_f=2),
           ep("masked", "a second message while one is being spoken is ignored", {0: (DOWN, 2, 5), 3: (UP, 2, 2), 5: (INFO, 3, 3)}, occ=fa("all_partial")),
           ep("all_ready_silent", "every station finished", {}, occ=fa("all_ready")),
           ep("first_of_each_silent", "one of two occupied", {}, occ=fa("first_of_each")),
           ep("see_delay_2", "a station must be in view for two consecutive steps", {}, occ=fa("all_partial"), see_delay=2),
           ep("mid2_empty", "source layout, cook alone", {}, layout="steak_mid_2", occ={}),
           ep("mid2_board_half", "source layout, half-chopped board: the source cook stalls here, ours must not", {}, layout="steak_mid_2", occ=fa("boards", "steak_mid_2"))]
    json.dump(dict(note="Leadtime's reference of the cook, ties by first option; log rows hold the state after the step", catalogue=CATALOGUE, episodes=eps), open(path, "w"), separators=(",", ":"))
    for x in eps: print("%-26s %s" % (x["name"], x["total"]))


if __name__ == "__main__":
    arg = lambda k: sys.argv[sys.argv.index(k) + 1]
    lay = arg("--layout") if "--layout" in sys.argv else "ring"
    if "--golden" in sys.argv: golden(arg("--golden"))
    elif "--trace" in sys.argv:
        e = Env(lay, family(lay, arg("--trace"), random.Random(1)), tie=False); print(e.run(silent))
        for l in e.log: print({k: v for k, v in l.items() if k not in ("aware", "speaking", "override", "said", "done")})
    elif "--check" in sys.argv:
        bad = n = 0
        for l in LAYOUTS:
            for sd in (1, 2, 3):
                for pol, kw in ((silent, {}), (silent, dict(aware=True)), (chatter, {}), (chatter, dict(d_r=2, d_f=5))):
                    s = batch("random", pol, 100, l, True, T=400, see_delay=sd, **kw); n += 100; bad += round((1 - s["ok"]) * 100)
        print("episodes", n, "not delivered within 400 steps:", bad)
    else:
        for rs, fams in ((False, FAMILIES), (True, ["random"])):
            for f in fams:
                print("%s, %s" % (f, "random start" if rs else "fixed start"))
                for nm, pol, kw in POLICIES:
                    s = batch(f, pol, 100, lay, rs, **kw)
                    print("   %-18s steps %5.1f sd %4.1f [%2d..%3d] in time %.2f notif %5.2f red steps %5.1f red pickups %.2f noop %4.1f return %6.2f"
                          % (nm, s["steps"], s["sd"], s["lo"], s["hi"], s["in_time"], s["notif"], s["red"], s["pick"], s["noop"], s["ret"]))

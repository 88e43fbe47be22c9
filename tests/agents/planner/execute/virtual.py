"""Vehicles, clocks and a bad network without waiting: a plan's execution in virtual time, as real vehicles fly it.

The vehicles take segments by the real code's rules and fly the real code's curves; their clocks are off; messages both
ways are lost, late, doubled and overtaken. Everything comes from one seed.
"""

from __future__ import annotations

import bisect
import heapq
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from agents.planner.execute.commit import Part
from agents.planner.execute.conductor import Conductor, Send
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import Track
from agents.planner.model.problem import Floats, Motion
from agents.planner.model.separation import separation
from zmav import wire
from zmav.errors import BadInput
from zmav.services.authority.trajectory import Segment

ORIGIN = wire.Origin(lat_deg=0.0, lon_deg=0.0, alt_amsl=0.0)
LEASE = 7
STEP = 0.1
AHEAD = 5.0


class Craft:
    """One vehicle: what zmav.services.authority.setpoints decides of a segment, and where the segment has it."""

    def __init__(self, part: Part, clock: float) -> None:
        self.part, self.clock = part, clock
        x, y, z = part.track.pos[0].tolist()
        self.rest: tuple[float, float, float] = (x, y, z)
        self.segment: Segment | None = None
        self.seq, self.on = 0, 0
        self.taken = 0
        self.jump = 0.0
        self.lease = LEASE
        self.pilot = False
        self.refuses = False
        """its fence, its limits or an order of its own let it take nothing"""
        self.instance = "first"
        self.late, self.lean = 0.0, (0.0, 0.0, 0.0)
        """s after its points' times at which it is there, and m that it is off its way then: as an autopilot follows"""

    def take(self, now: float, seq: int, deadline: float, points: list[wire.SegmentPoint]) -> None:
        mine = now + self.clock
        if self.pilot or self.refuses or seq <= self.seq or not 0.0 <= deadline - mine <= AHEAD:
            return
        self.seq = seq
        try:
            segment = Segment(points, ORIGIN, mine)
        except BadInput:
            return
        if not 0.0 < segment.end - mine <= 60.0:
            return
        before = self.place(now)
        self.segment, self.on, self.taken = segment, seq, self.taken + 1
        self.jump = max(self.jump, math.dist(before, self.place(now)))

    def place(self, now: float) -> tuple[float, float, float]:
        if self.segment is None:
            return self.rest
        pieces, t = self.segment.pieces, now + self.clock
        index = min(max(bisect.bisect_right(self.segment.times, t) - 1, 0), len(pieces) - 1)
        return pieces[index].at(t)[0]

    def truly(self, now: float) -> tuple[float, float, float]:
        """Where it is, late and leaning."""
        (x, y, z), (a, b, c) = self.place(now - self.late), self.lean
        return x + a, y + b, z + c

    def freeze(self, now: float) -> None:
        """It stops where it is: a pilot has it."""
        self.rest = self.place(now)
        self.segment, self.pilot = None, True

    def restart(self, now: float) -> None:
        """Its agent was started again: it stops where it is, and counts from zero."""
        self.rest, self.instance = self.place(now), "second"
        self.segment, self.seq, self.on = None, 0, 0

    def state(self, now: float) -> dict[str, Any]:
        on = self.segment is not None and not self.pilot
        return {
            "t": now + self.clock,
            "stamp": (LEASE, self.on) if on else None,
            "end": self.segment.end if self.segment is not None and on else None,
            "instance": self.instance,
        }


class Network:
    """Loss, delay, doubles; ``cut(now)``: nothing goes through."""

    def __init__(self, rng: np.random.Generator, loss: float, delay: tuple[float, float]) -> None:
        self.rng, self.loss, self.delay = rng, loss, delay
        self.cut: Callable[[float, str], bool] = lambda now, who: False
        self._heap: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = itertools.count()

    def send(self, now: float, who: str, deliver: Callable[[float], None]) -> None:
        if self.cut(now, who):
            return
        for _ in range(1 + (self.rng.random() < 0.05)):
            if self.rng.random() >= self.loss:
                late = self.rng.uniform(*self.delay) if self.rng.random() < 0.95 else self.rng.uniform(0.2, 6.0)
                heapq.heappush(self._heap, (now + late, next(self._count), deliver))

    def run(self, until: float) -> None:
        while self._heap and self._heap[0][0] <= until:
            at, _, deliver = heapq.heappop(self._heap)
            deliver(at)


class History:
    """One execution. ``run`` gives the least clearance that the vehicles truly had."""

    def __init__(
        self,
        motions: dict[str, Motion],
        rng: np.random.Generator,
        *,
        radius: float | Mapping[str, float] = 1.0,
        margin: float = 0.1,
        downwash: float = 1.5,
        accel: float = 2.5,
        loss: float = 0.3,
        delay: tuple[float, float] = (0.05, 0.2),
        skew: float = 0.02,
        late: Sequence[float] = (),
        lean: float = 0.0,
    ) -> None:
        """``late``: s by which each follows; ``lean``: m, root mean square, that all are off their ways, coming and
        going within seconds. Where there is one, they say where they are.
        """
        self.now, self.downwash = 1000.0, downwash
        radii = dict.fromkeys(motions, radius) if isinstance(radius, float) else radius
        self.parts = [
            Part(name, Track(motion), radii[name], accel, margin, Offset()) for name, motion in motions.items()
        ]
        self.crafts = {part.id: Craft(part, float(rng.uniform(-30.0, 30.0))) for part in self.parts}
        for part in self.parts:
            clock = self.crafts[part.id].clock
            part.offset.answered(self.now, self.now + clock + skew, self.now + rng.uniform(0.0, 4.0 * skew))
            part.offset.fix()
            part.error = part.offset.error(self.now)
            part.heard, part.instance = self.now, self.crafts[part.id].instance
        for craft, by in zip(self.crafts.values(), late, strict=False):
            craft.late = by
        self._says, self._lean, self._rng = bool(len(late)) or lean > 0.0, lean, rng
        self.network = Network(rng, loss, delay)
        self.conductor = Conductor(self.parts, downwash, self.now)
        self.alive = True
        self.seqs = {part.id: 0 for part in self.parts}
        self.places: list[Floats] = []
        self.sends = 0

    def run(self, seconds: float, stop: Callable[[History], bool] = lambda history: False) -> None:
        end, step = self.now + seconds, 0
        while self.now < end and not stop(self):
            self.network.run(self.now)
            for craft in self.crafts.values() if self._lean else ():  # a wander of 3 s
                kick = self._rng.normal(0.0, self._lean * math.sqrt(2.0 * STEP / 3.0 / 3.0), 3)
                a, b, c = (np.array(craft.lean) * (1.0 - STEP / 3.0) + kick).tolist()
                craft.lean = (a, b, c)
            self.places.append(np.array([craft.truly(self.now) for craft in self.crafts.values()]))
            if step % 2 == 0:
                for part in self.parts:
                    self._report(part)
            if self.alive:
                for send in self.conductor.decide(self.now):
                    self._put(send)
            step += 1
            self.now += STEP

    def restart_counting(self, name: str) -> None:
        """The lease after the agent's restart has the first one's number."""
        self.seqs[name] = 0

    def _report(self, part: Part) -> None:
        craft, now = self.crafts[part.id], self.now
        state, place = craft.state(now), np.array(craft.truly(now))

        def deliver(at: float) -> None:
            if self.alive:
                self.conductor.heard(part, at, state["t"], state["stamp"], state["end"], state["instance"])
                if self._says and part.known.taken and part.active:
                    self.conductor.strayed(part, at, part.offset.ours(state["t"]), place)

        self.network.send(self.now, part.id, deliver)

    def _put(self, send: Send) -> None:
        part, craft = send.part, self.crafts[send.part.id]
        self.seqs[part.id] += 1
        seq, deadline = self.seqs[part.id], part.offset.vehicle(send.deadline)
        points = [
            wire.SegmentPoint(t=part.offset.vehicle(row[0]), pos=tuple(row[1:4]), vel=tuple(row[4:7]))
            for row in send.rows.tolist()
        ]
        self.conductor.sent(send, (LEASE, seq), deadline, self.now)
        self.sends += 1
        self.network.send(self.now, part.id, lambda at: craft.take(at, seq, deadline, points))

    def least(self) -> float:
        """m between the nearest two, less their radii, at any instant of what was flown."""
        times = np.arange(len(self.places)) * STEP
        tracks = [np.column_stack((times, [place[i] for place in self.places])) for i in range(len(self.parts))]
        return min(
            (
                separation(tracks[i], tracks[j], self.downwash)[0] - self.parts[i].radius - self.parts[j].radius
                for i, j in itertools.combinations(range(len(self.parts)), 2)
            ),
            default=math.inf,
        )

    def away(self) -> float:
        """m from the goal, of the farthest one."""
        return max(math.dist(self.crafts[part.id].place(self.now), part.track.pos[-1]) for part in self.parts)


# Plans.


def line(start: Floats, goal: Floats, speed: float = 4.0, accel: float = 2.0, delay: float = 0.0) -> Motion:
    """A straight trapezoid, sampled at 10 Hz, after standing for ``delay`` seconds."""
    length = float(np.linalg.norm(goal - start))
    ramp = min(speed / accel, math.sqrt(length / accel))
    top = accel * ramp
    whole = 2.0 * ramp + (length - top * ramp) / top if length > 0.0 else 0.1
    t = np.append(np.arange(0.0, whole, 0.1), whole)
    up, down = np.minimum(t, ramp), np.minimum(whole - t, ramp)
    gone = np.where(t <= whole - ramp, 0.5 * accel * up**2 + top * (t - up), length - 0.5 * accel * down**2)
    return delayed(np.column_stack((t, start + np.outer(gone / max(length, 1e-9), goal - start))), delay)


def delayed(motion: Motion, delay: float) -> Motion:
    """The same after standing for ``delay`` seconds."""
    later = motion + np.array([delay, 0.0, 0.0, 0.0])
    return np.vstack(([0.0, *motion[0, 1:]], later)) if delay > 0.0 else later


def slower(motions: dict[str, Motion], times: float) -> dict[str, Motion]:
    return {name: motion * np.array([times, 1.0, 1.0, 1.0]) for name, motion in motions.items()}


def crossing(rng: np.random.Generator, n: int, size: float = 18.0, apart: float = 2.4) -> dict[str, Motion]:
    """Straight lines between random places, each delayed until it is clear of those before it."""
    while True:
        starts, goals = _spread(rng, n, size, apart), _spread(rng, n, size, apart)
        motions: dict[str, Motion] = {}
        for k in range(n):
            way = line(starts[k], goals[k])
            others = list(motions.values()) + [np.array([[0.0, *starts[j]]]) for j in range(k + 1, n)]
            for delay in np.arange(0.0, 40.0, 0.5):
                motion = delayed(way, float(delay))
                if all(separation(motion, other, 1.5)[0] >= apart for other in others):
                    motions[f"v{k}"] = motion
                    break
            else:
                break
        if len(motions) == n:
            return motions


def _spread(rng: np.random.Generator, n: int, size: float, apart: float) -> Floats:
    found: list[Floats] = []
    while len(found) < n:
        place = np.array([*rng.uniform(0.0, size, 2), 10.0])
        if all(np.linalg.norm(place - other) > apart + 0.5 for other in found):
            found.append(place)
    return np.array(found)


def carousel(n: int, radius: float, turn: float = math.pi, speed: float = 4.0) -> dict[str, Motion]:
    """All on one circle, turned together: each is where the next one was."""
    arc = line(np.zeros(3), np.array([radius * turn, 0.0, 0.0]), speed)
    motions = {}
    for k in range(n):
        angle = arc[:, 1] / radius + 2.0 * math.pi * k / n
        circle = radius * np.column_stack((np.cos(angle), np.sin(angle)))
        motions[f"v{k}"] = np.column_stack((arc[:, 0], circle, np.full(len(arc), 10.0)))
    return motions

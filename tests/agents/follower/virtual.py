"""A vehicle, its camera and a target in virtual time, for what the follower's guide flies."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from agents.follower.agent import Follower
from agents.follower.guide import FollowCommand, Guide, TargetFix
from agents.follower.place import Here
from zmav.errors import Stale
from zmav.vehicle.vehicle import Place as Said
from zmav.wire import Detection

TICK, LAG = 0.05, 0.35
DECK = -0.3
Place = Callable[[float], tuple[float, float]]


class World:
    """A vehicle that follows places and velocities as an autopilot does, late by :data:`LAG`, and a camera under it."""

    def __init__(self, target: Place, *, delay: float = 0.0, lost: float = 0.0) -> None:
        self.target, self.pos, self.vel = target, np.array((0.0, 0.0, -5.3)), np.zeros(3)
        self.t, self.clock, self.rng = 0.0, 0.0, np.random.default_rng(5)
        """``t``: UTC s, which a test may set; ``clock``: of a clock that nobody sets"""
        self.tuned = {name: each.default for name, each in Follower.tunables.items()}
        self.tuned["lead"] = LAG
        self.guide = Guide(self.tuned.__getitem__, 5.0)
        self.hidden: Callable[[float], bool] = lambda t: False
        self.more: Callable[[float], list[tuple[float, float]]] = lambda t: []
        self.told_off = (1.5, -1.0)
        """m by which the target's own positioning is wrong"""
        self.told = True
        self.plane = DECK
        """m down of the pad, as it is told"""
        self.delay, self.lost = delay, lost
        self.wander: Place = lambda t: (0.0, 0.0)
        """m north, east by which it takes itself to be beside where it is"""
        self.push, self.late, self.score = 0.0, 0.0, 0.8
        """m/s that the wind takes from what it flies north; s until a command is said to be heard; of each sight"""
        self.place_late: Callable[[float], float] = lambda t: 0.02
        """s until it is heard what it says of its place at that time"""
        self.place_every = 2
        """ticks from one to the next: ten a second"""
        self.here = Here(0.0)
        self.said: list[tuple[float, Said]] = []
        self.old_places = 0
        """steps at which nothing was flown, because its place was old"""
        self.due: deque[tuple[float, float, list[Detection]]] = deque()
        self.off: list[float] = []
        self.phases: list[str] = []
        self.command = FollowCommand((0.0, 0.0, 0.0))
        self.frame = 0

    @property
    def me(self) -> tuple[float, float, float]:
        north, east = self.wander(self.t)
        return float(self.pos[0]) + north, float(self.pos[1]) + east, float(self.pos[2])

    def word(self) -> TargetFix | None:
        if not self.told:
            return None
        (a, b), (c, d) = self.target(self.t), self.target(self.t - 0.1)
        pos = (a + self.told_off[0], b + self.told_off[1], 0.0)
        return TargetFix(self.t - 0.3, pos, ((a - c) / 0.1, (b - d) / 0.1, 0.0))

    def run(self, seconds: float, until: Callable[[World], bool] = lambda world: False) -> World:
        end = self.t + seconds
        while self.t < end and not until(self):
            self.step()
        return self

    def step(self) -> None:
        self.t += TICK
        self.clock += TICK
        self.frame += 1
        if self.frame % 2 == 0 and self.rng.random() >= self.lost:
            self.due.append((self.t + self.delay, self.t, self.picture()))
        while self.due and self.due[0][0] <= self.t:
            _, taken, found = self.due.popleft()
            self.guide.see(self.t, taken, found, self.me, self.word(), 0.3)
        self.hear()
        want = np.zeros(3)
        try:
            last = self.here.check(self.t, self.clock)
        except Stale:  # without a setpoint it holds
            self.old_places += 1
        else:
            me = self.here.at(self.t)
            assert me is not None
            word, old = self.word(), self.here.late
            self.command = self.guide.step(self.t, me, word, self.plane, self.late, last.vel, old)
            # It flies to where the place that moves was a little ago: see docs/vision.md.
            aim = np.array(self.command.pos) - LAG * np.array(self.command.vel)
            want = np.array(self.command.vel) + np.clip(1.2 * (aim - self.me), -4.0, 4.0)
        want[0] -= self.push
        self.vel += np.clip((want - self.vel) / 0.25, -5.0, 5.0) * TICK
        self.pos += self.vel * TICK
        self.off.append(math.dist(self.pos[:2], self.target(self.t)))
        if not self.phases or self.phases[-1] != self.guide.phase:
            self.phases.append(self.guide.phase)

    def hear(self) -> None:
        """Its places, as they come: one may overtake another."""
        if self.frame % self.place_every == 1:
            vel = (float(self.vel[0]), float(self.vel[1]), float(self.vel[2]))
            self.said.append((self.t + self.place_late(self.t), Said(self.t, self.me, vel)))
        self.said.sort(key=lambda each: each[0])
        while self.said and self.said[0][0] <= self.t + 1e-9:
            _, said = self.said.pop(0)
            if self.here.feed(said, self.t, self.clock):
                self.guide.drift.feed(said.t, self.clock, said.pos, said.vel)

    def picture(self) -> list[Detection]:
        """All pads in a view of 63 by 49 degrees, a little noise on each."""
        height = DECK - float(self.pos[2])
        found = []
        pads = [*([] if self.hidden(self.t) else [self.target(self.t)]), *self.more(self.t)]
        for north, east in pads:
            if max(abs(north - self.pos[0]), abs(east - self.pos[1])) > 0.46 * height or not 0.5 < height < 12.0:
                continue
            seen = np.array([north, east]) + self.rng.normal(0.0, 0.01 * height, 2)
            off = self.wander(self.t)
            place = (float(seen[0]) + off[0], float(seen[1]) + off[1], DECK)
            found.append(
                Detection(
                    symbol="H",
                    u=0.0,
                    v=0.0,
                    scale_px=20.0,
                    heading=0.0,
                    score=self.score,
                    pos=place,
                    covariance=(0.01, 0.0, 0.01),
                )
            )
        return found

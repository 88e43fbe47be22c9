"""One vehicle in the scene: its model, name, velocity, trail, setpoint, and its lines in the plots."""

from __future__ import annotations

import collections
import math
from collections.abc import Sequence
from typing import NamedTuple

import rerun as rr

from ground.view import style
from ground.view.canvas import VEHICLES, Canvas, Path
from ground.view.frames import Datum, usable
from zmav import keys, rotation, wire
from zmav.wire import Vector

BRIGHT, DIM, DARK = 1.0, 0.66, 0.24
"""shares of the vehicle's own colour"""


class BodyBox(NamedTuple):
    """A part of a model in body axes (forward, right, down), m. Models are about two metres across: larger than most
    real vehicles, so that one is still seen across a field.
    """

    center: Vector
    size: Vector
    share: float
    yaw: float = 0.0
    """radians about down"""


def _arm(yaw: float) -> tuple[BodyBox, ...]:
    x, y = 0.72 * math.cos(yaw), 0.72 * math.sin(yaw)
    return (
        BodyBox((x / 2, y / 2, 0.0), (0.72, 0.07, 0.06), DIM, yaw),
        BodyBox((x, y, -0.1), (0.6, 0.6, 0.02), BRIGHT if x > 0 else DIM, yaw),
        BodyBox((x, y, 0.0), (0.1, 0.1, 0.16), DARK),
    )


COPTER = (
    BodyBox((0.0, 0.0, 0.0), (0.5, 0.34, 0.18), BRIGHT),
    BodyBox((0.27, 0.0, 0.0), (0.14, 0.2, 0.1), DARK),
    *(part for turn in (1, 3, 5, 7) for part in _arm(turn * math.pi / 4)),
)
PLANE = (
    BodyBox((-0.13, 0.0, 0.0), (1.95, 0.23, 0.23), BRIGHT),
    BodyBox((0.98, 0.0, 0.0), (0.26, 0.16, 0.16), DARK),
    BodyBox((0.26, 0.0, -0.08), (0.44, 3.1, 0.06), BRIGHT),
    BodyBox((-1.0, 0.0, -0.03), (0.3, 1.04, 0.05), DIM),
    BodyBox((-1.05, 0.0, -0.23), (0.3, 0.04, 0.46), DIM),
)
ROVER = (
    BodyBox((0.0, 0.0, -0.38), (1.4, 0.8, 0.26), BRIGHT),
    BodyBox((-0.2, 0.0, -0.6), (0.7, 0.6, 0.2), DIM),
    BodyBox((0.3, 0.0, -0.58), (0.1, 0.12, 0.28), DARK),
    *(BodyBox((x, y, -0.24), (0.4, 0.12, 0.4), DARK) for x in (-0.46, 0.46) for y in (-0.46, 0.46)),
)
OTHER = (BodyBox((0.0, 0.0, 0.0), (1.2, 0.4, 0.3), BRIGHT), BodyBox((0.7, 0.0, 0.0), (0.2, 0.2, 0.15), DARK))
KINDS = {"copter": COPTER, "heli": COPTER, "plane": PLANE, "vtol": PLANE, "rover": ROVER, "boat": ROVER}


def model(kind: str | None, size: float, shade: style.Colour) -> rr.Boxes3D:
    """The model of a kind of vehicle (:attr:`zmav.wire.VehicleState.kind`), enlarged ``size`` times."""
    parts = KINDS.get(kind or "", OTHER)
    return rr.Boxes3D(
        centers=[[size * x for x in part.center] for part in parts],
        sizes=[[size * x for x in part.size] for part in parts],
        rotation_axis_angles=[rr.RotationAxisAngle((0.0, 0.0, 1.0), radians=part.yaw) for part in parts],
        colors=[style.darkened(shade, part.share) for part in parts],
        fill_mode=rr.components.FillMode.Solid,
    )


STALE = 2.0 * (keys.SETPOINT.stale_after or 0.5)
"""s after which the last setpoint of a stream is drawn no more"""
MOST_SENDERS = 8
"""senders remembered for one vehicle"""


class Setpoints:
    """The last setpoint of every sender; the lease holder's counts where it has one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last: dict[str, tuple[wire.Setpoint, float]] = {}
        self._fresh = False
        self._segment: tuple[str, int] | None = None
        """lease and sequence number of the one that is drawn"""

    def on_setpoint(self, agent: str, setpoint: wire.Setpoint, mono: float) -> None:
        if agent in self._last or len(self._last) < MOST_SENDERS:
            self._last[agent] = (setpoint, mono)
            self._fresh = True

    def paint(
        self,
        canvas: Canvas,
        position: Vector | None,
        holder: str | None,
        datum: Datum,
        home_amsl: float | None,
        now: float,
        t: float,
    ) -> float | None:
        """Draw marker and error; the error in metres, where both places are known and something new was heard."""
        chosen = self._chosen(holder)
        setpoint = None if chosen is None or self._over(chosen, now, t) else chosen[0]
        target = None if setpoint is None else target_of(setpoint, datum, home_amsl, t)
        self._paint_segment(canvas, setpoint)
        if target is None:
            canvas.clear((*self._path, "setpoint"))
            canvas.clear((*self._path, "error"))
            return None
        following = setpoint is not None and setpoint.segment is not None
        if not (self._fresh or following):
            return None
        self._fresh = False
        marker = rr.Points3D([target], colors=style.SETPOINT, radii=style.points(4.0))
        canvas.put((*self._path, "setpoint"), marker)
        if position is None:
            return None
        line = rr.LineStrips3D([[position, target]], colors=style.ERROR_LINE, radii=style.points(1.0))
        canvas.put((*self._path, "error"), line)
        return math.dist(position, target)

    def _chosen(self, holder: str | None) -> tuple[wire.Setpoint, float] | None:
        if holder in self._last:
            return self._last[holder]
        return max(self._last.values(), key=lambda last: last[1], default=None)

    @staticmethod
    def _over(chosen: tuple[wire.Setpoint, float], now: float, t: float) -> bool:
        setpoint, mono = chosen
        if setpoint.segment:
            return t > setpoint.segment[-1].t + STALE
        return now - mono > STALE

    def _paint_segment(self, canvas: Canvas, setpoint: wire.Setpoint | None) -> None:
        path = (*self._path, "segment")
        points = [] if setpoint is None else [p.pos for p in setpoint.segment or () if usable(p.pos)]
        if setpoint is None or len(points) < 2:
            canvas.clear(path)
            self._segment = None
        elif (setpoint.lease, setpoint.seq) != self._segment:
            self._segment = setpoint.lease, setpoint.seq
            canvas.put(path, rr.LineStrips3D([points], colors=style.SEGMENT, radii=style.points(1.2)))


def target_of(setpoint: wire.Setpoint, datum: Datum, home_amsl: float | None, t: float) -> Vector | None:
    """Where the vehicle is told to be at ``t`` (UTC seconds), in NED; None where it is told no place."""
    if setpoint.segment:
        return _along(setpoint.segment, t)
    if setpoint.frame == "ned":
        return setpoint.pos if usable(setpoint.pos) else None
    alt = setpoint.alt_amsl
    if alt is None and setpoint.alt_rel is not None and home_amsl is not None:
        alt = home_amsl + setpoint.alt_rel
    if setpoint.lat_deg is None or setpoint.lon_deg is None or alt is None:
        return None
    return datum.place(setpoint.lat_deg, setpoint.lon_deg, alt)


def _along(segment: Sequence[wire.SegmentPoint], t: float) -> Vector | None:
    """On the straight line between the two points around ``t``: near enough for the eye."""
    before = segment[0]
    for after in segment:
        if after.t >= t:
            span = after.t - before.t
            part = (t - before.t) / span if span > 0.0 else 1.0
            a, b = before.pos, after.pos
            found = (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))
            return found if usable(found) else None
        before = after
    return before.pos if usable(before.pos) else None


SILENT = 2.0 * (keys.STATE.stale_after or 2.0)
"""s without a state after which a vehicle is grey"""
STEP = 0.4
"""m between two points of a trail"""
TAIL, TRAIL = 25, 400
"""points of the trail's fresh end, which is logged often, and of all of it"""
JUMP = 200.0
"""m between two states that no vehicle flies: the trail begins again"""
SLOW = 0.25
"""m/s below which no arrow is drawn"""


class Craft:
    """Told what is heard of one vehicle; draws what has changed since it was last drawn."""

    def __init__(self, fleet: str, name: str, label: str, size: float) -> None:
        self.fleet, self.name, self.label, self._size = fleet, name, label, size
        self.colour = style.colour(label)
        self.path: Path = (*VEHICLES, label)
        self.state: wire.VehicleState | None = None
        self.position: Vector | None = None
        self.home_amsl: float | None = None
        self.heard = -math.inf
        """monotonic seconds"""
        self.delay = 0.0
        self.setpoints = Setpoints(self.path)
        self.silent = False
        self.complained = False
        """its position could not be drawn, and that was said"""
        self._fresh = False
        self._looks: tuple[str | None, bool] = ("", True)
        """the kind of vehicle that is drawn, and whether as one that is silent"""
        self._name = ""
        self._tail: collections.deque[Vector] = collections.deque()
        self._trail: collections.deque[Vector] = collections.deque(maxlen=TRAIL)
        self._series: set[str] = set()
        self._aged = -math.inf

    # What is heard.

    def on_state(self, state: wire.VehicleState, t: float, mono: float, datum: Datum) -> None:
        self.state, self.heard, self.delay = state, mono, t - state.t
        if state.position is not None and usable((state.position.alt_amsl, state.position.alt_rel, 0.0)):
            self.home_amsl = state.position.alt_amsl - state.position.alt_rel
        self.place(datum)
        self._fresh = True

    def place(self, datum: Datum) -> None:
        """Find the position again, in a state or about an origin that has changed."""
        if self.state is not None:
            self.position = datum.ned(self.state) or self.position

    def forget_trail(self, canvas: Canvas) -> None:
        self._tail.clear()
        self._trail.clear()
        for part in ("old", "fresh"):
            canvas.clear((*self.path, "trail", part))

    @property
    def holder(self) -> str | None:
        return self.state.lease.holder if self.state is not None and self.state.lease is not None else None

    # What is drawn.

    def paint(self, canvas: Canvas, datum: Datum, now: float, t: float, crowded: bool) -> None:
        """``now`` is monotonic, ``t`` UTC seconds; ``crowded``: names alone, without what the vehicle does."""
        state = self.state
        self.silent = now - self.heard > SILENT
        self._paint_model(canvas, crowded)
        if state is not None and self._fresh:
            self._fresh = False
            self._paint_pose(canvas, state)
            self._paint_trail(canvas)
            self._plot_state(canvas, state)
        error = self.setpoints.paint(canvas, self.position, self.holder, datum, self.home_amsl, now, t)
        if error is not None and not self.silent:
            self.plot(canvas, "error", error)
        if now - self._aged >= 1.0 and self.heard > -math.inf:
            self._aged = now
            self.plot(canvas, "age", now - self.heard)
            self._plot_slow(canvas)

    def _paint_model(self, canvas: Canvas, crowded: bool) -> None:
        looks, text = (self.state.kind if self.state else None, self.silent), self._text(crowded)
        shade = style.GREY if self.silent else self.colour
        if looks != self._looks:
            canvas.put((*self.path, "pose", "model"), model(looks[0], self._size, shade))
            self._redraw_trail(canvas, shade)
        if (looks, text) != (self._looks, self._name):
            self._looks, self._name = looks, text
            below = [(0.0, 0.0, 0.4 * self._size)]  # words stand under their point: so they leave the model free
            name = rr.Points3D(below, radii=style.points(0.5), colors=shade, labels=text, show_labels=True)
            canvas.put((*self.path, "pose", "name"), name)

    def _text(self, crowded: bool) -> str:
        state = self.state
        if self.silent:
            return f"{self.label} · silent"
        if state is None or crowded:
            return self.label
        if not state.connected:
            return f"{self.label} · no autopilot"
        words = [self.label, state.mode or "", f"← {self.holder}" if self.holder else ""]
        return " ".join(word[:40] for word in words if word)

    def _paint_pose(self, canvas: Canvas, state: wire.VehicleState) -> None:
        if self.position is None:
            return
        turned = state.attitude
        if turned is not None and all(map(math.isfinite, (turned.roll, turned.pitch, turned.yaw))):
            w, x, y, z = rotation.from_euler(turned.roll, turned.pitch, turned.yaw)
            pose = rr.Transform3D(translation=self.position, quaternion=rr.Quaternion(xyzw=(x, y, z, w)))
        else:
            pose = rr.Transform3D(translation=self.position)
        canvas.put((*self.path, "pose"), pose)
        velocity, arrow = state.velocity, None
        if velocity is not None and usable(velocity) and math.hypot(*velocity) > SLOW:
            shade = style.faded(self.colour, 220)
            arrow = rr.Arrows3D(origins=[self.position], vectors=[velocity], colors=shade, radii=style.points(1.4))
        canvas.put((*self.path, "velocity"), arrow)

    def _paint_trail(self, canvas: Canvas) -> None:
        """The fresh end is logged whenever it grows, and the rest once in a while, so that little is logged twice."""
        if self.position is None:
            return
        last = self._tail[-1] if self._tail else None
        moved = math.inf if last is None else math.dist(last, self.position)
        if last is not None and moved > JUMP:
            self.forget_trail(canvas)
        elif moved < STEP:
            return
        self._tail.append(self.position)
        if len(self._tail) > TAIL:
            while len(self._tail) > 1:
                self._trail.append(self._tail.popleft())
            self._redraw_trail(canvas, self.colour)
        elif len(self._tail) > 1 or self._trail:
            canvas.put((*self.path, "trail", "fresh"), self._strip([*list(self._trail)[-1:], *self._tail], self.colour))

    def _redraw_trail(self, canvas: Canvas, shade: style.Colour) -> None:
        if len(self._trail) > 1:
            canvas.put((*self.path, "trail", "old"), self._strip([*self._trail, self._tail[0]], shade))
        if len(self._tail) > 1 or (self._trail and self._tail):
            canvas.put((*self.path, "trail", "fresh"), self._strip([*list(self._trail)[-1:], *self._tail], shade))

    def _strip(self, points: list[Vector], shade: style.Colour) -> rr.LineStrips3D:
        return rr.LineStrips3D([points], colors=style.faded(shade, 170), radii=style.points(1.2))

    # The plots.

    def _plot_state(self, canvas: Canvas, state: wire.VehicleState) -> None:
        if self.position is not None:
            self.plot(canvas, "height", -self.position[2])
        if state.velocity is not None and usable(state.velocity):
            self.plot(canvas, "speed", math.hypot(*state.velocity))

    def _plot_slow(self, canvas: Canvas) -> None:
        """What a point a second tells well enough."""
        state = self.state
        if state is None or self.silent:
            return
        if state.battery is not None and state.battery.remaining is not None:
            self.plot(canvas, "battery", 100.0 * state.battery.remaining)
        if abs(self.delay) < 1000.0:
            self.plot(canvas, "delay", 1e3 * self.delay)

    def plot(self, canvas: Canvas, what: str, value: float, part: str = "", dim: bool = False) -> None:
        """A point of ``plots/{what}/{vehicle}``; ``part`` tells two lines of one vehicle in one plot apart."""
        if not math.isfinite(value):
            return
        label = f"{self.label} {part}".rstrip()
        path = ("plots", what, label)
        if what + part not in self._series:
            self._series.add(what + part)
            shade = style.faded(self.colour, 110) if dim else self.colour
            canvas.fixed(path, rr.SeriesLines(colors=shade, widths=1.0 if dim else 1.6, names=label))
        canvas.put(path, rr.Scalars(value))

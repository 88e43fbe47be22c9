"""Trajectory segments: time-tagged points that end at rest, joined by polynomials and flown by the vehicle itself.

A bad link then delays new plans and not control. Between two points with a velocity the way is a cubic in time
(Hermite's), where both have an acceleration too a quintic; both are kept as Bézier curves, whose control points enclose
them, so that the fence and the limits are held over the whole way and not only at some points of it.
"""

from __future__ import annotations

import bisect
import math
import time
from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

from zmav import geo, wire
from zmav.autopilots import Target
from zmav.config import Limits
from zmav.errors import BadInput
from zmav.rotation import wrap
from zmav.services.authority.clearance import Place
from zmav.services.authority.limits import Fence, check_motion
from zmav.services.authority.targets import MAX_ANGLE, MAX_DISTANCE, MAX_MOTION, number, to_global, vector

MAX_POINTS = 500
MIN_STEP, MAX_STEP = 0.02, 60.0
"""s between two points"""
MAX_LATE, MAX_AHEAD = 5.0, 60.0
"""s that the first point may lie behind us and before us"""
AT_REST = 0.01
"""m/s that the last point may still have"""
FLAT = 0.05
"""m: a piece of the way that bends less is judged as the straight way between its ends"""
SLACK = 1.001
"""limits are held to a thousandth: a curve that only touches one would else be halved for ever"""
DEPTH = 12
"""halvings of one piece of the way at most, while it is not clear whether it keeps to a limit"""

Curve = tuple[wire.Vector, ...]
"""control points of a Bézier curve"""


class Piece:
    """The way between two points; NED in metres about the origin."""

    def __init__(self, start: float, step: float, curve: Curve) -> None:
        self.start, self.step, self.curve = start, step, curve

    def at(self, t: float) -> tuple[wire.Vector, wire.Vector, wire.Vector]:
        """Position, velocity and acceleration at time ``t``."""
        s = min(max((t - self.start) / self.step, 0.0), 1.0)
        n = e = d = vn = ve = vd = an = ae = ad = 0.0
        for cn, ce, cd in self._powers:  # Horner's scheme, for its two derivatives as well
            an, ae, ad = an * s + vn, ae * s + ve, ad * s + vd
            vn, ve, vd = vn * s + n, ve * s + e, vd * s + d
            n, e, d = n * s + cn, e * s + ce, d * s + cd
        speed, bend = 1.0 / self.step, 2.0 / (self.step * self.step)
        return (n, e, d), (vn * speed, ve * speed, vd * speed), (an * bend, ae * bend, ad * bend)

    @cached_property
    def _powers(self) -> Curve:
        """The same polynomial by powers of the share of the time, the highest first; few pieces are asked, often."""
        row, found, degree = self.curve, list[wire.Vector](), len(self.curve) - 1
        for power in range(degree + 1):
            n, e, d = row[0]
            times = math.comb(degree, power)
            found.append((n * times, e * times, d * times))
            row = tuple((b[0] - a[0], b[1] - a[1], b[2] - a[2]) for a, b in pairwise(row))
        return tuple(reversed(found))

    @property
    def velocity(self) -> Curve:
        """Its velocity, a Bézier curve itself (m/s)."""
        return _derivative(self.curve, self.step)


class Segment:
    """A trajectory: ``at`` gives what to fly at any time. Raises :class:`BadInput` naming the point and the field.

    Points without a velocity: the ends are at rest, the others pass with the mean velocity of the way before and behind
    them. ``yaw`` is turned the short way round from point to point, and is given for all of them or for none.
    """

    def __init__(self, points: list[wire.SegmentPoint], origin: wire.Origin | None, now: float | None = None) -> None:
        _check_points(points, time.time() if now is None else now)
        to_global("segment[0].pos", points[0].pos, origin)
        assert origin is not None
        self.origin = origin
        self.start, self.end = points[0].t, points[-1].t
        self.rests = _rests(points)
        self.times = [point.t for point in points]
        self._yaws = [point.yaw for point in points]
        velocities = _velocities(points)
        self.pieces = [
            Piece(a.t, b.t - a.t, _curve(a, b, va, vb))
            for (a, va), (b, vb) in pairwise(zip(points, velocities, strict=True))
        ]

    def at(self, t_utc: float) -> Target:
        """What to fly then: position, velocity and acceleration; before the start and after the end it rests there."""
        pos, vel, acc, yaw = self.local(t_utc)
        lat, lon, alt = geo.to_global(self.origin, pos)
        return Target(lat, lon, alt, None, vel, acc, yaw)

    def places(self) -> Iterator[Place]:
        """Where it leads, every second and at both ends; at most some thousand places."""
        step = max(1.0, (self.end - self.start) / 1000)
        for i in range(math.ceil((self.end - self.start) / step)):
            yield Place(*geo.to_global(self.origin, self.local(self.start + i * step)[0]))
        yield Place(*geo.to_global(self.origin, self.local(self.end)[0]))

    def local(self, t_utc: float) -> tuple[wire.Vector, wire.Vector, wire.Vector, float | None]:
        """As :meth:`at`: position, velocity, acceleration (NED about the origin) and yaw."""
        index = min(max(bisect.bisect_right(self.times, t_utc) - 1, 0), len(self.pieces) - 1)
        pos, vel, acc = self.pieces[index].at(t_utc)
        if not self.start <= t_utc < self.end:
            vel, acc = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        return pos, vel, acc, self._yaw(index, t_utc)

    def away(self, t_utc: float, place: tuple[float, float, float], *, flat: bool) -> float:
        """m from that place (degrees north and east, m above the sea) to where it has the vehicle then; ``flat``: over
        the ground alone.
        """
        axes = 2 if flat else 3
        return math.dist(geo.to_ned(self.origin, *place)[:axes], self.local(t_utc)[0][:axes])

    def _yaw(self, index: int, t: float) -> float | None:
        first, second = self._yaws[index], self._yaws[index + 1]
        if first is None or second is None:
            return None
        piece = self.pieces[index]
        turn = wrap(second - first)
        return first + turn * min(max((t - piece.start) / piece.step, 0.0), 1.0)

    def check(
        self, fence: Fence | None, limits: Limits | None, home_alt_amsl: float | None, *, flat: bool = False
    ) -> None:
        """Raise :class:`BadInput` where any part of the way is beyond the fence or a limit; see :mod:`.limits`."""
        for index, piece in enumerate(self.pieces):
            place = f"segment[{index}..{index + 1}]."
            if limits is not None:
                velocity = piece.velocity
                _hold(velocity, limits, place, "vel")
                _hold(_derivative(velocity, piece.step), limits, place, "acc")
                self._check_turn(index, limits, place)
            if fence is not None and (fence.limits_ground or fence.limits_height):
                self._hold_fence(piece.curve, fence, home_alt_amsl, flat, place)

    def _check_turn(self, index: int, limits: Limits, place: str) -> None:
        piece = self.pieces[index]
        first, last = self._yaw(index, piece.start), self._yaw(index, piece.start + piece.step)
        if first is None or last is None or limits.yaw_rate is None:
            return
        rate = abs(last - first) / piece.step
        if rate > limits.yaw_rate * SLACK:
            text = f"{place}yaw turns at {rate:.3g} rad/s, more than the limit yaw_rate = {limits.yaw_rate:g}"
            raise BadInput(text, field=f"{place}yaw", value=rate, expected=f"{limits.yaw_rate:g}", count="yaw_rate")

    def _hold_fence(
        self, curve: Curve, fence: Fence, home: float | None, flat: bool, place: str, depth: int = DEPTH
    ) -> None:
        """Raise where the curve leaves the fence: halved until each part is clearly within it, or as good as straight.

        A convex fence that has the control points within has the curve within; in any other, the nearest edge tells.
        """
        beyond = [fence.excess(*self._local(fence, p), self._height(p, fence, home, flat)) for p in curve]
        for metres, where in (beyond[0], beyond[-1]):
            if metres:
                raise _left(place, where)
        if not any(metres for metres, _ in beyond):
            reach = max(math.dist(curve[0], point) for point in curve)
            if fence.convex or fence.to_edge(*self._local(fence, curve[0])) > reach:
                return
        if depth == 0 or max(_from_chord(point, curve[0], curve[-1]) for point in curve[1:-1]) < FLAT:
            if not fence.leg(*self._local(fence, curve[0]), *self._local(fence, curve[-1])):
                raise _left(place, "it cuts a corner of the geofence's polygon")
            return
        for half in _halves(curve):
            self._hold_fence(half, fence, home, flat, place, depth - 1)

    def _local(self, fence: Fence, point: wire.Vector) -> tuple[float, float]:
        if fence.origin == self.origin:
            return point[0], point[1]
        return fence.local(*geo.to_global(self.origin, point)[:2])

    def _height(self, point: wire.Vector, fence: Fence, home: float | None, flat: bool) -> float | None:
        if flat or not fence.limits_height:
            return None
        if home is None:
            text = "the geofence counts heights from home, and where home is, is not known yet"
            raise BadInput(text, field="segment", value=None, expected="later", count="fence")
        return self.origin.alt_amsl - point[2] - home


def _check_points(points: list[wire.SegmentPoint], now: float) -> None:
    if not 2 <= len(points) <= MAX_POINTS:
        text = f"a segment has from 2 to {MAX_POINTS} points, not {len(points)}"
        raise BadInput(text, field="segment", value=len(points), expected=f"2 to {MAX_POINTS} points")
    for index, point in enumerate(points):
        place = f"segment[{index}]."
        vector(f"{place}pos", point.pos, MAX_DISTANCE)
        vector(f"{place}vel", point.vel, MAX_MOTION)
        vector(f"{place}acc", point.acc, MAX_MOTION)
        number(f"{place}yaw", point.yaw, MAX_ANGLE)
        _check_time(points, index, now)
        if (point.yaw is None) != (points[0].yaw is None):
            text = f"{place}yaw: give every point a yaw, or none"
            raise BadInput(text, field=f"{place}yaw", value=point.yaw, expected="as the first point")
    last, place = points[-1], f"segment[{len(points) - 1}]."
    if last.vel is not None and math.hypot(*last.vel) > AT_REST:
        text = f"{place}vel: a segment ends at rest, so that nothing flies on when no other follows"
        raise BadInput(text, field=f"{place}vel", value=list(last.vel), expected="[0, 0, 0], or absent")


def _check_time(points: list[wire.SegmentPoint], index: int, now: float) -> None:
    field, t = f"segment[{index}].t", points[index].t
    if not math.isfinite(t):
        raise BadInput(f"{field} is not finite", field=field, value=str(t), expected="UTC seconds")
    if index == 0:
        if not -MAX_LATE <= t - now <= MAX_AHEAD:
            text = f"{field} is {t - now:+.1f} s from now: is a clock off?"
            raise BadInput(text, field=field, value=t, expected=f"from -{MAX_LATE:.0f} s to +{MAX_AHEAD:.0f} s")
    elif not MIN_STEP <= t - points[index - 1].t <= MAX_STEP:
        text = f"{field} is {t - points[index - 1].t:g} s after the point before it"
        raise BadInput(text, field=field, value=t, expected=f"{MIN_STEP} to {MAX_STEP:.0f} s after the point before it")


def _rests(points: list[wire.SegmentPoint]) -> float:
    """The time from which all points are in one place."""
    rests = points[-1].t
    for point in reversed(points):
        if point.pos != points[-1].pos:
            break
        rests = point.t
    return rests


def _velocities(points: list[wire.SegmentPoint]) -> list[wire.Vector]:
    found: list[wire.Vector] = []
    last = len(points) - 1
    for i, point in enumerate(points):
        if i == last or (i == 0 and point.vel is None):
            found.append((0.0, 0.0, 0.0))
        elif point.vel is not None:
            found.append(point.vel)
        else:
            before, after = points[i - 1], points[i + 1]
            n, e, d = (b - a for a, b in zip(before.pos, after.pos, strict=True))
            span = after.t - before.t
            found.append((n / span, e / span, d / span))
    return found


def _curve(a: wire.SegmentPoint, b: wire.SegmentPoint, va: wire.Vector, vb: wire.Vector) -> Curve:
    """The control points of the polynomial that has the two points' positions, velocities and accelerations."""
    h = b.t - a.t
    if a.acc is None or b.acc is None:
        return a.pos, geo.plus(a.pos, va, h / 3), geo.plus(b.pos, vb, -h / 3), b.pos
    bend = h * h / 20
    return (
        a.pos,
        geo.plus(a.pos, va, h / 5),
        geo.plus(geo.plus(a.pos, va, 2 * h / 5), a.acc, bend),
        geo.plus(geo.plus(b.pos, vb, -2 * h / 5), b.acc, bend),
        geo.plus(b.pos, vb, -h / 5),
        b.pos,
    )


def _halfway(row: Curve, s: float) -> Curve:
    """One step of de Casteljau's algorithm: the points a share ``s`` of the way from each point to the next."""
    return tuple(geo.between(a, b, s) for a, b in pairwise(row))


def _halves(curve: Curve) -> tuple[Curve, Curve]:
    """The same curve as two, each of half the time."""
    left, right, row = [curve[0]], [curve[-1]], curve
    while len(row) > 1:
        row = _halfway(row, 0.5)
        left.append(row[0])
        right.append(row[-1])
    return tuple(left), tuple(reversed(right))


def _derivative(curve: Curve, step: float) -> Curve:
    share = (len(curve) - 1) / step
    return tuple(((b[0] - a[0]) * share, (b[1] - a[1]) * share, (b[2] - a[2]) * share) for a, b in pairwise(curve))


def _hold(curve: Curve, limits: Limits, place: str, name: str, depth: int = DEPTH) -> None:
    """Raise where a velocity or an acceleration is beyond a limit anywhere on the curve."""
    vel = name == "vel"
    for point in (curve[0], curve[-1]):
        check_motion(place, point if vel else None, None if vel else point, limits, SLACK)
    if depth and not all(_keeps(point, limits, vel) for point in curve[1:-1]):
        for half in _halves(curve):
            _hold(half, limits, place, name, depth - 1)


def _keeps(point: wire.Vector, limits: Limits, vel: bool) -> bool:
    try:
        check_motion("", point if vel else None, None if vel else point, limits, SLACK)
    except BadInput:
        return False
    return True


def _from_chord(point: wire.Vector, a: wire.Vector, b: wire.Vector) -> float:
    """Metres from a point to the straight line between two others."""
    along = [y - x for x, y in zip(a, b, strict=True)]
    length = sum(x * x for x in along)
    share = sum((p - x) * d for p, x, d in zip(point, a, along, strict=True)) / length if length else 0.0
    return math.dist(point, geo.plus(a, (along[0], along[1], along[2]), min(max(share, 0.0), 1.0)))


def _left(place: str, where: str) -> BadInput:
    text = f"{place}pos: {where}"
    return BadInput(text, field=f"{place}pos", value=where, expected="within the geofence", count="fence")

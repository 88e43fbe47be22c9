"""A vehicle's setpoints in the scene: where it is told to be, and how far from there it is."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from ground.view import style
from ground.view.canvas import Canvas, Path
from ground.view.frames import Datum, usable
from zmav import geo, keys, wire
from zmav.wire import Vector

STALE = 2.0 * (keys.SETPOINT.stale_after or 0.5)
"""s after which the last setpoint of a stream is drawn no more"""
MOST = 8
"""senders remembered for one vehicle"""


class Setpoints:
    """The last setpoint of every sender; the lease holder's counts where it has one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last: dict[str, tuple[wire.Setpoint, float]] = {}
        self._fresh = False
        self._segment: int | None = None
        """the sequence number of the one that is drawn"""

    def on_setpoint(self, agent: str, setpoint: wire.Setpoint, mono: float) -> None:
        if agent in self._last or len(self._last) < MOST:
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
        return geo.distance(position, target)

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
        elif setpoint.seq != self._segment:
            self._segment = setpoint.seq
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

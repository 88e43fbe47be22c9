"""Outer-loop commands: one point of a stream at any level of authority, or a trajectory segment."""

from __future__ import annotations

from typing import Literal

from zmav.wire.base import Vector, Wire

Quaternion = tuple[float, float, float, float]
"""w, x, y, z: the rotation from body (forward, right, down) to NED"""


class ManualControl(Wire, kw_only=True):
    """Stick positions as of a joystick (MANUAL_CONTROL): each from -1 to 1, ``z`` (thrust) from 0 to 1."""

    x: float = 0.0
    """pitch stick: forward is positive"""
    y: float = 0.0
    """roll stick: right is positive"""
    z: float = 0.5
    r: float = 0.0
    """yaw stick: clockwise is positive"""
    buttons: int = 0


class SegmentPoint(Wire, kw_only=True):
    """Where to be at time ``t`` (UTC seconds): ``pos`` in metres NED about the fleet's origin, ``vel`` in m/s."""

    t: float
    pos: Vector
    vel: Vector | None = None
    acc: Vector | None = None
    yaw: float | None = None


class WayHome(Wire, kw_only=True):
    """What a vehicle does by itself, by its own clock, where nothing comes any more after the segment that this was
    sent with: it begins where that ends, at rest, and ends at rest above where the vehicle then lands.
    """

    start: float
    """UTC seconds by the vehicle's clock; no sooner than ``returns_after`` s (``body``) past the segment's end"""
    points: list[tuple[float, Vector, Vector]]
    """s since ``start``, place (m NED about the fleet's origin) and velocity; the first at 0, joined as a segment's"""


class Setpoint(Wire, kw_only=True):
    """One point of an outer-loop command stream, or a whole ``segment``.

    ``frame`` "ned": ``pos`` is metres north, east, down about the fleet's origin. "global": ``lat_deg``, ``lon_deg``
    and one of ``alt_amsl``, ``alt_rel``. ``vel`` (m/s) and ``acc`` (m/s²) are NED in either frame. ``yaw`` is radians
    clockwise from north; ``yaw_rate`` rad/s. ``seq`` grows; later than ``deadline`` (UTC seconds) it is not flown.

    Levels of authority, from the outermost to the innermost; one at a time:
    position (with ``vel`` and ``acc`` fed forward: a trajectory), velocity, acceleration;
    ``attitude`` + ``thrust`` (0 to 1; may carry ``rates`` as feed-forward), ``rates`` (rad/s, body) + ``thrust``;
    ``torque`` (-1 to 1, body) + ``thrust``; ``manual`` (sticks); ``rc`` (channel 1 up: µs of PWM, None leaves a channel
    to the pilot's radio); ``servo`` (output 1 up: µs of PWM, None leaves an output alone).
    """

    lease: str
    seq: int
    deadline: float
    frame: Literal["ned", "global"] = "ned"
    pos: Vector | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    vel: Vector | None = None
    acc: Vector | None = None
    yaw: float | None = None
    yaw_rate: float | None = None
    attitude: Quaternion | None = None
    rates: Vector | None = None
    thrust: float | None = None
    torque: Vector | None = None
    manual: ManualControl | None = None
    rc: list[int | None] | None = None
    servo: list[int | None] | None = None
    segment: list[SegmentPoint] | None = None
    """at least two points, times increasing, the last one at rest; flown by the vehicle itself until its end"""
    home: WayHome | None = None
    """what follows the ``segment`` where nothing else comes, and the fleet file has ``return = "together"``"""

"""What a supervisor of a controller is given: what is fixed, what may be changed, and what it is told to follow."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from agents.controllers import loading
from zmav import wire
from zmav.tunable import Tunable


class ControllerSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    controller: str
    """a file that ends in .py, or the name of one that is installed"""
    name: str = ""
    """in keys; empty: that of the file"""
    rate_hz: float = 250.0
    """cycles a second that are wanted of the autopilot"""
    rc: tuple[int, int, int, int] = (1, 2, 3, 4)
    """channels of the pilot's roll, pitch, throttle and yaw"""
    by_switch: bool = False
    """the pilot's switch (``[pilot_switch]`` in the fleet file) turned away from him engages it, too"""
    priority: int = 0
    lease_s: float = 3.0


def slug(what: str) -> str:
    """A name for keys from a file's or a controller's."""
    stem = Path(what).stem.lower() if loading.is_file(what) else what
    return re.sub("[^a-z0-9_-]+", "-", stem).strip("-") or "controller"


TUNABLES: dict[str, Tunable] = {
    "guard_tilt_deg": Tunable(60.0, 5.0, 85.0, "deg", "of tilt at most"),
    "guard_rate_dps": Tunable(400.0, 30.0, 1500.0, "deg/s", "about any axis at most"),
    "guard_low": Tunable(1.0, -1000.0, 1000.0, "m", "above home at least"),
    "guard_high": Tunable(120.0, 1.0, 10000.0, "m", "above home at most"),
    "guard_radius": Tunable(100.0, 1.0, 10000.0, "m", "over the ground from where it took over, at most"),
    "guard_error": Tunable(5.0, 0.1, 100.0, "m", "off a reference of positions at most"),
    "guard_error_deg": Tunable(60.0, 5.0, 180.0, "deg", "off a reference of attitudes at most"),
    "guard_late": Tunable(8.0, 2.0, 25.0, "cycles", "in a row without an output at most"),
    "guard_silent": Tunable(0.1, 0.05, 1.0, "s", "without an attitude at most, and that an output is flown"),
    "stick_tilt_deg": Tunable(35.0, 5.0, 60.0, "deg", "of the full stick"),
    "stick_yaw_dps": Tunable(120.0, 10.0, 400.0, "deg/s", "of the full stick"),
    "stick_rate_dps": Tunable(220.0, 10.0, 720.0, "deg/s", "of roll and pitch of the full stick"),
    "stick_speed": Tunable(3.0, 0.2, 15.0, "m/s", "of the full stick"),
    "stick_climb": Tunable(1.5, 0.2, 5.0, "m/s", "of the full stick"),
    "signals_hz": Tunable(50.0, 1.0, 500.0, "Hz", "of the stream of signals"),
}
"""the envelope, what full sticks ask for, how often signals are told"""


def usual() -> dict[str, float]:
    """Each of them by its name, in its own unit: what guard and references go by, and what is changed in flight."""
    return {name: each.default for name, each in TUNABLES.items()}


class GoTo(wire.Order, kw_only=True):
    """A place to fly to under the controller."""

    pos: wire.Vector
    """m, NED about the fleet's origin"""
    yaw: float | None = None
    """rad"""
    speed: float = 2.0
    """m/s at most"""
    accel: float = 2.0
    """m/s² at most"""


class FollowSegment(wire.Order, kw_only=True):
    """A trajectory to follow under the controller."""

    segment: list[wire.SegmentPoint]


class ByStick(wire.Order, kw_only=True):
    """The pilot's sticks as reference."""

    level: str = "attitude"
    """velocity, attitude or rates"""

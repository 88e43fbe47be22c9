"""What each kind of vehicle is asked in the check flight: data, so that the checks have no branches."""

from __future__ import annotations

from dataclasses import dataclass

from zmav import wire
from zmav.errors import Unsupported

HOVERS = ("ready", "arm", "takeoff", "square", "holder killed", "fence", "speed limit", "pilot", "home")
DRIVES = ("ready", "arm", "square", "holder killed", "fence", "speed limit", "pilot", "home")
CIRCLES = ("ready", "arm", "takeoff", "square", "holder killed", "fence", "pilot", "home")


@dataclass(frozen=True)
class Kind:
    """One kind of vehicle under one autopilot; metres, m/s, seconds."""

    autopilot: str
    kind: str
    pilots_mode: str
    """a mode that a pilot may choose, and no order of the flight's does"""
    steps: tuple[str, ...] = HOVERS
    height: float = 6.0
    """of the takeoff; 0: it has none"""
    side: float = 8.0
    """of the square"""
    least: float = 4.0
    """side below which it is not tried: the fence leaves no room"""
    near: float = 1.5
    """so close to a corner is there"""
    leg: float = 30.0
    """s for one side"""
    velocity: wire.Vector | None = (0.0, 1.5, 0.0)
    """streamed by who is then killed; None: it takes none, and flies to a far place"""
    rests: bool = True
    """its hold is a rest; else it circles"""
    lands: bool = True
    """its way home ends disarmed"""


KINDS = (
    Kind("ardupilot", "copter", "LOITER"),
    Kind("px4", "copter", "HOLD"),
    Kind("ardupilot", "rover", "MANUAL", DRIVES, height=0.0, side=12.0, least=8.0, near=3.2, leg=40.0, lands=False),
    Kind(
        "ardupilot",
        "plane",
        "CIRCLE",
        CIRCLES,
        height=50.0,
        side=300.0,
        least=200.0,
        near=130.0,
        leg=60.0,
        velocity=None,
        rests=False,
        lands=False,
    ),
)


def kind_of(autopilot: str | None, kind: str | None) -> Kind:
    """Raises :class:`Unsupported` for what there is no check flight for."""
    for each in KINDS:
        if (each.autopilot, each.kind) == (autopilot, kind):
            return each
    known = ", ".join(f"{each.kind} by {each.autopilot}" for each in KINDS)
    raise Unsupported(f"there is no check flight for a {kind} by {autopilot}; there is for {known}", kind=kind)

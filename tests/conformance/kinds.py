"""What each kind of vehicle can be asked, and what a check means for it: data, so that the checks have no branches.

A copter hovers, a rover stands, a plane circles. Where a check asks for what a kind cannot do (a rover's takeoff), it
must be refused with the reason, and nothing else happens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from tests.descents import COPTER_HOME, PX4_DOWN
from zmav import wire


@dataclass(frozen=True)
class Kind:
    """One kind of vehicle under one autopilot; metres, m/s, radians.

    ``simulate``: what ``zmav sim`` is told to bring one, beside where it is reached.
    """

    name: str
    autopilot: str
    kind: str
    simulate: tuple[str, ...]
    pilots_mode: str
    """a mode that a pilot may choose at any time, and no order of zmav's does"""
    harmless: tuple[str, ...]
    """a parameter that may be changed, newest firmware's name first"""
    log_magic: bytes
    height: float = 6.0
    """of a takeoff; 0: it has none"""
    reach: float = 12.0
    """how far a check goes: farther than ``near``"""
    near: float = 1.5
    """so close to a place is there"""
    tolerance: float = 1.0
    """of a goto"""
    rests: bool = True
    """it comes to rest; else it circles"""
    velocity: wire.Vector | None = (0.0, 2.0, 0.0)
    """that it can be streamed; None: it takes none, and says so"""
    trajectories: bool = True
    lean: float | None = math.radians(8.0)
    """nose down that an attitude asks for; None: of an attitude it follows the heading"""
    bank: float = 0.0
    """to the right that an attitude asks for"""
    thrust: float = 0.5
    """beside an attitude: about what carries it, or what drives it"""
    lands: bool = True
    """it lands where it is, and disarms itself"""
    lands_at_home: bool = True
    """RTL ends on the ground, disarmed"""
    patience: float = 60.0
    """s for a way of ``reach``"""
    shorter: dict[str, float] = field(default_factory=dict)
    """the simulated one's parameters that make its ways home and down shorter; a real one keeps its own"""


ARDUPILOT_LOG = b"\xa3\x95"
KINDS = (
    Kind(
        "arducopter",
        "ardupilot",
        "copter",
        ("--copters", "1"),
        "LOITER",
        ("WP_RADIUS_M", "WPNAV_RADIUS"),
        ARDUPILOT_LOG,
        shorter=COPTER_HOME,
    ),
    Kind(
        "px4",
        "px4",
        "copter",
        ("--px4", "1"),
        "HOLD",
        ("NAV_ACC_RAD",),
        b"ULog\x01\x12\x35",
        shorter=PX4_DOWN,
    ),
    Kind(
        "ardurover",
        "ardupilot",
        "rover",
        ("--rovers", "1"),
        "MANUAL",
        ("WP_RADIUS",),
        ARDUPILOT_LOG,
        height=0.0,
        reach=8.0,
        near=3.2,
        tolerance=3.0,
        lean=None,
        thrust=0.3,
        lands=False,
        lands_at_home=False,
    ),
    Kind(
        "arduplane",
        "ardupilot",
        "plane",
        ("--planes", "1"),
        "CIRCLE",
        ("WP_RADIUS",),
        ARDUPILOT_LOG,
        height=50.0,
        reach=300.0,
        near=130.0,
        tolerance=130.0,
        rests=False,
        velocity=None,
        trajectories=False,
        lean=0.0,
        bank=math.radians(20.0),
        thrust=0.6,
        lands_at_home=False,
        patience=90.0,
        shorter={"AUTOLAND_WP_DIST": 250.0, "AUTOLAND_WP_ALT": 34.0, "LAND_DISARMDELAY": 2.0},
    ),
)
SIMULATED = ("arducopter", "px4", "ardurover", "arduplane")


def named(name: str) -> Kind:
    return next(kind for kind in KINDS if kind.name == name)


def kind_of(state: wire.VehicleState) -> Kind:
    """Of a vehicle that was heard; an AssertionError names the kinds that there are checks for."""
    found = [k for k in KINDS if (k.autopilot, k.kind) == (state.autopilot, state.kind)]
    assert found, f"no checks for a {state.kind} under {state.autopilot}; there are {[k.name for k in KINDS]}"
    return found[0]

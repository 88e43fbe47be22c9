"""What ArduPilot keeps of a mission item, and what it refuses: a stored command has fifteen bytes, so parameters that
a command does not use are lost, and those it uses become numbers of the size that they are stored with.

After ArduPilot's AP_Mission library; https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from zmav.mavlink.results import MissionResult
from zmav.sim.autopilots.items import LOCATED, Item, check_place

HIGHEST_M = 83_000.0
MISSION_FRAME = 2
ABSOLUTE = (0, MISSION_FRAME, 5)  # MAV_FRAME
RELATIVE = (3, 6)
TERRAIN = (10, 11)

Keep = Callable[[float], float]


def _single(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def _whole(value: float) -> float:
    return float(int(value))


def _none(value: float) -> float:
    return 0.0


def _flag(value: float) -> float:
    return float(value > 0)


def _side(value: float) -> float:
    return -1.0 if value < 0 else 1.0


class Kind(NamedTuple):
    """A command: what STATUSTEXT calls it as it starts, and how its first parameters are kept; the others are lost."""

    name: str
    kept: tuple[Keep, ...] = ()


# By MAV_CMD. Regions of interest, relays, mounts and cameras are kept and do nothing.
KINDS: dict[int, Kind] = {
    16: Kind("WP", (_whole,)),
    17: Kind("LoitUnlim", (_none, _none, _whole)),
    19: Kind("LoitTime", (_whole, _none, _side, _flag)),
    20: Kind("RTL"),
    21: Kind("Land", (_whole, _none, _none, _side)),
    22: Kind("Takeoff", (_whole,)),
    31: Kind("LoitAltitude", (_none, _whole, _none, _flag)),
    177: Kind("Jump", (_whole, _whole)),
    178: Kind("ChangeSpeed", (_whole, _single, _single)),
    179: Kind("SetHome", (_whole,)),
    181: Kind("SetRelay", (_whole, _whole)),
    183: Kind("SetServo", (_whole, _whole)),
    189: Kind("LandStart"),
    195: Kind("SetROILocation", (_whole,)),
    197: Kind("SetROINone", (_whole,)),
    201: Kind("SetROI", (_whole,)),
    203: Kind("DigiCamCtrl", (_whole, _whole, _whole, _whole)),
    205: Kind("MountControl", (_single, _single, _single)),
    206: Kind("SetCamTrigDst", (_single, _none, _whole)),
    1000: Kind("GimbalPitchYaw", (_whole, _whole, _whole, _whole)),
    2000: Kind("ImageStartCapture", (_whole, _single, _whole, _whole)),
    2001: Kind("ImageStopCapture", (_whole,)),
}
_NAN_ALLOWED = {16: (3,), 17: (3,), 21: (3,), 22: (3,)}


def stored(item: Item) -> Item | MissionResult:
    """The item as it is kept, and given back by a download; or why it is not taken."""
    if item.command not in KINDS:
        return MissionResult.INVALID if item.command in (0, 1) else MissionResult.UNSUPPORTED
    allowed = _NAN_ALLOWED.get(item.command, ())
    for index, value in enumerate(item.params):
        if math.isinf(value) or (math.isnan(value) and index not in allowed):
            return MissionResult(MissionResult.INVALID_PARAM1 + index)
    given = [0.0 if math.isnan(value) else value for value in item.params]
    kept = [keep(value) for keep, value in zip(KINDS[item.command].kept, given, strict=False)]
    p1, p2, p3, p4 = kept + [0.0] * (4 - len(kept))
    bare = Item(command=item.command, p1=p1, p2=p2, p3=p3, p4=p4, frame=0, seq=item.seq)
    if item.command in LOCATED:
        return _placed(item, bare)
    return bare


def _placed(item: Item, bare: Item) -> Item | MissionResult:
    bad = check_place(item)
    if bad is not MissionResult.ACCEPTED:
        return bad
    if not abs(item.z) < HIGHEST_M:
        return MissionResult.INVALID_PARAM7
    frame = kept_frame(item.frame)
    if frame is None:
        return MissionResult.UNSUPPORTED_FRAME
    # Altitudes are kept in whole centimetres.
    z = _single(int(_single(item.z * 100.0)) * 0.01)
    return msgspec.structs.replace(bare, frame=frame, x=item.x, y=item.y, z=z)


def kept_frame(frame: int) -> int | None:
    """The MAV_FRAME that a place is kept with; None for one that has no places."""
    groups = ((ABSOLUTE, 0), (RELATIVE, 3), (TERRAIN, 10))
    return next((kept for group, kept in groups if frame in group), None)


def is_navigation(item: Item) -> bool:
    """Only one such command runs at a time; the others run beside it."""
    return item.command <= 95

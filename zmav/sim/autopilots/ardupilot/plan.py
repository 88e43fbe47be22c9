"""What ArduPilot keeps of a mission item, and what it refuses: a stored command has fifteen bytes, so parameters that
a command does not use are lost, and those it uses become numbers of the size that they are stored with.

After ArduPilot's AP_Mission library; https://ardupilot.org/copter/docs/mission-command-list.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import msgspec

from zmav.sim.autopilots.items import LOCATED, Item, Result, check_place

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


# MAV_CMD -> how its parameters 1 to 4 are kept; missing ones are not. Regions of interest, relays, mounts and cameras
# are kept and do nothing.
_KEPT: dict[int, tuple[Keep, ...]] = {
    16: (_whole,),  # NAV_WAYPOINT
    17: (_none, _none, _whole),  # NAV_LOITER_UNLIM
    19: (_whole, _none, _side, _flag),  # NAV_LOITER_TIME
    20: (),  # NAV_RETURN_TO_LAUNCH
    21: (_whole, _none, _none, _side),  # NAV_LAND
    22: (_whole,),  # NAV_TAKEOFF
    31: (_none, _whole, _none, _flag),  # NAV_LOITER_TO_ALT
    177: (_whole, _whole),  # DO_JUMP
    178: (_whole, _single, _single),  # DO_CHANGE_SPEED
    179: (_whole,),  # DO_SET_HOME
    181: (_whole, _whole),  # DO_SET_RELAY
    183: (_whole, _whole),  # DO_SET_SERVO
    189: (),
    195: (_whole,),  # DO_SET_ROI_LOCATION
    197: (_whole,),  # DO_SET_ROI_NONE
    201: (_whole,),  # DO_SET_ROI
    203: (_whole, _whole, _whole, _whole),  # DO_DIGICAM_CONTROL
    205: (_single, _single, _single),  # DO_MOUNT_CONTROL
    206: (_single, _none, _whole),  # DO_SET_CAM_TRIGG_DIST
    1000: (_whole, _whole, _whole, _whole),  # DO_GIMBAL_MANAGER_PITCHYAW
    2000: (_whole, _single, _whole, _whole),  # IMAGE_START_CAPTURE
    2001: (_whole,),
}
_NAN_ALLOWED = {16: (3,), 17: (3,), 21: (3,), 22: (3,)}
_INVALID_PARAM = (Result.INVALID_PARAM1, Result.INVALID_PARAM2, Result.INVALID_PARAM3, Result.INVALID_PARAM4)

NAMES: dict[int, str] = {
    16: "WP",
    17: "LoitUnlim",
    19: "LoitTime",
    20: "RTL",
    21: "Land",
    22: "Takeoff",
    31: "LoitAltitude",
    177: "Jump",
    178: "ChangeSpeed",
    179: "SetHome",
    181: "SetRelay",
    183: "SetServo",
    189: "LandStart",
    195: "SetROILocation",
    197: "SetROINone",
    201: "SetROI",
    203: "DigiCamCtrl",
    205: "MountControl",
    206: "SetCamTrigDst",
    1000: "GimbalPitchYaw",
    2000: "ImageStartCapture",
    2001: "ImageStopCapture",
}
"""What STATUSTEXT calls a command that starts; "?" where there is no name here."""


def stored(item: Item) -> Item | Result:
    """The item as it is kept, and given back by a download; or why it is not taken."""
    if item.command not in _KEPT:
        return Result.INVALID if item.command in (0, 1) else Result.UNSUPPORTED
    allowed = _NAN_ALLOWED.get(item.command, ())
    for index, value in enumerate(item.params):
        if math.isinf(value) or (math.isnan(value) and index not in allowed):
            return _INVALID_PARAM[index]
    given = [0.0 if math.isnan(value) else value for value in item.params]
    kept = [keep(value) for keep, value in zip(_KEPT[item.command], given, strict=False)]
    p1, p2, p3, p4 = kept + [0.0] * (4 - len(kept))
    bare = Item(command=item.command, p1=p1, p2=p2, p3=p3, p4=p4, frame=0, seq=item.seq)
    if item.command in LOCATED:
        return _placed(item, bare)
    return bare


def _placed(item: Item, bare: Item) -> Item | Result:
    bad = check_place(item)
    if bad is not Result.ACCEPTED:
        return bad
    if not abs(item.z) < HIGHEST_M:
        return Result.INVALID_PARAM7
    frames = ((ABSOLUTE, 0), (RELATIVE, 3), (TERRAIN, 10))
    frame = next((kept for group, kept in frames if item.frame in group), None)
    if frame is None:
        return Result.UNSUPPORTED_FRAME
    # Altitudes are kept in whole centimetres.
    z = _single(int(_single(item.z * 100.0)) * 0.01)
    return msgspec.structs.replace(bare, frame=frame, x=item.x, y=item.y, z=z)


def is_navigation(item: Item) -> bool:
    """Only one such command runs at a time; the others run beside it."""
    return item.command <= 95

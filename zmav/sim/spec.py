"""What a simulated vehicle is made of."""

from __future__ import annotations

import math

import msgspec

from zmav.errors import BadConfig
from zmav.keys import check_name
from zmav.sim.camera.spec import CameraSpec, PadSpec, check_bounds, check_pad
from zmav.sim.geo import Position

FARTHEST_M = 1e6
ARDUCOPTER, ARDUROVER, ARDUPLANE, PX4 = "arducopter", "ardurover", "arduplane", "px4"
# What each autopilot can be put on; first what its own simulation drives.
AIRFRAMES = {
    ARDUCOPTER: ("quad", "hexa"),
    PX4: ("sih", "quad", "hexa"),
    ARDUROVER: ("rover",),
    ARDUPLANE: ("plane",),
}
PX4_FIRMWARE = ("1.16", "1.13")


class Home(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Origin of the world's local frame: degrees (WGS84), metres AMSL, and the heading vehicles start with."""

    lat_deg: float = -35.363261
    lon_deg: float = 149.165230
    alt_amsl_m: float = 584.09
    yaw_deg: float = 0.0

    @property
    def position(self) -> Position:
        return Position(self.lat_deg, self.lon_deg, self.alt_amsl_m)


class Stack(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A real flight stack, outside the simulator, that flies a vehicle on the simulator's physics; see
    :mod:`zmav.hil`.

    ``program``: a user's own SITL binary or build tree, to be started (None: it is started by somebody else, and
    connects to ``port``; None: the one that the stack looks for by itself). ``instance``: its number, which its ports
    follow (None: its place among the world's vehicles with such an autopilot).
    ``directory``: where its files are kept (None: nowhere). ``device``: PATH[:BAUD] of a real flight controller.
    """

    program: str | None = None
    port: int | None = None
    instance: int | None = None
    directory: str | None = None
    device: str | None = None


class VehicleSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One vehicle. What is None is chosen by the world; see :mod:`zmav.sim.lineup`.

    ``autopilot``: "arducopter", "ardurover", "arduplane" or "px4". ``airframe``: one of :data:`AIRFRAMES` (None: what
    the autopilot's own simulation drives). ``start_ned_m``: where it stands, metres NED of the world.
    ``endpoints``: see :mod:`zmav.sim.endpoints`. ``uid``: what AUTOPILOT_VERSION tells it apart by. ``params``:
    parameters that differ from the defaults. ``firmware``: whose habits a PX4 has, one of :data:`PX4_FIRMWARE` (None:
    the newest); 1.13 was the last to take torques over MAVLink. ``stack``: who flies it in place of the simulator's
    own autopilot. ``camera``: the downward camera it has; ``pad``: the landing pad it carries.
    """

    name: str | None = None
    sysid: int | None = None
    autopilot: str = ARDUCOPTER
    airframe: str | None = None
    start_ned_m: tuple[float, float, float] | None = None
    yaw_deg: float | None = None
    endpoints: tuple[str, ...] | None = None
    uid: int | None = None
    params: dict[str, float] = {}
    firmware: str | None = None
    camera: CameraSpec | None = None
    pad: PadSpec | None = None
    stack: Stack | None = None


def usual(spec: VehicleSpec) -> tuple[str, ...]:
    """The endpoints of a vehicle for which nobody names any."""
    return ("px4",) if spec.autopilot == PX4 else ("ardupilot",)


def kind_of(spec: VehicleSpec) -> str:
    """What its count on the command line is called by: copter, hexa, rover, plane or px4."""
    if spec.autopilot == ARDUCOPTER:
        return "hexa" if airframe_of(spec) == "hexa" else "copter"
    return spec.autopilot.removeprefix("ardu")


def airframe_of(spec: VehicleSpec) -> str:
    """The name of the airframe it flies."""
    return spec.airframe or AIRFRAMES[spec.autopilot][0]


def check(spec: VehicleSpec, where: str) -> None:
    """:class:`BadConfig` names what in ``spec`` (called ``where``) cannot be."""
    if spec.autopilot not in AIRFRAMES:
        raise _bad(where, "autopilot", spec.autopilot, " or ".join(AIRFRAMES))
    if airframe_of(spec) not in AIRFRAMES[spec.autopilot]:
        raise _bad(where, "airframe", spec.airframe, " or ".join(AIRFRAMES[spec.autopilot]))
    if spec.name is not None:
        check_name(spec.name)
    if spec.sysid is not None and not 1 <= spec.sysid <= 255:
        raise _bad(where, "sysid", spec.sysid, "1 to 255")
    if spec.uid is not None and not 1 <= spec.uid < 1 << 64:
        raise _bad(where, "uid", spec.uid, "1 to 2^64 - 1")
    if spec.yaw_deg is not None and not math.isfinite(spec.yaw_deg):
        raise _bad(where, "yaw_deg", spec.yaw_deg, "degrees")
    if spec.firmware is not None and (spec.autopilot != PX4 or spec.firmware not in PX4_FIRMWARE):
        raise _bad(where, "firmware", spec.firmware, f"{' or '.join(PX4_FIRMWARE)}, of a PX4")
    for name, value in spec.params.items():
        if not math.isfinite(value):
            raise _bad(where, f"params.{name}", value, "a finite number")
    start = spec.start_ned_m
    if start is not None and not all(abs(c) < FARTHEST_M for c in start):
        raise _bad(where, "start_ned_m", start, "three numbers of metres, north, east and down")
    if spec.camera is not None:
        check_bounds(spec.camera, f"{where}: camera")
    if spec.pad is not None:
        check_pad(spec.pad, f"{where}: pad")


def _bad(where: str, field: str, value: object, expected: str) -> BadConfig:
    return BadConfig.wrong(field, value, expected, f"{where}: {field} is {value!r}")

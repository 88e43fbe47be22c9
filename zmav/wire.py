"""Payload types: what travels as JSON under the keys.

Rules of the wire: unknown fields are refused, so that a misspelt one is an error and not a silence. SI units; radians,
and degrees only where a name ends in ``_deg``; latitude and longitude are WGS84; ``alt_amsl`` is metres above mean sea
level and ``alt_rel`` metres above home; local vectors are north, east, down (NED) about the fleet's declared origin.
``t`` is UTC in seconds at the source.
"""

from __future__ import annotations

import re
from typing import Any, Literal, TypeVar

import msgspec

from zmav.errors import BadInput, ZmavError, from_code

Vector = tuple[float, float, float]


class Wire(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """Base of every payload: keyword-only, strict."""


class GlobalPosition(Wire, kw_only=True):
    lat_deg: float
    lon_deg: float
    alt_amsl: float
    alt_rel: float


class Attitude(Wire, kw_only=True):
    """Euler angles of body (FRD) against NED, radians."""

    roll: float
    pitch: float
    yaw: float


class Battery(Wire, kw_only=True):
    voltage: float | None = None
    current: float | None = None
    remaining: float | None = None
    """0 to 1"""


class Gps(Wire, kw_only=True):
    fix: str
    """GPS_FIX_TYPE without its prefix: ``3D_FIX``, ``RTK_FIXED``..."""
    satellites: int | None = None
    hdop: float | None = None


class LinkQuality(Wire, kw_only=True):
    """One link of a vehicle; for the autopilot's own link also every counter of its splitter."""

    t: float
    name: str
    url: str
    state: str
    age: float | None
    """seconds since anything was heard; None: never"""
    rx_rate: float
    """frames a second over the last interval"""
    rx_bytes_rate: float
    loss: float
    """share of the vehicle's own frames lost over the last interval, 0 to 1, from their sequence numbers"""
    rtt: float | None = None
    """seconds, by TIMESYNC"""
    signal: float | None = None
    rx_frames: int = 0
    rx_bytes: int = 0
    lost: int = 0
    """of the vehicle's own frames"""
    bad_crc: int = 0
    bad_length: int = 0
    bad_flags: int = 0
    garbage: int = 0
    unknown: int = 0
    tx_frames: int = 0
    tx_dropped: int = 0
    tx_refused: int = 0
    """frames put on ``mav/tx`` that were not fit to be sent"""
    rx_dropped: int = 0
    """datagrams that the kernel threw away because nobody took them in time (UDP on Linux)"""
    opens: int = 0
    last_error: str | None = None


class LeaseInfo(Wire, kw_only=True):
    holder: str
    expires: float
    """UTC seconds"""


class VehicleState(Wire, kw_only=True):
    """What a vehicle is and does, 5 Hz and on change.

    A part never heard of is None; ``ages``: seconds since each part came, by the vehicle's clock.
    """

    t: float
    fleet: str
    name: str
    instance: str
    """which process speaks: two instances under one name are a clash"""
    connected: bool = False
    """the autopilot's heartbeat is fresh"""
    sysid: int | None = None
    compid: int | None = None
    uid: str | None = None
    autopilot: str | None = None
    """ardupilot, px4 or generic"""
    kind: str | None = None
    """copter, plane, rover, boat, sub, vtol, heli or other"""
    firmware: str | None = None
    mode: str | None = None
    armed: bool | None = None
    status: str | None = None
    """MAV_STATE without its prefix"""
    landed: bool | None = None
    ready: bool | None = None
    not_ready: list[str] = []
    """what is missing before arming, in words"""
    position: GlobalPosition | None = None
    local: Vector | None = None
    """m, NED about the fleet's origin; None where no origin was declared"""
    velocity: Vector | None = None
    """m/s, NED"""
    attitude: Attitude | None = None
    battery: Battery | None = None
    gps: Gps | None = None
    link: str = "closed"
    link_loss: float = 0.0
    ages: dict[str, float] = {}
    lease: LeaseInfo | None = None
    setpoints: dict[str, int] = {}
    """setpoints flown, and those dropped, by reason"""
    clash: str | None = None
    """who else claims the name or system id; commands are refused while it stands"""


Severity = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug"]


class Event(Wire, kw_only=True):
    t: float
    kind: str
    """statustext, mode, armed, autopilot, link, lease, setpoint, clash, refused"""
    severity: Severity
    text: str
    detail: dict[str, Any] = {}


class LastMessage(Wire, kw_only=True):
    """Reply to ``msg/{MSG}``: the fields with enum names, their units, and the age in seconds."""

    name: str
    id: int
    sysid: int
    compid: int
    seq: int
    age: float
    count: int
    signed: bool
    verified: bool
    fields: dict[str, Any]
    units: dict[str, str]


class Setpoint(Wire, kw_only=True):
    """One point of an outer-loop command stream.

    ``frame`` "ned": ``pos`` is metres north, east, down about the fleet's origin. "global": ``lat_deg``, ``lon_deg``
    and one of ``alt_amsl``, ``alt_rel``. ``vel`` (m/s) and ``acc`` (m/s²) are NED in either frame. ``yaw`` is radians
    clockwise from north; ``yaw_rate`` rad/s. ``seq`` grows; later than ``deadline`` (UTC seconds) it is not flown.
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


class Order(Wire, kw_only=True):
    """Base of all ``do/*`` arguments.

    With an ``id`` the order is done once however often it is sent, and answered within ``wait`` seconds with status
    "running" where it takes longer: ask again with the same id. Without one, the answer is the end of it.
    """

    id: str = ""
    wait: float = 0.5
    lease: str = ""


class Arm(Order, kw_only=True):
    ready_timeout: float = 60.0
    """seconds to wait for the autopilot to be ready; 0: try at once"""


class Takeoff(Order, kw_only=True):
    alt_rel: float
    """m above home"""


class GoTo(Order, kw_only=True):
    """Fly to a point; ``frame`` and fields as in :class:`Setpoint`. Done when within ``tolerance`` metres of it."""

    frame: Literal["ned", "global"] = "ned"
    pos: Vector | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_amsl: float | None = None
    alt_rel: float | None = None
    yaw: float | None = None
    tolerance: float = 1.0
    timeout: float = 300.0
    arrive: bool = True
    """False: done as soon as the autopilot has the target"""


class SetMode(Order, kw_only=True):
    mode: str


class TakeLease(Order, kw_only=True):
    holder: str
    ttl: float = 3.0
    """seconds; every setpoint under the lease renews it"""


class DropLease(Order, kw_only=True):
    pass


class Outcome(Wire, kw_only=True):
    """Reply to ``do/*``."""

    verb: str
    status: Literal["done", "running"]
    took: float
    """seconds since the order was first heard"""
    result: dict[str, Any] = {}


class AgentStatus(Wire, kw_only=True):
    t: float
    agent: str
    state: str
    text: str = ""
    detail: dict[str, Any] = {}


class Origin(Wire, kw_only=True):
    """The fleet's declared origin, about which every local frame is."""

    lat_deg: float
    lon_deg: float
    alt_amsl: float


class ErrorBody(Wire, kw_only=True):
    """Payload of an error reply: see :mod:`zmav.errors`."""

    code: str
    message: str
    detail: dict[str, Any] = {}


W = TypeVar("W", bound=msgspec.Struct)
_encoder = msgspec.json.Encoder(enc_hook=str)
_NAMED_FIELD = re.compile(r"field `([^`]*)`")


def encode(payload: msgspec.Struct) -> bytes:
    """JSON bytes; NaN and infinities become null."""
    return _encoder.encode(payload)


def decode(data: bytes, kind: type[W], what: str) -> W:
    """``data`` as a ``kind``; raises :class:`BadInput` that names the field and what was expected."""
    try:
        return msgspec.json.decode(data or b"{}", type=kind)
    except msgspec.ValidationError as e:
        text, _, path = str(e).partition(" - at `$")
        named = _NAMED_FIELD.search(text)  # a missing or an unknown field: the path is that of the object around it
        field = ".".join(filter(None, (path.strip("`").lstrip("."), named and named[1]))) or kind.__name__
        raise BadInput(f"{what}: {text} (at {field})", field=field, value=_clip(data), expected=text) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise BadInput(f"{what}: not JSON: {e}", field=what, value=_clip(data), expected="a JSON object") from None


def _clip(data: bytes) -> str:
    return data[:80].decode("utf-8", "replace")


def error_body(error: ZmavError) -> bytes:
    return encode(ErrorBody(code=error.code, message=error.message, detail=error.detail))


def error_from(data: bytes) -> ZmavError:
    """The exception an error reply stands for."""
    try:
        body = msgspec.json.decode(data, type=ErrorBody)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return ZmavError(_clip(data) or "an error without a text")
    return from_code(body.code, body.message, body.detail)

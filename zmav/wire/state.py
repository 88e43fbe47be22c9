"""What a vehicle says of itself: its state, its events, its links, its last messages."""

from __future__ import annotations

from typing import Any, Literal

from zmav.wire.base import Told, Vector, Wire
from zmav.wire.swarm import SegmentInfo
from zmav.wire.traffic import TrafficInfo


class GlobalPosition(Told, kw_only=True):
    lat_deg: float
    lon_deg: float
    alt_amsl: float
    alt_rel: float


class Attitude(Told, kw_only=True):
    """Euler angles of body (FRD) against NED, radians."""

    roll: float
    pitch: float
    yaw: float


class Battery(Told, kw_only=True):
    voltage: float | None = None
    current: float | None = None
    remaining: float | None = None
    """0 to 1"""
    time_left: float | None = None
    """s, by the autopilot's own estimate; of several batteries the least; None: it gives none, as most do"""


class Gps(Told, kw_only=True):
    fix: str
    """GPS_FIX_TYPE without its prefix: ``3D_FIX``, ``RTK_FIXED``..."""
    satellites: int | None = None
    hdop: float | None = None
    h_acc: float | None = None
    """m, the receiver's own estimate of its horizontal error"""


class CorrectionsInfo(Told, kw_only=True):
    """Corrections for the autopilot's GNSS receiver, as its agent hands them on."""

    age: float | None
    """s since the source had the newest observations that the autopilot was given, by the source's clock; None: it was
    given none yet"""
    source: str
    """who sends them"""
    station: int | None = None
    """the reference station's id"""
    baseline: float | None = None
    """m from the vehicle to the base; None: the base has not said where it is, or the vehicle does not know"""
    rate: float = 0.0
    """bytes a second that the autopilot gets of them"""
    dropped: dict[str, int] = {}
    """messages that it did not get, by reason: old, ahead, overtaken, standby, malformed, link, full"""


class Estimate(Told, kw_only=True):
    """How well the autopilot's own filter knows where it is (EKF_STATUS_REPORT, ESTIMATOR_STATUS)."""

    accuracy: float | None = None
    """m across, one standard deviation, as the filter reckons; None: it does not say"""
    ratio: float | None = None
    """how much of what its filter allows its position is off what its sensors say: from 1 on these are refused"""


class ClockInfo(Told, kw_only=True):
    """The autopilot's clock against UTC, by TIMESYNC."""

    boot_t: float
    """UTC seconds at which its time was zero"""
    error_s: float
    """how far from the companion's UTC a time of the autopilot's can be"""
    drift_ppm: float = 0.0
    """µs a second by which a simulation's falls behind the companion's; zero of a real one"""
    gps_offset_s: float | None = None
    """s by which GPS time is ahead of the companion's UTC; None: no GPS time yet"""


class LeaseInfo(Told, kw_only=True):
    """The lease in force."""

    holder: str
    expires: float
    """UTC seconds"""
    priority: int = 0
    number: int = 0
    """of all the leases this vehicle's agent has granted: what tells two of one holder apart"""
    origin: str | None = None
    """whose certificate proved the order that took it; None: no proofs are asked for"""


LeaseEnding = Literal["expired", "released", "revoked", "preempted", "gone", "pilot", "failsafe", "clock"]


class LeaseEnd(Told, kw_only=True):
    """How the last lease that ended did: where its holder reads what took the vehicle."""

    t: float
    number: int
    holder: str
    reason: LeaseEnding
    """expired: nobody renewed it; gone: its holder's liveliness token went; pilot: the pilot, another station or the
    autopilot itself changed the mode or disarmed; failsafe: the stream was silent for land_after; clock: the vehicle's
    time was set, so that a segment would not be flown when its holder means it"""
    text: str
    by: str | None = None
    """who took it, where somebody did"""


class VehicleState(Told, kw_only=True):
    """What a vehicle is and does, 5 Hz and on change.

    A part never heard of is None; ``ages``: seconds since each part came, by the vehicle's clock.
    """

    t: float
    fleet: str
    name: str
    instance: str
    """which process speaks: two instances under one name are a clash"""
    replayed: bool = False
    """it is a recording, which takes no orders: see :func:`zmav.keys.replay_of`"""
    connected: bool = False
    """the autopilot's heartbeat is fresh"""
    sysid: int | None = None
    compid: int | None = None
    uid: str | None = None
    autopilot: str | None = None
    """ardupilot, px4 or generic"""
    kind: str | None = None
    """copter, plane, rover, boat, vtol, heli or other"""
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
    estimate: Estimate | None = None
    corrections: CorrectionsInfo | None = None
    """for its GNSS receiver; None: none came within the last ten minutes"""
    traffic: TrafficInfo | None = None
    """the aircraft that it warns of, the worst; None: none"""
    link: str = "closed"
    link_loss: float = 0.0
    clock: ClockInfo | None = None
    ages: dict[str, float] = {}
    lease: LeaseInfo | None = None
    lease_end: LeaseEnd | None = None
    """of the last lease that ended"""
    segment: SegmentInfo | None = None
    """the committed trajectory in force; None: none under the present lease"""
    mover: str = "nobody"
    """what its agent moves it by: pilot, order, target, segment, stream, hold, failsafe; nobody: the autopilot flies by
    itself, or stands"""
    pilot: str | None = None
    """why no agent may have the vehicle: the pilot's switch"""
    setpoints: dict[str, int] = {}
    """setpoints flown, and those dropped, by reason"""
    clash: str | None = None
    """who else claims the name or system id; commands are refused while it stands"""
    gate: str | None = None
    """what a proof of origin for this vehicle answers (16 hexadecimal digits), new with each start of its agent; None:
    it asks for no proofs"""
    forbidden: dict[str, int] = {}
    """orders and frames whose proof of origin was refused, by reason"""


Severity = Literal["emergency", "alert", "critical", "error", "warning", "notice", "info", "debug"]


class Event(Told, kw_only=True):
    t: float
    kind: str
    """statustext, numbered (an EVENT), mode, armed, autopilot, link, lease, setpoint, pilot, failsafe,
    rate, clock, mission, clash, certificate, corrections, traffic, refused, fault"""
    severity: Severity
    text: str
    detail: dict[str, Any] = {}


class LastMessage(Told, kw_only=True):
    """Reply to ``msg/{MSG}``: the fields with enum names, their units, and the age in seconds."""

    name: str
    id: int
    sysid: int
    compid: int
    seq: int
    age: float
    t: float | None = None
    """UTC seconds at which the autopilot took it, by the message's own time; None where it has none or the clocks are
    not in step yet"""
    t_error: float | None = None
    """s that ``t`` can be wrong by, against the companion's UTC; None where the autopilot gave UTC itself"""
    count: int
    signed: bool
    verified: bool
    fields: dict[str, Any]
    units: dict[str, str]


class AgentStatus(Told, kw_only=True):
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

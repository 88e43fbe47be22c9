"""What services need to know about an autopilot: one interface, and the data that differs by vehicle kind.

Nothing here talks: an autopilot turns intents into commands and messages and judges what came back, so that each file
can be read against its vendor's documentation. Facts are those measured on ArduPilot 4.7 and PX4 1.16.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import msgspec

from zmav.errors import BadInput, Unsupported
from zmav.mavlink import Dialect
from zmav.wire import ManualControl, Quaternion, Vector

Level = Literal[
    "position", "velocity", "acceleration", "trajectory", "attitude", "rates", "torque", "manual", "rc", "servo"
]

NAN = math.nan
HERE = 0x7FFFFFFF
"""x and y of a COMMAND_INT that names no place"""
Fields = Mapping[str, Any]
Latest = Callable[[str], "Fields | None"]
"""The decoded fields of the vehicle's last message of that name; None: never heard, or too old to judge by"""


@dataclass(frozen=True)
class Command:
    """A MAV_CMD with param1 to param7; ``frame`` given, it goes as COMMAND_INT with x = lat·1e7, y = lon·1e7."""

    name: str
    params: tuple[float, ...] = ()
    frame: str | None = None

    def padded(self) -> tuple[float, ...]:
        return (*self.params, *(0.0,) * (7 - len(self.params)))

    def message(self, dialect: Dialect, attempt: int = 0) -> Message:
        """As it travels: COMMAND_LONG, or COMMAND_INT where it has a frame. ``attempt`` counts from 0."""
        p = self.padded()
        fields: dict[str, Any] = {f"param{i + 1}": p[i] for i in range(4)}
        fields["command"] = dialect.value("MAV_CMD", self.name)
        if self.frame is None:
            return Message("COMMAND_LONG", {**fields, **dict(zip(LAST, p[4:], strict=True)), "confirmation": attempt})
        frame = dialect.value("MAV_FRAME", self.frame)
        return Message("COMMAND_INT", {**fields, "x": int(p[4]), "y": int(p[5]), "z": p[6], "frame": frame})


LAST = ("param5", "param6", "param7")


@dataclass(frozen=True)
class Message:
    """A MAVLink message to send; :meth:`addressed` adds the target."""

    name: str
    fields: dict[str, Any] = field(default_factory=dict)

    def addressed(self, system: int, component: int) -> dict[str, Any]:
        """All its fields for that vehicle: MANUAL_CONTROL alone calls the target otherwise."""
        if self.name == "MANUAL_CONTROL":
            return {"target": system, **self.fields}
        return {"target_system": system, "target_component": component, **self.fields}


def commands(names: str) -> frozenset[str]:
    """MAV_CMDs by the rest of their names, between blanks."""
    return frozenset(f"MAV_CMD_{name}" for name in names.split())


Action = Message | Command
"""What a setpoint becomes: a message to be sent as it is, or a command, which the autopilot answers"""


class Target(msgspec.Struct, frozen=True):
    """What is asked for at one level of authority, in the terms autopilots share.

    WGS84 degrees, metres, NED m/s and m/s², radians; ``alt_rel`` is above home. A position needs ``lat_deg``,
    ``lon_deg`` and one of the altitudes. ``attitude`` is w, x, y, z from body (forward, right, down) to NED, of length
    1; ``rates`` rad/s and ``torque`` (-1 to 1) about the body's axes; ``thrust`` 0 to 1; ``rc`` and ``servo`` µs of PWM
    from channel 1 up.
    """

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
    rc: tuple[int | None, ...] | None = None
    servo: tuple[int | None, ...] | None = None

    @property
    def level(self) -> Level:
        """The level of authority; ``trajectory`` is a position with a velocity or an acceleration fed forward."""
        if self.lat_deg is not None:
            return "position" if self.vel is None and self.acc is None else "trajectory"
        if self.vel is not None:
            return "velocity"
        if self.acc is not None:
            return "acceleration"
        if self.attitude is not None:
            return "attitude"
        if self.torque is not None:
            return "torque"
        if self.rates is not None:
            return "rates"
        if self.manual is not None:
            return "manual"
        return "rc" if self.rc is not None else "servo"

    @property
    def inner(self) -> bool:
        """It is for a loop within that of the velocities: an old one leads anywhere."""
        return self.attitude is not None or self.rates is not None or self.torque is not None


@dataclass(frozen=True)
class Need:
    """What a parameter of the autopilot must be for a level to mean what it says.

    ``params``: its name, newest firmware's first. ``wanted``: the value it should have, from the one it has and the
    vehicle's system id. ``fatal``: as long as it has not, such setpoints do nothing.
    """

    params: tuple[str, ...]
    wanted: Callable[[int, int], int]
    fatal: bool
    why: str

    def unmet(self, param: Callable[[str], float | None], sysid: int) -> str | None:
        """Why not, and what to set; None: it is met, or the parameter is not known. ``param`` gives values by name."""
        for name in self.params:
            value = param(name)
            if value is not None and math.isfinite(value):
                wanted = self.wanted(int(value), sysid)
                return None if int(value) == wanted else f"{self.why}: set {name} to {wanted} (it is {int(value)})"
        return None


@dataclass(frozen=True)
class MissionRules:
    """How a flight stack keeps and flies missions; the defaults are what the protocol promises of any autopilot."""

    mode: str | None = None
    """the mode that flies the mission; None: MAV_CMD_MISSION_START alone"""
    start_command: bool = True
    """MAV_CMD_MISSION_START begins it (a copter on the ground takes off by it)"""
    home_first: bool = False
    """item 0 on the autopilot is home, and no part of the mission"""
    window: int = 1
    """items that may be under way at once: more than one where each request of a download stands for itself, and an
    upload takes the next item as soon as it has the one before, asked for or not"""
    files: frozenset[str] = frozenset()
    """kinds of plans that a disarmed vehicle lets be read as files, too: :mod:`zmav.mavlink.plan_file`"""
    set_by_command: bool = True
    """it knows MAV_CMD_DO_SET_MISSION_CURRENT; False: the message MISSION_SET_CURRENT alone"""
    mission_frame: bool = False
    """items without a place are taken in MAV_FRAME_MISSION only"""
    never_placed: frozenset[str] = frozenset()
    """commands that it takes without a place only, though MAVLink gives them one"""
    exact: bool = True
    """every item is kept as it was sent; False: parameters are rounded, or left out where the vehicle ignores them"""


Convert = Callable[[Target], "list[Action]"]


@dataclass(frozen=True)
class Mode:
    """What DO_SET_MODE takes: base mode flags, then custom mode (ArduPilot) or main and sub mode (PX4)."""

    name: str
    custom: int
    command: Command


class Autopilot(ABC):
    """One flight stack; instances are of one vehicle kind and hold no state. What a stack says nothing of is what the
    common dialect promises, and no more.
    """

    name: ClassVar[str]
    floor: ClassVar[Mapping[str, float]]
    """messages that always flow, and their rate in Hz; what a VehicleState is made of"""
    log_suffix: ClassVar[str] = ""
    """of a flight log's file"""
    mode_message: ClassVar[str | None] = None
    """what tells the mode, and the one intended, sooner than HEARTBEAT does: CURRENT_MODE, or what has its fields"""
    unrated: ClassVar[frozenset[str]] = frozenset()
    """messages whose rate it does not let itself be told"""
    never_rated: ClassVar[tuple[int, ...]] = (2, 3)
    """MAV_RESULTs of a rate that say that asking again changes nothing: denied and unsupported"""
    logs_while_armed: ClassVar[bool] = True
    """whether it gives out logs while armed"""
    log_ids_are_places: ClassVar[bool] = False
    """a log's id is its place in a directory, from 0: no order of time, and LOG_ENTRY's last_log_num is no id"""
    report_checks: ClassVar[Command | None] = None
    """what makes it report its arming checks as events, where it does not so by itself"""
    command_frame: ClassVar[str] = "MAV_FRAME_GLOBAL_RELATIVE_ALT"
    """what the place of a COMMAND_LONG is taken in, which names no frame"""
    ignores_frames: ClassVar[bool] = False
    """a command's altitude is above the sea, whatever frame is given, and 0, 0 is a place like any other"""
    params_bytewise: ClassVar[bool] = False
    """how integer parameters travel where AUTOPILOT_VERSION does not tell: as their bytes, or cast to float"""
    own_params: ClassVar[tuple[str, ...]] = ()
    """shell patterns of parameters that are each vehicle's own: its system id, and what the autopilot writes by itself
    (counters, ids of sensors it found, measurements)"""

    switches: ClassVar[frozenset[int]] = frozenset()
    """functions of MAV_CMD_DO_AUX_FUNCTION that arm, disarm or fly the mission, which the orders for it would judge"""
    camera_params: ClassVar[tuple[str, ...]] = ()
    """each 0 where that camera is none: with none at all it may accept what triggers one"""
    missions: MissionRules = MissionRules()
    circle_param: str | None = None
    """the parameter with the radius (m) of its circles, where it circles a place instead of stopping there"""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self._modes: dict[str, Mode] = {}

    def told(self, capabilities: int) -> Autopilot:
        """The rules of one that says it has these: AUTOPILOT_VERSION's MAV_PROTOCOL_CAPABILITY."""
        return self

    @property
    def on_surface(self) -> bool:
        """It keeps to the ground or the water: where it is has no height of its own choosing."""
        return self.kind in ("rover", "boat")

    def mode_name(self, base_mode: int, custom_mode: int) -> str:
        """The mode's name as the vendor writes it; ``MODE_23`` where it is not known."""
        return f"MODE_{custom_mode}"

    def modes(self) -> dict[str, Mode]:
        """Every mode by name."""
        return self._modes

    def mode(self, name: str) -> Mode:
        """The mode of that name, in any case; raises :class:`BadInput` listing the modes there are."""
        modes = self.modes()
        found = modes.get(name.upper())
        if found is None:
            known = ", ".join(modes) or "none known"
            text = f"no mode {name!r} on this {self.name} {self.kind}; it has {known}"
            raise BadInput(text, field="mode", value=name, expected=known)
        return found

    def mode_by(self, command: Command) -> str | None:
        """The mode that a MAV_CMD_DO_SET_MODE enters; None: none that is known."""
        for mode in self.modes().values():
            given = mode.command.params
            if mode.command.name == command.name and command.padded()[: len(given)] == tuple(given):
                return mode.name
        return None

    @abstractmethod
    def missing(self, latest: Latest, checks: Sequence[str] = ()) -> list[str]:
        """What is not ready for arming, in words; empty: ready. ``checks``: what its own report of its checks says."""

    def has_position(self, latest: Latest) -> bool:
        """GLOBAL_POSITION_INT can be believed: it also flows before there is a fix."""
        position = latest("GLOBAL_POSITION_INT")
        return position is not None and bool(position["lat"] or position["lon"])

    @property
    def guided(self) -> str:
        """The mode in which the vehicle follows setpoints."""
        raise self.unsupported("a guided mode")

    def arming_mode(self, mode: str | None) -> str | None:
        """The mode to enter before arming, where it cannot be armed in ``mode`` (a landing has just ended in LAND) or
        would take off by itself.
        """
        return None

    arming_needs: tuple[Need, ...] = ()
    """what its parameters must be for it to be armed by a companion alone"""

    def arm(self, on: bool) -> Command:
        """MAV_CMD_COMPONENT_ARM_DISARM, never forced: a disarm in the air is refused by the autopilot."""
        return Command("MAV_CMD_COMPONENT_ARM_DISARM", (1.0 if on else 0.0,))

    def takeoff(self, alt_rel: float, latest: Latest) -> tuple[str | None, Command | None]:
        """The mode to enter first and the command then given, to climb to ``alt_rel`` metres above home."""
        return None, Command("MAV_CMD_NAV_TAKEOFF", (0, 0, 0, 0, 0, 0, alt_rel))

    takeoff_ends: ClassVar[tuple[str, float] | None] = None
    """the mode that its own takeoff goes over to, and how far (m) below the height told it may end and stay"""

    def climb_on(self, alt_rel: float, latest: Latest) -> Command:
        """What leads it up to ``alt_rel`` metres above home from where its takeoff ended."""
        raise self.unsupported("a climb after the takeoff")

    def hold(self) -> tuple[str, Message | None]:
        """The mode, and the message then sent, that stop the vehicle where it is."""
        raise self.unsupported("hold")

    pause: ClassVar[Command | None] = None
    """what stops it on its way to a place in the mode of :meth:`hold`, where entering that again changes nothing"""

    stream_lost: ClassVar[tuple[str, ...]] = ()
    """modes that it enters by itself when the stream ends, its intention staying :attr:`guided`"""
    failsafe_waits: ClassVar[tuple[str, float]] = ("", 0.0)
    """the parameter of how long (s), and how long without it known, a failsafe waits in the mode of :meth:`hold` before
    it acts: a change of the mode would end it, and that mode ordered is one"""

    def land(self) -> str:
        """The mode that lands the vehicle where it is."""
        raise self.unsupported("land by mode")

    lands_after_rtl: bool = True
    """a return to launch ends on the ground, disarmed"""
    home_circle_param: str | None = None
    """the parameter of the radius of its circle over home, where that is not ``circle_param``'s; 0: it is that"""
    home_height_params: tuple[str, ...] = ()
    """parameters, one of which above 0 has it hover over home and not land"""

    def rtl(self) -> str:
        """The mode that returns to launch."""
        raise self.unsupported("a return to launch")

    def servo(self, output: int, pwm: int) -> Command:
        """One output (from 1) to a PWM in µs."""
        return Command("MAV_CMD_DO_SET_SERVO", (float(output), float(pwm)))

    def loiter(self) -> str:
        """The mode that stays where it is without anybody's orders, whatever the sticks are left at."""
        raise self.unsupported("loiter")

    def placed(self, target: Target, latest: Latest) -> Target:
        """``target`` with the kind of altitude that this autopilot's commands take."""
        return target

    def goto(self, target: Target) -> Command | Message:
        """Fly to one point and stay there."""
        return reposition(target)

    # The stream of setpoints.

    keepalive_hz: float = 4.0
    """how often the autopilot must hear a setpoint that is still wanted"""
    engage_after: float = 0.0
    """s of stream that must have flown on the ground before the mode that follows it may be asked for; 0: none need"""
    levels: Mapping[Level, Convert | str] = {}
    """what each level becomes, or why there is no such thing here"""
    modes_by_level: Mapping[Level, str | None] = {"manual": None, "rc": None, "servo": None}
    """where the mode is not ``guided``; None: whatever mode the vehicle is in"""
    needs_by_level: Mapping[Level, tuple[Need, ...]] = {}

    def engages_after(self, level: Level, flies: bool) -> float:
        """:attr:`engage_after` for a stream of that level; ``flies``: it has left the ground."""
        return self.engage_after

    def setpoint(self, target: Target) -> list[Action]:
        """One point of a stream at any level; raises :class:`Unsupported` with the reason."""
        return self._convert(target.level)(target)

    def guided_for(self, target: Target) -> str | None:
        """The mode that follows such setpoints; None: any (sticks and outputs act in the mode the vehicle is in).

        Raises :class:`Unsupported` for a level there is not.
        """
        level = target.level
        self._convert(level)
        if level in self.modes_by_level:
            return self.modes_by_level[level]
        return self.guided

    def needs(self, target: Target) -> tuple[Need, ...]:
        """What the autopilot's parameters must be for it."""
        return self.needs_by_level.get(target.level, ())

    def release(self, target: Target) -> list[Message]:
        """What lets go of what ``target`` took, where silence alone would keep it for a while."""
        return []

    def _convert(self, level: Level) -> Convert:
        how = self.levels.get(level, f"{level} setpoints are not something {self.name} does with a {self.kind}")
        if isinstance(how, str):
            others = [each for each, convert in self.levels.items() if not isinstance(convert, str)]
            raise Unsupported(how, field=level, value=level, expected=", ".join(others))
        return how

    def hold_mode(self) -> str:
        """The mode in which it holds."""
        return self.hold()[0]

    def unsupported(self, what: str) -> Unsupported:
        return Unsupported(f"{what} is not something {self.name} does with a {self.kind}")


def mode_of(names: Callable[[], str]) -> str | None:
    """What an autopilot's method such as ``land`` names; None: it has no such mode."""
    try:
        return names()
    except Unsupported:
        return None


def reposition(
    target: Target, *, speed: float | None = None, radius: float | None = None, change_mode: bool = True
) -> Command:
    """MAV_CMD_DO_REPOSITION as COMMAND_INT; ``speed`` in m/s over the ground, ``radius`` in m (a plane circles).

    ``change_mode``: enter the guided mode for it, where the vehicle is in another.
    """
    if target.lat_deg is None or target.lon_deg is None:
        raise BadInput("a reposition needs a position", field="lat_deg", value=None, expected="a position")
    relative = target.alt_amsl is None
    return Command(
        "MAV_CMD_DO_REPOSITION",
        (
            -1.0 if speed is None else speed,
            1.0 if change_mode else 0.0,
            0.0 if radius is None else radius,
            NAN if target.yaw is None else target.yaw,
            round(target.lat_deg * 1e7),
            round(target.lon_deg * 1e7),
            (target.alt_rel if relative else target.alt_amsl) or 0.0,
        ),
        "MAV_FRAME_GLOBAL_RELATIVE_ALT" if relative else "MAV_FRAME_GLOBAL",
    )


def custom_mode(name: str, number: int) -> Mode:
    """A mode of MAV_MODE_FLAG_CUSTOM_MODE_ENABLED with one number."""
    return Mode(name, number, Command("MAV_CMD_DO_SET_MODE", (1.0, float(number))))

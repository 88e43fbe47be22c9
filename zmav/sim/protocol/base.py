"""What the MAVLink face of any autopilot does: channels, routing, streams, and handing each message to who answers
it.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from zmav.errors import BadMessage
from zmav.mavlink.codec import decode
from zmav.mavlink.dialect import Dialect
from zmav.mavlink.frames import Frame
from zmav.mavlink.results import CommandResult
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.autopilots.px4.copter import Px4Copter
from zmav.sim.fleets.base import Seat
from zmav.sim.protocol.channel import FORCE, Answer, Channel, Command, Outlet, Part, Sender, read_command
from zmav.sim.protocol.corrections import CorrectedReceiver
from zmav.sim.protocol.gimbal import HANDLERS as GIMBAL_HANDLERS
from zmav.sim.protocol.gimbal import SimGimbal
from zmav.sim.protocol.router import Router
from zmav.sim.protocol.streams import HEARTBEAT_PERIOD_S
from zmav.sim.sensors.magnetic import earth_field

COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1
REBOOT_DELAY_S = 0.2
THINKING_S = 0.019  # between two thoughts of an autopilot, and a little less
_NO_NUMBER = (BadMessage, ArithmeticError, ValueError)
_WARNING = 4  # MAV_SEVERITY
GIT_HASH = "zmav-sim"

CLOCKS = {"time_boot_ms": 1e3, "time_usec": 1e6}
"""fields that carry the time since boot, and their units a second; :meth:`Node.fields` fills them in"""

Brain = ArduVehicle | Px4Copter
Fields = dict[str, Any]
Report = Callable[[Any], "Fields | None"]
"""From a node to the fields of a message; None where there is nothing to say yet"""
Handler = Callable[[Any, Command], "int | bool"]
"""Carries out a command for a node; gives a MAV_RESULT, or whether it was done"""
Target = Callable[[Any, dict[str, Any]], None]
"""Applies a setpoint message to a vehicle"""


class Node(ABC):
    """Speaks for one autopilot as system ``sysid``, component 1. Everything here runs in the world's thread.

    A subclass names what it can report, which commands and setpoints it takes, and what else it answers; :meth:`add`
    gives it further microservices.
    """

    SYSID_PARAM: ClassVar[str]
    REPORTS: ClassVar[Mapping[str, Report]]
    HANDLERS: ClassVar[Mapping[int, Handler]]
    """by MAV_CMD; any other is answered MAV_RESULT_UNSUPPORTED"""
    TARGETS: ClassVar[Mapping[str, Target]]
    REFUSED: ClassVar[int]
    """MAV_RESULT of a command that could not be done"""
    ANSWERED_TWICE: ClassVar[tuple[int, ...]] = ()
    """commands that are accepted when they are read, too"""
    COMMANDS_NOT_SIMULATED: ClassVar[tuple[int, ...]]
    """commands that the real firmware takes, and about which it says that they are not simulated"""
    TEXT_END: ClassVar[str] = ""
    """of every text"""
    TIMESYNC_PERIOD_S: ClassVar[float] = 10.0
    UNKNOWN_INTERVAL, UNKNOWN_REQUEST, UNKNOWN_PERIOD = CommandResult.DENIED, CommandResult.FAILED, CommandResult.FAILED
    """MAV_RESULT of SET_MESSAGE_INTERVAL, REQUEST_MESSAGE and GET_MESSAGE_INTERVAL for a message that there is not"""
    ACKS_FIRST: ClassVar[bool] = True
    """a message that was asked for comes after the acknowledgement"""
    STANDS_IN: ClassVar[bool] = True
    """it answers what is asked of a component that is not there, as ArduPilot does"""

    def __init__(self, brain: Brain, dialect: Dialect, *, uid: int, epoch_us: int) -> None:
        self.brain = brain
        self.dialect = dialect
        self.uid = uid
        self.field = earth_field(brain.world.lat_deg, brain.world.lon_deg)
        self.seat: Seat  # where its body is simulated; set by who puts both together
        self.channels: list[Channel] = []
        self.bad_messages = 0
        self._epoch_us = epoch_us
        self.late_us = 0
        """by which simulated time fell behind real time: a receiver tells UTC nevertheless"""
        self._router = Router(dialect, stands_in=self.STANDS_IN)
        self.parts: list[Part] = []
        """all microservices that were added"""
        self.hung = False
        """a fault: it hears and says nothing"""
        self._ticking: list[Part] = []  # those that do something at a tick
        reported = {name: dialect.by_name[name] for name in self.REPORTS if name in dialect.by_name}
        self._ids = {message.id: name for name, message in reported.items()}
        self._clocks = {
            name: clock for name, message in reported.items() for clock in CLOCKS if clock in message.by_name
        }
        self._answers: dict[int, Answer] = {}
        self._pending: list[tuple[Channel, str]] = []
        self._next_timesync = self.TIMESYNC_PERIOD_S
        self._reboot_at: float | None = None
        self.on_defect: Callable[[Exception], None] = _raise
        self.timesync_answered: Callable[[Channel, int], None] = lambda channel, question: None
        self.receiver = CorrectedReceiver(self)
        self.gimbal = SimGimbal(self)
        self.answer("GPS_RTCM_DATA", self.receiver.take)
        self.answer("GIMBAL_MANAGER_SET_ATTITUDE", self.gimbal.set_attitude)
        self.answer("TIMESYNC", self._timesync)
        self.answer("PING", self._ping)
        self.answer("COMMAND_LONG", self._command)
        self.answer("COMMAND_INT", self._command)
        for name, target in self.TARGETS.items():
            self.take_target(name, target)
        brain.say, brain.beat, brain.announce = self.say, self.beat, self.announce
        self.brain.params.watch(self._param_changed)

    def answer(self, name: str, answer: Answer) -> None:
        """Have messages of that name answered by ``answer`` from now on."""
        self._answers[self.dialect.by_name[name].id] = answer

    def take_target(self, name: str, target: Target) -> None:
        """Have setpoint messages of that name applied by ``target`` from now on."""
        self.answer(name, lambda channel, msg, sender: target(self.brain, msg))

    def add(self, part: Part) -> None:
        """Offer a further microservice."""
        self.parts.append(part)
        if type(part).tick is not Part.tick:
            self._ticking.append(part)
        for name, answer in part.answers().items():
            self.answer(name, answer)

    # ---- what a subclass says

    @abstractmethod
    def say(self, severity: int, text: str) -> None:
        """A STATUSTEXT to whom it may concern."""

    def greet(self, channel: Channel) -> None:  # noqa: B027 - not every autopilot sends anything by itself
        """A link was opened: start what is sent there unasked."""

    def usual_period(self, channel: Channel, name: str) -> float:
        """Seconds between two such messages unless somebody asked otherwise; 0: it is not sent."""
        return HEARTBEAT_PERIOD_S if name == "HEARTBEAT" else 0.0

    def asked_period(self, microseconds: float) -> float:
        """The period, s, that somebody gets who asks for this one."""
        return max(microseconds / 1e6, 0.0)

    def takes(self, command: Command) -> bool:
        """False for a command whose numbers are denied, whatever it is about."""
        return True

    # ---- what there is to know

    @property
    def sysid(self) -> int:
        """The system id parameter, or the nearest there is."""
        return min(max(int(self.brain.params[self.SYSID_PARAM]), 1), 255)

    @property
    def unix_us(self) -> int:
        """UTC as the GPS would tell it, microseconds."""
        return self._epoch_us + self.late_us + int(self.brain.now * 1e6)

    def name_in(self, command: Command) -> str:
        """The message that a command names by its first parameter; empty for one that this vehicle cannot report."""
        return self._ids.get(round(command.p1), "") if math.isfinite(command.p1) else ""

    # ---- channels

    def open_channel(self, outlet: Outlet, link: str = "") -> Channel:
        """A new link; it hears the heartbeat from now on, and what :meth:`greet` starts."""
        channel = Channel(self.dialect, outlet, self.sysid, COMPONENT, self.brain.now, link)
        self.greet(channel)
        self.channels.append(channel)
        for part in self.parts:
            part.opened(channel)
        return channel

    def close_channel(self, channel: Channel) -> None:
        if channel in self.channels:
            self.channels.remove(channel)
        self._router.forget(channel)
        self._pending = [p for p in self._pending if p[0] is not channel]
        for part in self.parts:
            part.closed(channel)

    # ---- out

    @property
    def hurries(self) -> bool:
        """A stream is quicker than autopilots think."""
        return any(channel.streams.fastest < THINKING_S for channel in self.channels)

    @property
    def next_due(self) -> float:
        """When the next stream or question for the time is, simulated seconds; now, while something long is sent."""
        if any(part.sending for part in self._ticking):
            return self.brain.now
        return min([self._next_timesync, *(channel.streams.next_due for channel in self.channels)])

    def tick(self) -> None:
        """Send what is due."""
        if self.hung:
            return
        now = self.brain.now
        if self._reboot_at is not None and now >= self._reboot_at:
            self._reboot_at = None
            self.restart()
        for channel in self.channels:
            if now < channel.streams.next_due:
                continue
            for name in channel.streams.due(now):
                if self.flows(name):
                    self.report(channel, name)
        for part in self._ticking:
            if now >= part.due:
                part.tick(now)
        if now >= self._next_timesync:
            self._next_timesync = now + self.TIMESYNC_PERIOD_S
            for channel in self.channels:
                channel.send("TIMESYNC", tc1=0, ts1=self.nanoseconds())

    def flows(self, name: str) -> bool:
        """A stream of that message may be sent now."""
        return True

    def restart(self) -> None:
        """Boot the autopilot again: what it had been asked to send is forgotten, and all counting starts again."""
        self.brain.power_on()
        self.receiver.restart()
        self.gimbal.restart()
        for channel in self.channels:
            channel.restart(self.brain.now)
            self.greet(channel)

    def fields(self, name: str) -> Fields | None:
        """What it reports in that message now; None where there is nothing to say yet."""
        report = self.REPORTS.get(name)  # a stream may name what this kind of vehicle does not report
        fields = None if report is None else report(self)
        clock = self._clocks.get(name)
        if fields is None or clock is None:
            return fields
        return {clock: int(self.brain.uptime * CLOCKS[clock]), **fields}

    def report(self, channel: Channel, name: str) -> None:
        """Send one message, unless there is nothing to say yet."""
        try:
            fields = self.fields(name)
            if fields is not None:
                channel.send(name, **fields)
        except _NO_NUMBER:
            # A number that its field cannot hold, such as a speed beyond all reason: this one message is not sent.
            self.bad_messages += 1

    def after_ack(self, channel: Channel, name: str) -> None:
        """Send a message once the acknowledgement of what is being handled is out."""
        self._pending.append((channel, name))

    def reboot_after_ack(self) -> None:
        self._reboot_at = self.brain.now + REBOOT_DELAY_S

    def report_to_all(self, name: str) -> None:
        for channel in self.channels:
            self.report(channel, name)

    def beat(self) -> None:
        self.report_to_all("HEARTBEAT")

    def announce(self) -> None:
        """Tell where the origin and home are now."""
        for channel in self.channels:
            self.report(channel, "GPS_GLOBAL_ORIGIN")
            self.report(channel, "HOME_POSITION")

    def nanoseconds(self) -> int:
        """The autopilot's own clock, as TIMESYNC carries it."""
        return int(self.brain.uptime * 1e9)

    # ---- in

    def receive(self, channel: Channel, data: bytes) -> None:
        """Bytes came by ``channel``."""
        if channel.incoming is None:
            self.take(channel, data)
        else:
            channel.incoming(data)

    def take(self, channel: Channel, data: bytes) -> None:
        """Understand bytes that came by ``channel``. Bad ones are counted and dropped; nothing raises."""
        if self.hung:
            return
        for frame in channel.splitter.feed(data):
            if channel.signing is not None and not channel.signing.accepts(frame):
                continue
            if frame.verified and self._router.route(frame, channel, self.channels, (self.sysid, COMPONENT)):
                try:
                    self._handle(channel, frame)
                except Exception as error:  # a defect met in answering costs that answer, not the flight
                    self.on_defect(error)

    def _handle(self, channel: Channel, frame: Frame) -> None:
        answer = self._answers.get(frame.msgid)
        if answer is None:
            return
        try:
            answer(channel, decode(frame, self.dialect), (frame.sysid, frame.compid))
        except _NO_NUMBER:
            # Whatever one client sends, the world goes on for the others.
            self.bad_messages += 1
        pending, self._pending = self._pending, []
        for where, name in pending:
            self.report(where, name)

    def _command(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        """Carry out a command, and acknowledge to who asked on the link it came by.

        Protocol: https://mavlink.io/en/services/command.html
        """
        command = read_command(msg, channel, sender)
        number, handler = command.number, self.HANDLERS.get(command.number)
        if number in self.ANSWERED_TWICE:
            channel.acknowledge(number, CommandResult.ACCEPTED, sender)
        if number in self.COMMANDS_NOT_SIMULATED:
            self.say(_WARNING, f"MAV_CMD {number} is not simulated{self.TEXT_END}")
        if handler is None:
            result: int = CommandResult.UNSUPPORTED
        else:
            result = self._carry_out(handler, command)
        if isinstance(result, bool):
            result = CommandResult.ACCEPTED if result else self.REFUSED
        channel.acknowledge(number, result, sender)

    def _carry_out(self, handler: Handler, command: Command) -> int:
        """The result of a command, also of one with a number that nothing can be done with: who asked is answered."""
        try:
            return handler(self, command) if self.takes(command) else CommandResult.DENIED
        except _NO_NUMBER:
            self.bad_messages += 1
            return CommandResult.DENIED

    def _timesync(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["tc1"] == 0:
            channel.send("TIMESYNC", tc1=self.nanoseconds(), ts1=msg["ts1"])
        else:
            self.timesync_answered(channel, msg["ts1"])

    def _ping(self, channel: Channel, msg: dict[str, Any], sender: Sender) -> None:
        if msg["target_system"] == 0 and msg["target_component"] == 0:
            channel.send(
                "PING",
                time_usec=msg["time_usec"],
                seq=msg["seq"],
                target_system=sender[0],
                target_component=sender[1],
            )

    def _param_changed(self, name: str, value: float) -> None:
        """A new system id is spoken with at once."""
        if name == self.SYSID_PARAM:
            for channel in self.channels:
                channel.adopt(self.sysid)


def _raise(error: Exception) -> None:
    raise error


# ---- the commands that every autopilot takes: https://mavlink.io/en/services/command.html


def arm_disarm(node: Node, c: Command) -> int:
    forced = c.p2 == FORCE
    if c.p1 == 1:
        return node.brain.arm(forced=forced)
    if c.p1 == 0:
        return node.brain.disarm(forced=forced)
    return CommandResult.UNSUPPORTED


def set_interval(node: Node, c: Command) -> int:
    name = node.name_in(c)
    if not name or not math.isfinite(c.p2):
        return node.UNKNOWN_INTERVAL
    period = node.usual_period(c.channel, name) if c.p2 == 0 else node.asked_period(c.p2)
    c.channel.streams.set_period(name, period, node.brain.now)
    return CommandResult.ACCEPTED


def get_interval(node: Node, c: Command) -> int:
    """An interval of 0 says that there is no such message, -1 that it is not sent."""
    name = node.name_in(c)
    period = c.channel.streams.period(name) if name else None
    interval = round(period * 1e6) if period else -1 if name else 0
    c.channel.send(
        "MESSAGE_INTERVAL", message_id=int(c.p1) & 0xFFFF if math.isfinite(c.p1) else 0, interval_us=interval
    )
    return CommandResult.ACCEPTED if name else node.UNKNOWN_PERIOD


def request_message(node: Node, c: Command) -> int:
    name = node.name_in(c)
    return send_message(node, c, name) if name else node.UNKNOWN_REQUEST


def send_message(node: Node, c: Command, name: str) -> int:
    """Send a message that a command asks for."""
    if node.ACKS_FIRST:
        node.after_ack(c.channel, name)
    else:
        node.report(c.channel, name)
    return CommandResult.ACCEPTED


SHARED_HANDLERS: Mapping[int, Handler] = {
    400: arm_disarm,
    510: get_interval,
    511: set_interval,
    512: request_message,
    **GIMBAL_HANDLERS,
}

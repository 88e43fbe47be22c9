"""The recorded flights, flown again by the simulator's vehicles: the same orders at the same times."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping

import msgspec

from tests.sim.conftest import Gcs
from tests.sim.px4.conftest import Companion
from tests.sim.yardstick.reading import Message
from zmav.mavlink import Dialect, load_dialect
from zmav.mavlink.codec import decode
from zmav.sim import REALISTIC_READY_S, Home, VehicleSpec, World
from zmav.sim.protocol.px4.node import px4_dialect

GUIDED, TAKEOFF, PLANE_GUIDED, PLANE_RTL, ROVER_GUIDED, ROVER_HOLD = 4, 13, 15, 11, 15, 4
SIDE_M = 75.0
ROVER_ORDERS = ((43.3, 15.0, 0.0), (49.3, 15.0, 15.0), (56.3, 0.0, 0.0))  # s; m north, east
PLANE_PLACE = (-353582610, 1491652300, 80.0)  # degrees times 1e7, m above home
PX4_HOME = Home(47.397742, 8.545594, 489.05)
STREAMS = {0: 2, 6: 5, 10: 10, 11: 10}  # what was asked for: MAV_DATA_STREAM -> Hz


class Recorder(Gcs):
    """A ground station that keeps all it hears, with the time of it."""

    def __init__(self, autopilot: str) -> None:
        world = World([VehicleSpec(autopilot=autopilot, endpoints=())], ready_s=REALISTIC_READY_S, epoch_s=0.0)
        self.messages: list[Message] = []
        super().__init__(world, world.vehicles[0])

    def put(self, frame: bytes) -> None:
        for each in self.splitter.feed(frame):
            self.frames.append(each)
            name = self.dialect.name_of(each.msgid)
            self.messages.append((self.world.time_s, name, decode(each, self.dialect)))

    def begin(self, *, local: bool = True) -> None:
        """As every recording begins: a second of silence, then the streams; ``local``: LOCAL_POSITION_NED besides."""
        self.world.step(1.0)
        for stream, rate in STREAMS.items():
            self.send("REQUEST_DATA_STREAM", req_stream_id=stream, req_message_rate=rate, start_stop=1)
        if local:
            self.order(511, 32, 1e5)

    def at(self, time_s: float) -> None:
        """Wait for that moment of the recording."""
        self.world.step(time_s - self.world.time_s)
        self.frames.clear()

    def order(self, number: int, *params: float) -> None:
        assert self.command(number, *params) == 0, number

    def end(self) -> list[Message]:
        self.world.close()
        return self.messages


def copter() -> list[Message]:
    gcs = Recorder("arducopter")
    gcs.begin()
    gcs.take_off(10.0)
    for north, east in ((SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)):
        gcs.goto(north, east, -10.0)
        gcs.until(functools.partial(gcs.near, north, east, -10.0, 0.3))
        gcs.frames.clear()
    gcs.order(21)
    gcs.until(lambda: not gcs.vehicle.copter.armed)
    gcs.world.step(4.0)
    return gcs.end()


def rover() -> list[Message]:
    gcs = Recorder("ardurover")
    gcs.begin()
    gcs.at(42.4)
    gcs.order(176, 1, ROVER_GUIDED)
    gcs.order(400, 1)
    for when, north, east in ROVER_ORDERS:
        gcs.at(when)
        gcs.goto(north, east, 0.0)
    gcs.at(65.2)
    gcs.order(176, 1, ROVER_HOLD)
    gcs.order(400, 0)
    gcs.at(69.0)
    return gcs.end()


def plane() -> list[Message]:
    gcs = Recorder("arduplane")
    gcs.begin(local=False)
    gcs.at(22.9)
    gcs.order(176, 1, TAKEOFF)
    gcs.order(400, 1)
    gcs.at(31.3)
    gcs.order(176, 1, PLANE_GUIDED)
    x, y, z = PLANE_PLACE
    assert gcs.command_int(192, x=x, y=y, z=z, param1=-1, param2=1) == 0
    gcs.at(71.4)
    gcs.order(176, 1, PLANE_RTL)
    gcs.at(81.5)
    return gcs.end()


def px4() -> list[Message]:
    """OFFBOARD without a stream and a refused arming; HOLD, arm, takeoff by mode 4/2; OFFBOARD asked for too early and
    again; a square by positions, velocities; the stream ends; after 1.7 s LAND.
    """
    world = _px4_world()
    companion = Companion(world, world.vehicles[0])
    step = world.step
    companion.ready()
    step(4.0)  # the recording began after the report of it
    companion.clear()
    step(0.5)
    companion.command(512, 148)
    step(0.02)
    companion.mode(6)
    step(1.2)
    companion.arm()
    companion.mode(4, 3)
    step(1.2)
    step(1.45 - world.time_s % 1.0)  # so that a heartbeat falls between arming and the takeoff, as it did
    companion.arm()
    step(0.57)
    companion.mode(4, 2)
    companion.until(lambda: companion.flying == "HOLD")
    # The real one refused here. A stream that it has seen it takes at once: 64 of 64, first setpoint 0 to 0.5 s before.
    step(0.3)
    companion.mode(6)
    companion.stream(1.5, lambda: companion.position(0.0, 0.0, -5.0))
    companion.mode(6)
    companion.stream(3.0, lambda: companion.position(0.0, 0.0, -5.0))
    for north, east in ((8.0, 0.0), (8.0, 8.0), (0.0, 8.0), (0.0, 0.0)):
        companion.stream(3.5 + 0.3, functools.partial(companion.position, north, east, -5.0))
    companion.stream(4.0, lambda: companion.velocity(1.5, 0.0))
    companion.stream(3.5, lambda: companion.position(6.0, 0.0, -5.0))
    companion.stream(3.0, lambda: companion.attitude(0.0, 0.0, 0.49))
    companion.stream(4.0, lambda: companion.position(8.0, 0.0, -5.0))
    step(2.7)
    companion.mode(4, 6)
    companion.until(lambda: not companion.vehicle.px4.armed)
    step(1.5)
    world.close()
    return _heard(companion)


def px4_ground() -> list[Message]:
    """The first of three on a shared ground link: takeoff, OFFBOARD, the stream ends."""
    world = _px4_world()
    station, companion = Companion(world, world.vehicles[0], "ground"), Companion(world, world.vehicles[0])
    station.beat()
    companion.ready()
    world.step(3.2)
    station.clear()
    companion.arm()
    beats = _every(1.0, station.beat, world)
    world.step(0.1)
    companion.mode(4, 2)
    companion.until(lambda: companion.flying == "HOLD", say=beats)

    def say() -> None:
        beats()
        companion.position(-7.6, 2.3, -5.0)

    companion.stream(2.0, say)
    companion.mode(6)
    companion.stream(5.1, say)
    companion.stream(10.0, beats)
    world.close()
    return _heard(station)


def _px4_world() -> World:
    """At the place where PX4's own simulation stands."""
    spec = VehicleSpec(autopilot="px4", endpoints=())
    return World([spec], home=PX4_HOME, epoch_s=0.0, ready_s=0.5)


def _every(period_s: float, say: Callable[[], None], world: World) -> Callable[[], None]:
    due = [world.time_s]

    def maybe() -> None:
        if world.time_s >= due[0]:
            due[0] += period_s
            say()

    return maybe


def _heard(companion: Companion) -> list[Message]:
    dialect = companion.dialect
    heard = [(at, dialect.name_of(f.msgid), decode(f, dialect)) for at, f in companion.heard]
    start = heard[0][0]
    return [(at - start, name, fields) for at, name, fields in heard]


class Yardstick(msgspec.Struct, frozen=True):
    """One recording, and the flight that is held against it. ``states``: fields whose changes must be the same."""

    name: str
    tlog: str
    fly: Callable[[], list[Message]]
    dialect: Callable[[], Dialect]
    states: Mapping[str, tuple[str, ...]]
    sysid: int | None = None
    drop: tuple[str, ...] = ()
    """messages that are no part of the comparison"""


def _ardupilot(name: str, fly: Callable[[], list[Message]]) -> Yardstick:
    kinds = {
        "HEARTBEAT": ("type", "autopilot", "base_mode", "custom_mode", "system_status"),
        "EKF_STATUS_REPORT": ("flags",),
        "GPS_RAW_INT": ("fix_type", "satellites_visible", "eph", "h_acc"),
    }
    return Yardstick(name, f"{name}.tlog", fly, lambda: load_dialect("ardupilotmega"), kinds)


YARDSTICKS = {
    each.name: each
    for each in (
        _ardupilot("copter", copter),
        _ardupilot("rover", rover),
        _ardupilot("plane", plane),
        Yardstick(
            "px4",
            "px4.tlog",
            px4,
            px4_dialect,
            {
                "EXTENDED_SYS_STATE": ("landed_state",),
                "COMMAND_ACK": ("command", "result"),
                "ATTITUDE_TARGET": ("type_mask",),
                "GPS_RAW_INT": ("fix_type", "satellites_visible"),
            },
        ),
        Yardstick("px4_ground", "px4_three.tlog", px4_ground, px4_dialect, {}, sysid=1),
    )
}

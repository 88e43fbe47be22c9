"""A companion in memory at a simulated PX4's link, so that a world can be stepped without sockets or clocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.sim.conftest import hang
from zmav.mavlink.codec import Packer, decode
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.sim.autopilots.px4.ground import Stage
from zmav.sim.protocol.px4.node import px4_dialect

POSITION, VELOCITY = 0x9F8, 0xDC7  # type masks, as recorded: position and yaw, velocity
COMPANION, GCS = 18, 6  # MAV_TYPE
Where = tuple[float, float, float]


class Companion:
    """A client at one vehicle's link; it steps the world itself, and keeps all it hears with the time of it."""

    def __init__(self, world: World, vehicle: SimVehicle, link: str = "onboard", sysid: int = 240) -> None:
        self.world = world
        self.vehicle = vehicle
        self.dialect = px4_dialect()
        self._frames: list[tuple[float, Frame]] = []
        self._unread: list[tuple[float, bytes]] = []
        self._splitter = Splitter(self.dialect)
        self._packer = Packer(self.dialect, sysid, 191)
        self.channel = vehicle.node.open_channel(self, link)

    # The outlet of the vehicle's channel.
    def room(self) -> int:
        return 1 << 20

    def put(self, frame: bytes) -> None:
        self._unread.append((self.world.time_s, frame))

    @property
    def heard(self) -> list[tuple[float, Frame]]:
        """Everything since the last :meth:`clear`, with the simulated time of it."""
        unread, self._unread = self._unread, []
        self._frames += [(at, frame) for at, data in unread for frame in self._splitter.feed(data)]
        return self._frames

    def send(self, name: str, **fields: Any) -> None:
        message = self.dialect.message(name)
        if message.target_component is not None:
            fields = {"target_system": self.vehicle.sysid, "target_component": 1, **fields}
        self.vehicle.node.receive(self.channel, self._packer.pack(name, **fields))

    def beat(self, kind: int = GCS) -> None:
        self.send("HEARTBEAT", type=kind, autopilot=8, system_status=4)

    def all(self, name: str) -> list[dict[str, Any]]:
        msgid = self.dialect.message(name).id
        return [decode(frame, self.dialect) for _, frame in self.heard if frame.msgid == msgid]

    def timed(self, name: str) -> list[tuple[float, dict[str, Any]]]:
        msgid = self.dialect.message(name).id
        return [(at, decode(frame, self.dialect)) for at, frame in self.heard if frame.msgid == msgid]

    def texts(self) -> list[str]:
        return [m["text"] for m in self.all("STATUSTEXT")]

    def events(self) -> list[int]:
        return [m["id"] for m in self.all("EVENT")]

    def clear(self) -> None:
        self.heard.clear()  # read first, so that none counts as lost

    # ---- orders

    def command(self, number: int, *params: float) -> list[int]:
        """COMMAND_LONG; gives the results of all its acknowledgements, which come at once."""
        before = len(self._unread)
        self.send("COMMAND_LONG", command=number, **{f"param{i}": float(p) for i, p in enumerate(params, start=1)})
        return self._results(number, before)

    def command_int(
        self, number: int, *, frame: int = 0, x: int = 0, y: int = 0, z: float = 0.0, **p: float
    ) -> list[int]:
        before = len(self._unread)
        self.send("COMMAND_INT", command=number, frame=frame, x=x, y=y, z=z, **p)
        return self._results(number, before)

    def _results(self, number: int, before: int) -> list[int]:
        frames = [frame for _, data in self._unread[before:] for frame in Splitter(self.dialect).feed(data)]
        acks = [decode(f, self.dialect) for f in frames if f.msgid == self.dialect.message("COMMAND_ACK").id]
        assert {ack["command"] for ack in acks} <= {number}
        assert {(ack["target_system"], ack["target_component"]) for ack in acks} <= {(240, 191)}
        return [ack["result"] for ack in acks]

    def mode(self, main: int, sub: int = 0) -> list[int]:
        return self.command(176, 1, main, sub)

    def arm(self) -> list[int]:
        return self.command(400, 1)

    # ---- the stream

    def position(self, north: float, east: float, down: float, **more: float) -> None:
        more = {"x": north, "y": east, "z": down, "type_mask": POSITION, "coordinate_frame": 1, **more}
        self.send("SET_POSITION_TARGET_LOCAL_NED", **more)

    def velocity(self, vn: float, ve: float, vd: float = 0.0, **more: float) -> None:
        more = {"vx": vn, "vy": ve, "vz": vd, "type_mask": VELOCITY, "coordinate_frame": 1, **more}
        self.send("SET_POSITION_TARGET_LOCAL_NED", **more)

    def attitude(self, roll: float, pitch: float, thrust: float, **more: Any) -> None:
        q = [math.cos(roll / 2) * math.cos(pitch / 2), math.sin(roll / 2), math.sin(pitch / 2), 0.0]
        self.send("SET_ATTITUDE_TARGET", **{"type_mask": 7, "q": q, "thrust": thrust, **more})

    def stream(self, seconds: float, say: Callable[[], None]) -> None:
        """Say it 20 times a second for so long."""
        for _ in range(round(seconds * 20)):
            say()
            self.world.step(0.05)

    def until(self, true: Callable[[], bool], sim_s: float = 60.0, say: Callable[[], None] = lambda: None) -> float:
        """Step until ``true()``, saying ``say`` 20 times a second; gives the simulated seconds that took."""
        start = self.world.time_s
        while not true():
            assert self.world.time_s - start < sim_s, f"not within {sim_s} s"
            self.stream(0.05, say)
        return self.world.time_s - start

    # ---- flights

    @property
    def ned(self) -> Where:
        """Where the vehicle is, about its own origin."""
        return self.vehicle.px4.local

    @property
    def flying(self) -> str:
        return self.vehicle.px4.mode.name

    def near(self, north: float, east: float, down: float, within: float = 0.5) -> bool:
        n, e, d = self.ned
        return max(abs(n - north), abs(e - east), abs(d - down)) < within

    def ready(self) -> None:
        self.until(lambda: self.vehicle.px4.checks_ok)

    def take_off(self) -> None:
        """HOLD, 2.5 m up."""
        self.ready()
        assert self.arm() == [0]
        assert self.mode(4, 2) == [0, 0]
        self.until(lambda: self.flying == "HOLD")

    def put_up(self, height: float = 2.5) -> None:
        """HOLD, that high up, as after :meth:`take_off`, but without the flight: for what is about something else."""
        self.ready()
        assert self.mode(4, 3) == [0, 0]
        assert self.arm() == [0]
        hang(self.vehicle, height)
        self.vehicle.px4.ground.stage = Stage.FLYING
        self.world.step(0.5)
        assert not self.vehicle.px4.landed and self.flying == "HOLD" and self.near(0.0, 0.0, -height, 0.2)

    def offboard(self, say: Callable[[], None], height: float = 2.0) -> None:
        """In the air, and into OFFBOARD, streaming ``say``."""
        self.put_up(height)
        self.stream(1.0, say)
        assert self.mode(6) == [0, 0]


MakeCompanion = Callable[..., Companion]


@pytest.fixture
def make_companion() -> Iterator[MakeCompanion]:
    """A world of PX4s without endpoints, and a companion at its first one; options are :class:`VehicleSpec`'s."""
    worlds = []

    def make(**options: Any) -> Companion:
        world = World([VehicleSpec(autopilot="px4", endpoints=(), **options)], epoch_s=0.0, ready_s=0.5)
        worlds.append(world)
        return Companion(world, world.vehicles[0])

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def companion(make_companion: MakeCompanion) -> Companion:
    """At one PX4 on the ground, ready within half a second."""
    return make_companion()

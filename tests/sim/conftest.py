"""What the simulator's tests share: a ground station in memory, so that a world can be stepped without sockets or
clocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from zmav.mavlink import load_dialect
from zmav.mavlink.codec import Packer, decode
from zmav.mavlink.frames import Frame, Splitter
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.sim.fleets.copter import CopterFleet

GUIDED = 4
POSITION, VELOCITY = 0x0DF8, 0x0DC7  # type masks


def hang(vehicle: SimVehicle, height: float) -> None:
    """Put a copter at rest in the air, with its rotors at the speed that carries it; its autopilot is told nothing."""
    seat = vehicle.node.seat
    fleet, i = seat.fleet, seat.index
    assert isinstance(fleet, CopterFleet)
    dyn = fleet.dynamics
    dyn.pos[2, i] -= height
    dyn.rotor[:, i] = math.sqrt(fleet.airframe.hover_share)
    dyn.contact[i] = dyn.resting[i] = False


class Gcs:
    """A ground station at one vehicle's link; it steps the world itself, and keeps all it hears."""

    def __init__(self, world: World, vehicle: SimVehicle, *, sysid: int = 255, compid: int = 190) -> None:
        self.world = world
        self.vehicle = vehicle
        self.dialect = load_dialect("ardupilotmega")
        self.frames: list[Frame] = []
        self.limit = 1 << 20
        self.splitter = Splitter(self.dialect)
        self._packer = Packer(self.dialect, sysid, compid)
        self.channel = vehicle.node.open_channel(self)

    # The outlet of the vehicle's channel.
    def room(self) -> int:
        return self.limit

    def put(self, frame: bytes) -> None:
        self.frames += self.splitter.feed(frame)

    def send(self, name: str, **fields: Any) -> None:
        """Send to this vehicle unless ``target_system`` says otherwise."""
        message = self.dialect.message(name)
        if message.target_system is not None and "target" not in fields:
            fields = {"target_system": self.vehicle.sysid, "target_component": 1, **fields}
            if message.target_component is None:
                del fields["target_component"]
        self.vehicle.node.receive(self.channel, self._packer.pack(name, **fields))

    def command(self, number: int, *params: float) -> int:
        """COMMAND_LONG; gives the MAV_RESULT. The answer comes at once."""
        self.clear("COMMAND_ACK")
        self.send("COMMAND_LONG", command=number, **{f"param{i}": float(p) for i, p in enumerate(params, start=1)})
        return self.ack(number)

    def command_int(self, number: int, *, x: int = 0, y: int = 0, z: float = 0.0, frame: int = 3, **p: float) -> int:
        self.clear("COMMAND_ACK")
        self.send("COMMAND_INT", command=number, x=x, y=y, z=z, frame=frame, **p)
        return self.ack(number)

    def ack(self, number: int) -> int:
        acks = self.all("COMMAND_ACK")
        assert [a["command"] for a in acks] == [number]
        assert (acks[0]["target_system"], acks[0]["target_component"]) == (255, 190)
        return int(acks[0]["result"])

    def all(self, name: str) -> list[dict[str, Any]]:
        """Every such message heard since the last :meth:`clear`."""
        msgid = self.dialect.message(name).id
        return [decode(frame, self.dialect) for frame in self.frames if frame.msgid == msgid]

    def last(self, name: str) -> dict[str, Any]:
        """The latest such message; asks for one where a link may have no stream of it."""
        self.clear(name)
        assert self.command(512, self.dialect.message(name).id) == 0
        return self.all(name)[-1]

    def texts(self) -> list[str]:
        return [m["text"] for m in self.all("STATUSTEXT")]

    def clear(self, name: str | None = None) -> None:
        msgid = None if name is None else self.dialect.message(name).id
        self.frames = [] if msgid is None else [f for f in self.frames if f.msgid != msgid]

    def until(self, true: Callable[[], bool], sim_s: float = 60.0) -> float:
        """Step until ``true()``; gives the simulated seconds that took."""
        start = self.world.time_s
        while not true():
            assert self.world.time_s - start < sim_s, f"not within {sim_s} s"
            self.world.step(0.1)
        return self.world.time_s - start

    @property
    def ned(self) -> tuple[float, float, float]:
        """Where the vehicle is, about its own origin."""
        return self.vehicle.copter.local

    def near(self, north: float, east: float, down: float, within: float = 0.5) -> bool:
        n, e, d = self.ned
        return max(abs(n - north), abs(e - east), abs(d - down)) < within

    def take_off(self, height: float = 5.0) -> None:
        """Into the air and at rest, in GUIDED."""
        self.until(lambda: self.vehicle.copter.position_ok)
        assert self.command(176, 1, GUIDED) == 0
        assert self.command(400, 1) == 0
        assert self.command(22, 0, 0, 0, 0, 0, 0, height) == 0
        self.until(lambda: abs(self.ned[2] + height) < 0.3 and abs(self.vehicle.copter.sense.vd) < 0.2)

    def put_up(self, height: float = 5.0) -> None:
        """As :meth:`take_off`, but without the flight there: for what is about something else."""
        copter = self.vehicle.copter
        self.until(lambda: copter.position_ok)
        assert self.command(176, 1, GUIDED) == 0
        assert self.command(400, 1) == 0
        hang(self.vehicle, height)
        copter.landed, copter.auto_armed = False, True
        north, east, _ = self.ned
        self.goto(north, east, -height)
        self.world.step(0.5)
        assert not copter.landed and self.near(north, east, -height, 0.2)

    def goto(self, north: float, east: float, down: float, frame: int = 1, mask: int = POSITION, **more: float) -> None:
        """A position target."""
        more = {"x": north, "y": east, "z": down, **more}
        self.send("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=frame, type_mask=mask, **more)

    def fly(self, vn: float, ve: float, vd: float = 0.0, frame: int = 1, mask: int = VELOCITY, **more: float) -> None:
        """A velocity target."""
        more = {"vx": vn, "vy": ve, "vz": vd, **more}
        self.send("SET_POSITION_TARGET_LOCAL_NED", coordinate_frame=frame, type_mask=mask, **more)


MakeGcs = Callable[..., Gcs]


@pytest.fixture
def make_gcs() -> Iterator[MakeGcs]:
    """A world without endpoints and a ground station at its first vehicle; options are :class:`World`'s."""
    worlds = []

    def make(vehicles: int | list[VehicleSpec] = 1, **options: Any) -> Gcs:
        options = {"ready_s": 0.5, "epoch_s": 0.0, **options}
        specs = [VehicleSpec() for _ in range(vehicles)] if isinstance(vehicles, int) else vehicles
        world = World(specs, **options)
        worlds.append(world)
        return Gcs(world, world.vehicles[0])

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def gcs(make_gcs: MakeGcs) -> Gcs:
    """One copter on the ground, awake within half a second."""
    return make_gcs()


@pytest.fixture
def another_gcs() -> Callable[..., Gcs]:
    """Makes further ground stations at vehicles of a world that is there already."""
    return Gcs

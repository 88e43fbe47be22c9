"""Lock step: the world goes no faster than its clients see it, and is held up by none that has stopped answering."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest
from pymavlink import mavutil

from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.sim.lockstep import Lockstep

if TYPE_CHECKING:
    from tests.sim.conftest import Gcs, MakeGcs

PATIENCE_S = 30.0
GUIDED = 4


class Client:
    """A script at a vehicle's link that answers TIMESYNC only while :meth:`answer` is called."""

    def __init__(self, vehicle: SimVehicle) -> None:
        self.link = mavutil.mavlink_connection(vehicle.url, source_system=255, source_component=190)
        self.questions: list[int] = []

    def next(self, kind: str) -> Any:
        """The next message of that kind; questions on the way are answered."""
        while True:
            message = self.link.recv_match(blocking=True, timeout=PATIENCE_S)
            assert message is not None, f"no {kind}"
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self.questions.append(message.ts1)
                if kind == "question":
                    return message
                self.answer(message.ts1)
            elif message.get_type() == kind:
                return message

    def answer(self, question: int) -> None:
        self.link.mav.timesync_send(1, question)

    def command(self, number: int, *params: float) -> int:
        self.link.mav.command_long_send(1, 1, number, 0, *[*params, *[0.0] * (7 - len(params))])
        return int(self.next("COMMAND_ACK").result)

    def velocity(self, north: float) -> None:
        self.link.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0x0DC7, 0, 0, 0, north, 0, 0, 0, 0, 0, 0, 0)


def flying(world: World, client: Client) -> None:
    """Take off to 5 m in GUIDED, and have its position ten times a second."""
    vehicle = world.vehicles[0]
    while not vehicle.copter.position_ok:
        client.next("HEARTBEAT")
    for command in ((511, 32, 1e5), (176, 1, GUIDED), (400, 1), (22, 0, 0, 0, 0, 0, 0, 5)):
        assert client.command(*command) == 0
    while client.next("LOCAL_POSITION_NED").z > -4.5:
        pass


def test_setpoints_hold_at_the_greatest_speed() -> None:
    """Each is sent for a position seen, as by a controller; GUIDED stops a vehicle that hears none for 3 s."""
    with World([VehicleSpec(endpoints=("tcp:0",))], speed=math.inf, lockstep=True, ready_s=0.5) as world:
        client = Client(world.vehicles[0])
        flying(world, client)
        speeds = []
        for _ in range(150):
            seen = client.next("LOCAL_POSITION_NED")
            client.velocity(2.0)
            speeds.append(seen.vx)
            # Nothing that was sent is older than what the world goes on without an answer.
            assert world.time_s * 1000 - seen.time_boot_ms < 200
        assert speeds[50:] == pytest.approx([2.0] * 100, abs=0.3)
        client.link.close()


def test_offboard_holds_at_the_greatest_speed() -> None:
    """PX4 leaves OFFBOARD a second after the last setpoint."""
    spec = VehicleSpec(autopilot="px4", endpoints=("tcp:0",))
    with World([spec], speed=math.inf, lockstep=True, ready_s=0.5) as world:
        px4 = world.vehicles[0].px4
        client = Client(world.vehicles[0])
        while not px4.position_ok:
            client.next("HEARTBEAT")
        for command in ((176, 1, 4, 3), (400, 1), (176, 1, 4, 2)):  # HOLD, arm, TAKEOFF
            assert client.command(*command) == 0
        while client.next("LOCAL_POSITION_NED").z > -2.0:
            pass
        for _ in range(30):  # a second of stream before the mode
            client.next("LOCAL_POSITION_NED")
            client.velocity(1.0)
        assert client.command(176, 1, 6) == 0
        speeds, modes = [], set()
        for n in range(300):
            speeds.append(client.next("LOCAL_POSITION_NED").vx)
            client.velocity(1.0)
            if n > 60:
                modes.add(px4.mode.name)
        assert modes == {"OFFBOARD"}
        assert speeds[150:] == pytest.approx([1.0] * 150, abs=0.2)
        while px4.mode.name == "OFFBOARD":  # and without a stream, as soon as ever
            client.next("LOCAL_POSITION_NED")
        client.link.close()


def test_without_it_the_world_runs_away_from_them() -> None:
    with World([VehicleSpec(endpoints=("tcp:0",))], speed=math.inf, ready_s=0.5) as world:
        client = Client(world.vehicles[0])
        flying(world, client)
        before = world.time_s
        client.velocity(2.0)
        world.wait_for(lambda: world.time_s > before + 20.0)  # while the client does nothing
        while client.next("LOCAL_POSITION_NED").time_boot_ms < (before + 15.0) * 1000:
            pass
        assert abs(client.next("LOCAL_POSITION_NED").vx) < 0.1  # it has given up waiting for the next one
        client.link.close()


def test_the_world_waits_while_a_client_thinks() -> None:
    with World([VehicleSpec(endpoints=("tcp:0",))], speed=math.inf, lockstep=True, ready_s=0.5) as world:
        assert world.lockstep is not None
        client = Client(world.vehicles[0])
        flying(world, client)  # it keeps up, so that no question of before is on the way
        question = client.next("question").ts1
        times = [world.call(lambda: world.time_s) for _ in range(20)]
        assert len(set(times)) == 1
        assert world.call(lambda: world.lockstep.members if world.lockstep else 0) == 1
        client.answer(question)
        client.next("question")
        assert world.call(lambda: world.time_s) == pytest.approx(times[0] + 0.02)
        client.link.close()
        world.wait_for(lambda: world.time_s > times[0] + 5.0)  # who has left holds nobody up


class Answerer:
    """An outlet that answers each TIMESYNC at once, unless it sulks."""

    def __init__(self, gcs: Gcs) -> None:
        self.gcs = gcs
        self.sulks = False
        self.asked: list[int] = []

    def step(self) -> None:
        for message in self.gcs.all("TIMESYNC"):
            if message["tc1"] == 0 and message["ts1"] not in self.asked:
                self.asked.append(message["ts1"])
                if not self.sulks:
                    self.gcs.send("TIMESYNC", tc1=1, ts1=message["ts1"])
        self.gcs.clear()


def test_one_that_stops_answering_is_left_out_and_may_come_back(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    wall, said = [100.0], list[str]()
    lockstep = Lockstep(gcs.world.vehicles, said.append, patience_s=1.0, clock=lambda: wall[0])
    answerer = Answerer(gcs)

    def go(seconds: float) -> bool:
        """Whether the world could go on for so long, at ten times real time."""
        for _ in range(round(seconds / 0.01)):
            if not lockstep.ready():
                return False
            gcs.world.step()
            lockstep.ticked(gcs.world.time_s)
            wall[0] += 0.001
            answerer.step()
        return True

    assert go(3.0)
    assert lockstep.members == 1
    assert len(answerer.asked) > 90  # every 20 ms
    answerer.sulks = True
    assert not go(0.1)
    wall[0] += 0.9
    assert not lockstep.ready()
    assert said == []
    wall[0] += 0.2
    assert lockstep.ready()
    assert said == ["quad1: no answer for 1 s; lock step goes on without that client"]
    asked = len(answerer.asked)
    assert go(5.0)
    assert len(answerer.asked) - asked <= 6  # once a second
    answerer.sulks = False
    assert go(3.0)
    assert lockstep.members == 1
    answerer.sulks = True
    assert not go(0.1)
    wall[0] += 1.1
    assert lockstep.ready()
    assert len(said) == 1  # once for each client


def test_one_that_answers_late_does_not_join(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    wall = [100.0]
    lockstep = Lockstep(gcs.world.vehicles, lambda text: None, patience_s=1.0, clock=lambda: wall[0])
    for _ in range(4):
        gcs.world.step(1.0)
        lockstep.ticked(gcs.world.time_s)
        wall[0] += 0.6
        for message in gcs.all("TIMESYNC"):
            if message["tc1"] == 0:
                gcs.send("TIMESYNC", tc1=1, ts1=message["ts1"])
        gcs.clear()
        assert lockstep.members == 0
        assert lockstep.ready()


@pytest.mark.parametrize(
    ("kind", "parameters", "asked"),
    [
        ("link-loss", {"percent": 100.0}, 50),
        ("link-cut", {}, 0),
        ("link-cut", {"direction": "up"}, 0),
        ("frozen", {}, 0),
    ],
)
def test_no_fault_has_the_world_wait_for_answers_that_cannot_come(
    make_gcs: MakeGcs, kind: str, parameters: dict[str, Any], asked: int
) -> None:
    gcs = make_gcs()
    lockstep = Lockstep(gcs.world.vehicles, lambda text: None, clock=lambda: gcs.world.time_s / 10)
    answerer = Answerer(gcs)
    for tick in range(400):
        assert lockstep.ready()
        gcs.world.step()
        lockstep.ticked(gcs.world.time_s)
        answerer.step()
        if tick == 199:
            assert lockstep.members == 1
            gcs.world.fault("quad1", kind, **parameters)
            before = len(answerer.asked)
        if tick == 299:
            assert len(answerer.asked) - before == pytest.approx(asked, abs=2)
            gcs.world.clear()
            before = len(answerer.asked)
    assert lockstep.members == 1
    assert len(answerer.asked) - before == pytest.approx(50, abs=2)


def test_a_link_without_room_is_not_waited_for(make_gcs: MakeGcs) -> None:
    gcs = make_gcs()
    lockstep = Lockstep(gcs.world.vehicles, lambda text: None)
    gcs.world.step(1.0)
    lockstep.ticked(1.0)
    gcs.send("TIMESYNC", tc1=1, ts1=gcs.all("TIMESYNC")[-1]["ts1"])
    assert lockstep.members == 1
    gcs.limit = 0
    gcs.world.step(1.0)
    lockstep.ticked(2.0)
    assert lockstep.ready()

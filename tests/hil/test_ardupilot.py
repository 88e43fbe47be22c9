"""A vehicle that speaks ArduPilot's JSON interface over a real UDP socket, in a world that runs."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterator
from typing import Any

import pytest

from tests.hil.conftest import MakeWorld, hil_world
from tests.hil.hover import PLUS, state_of, steer
from tests.waiting import wait_until
from zmav.errors import PortInUse
from zmav.hil.ardupilot import JsonVehicle
from zmav.sim import VehicleSpec, World
from zmav.sim.spec import Stack

WAITING = VehicleSpec(stack=Stack(port=0))


class Client:
    """A flight stack's end."""

    def __init__(self, world: World, index: int = 0) -> None:
        vehicle = world.externals.vehicles[index]
        assert isinstance(vehicle, JsonVehicle)
        self.vehicle = vehicle
        self.frame = 0
        self.open()

    def open(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", self.vehicle.port))
        self.socket.settimeout(20.0)

    def send(self, frame: int, pwm: list[int] | None = None, rate: int = 400) -> None:
        self.socket.send(struct.pack("<HHI16H", 18458, rate, frame, *(pwm or [1000] * 16)))

    def step(self, pwm: list[int] | None = None, rate: int = 400) -> Any:
        self.send(self.frame, pwm, rate)
        self.frame += 1
        return json.loads(self.socket.recv(4096))

    def nothing_comes(self) -> bool:
        self.socket.settimeout(0.1)
        try:
            self.socket.recv(4096)
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(20.0)
        return False

    def close(self) -> None:
        self.socket.close()


@pytest.fixture
def world(make_world: MakeWorld) -> World:
    return make_world(WAITING)


@pytest.fixture
def client(world: World) -> Iterator[Client]:
    made = Client(world)
    yield made
    made.close()


def test_a_stack_flies_and_the_world_shows_it(world: World, client: Client) -> None:
    assert world.status().vehicles[0].mode == "waiting"
    pwm = [1000] * 16
    for _ in range(6 * 400):
        pwm[:4] = [round(1000 + 1000 * u) for u in steer(PLUS, state_of(client.step(pwm)), (1.0, 2.0, -4.0), 0.0)]
    shown = world.status().vehicles[0]
    assert (shown.name, shown.autopilot, shown.airframe, shown.mode) == ("quad1", "ardupilot", "quad", "external")
    assert shown.ned_m == pytest.approx((1.0, 2.0, -4.0), abs=1.0)
    assert shown.armed and not shown.landed
    assert shown.height_m == pytest.approx(-shown.ned_m[2])


def test_the_worlds_time_and_the_stacks_go_together(world: World, client: Client) -> None:
    first = client.step()
    begun = world.time_s
    for _ in range(800):
        last = client.step()
    passed = last["timestamp"] - first["timestamp"]
    assert passed == pytest.approx(2.0)
    assert world.time_s - begun == pytest.approx(passed, abs=0.1)


def test_a_world_that_stands_still_gives_no_time(world: World, client: Client) -> None:
    client.step()
    world.pause()
    for _ in range(8):  # what was granted before the pause
        client.send(client.frame)
        if client.nothing_comes():
            break
        client.frame += 1
    else:
        raise AssertionError("time went on")
    world.resume()
    assert json.loads(client.socket.recv(4096))["timestamp"] > 0.0


def test_a_stack_that_falls_silent_holds_up_nobody_for_long(world: World, client: Client) -> None:
    client.step()
    begun = world.time_s
    world.wait_for(lambda: world.time_s > begun + 30.0, 60.0)
    timestamp = client.step()["timestamp"]
    assert timestamp < 1.0  # and it goes on where it was, without a leap


def test_an_answer_goes_to_whoever_asked_though_its_port_changed(client: Client) -> None:
    client.step()
    client.close()
    client.vehicle._heard -= 10.0  # long ago
    client.open()
    assert client.step()["timestamp"] == pytest.approx(2 / 400)


def test_a_second_stack_on_the_same_port_is_not_mixed_in(world: World, client: Client) -> None:
    client.step()
    other = Client(world)
    other.send(0)
    assert other.nothing_comes()
    assert client.vehicle.strangers >= 1
    assert client.vehicle.protocol.restarts == 0
    other.close()


def test_a_stack_that_restarts_begins_at_the_start(world: World, client: Client) -> None:
    for _ in range(400):
        client.step([1800] * 16)
    assert world.status().vehicles[0].ned_m[2] < -0.5
    client.frame = 0
    assert client.step()["timestamp"] == pytest.approx(1 / 400)
    assert world.status().vehicles[0].ned_m == (0.0, 0.0, 0.0)
    assert any("started again" in note for note in world.externals.notes)


def test_what_is_no_packet_is_counted_and_said_once(world: World, client: Client) -> None:
    for junk in (b"", b"junk", b"\xff" * 2000, b"\x1a\x48" + b"\0" * 38):
        client.socket.send(junk)
    wait_until(lambda: client.vehicle.bad == 4)
    assert client.step()["timestamp"] > 0.0
    assert sum("no servo packet" in note for note in world.externals.notes) == 1


def test_embedded_vehicles_fly_beside_it_under_their_own_numbers(make_world: MakeWorld) -> None:
    world = make_world(WAITING, VehicleSpec(endpoints=("tcp:0",)), VehicleSpec(stack=Stack(port=0)))
    assert [vehicle.name for vehicle in world.vehicles] == ["quad2"]
    assert [(v.name, v.sysid) for v in world.externals.vehicles] == [("quad1", 1), ("quad3", 3)]
    assert [v.ned_m[1] for v in world.status().vehicles] == [10.0, 0.0, 20.0]


def test_two_worlds_cannot_have_one_port(world: World, client: Client) -> None:
    with (
        pytest.raises(PortInUse, match=str(client.vehicle.port)),
        hil_world([VehicleSpec(stack=Stack(port=client.vehicle.port))]),
    ):
        raise AssertionError("opened twice")

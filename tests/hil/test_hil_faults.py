"""Faults of vehicles that flight stacks outside the simulator fly: what reaches the stack, and what is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import pytest

from tests.hil.conftest import hil_world, plant
from tests.hil.px4_peer import Px4Peer
from zmav.errors import BadInput
from zmav.hil.ardupilot import JsonVehicle
from zmav.hil.json_fdm import compose
from zmav.hil.plant import Plant
from zmav.hil.px4 import Px4Vehicle
from zmav.hil.stream import BARO, MAG, HilStream
from zmav.mavlink import load_dialect
from zmav.sim import VehicleSpec, World
from zmav.sim.spec import Stack

NAMES = ("a", "p")


@pytest.fixture
def world() -> Iterator[World]:
    """An ArduPilot and a PX4 that nobody has started."""
    stack = Stack(port=0)
    made = hil_world([VehicleSpec(name="a", stack=stack), VehicleSpec(autopilot="px4", name="p", stack=stack)])
    yield made
    made.close()


def ardupilot(world: World) -> JsonVehicle:
    vehicle = world.externals.vehicles[0]
    assert isinstance(vehicle, JsonVehicle)
    return vehicle


def px4(world: World) -> Px4Vehicle:
    vehicle = world.externals.vehicles[1]
    assert isinstance(vehicle, Px4Vehicle)
    return vehicle


def heard(stream: HilStream, steps: int = 250) -> Px4Peer:
    """What a second of it says."""
    peer = Px4Peer(lambda data: None)
    for _ in range(steps):
        peer.take(stream.step())
    return peer


def told(vehicle: JsonVehicle) -> Any:
    return json.loads(compose(vehicle.plant))


@pytest.mark.parametrize("name", NAMES)
def test_a_motor_that_fails_turns_the_body_over(world: World, name: str) -> None:
    world.fault(name, "motor", number=1)
    body = next(v.plant for v in world.externals.vehicles if v.name == name)
    assert isinstance(body, Plant)
    body.dynamics.pos[2] = -50.0
    body.drive([0.6] * 4)
    body.advance(100)
    assert max(abs(rate) for rate in body.truth().rate[:2]) > 0.5
    world.clear(name)
    assert body.efficiency.min() == 1.0


def test_px4_gets_no_solution_from_a_lost_receiver_and_a_false_one_from_one_that_lies(world: World) -> None:
    stream = px4(world).stream
    before = heard(stream).heard["HIL_GPS"][-1]
    world.fault("p", "gps-loss")
    lost = heard(stream).heard["HIL_GPS"][-1]
    assert (before.fix_type, lost.fix_type) == (3, 1)
    assert lost.satellites_visible < before.satellites_visible
    world.clear()
    world.fault("p", "gps-glitch", north=80.0)
    shifted = heard(stream, 750).heard["HIL_GPS"][-1]
    assert shifted.fix_type == 3
    assert (shifted.lat - before.lat) * 0.0111 == pytest.approx(80.0, abs=6.0)


@pytest.mark.parametrize(("kind", "bits"), [("compass", MAG), ("baro", BARO)])
def test_a_sensor_that_is_lost_is_not_updated(world: World, kind: str, bits: int) -> None:
    stream = px4(world).stream
    assert any(m.fields_updated & bits == bits for m in heard(stream).heard["HIL_SENSOR"])
    world.fault("p", kind, lost=True)
    assert not any(m.fields_updated & bits for m in heard(stream).heard["HIL_SENSOR"])


def test_px4s_imu_shakes(world: World) -> None:
    stream = px4(world).stream
    world.fault("p", "imu", vibration=30.0)
    shaken = [m.zacc for m in heard(stream).heard["HIL_SENSOR"]]
    assert max(shaken) - min(shaken) > 40.0


def test_ardupilots_rangefinder_lies_or_sees_nothing(world: World) -> None:
    ardupilot(world).plant.dynamics.pos[2] = -10.0
    world.fault("a", "rangefinder", metres=-3.0)
    assert told(ardupilot(world))["rng_1"] == pytest.approx(7.0)
    world.fault("a", "rangefinder")
    assert told(ardupilot(world))["rng_1"] == 9999.0
    world.clear()
    assert told(ardupilot(world))["rng_1"] == pytest.approx(10.0)


def test_a_blocked_pitot_tube_tells_ardupilot_of_no_wind(world: World) -> None:
    ardupilot(world).plant.dynamics.vel[0] = 12.0
    assert told(ardupilot(world))["airspeed"] == pytest.approx(12.0)
    world.fault("a", "pitot")
    assert told(ardupilot(world))["airspeed"] == 0.0


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("a", "gps-loss"),
        ("a", "compass"),
        ("a", "baro"),
        ("a", "imu"),
        ("p", "rangefinder"),
        ("p", "pitot"),
        ("a", "reboot"),
        ("p", "frozen"),
        ("p", "link-cut"),
        ("a", "camera-blackout"),
    ],
)
def test_what_the_stack_would_not_notice_is_refused(world: World, name: str, kind: str) -> None:
    with pytest.raises(BadInput, match=name):
        world.fault(name, kind)
    assert world.faults() == []


def test_a_stack_that_restarts_has_what_has_failed_still() -> None:
    body = plant("sih")
    body.efficiency[2, 0] = 0.25
    body.battery.drain(0, 0.3)
    troubles = body.sensors.troubles
    stream = HilStream(body, load_dialect("ardupilotmega"), 1, 0)
    world = hil_world([VehicleSpec(autopilot="px4", name="p", stack=Stack(port=0))])
    try:
        world.fault("p", "compass", degrees=90.0)
        flown = world.externals.vehicles[0].plant
        assert isinstance(flown, Plant)
        flown.reset()
        assert flown.sensors.troubles.compass_turn[0] == pytest.approx(math.pi / 2)
        world.clear()
        assert flown.sensors.troubles.compass_turn[0] == 0.0
    finally:
        world.close()
    heard(stream, 5)
    body.reset()
    assert body.efficiency[:, 0].tolist() == [1.0, 1.0, 0.25, 1.0]
    assert body.battery.charge[0] == pytest.approx(0.3)
    assert body.sensors.troubles is not troubles

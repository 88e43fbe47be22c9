"""Every level of authority, from the key space down to a simulated copter's motion, under both autopilots' rules."""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

import zmav
from zmav import wire
from zmav.rotation import from_euler
from zmav.sim import VehicleSpec, World
from zmav.vehicle import Vehicle

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

PATIENCE_S = 30.0
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
STICK_MODE = {"arducopter": "ALT_HOLD", "px4": "POSCTL"}
State = wire.VehicleState
PATIENT = {"COM_OF_LOSS_T": 20.0, "COM_RC_LOSS_T": 20.0}
"""A busy machine interrupts the stream, and an order to change the mode the sticks: four times as fast that is long for
PX4, which would sink in POSCTL meanwhile, and fly nothing that is asked for.
"""


def near(north: float, east: float, down: float) -> Callable[[State], bool]:
    return lambda s: s.local is not None and math.dist(s.local, (north, east, down)) < 1.0


def moves(north: float, east: float) -> Callable[[State], bool]:
    return lambda s: s.velocity is not None and math.dist(s.velocity[:2], (north, east)) < 0.5


def turned(by: float) -> Callable[[State], bool]:
    """Turned so far clockwise from the north."""
    return lambda s: s.attitude is not None and s.attitude.yaw > by


LEVELS: list[tuple[dict[str, Any], Callable[[State], bool]]] = [
    ({"pos": (8.0, 0.0, -6.0), "yaw": 0.0}, near(8.0, 0.0, -6.0)),
    ({"vel": (0.0, 2.0, 0.0), "yaw": 0.0}, moves(0.0, 2.0)),
    ({"acc": (-1.0, 0.0, 0.0), "yaw": 0.0}, lambda s: s.velocity is not None and s.velocity[0] < -0.7),
    ({"pos": (0.0, 0.0, -6.0), "vel": (0.0, 0.0, 0.0), "yaw": 0.0}, near(0.0, 0.0, -6.0)),
    (
        {"attitude": from_euler(0.0, -0.15, 0.0), "thrust": 0.5},
        lambda s: s.attitude is not None and abs(s.attitude.pitch + 0.15) < 0.05,
    ),
    ({"rates": (0.0, 0.0, 0.5), "thrust": 0.5}, turned(0.7)),
]


def free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


async def fly_until(
    vehicle: Vehicle, true: Callable[[State], bool], fields: dict[str, Any], mode: str | None = None
) -> None:
    """Stream it under a lease until the vehicle does it; in ``mode`` where one is given, entered with sticks at rest:
    PX4 takes moved ones for a pilot who takes over.
    """
    given = {"manual": wire.ManualControl()} if mode else fields
    async with vehicle.lease("tester") as lease:

        async def stream() -> None:
            while True:
                lease.setpoint(**given)
                await asyncio.sleep(0.05)

        task = asyncio.create_task(stream())
        try:
            if mode:
                flown = vehicle.state.setpoints["flown"]
                await vehicle.wait_until(lambda s: s.setpoints["flown"] > flown + 5, PATIENCE_S)
                await vehicle.set_mode(mode)
                given = fields
            await vehicle.wait_until(true, PATIENCE_S)
        except zmav.ZmavError as e:
            raise AssertionError(f"{fields}: {vehicle.state}") from e
        finally:
            task.cancel()


async def counted(vehicle: Vehicle, what: str) -> None:
    await vehicle.wait_until(lambda s: s.setpoints.get(what, 0) > 0, PATIENCE_S)


@pytest.mark.parametrize("rules", ["arducopter", "px4"])
async def test_every_level_is_flown(net: Net, onboard: StartOnboard, rules: str) -> None:
    port = free_udp_port()
    there = f"onboard:0:{port}" if rules == "px4" else "tcp:127.0.0.1:0"
    patient = PATIENT if rules == "px4" else {}
    spec = VehicleSpec(autopilot=rules, sysid=1, endpoints=(there,), params=patient)
    with World([spec], speed=4.0, ready_s=0.5) as world:
        session, endpoint = net.router()
        link = f"udpin:127.0.0.1:{port}" if rules == "px4" else world.vehicles[0].url
        await onboard(session, link, origin=ORIGIN)
        async with zmav.open(connect=[endpoint]) as z:
            vehicle = z.vehicle("quad1")
            await vehicle.wait_until(lambda s: bool(s.ready and s.local), PATIENCE_S)
            await vehicle.arm()
            await vehicle.takeoff(5.0)
            for fields, done in LEVELS:
                # From rest: an acceleration keeps the velocity that it begins with.
                await vehicle.wait_until(lambda s: s.velocity is not None and math.hypot(*s.velocity) < 0.3, PATIENCE_S)
                await fly_until(vehicle, done, fields)
            async with vehicle.lease("tester") as lease:
                lease.setpoint(torque=(0.0, 0.0, 0.1), thrust=0.5)
                await counted(vehicle, "unsupported")
            await sticks(vehicle, rules)


async def test_torques_are_flown_by_the_px4_that_takes_them(net: Net, onboard: StartOnboard) -> None:
    port = free_udp_port()
    spec = VehicleSpec(autopilot="px4", sysid=1, firmware="1.13", endpoints=(f"onboard:0:{port}",), params=PATIENT)
    with World([spec], speed=2.0, ready_s=0.5):
        session, endpoint = net.router()
        await onboard(session, f"udpin:127.0.0.1:{port}", origin=ORIGIN)
        async with zmav.open(connect=[endpoint]) as z:
            vehicle = z.vehicle("quad1")
            await vehicle.wait_until(lambda s: bool(s.ready and s.local and s.firmware), PATIENCE_S)
            await vehicle.arm()
            await vehicle.takeoff(5.0)
            # The nose turns on and on: nothing but the torque holds it.
            nose = turned(0.7)
            await fly_until(
                vehicle, lambda s: nose(s) and s.mode == "OFFBOARD", {"torque": (0.0, 0.0, 0.02), "thrust": 0.5}
            )


async def sticks(vehicle: Vehicle, rules: str) -> None:
    """Sticks act in the mode the vehicle is in: PX4 enters a pilot's mode only where there are sticks already;
    ArduPilot must take us for its ground station.
    """
    if rules == "arducopter":
        await vehicle.params.set("MAV_GCS_SYSID", 1)
    leaning = {"manual": wire.ManualControl(x=0.4, z=0.5)}
    mode = STICK_MODE[rules]
    await fly_until(vehicle, lambda s: s.attitude is not None and s.attitude.pitch < -0.08, leaning, mode)
    if rules == "arducopter":
        start = vehicle.state.attitude.yaw if vehicle.state.attitude else 0.0
        rc = {"rc": [1500, 1500, 1500, 1800]}
        await fly_until(vehicle, lambda s: s.attitude is not None and abs(s.attitude.yaw - start) > 0.5, rc, mode)
        async with vehicle.lease("tester") as lease:
            lease.setpoint(servo=[1500])  # a motor's
            await counted(vehicle, "refused")

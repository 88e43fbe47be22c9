"""``zmav up`` is killed (-9) or ended (SIGTERM) with the vehicle in the air, or the bridge of the
ground station: nothing flies on.

The embedded simulator imitates what ArduCopter and PX4 do then; docs/failsafes.md has what was measured on the former.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import sys
from collections.abc import AsyncIterator
from typing import NamedTuple

import zmav
from tests.cli.conftest import PLACE, Process
from tests.descents import PX4_DOWN
from tests.ports import free_udp_ports
from zmav.mavlink import Packer, load_dialect
from zmav.process import free_port
from zmav.services.authority import leader
from zmav.sim import SimVehicle, VehicleSpec, VehicleStatus, World

SPEED, BEATING_SPEED = 6.0, 2.0
FAR = (600.0, 0.0, -8.0)


class Flight(NamedTuple):
    """A copter in the air, the process of its companion, and a client."""

    world: World
    up: Process
    vehicle: zmav.Vehicle
    endpoint: str
    """its router's"""

    @property
    def sim(self) -> SimVehicle:
        return self.world.vehicles[0]

    async def see(self, what: str, true: object, sim_s: float = 180.0) -> VehicleStatus:
        assert callable(true)
        try:
            await asyncio.to_thread(self.world.wait_for, lambda: bool(true(self.sim.status())), sim_s)
        except zmav.ZmavError:
            raise AssertionError(f"no {what}; {self.sim.status()}") from None
        return self.sim.status()

    async def stream(self, until: float) -> None:
        """Velocities north until it goes as fast as that."""
        async with self.vehicle.lease("alice", ttl=20.0) as lease:
            while self.sim.status().speed_mps < until:
                lease.setpoint(vel=(4.0, 0.0, 0.0))
                await asyncio.sleep(0.02)
            self.up.popen.kill()  # before the lease is given back

    async def go(self) -> asyncio.Task[None]:
        """On its way far north."""
        flying = asyncio.create_task(self.vehicle.goto(pos=FAR))
        await self.see("speed", lambda s: s.speed_mps > 5.0)
        return flying


@contextlib.asynccontextmanager
async def flight(spec: VehicleSpec) -> AsyncIterator[Flight]:
    with World([spec], endpoint="tcp:0", speed=SPEED, ready_s=0.5) as world:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        up = Process(sys.executable, "-m", "zmav", "up", "--link", world.urls[0], "-l", endpoint, "--origin", *PLACE)
        try:
            up.expect("demo/quad1: ")
            async with zmav.open(connect=[endpoint]) as z:
                (vehicle,) = await z.wait_for("quad1", timeout=30.0)
                await vehicle.wait_until(lambda s: s.connected, 30.0)
                await vehicle.arm()
                await vehicle.takeoff(8.0)
                yield Flight(world, up, vehicle, endpoint)
        finally:
            up.popen.kill()
            up.wait()


def north(status: VehicleStatus) -> float:
    return status.ned_m[0]


async def test_a_velocity_is_dropped_by_arducopter() -> None:
    async with flight(VehicleSpec()) as f:
        await f.stream(until=3.0)
        at = f.sim.status()
        there = await f.see("stop", lambda s: s.speed_mps < 0.1)
        assert (there.mode, there.armed) == ("GUIDED", True)
        assert north(there) - north(at) < 4.0 * 3.0 + 15.0  # GUID_TIMEOUT, and a stop from 4 m/s


async def test_a_far_target_is_given_as_a_near_one_and_with_the_parameters_set_it_comes_home() -> None:
    """MAV_GCS_SYSID is its own id, as the companion's heartbeats have it: their end is the ground station's loss."""
    params = {"FS_GCS_ENABLE": 1, "MAV_GCS_SYSID": 1, "FS_GCS_TIMEOUT": 5 * SPEED}  # the companion's clock is slower
    async with flight(VehicleSpec(params=params)) as f:
        flying = await f.go()
        f.up.popen.kill()
        f.up.wait()
        at = f.sim.status()
        there = await f.see("stop", lambda s: s.speed_mps < 0.1)
        flying.cancel()
        assert (there.mode, there.armed) == ("GUIDED", True)
        assert math.dist(there.ned_m, FAR) > 300.0
        assert north(there) - north(at) < leader.AHEAD_M + leader.AHEAD_S * 12.0
        await f.see("RTL", lambda s: s.mode == "RTL")
        await f.see("home", lambda s: math.hypot(*s.ned_m[:2]) < 2.0)


async def test_the_bridge_that_a_ground_station_beats_through() -> None:
    """It is killed with the vehicle in the air: to the autopilot the ground station is lost, and that is watched."""
    timeout = 3 * BEATING_SPEED
    port = free_udp_ports(1)
    async with flight(VehicleSpec(params={"FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": timeout})) as f:
        f.world.set_speed(BEATING_SPEED)  # nothing is flown while programs start and the station is patient
        gcs = Process(sys.executable, "-m", "zmav", "gcs", "--udpin", str(port), "-e", f.endpoint)
        beating = asyncio.create_task(beat(port))
        try:
            await asyncio.to_thread(gcs.expect, "is 255/190")
            patient = f.world.time_s + 2.0 * timeout
            await f.see("time", lambda s: f.world.time_s > patient)
            assert f.sim.status().mode == "GUIDED", "the station was heard all the time"
            gcs.popen.kill()
            await f.see("RTL", lambda s: s.mode == "RTL")
        finally:
            beating.cancel()
            gcs.popen.kill()
            gcs.wait()


async def beat(port: int) -> None:
    """The HEARTBEATs of a ground station."""
    packer, out = Packer(load_dialect(), 255, 190), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with out:
        while True:
            out.sendto(packer.pack("HEARTBEAT", type=6, autopilot=8, mavlink_version=3), ("127.0.0.1", port))
            await asyncio.sleep(0.3)


async def test_px4_leaves_offboard_by_itself() -> None:
    spec = VehicleSpec(autopilot="px4", params={"COM_OBL_RC_ACT": 4, **PX4_DOWN})
    async with flight(spec) as f:
        await f.stream(until=2.0)
        await f.see("landing", lambda s: not s.armed, sim_s=400.0)


async def test_sigterm_stops_a_stream_and_a_goto() -> None:
    async with flight(VehicleSpec()) as f:
        flying = await f.go()
        speed = f.sim.status().speed_mps
        assert await asyncio.to_thread(f.up.stop) == 0
        flying.cancel()
        at = f.sim.status()
        there = await f.see("stop", lambda s: s.speed_mps < 0.1)
        assert speed > 5.0
        assert north(there) - north(at) < 40.0  # it brakes, and does not go as far as its near target

"""A simulated PX4 through the whole of it: a lease, a takeoff, OFFBOARD by the stream, its loss, and the pilot."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import zmav
from zmav import wire
from zmav.config import Failsafe
from zmav.sim import VehicleSpec, World

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

HOME = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
SPEED = 4.0


async def stream_until(lease: zmav.Lease, vehicle: zmav.Vehicle, mode: str) -> None:
    for _ in range(400):
        if vehicle.state.mode == mode:
            return
        lease.setpoint(vel=(1.0, 0.0, 0.0))
        await asyncio.sleep(0.05)
    raise AssertionError(f"no {mode}; {vehicle.state}")


async def test_px4(net: Net, onboard: StartOnboard) -> None:
    # Its clock runs faster than ours: the hold must be ordered before it misses the stream by itself.
    spec = VehicleSpec(autopilot="px4", params={"COM_OF_LOSS_T": 10.0, "COM_FLTMODE1": 2})
    with World([spec], endpoint="tcp:127.0.0.1:0", speed=SPEED, ready_s=1.0) as world:
        session, endpoint = net.router()
        await onboard(
            session, world.urls[0], origin=HOME, failsafe=Failsafe(hold_after=0.5, land_after=3.0, action="land")
        )
        async with zmav.open(connect=[endpoint]) as z:
            (vehicle,) = await z.wait_for("quad1")
            await vehicle.wait_until(lambda s: bool(s.connected and s.ready), 30.0)
            async with vehicle.lease("alice", ttl=20.0) as lease:
                await vehicle.arm()
                await vehicle.takeoff(6.0)
                await vehicle.wait_until(lambda s: s.mode == "HOLD", 30.0)
                assert lease.lost is None  # TAKEOFF ends in HOLD by itself: that is nobody's taking over
                await stream_until(lease, vehicle, "OFFBOARD")
                await vehicle.wait_until(lambda s: s.mode == "HOLD", 10.0)  # the stream has stopped
                await vehicle.wait_until(lambda s: s.setpoints.get("held") == 1, 10.0)
                await stream_until(lease, vehicle, "OFFBOARD")  # and goes on
                await lease.vehicle.wait_until(lambda s: s.mode == "LAND", 20.0)  # and nobody comes back
                await vehicle.wait_until(lambda s: s.lease is None, 5.0)
                assert lease.lost is not None
                assert lease.lost.detail["reason"] == "failsafe"
            async with vehicle.lease("bob", ttl=20.0) as lease:
                await stream_until(lease, vehicle, "OFFBOARD")
                world.call(lambda: world.vehicles[0].pilot_mode("POSCTL"))
                await vehicle.wait_until(lambda s: s.mode == "POSCTL", 10.0)
                await vehicle.wait_until(lambda s: s.lease is None, 5.0)
                assert lease.lost is not None
                assert lease.lost.detail["reason"] == "pilot"

"""An agent of your own: takes the lease, circles, says every second what it does, ends well on Ctrl-C or SIGTERM.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/agent.py               # 'zmav top' shows it; so does 'zmav echo "quad1/agent/*/status"'
"""

from __future__ import annotations

import asyncio
import math
import sys

import zmav

NAME, RADIUS, SPEED, HEIGHT, RATE = "orbit", 8.0, 3.0, 10.0, 10  # m, m/s, m above home, Hz


class Orbit:
    def __init__(self, z: zmav.Client, vehicle: zmav.Vehicle) -> None:
        self.z, self.vehicle = z, vehicle

    def say(self, state: str, text: str = "") -> None:
        self.z.say_status(NAME, state, text, vehicle=self.vehicle.name)

    async def run(self) -> None:
        try:
            async with self.vehicle.lease(NAME) as lease:  # given back at the end: the vehicle holds
                self.say("takeoff")
                await self.vehicle.arm()
                start = self.vehicle.local  # on the ground: m north, east, down of the fleet's origin
                await self.vehicle.takeoff(HEIGHT)
                await self.circle(lease, *start)
        except zmav.ZmavError as e:  # refused; or another agent, an operator or the pilot took the vehicle
            self.say("failed", str(e))
            raise
        except asyncio.CancelledError:
            self.say("ended")
            raise

    async def circle(self, lease: zmav.Lease, north: float, east: float, down: float) -> None:
        step = 0
        while True:
            angle = SPEED / RADIUS * step / RATE
            n, e = math.cos(angle), math.sin(angle)
            pos, vel = (north + RADIUS * (n - 1.0), east + RADIUS * e, down - HEIGHT), (-SPEED * e, SPEED * n, 0.0)
            lease.setpoint(pos=pos, vel=vel, yaw=math.remainder(angle + math.pi, math.tau))  # facing the centre
            if step % RATE == 0:
                self.say("circling", f"lap {angle / math.tau:.1f}")
            step += 1
            await asyncio.sleep(1.0 / RATE)


async def main(*endpoints: str) -> None:
    async with zmav.open(connect=endpoints) as z:
        (vehicle,) = await z.wait_for("quad1")
        await Orbit(z, vehicle).run()


if __name__ == "__main__":
    zmav.run(main(*sys.argv[1:]))

"""A vehicle follows another one (a rover, say) at an offset, until that one is lost: then it holds. Ctrl-C: it holds.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/follow.py quad1 quad2  # leader, follower; then 'zmav goto quad1 --to 20,0,10'
"""

from __future__ import annotations

import asyncio
import sys

import zmav

OFFSET = (-6.0, 0.0, -4.0)  # m north, east and down of the leader
LOWEST, RATE = 6.0, 10.0  # m above the fleet's origin, Hz


async def follow(leader: zmav.Vehicle, lease: zmav.Lease) -> None:
    """Until the leader's state is older than two seconds (Stale), or the lease is lost (NotHolder)."""
    while True:
        north, east, down = (a + b for a, b in zip(leader.local, OFFSET, strict=True))
        velocity = leader.state.velocity
        level = (velocity[0], velocity[1], 0.0) if velocity else None  # fed forward: it does not lag behind
        lease.setpoint(pos=(north, east, min(down, -LOWEST)), vel=level)
        await asyncio.sleep(1.0 / RATE)


async def main(leader_name: str, follower_name: str, *endpoints: str) -> None:
    async with zmav.open(connect=endpoints) as z:
        leader, follower = await z.wait_for(leader_name, follower_name)
        async with follower.lease("follow") as lease:  # when it is given back, the vehicle holds
            await follower.arm()
            await follower.takeoff(LOWEST)
            print(f"{follower.name} follows {leader.name}", flush=True)
            try:
                await follow(leader, lease)
            except zmav.errors.Stale as e:
                print(f"{follower.name} holds: {e}", flush=True)


if __name__ == "__main__":
    zmav.run(main(*(sys.argv[1:] or ("quad1", "quad2"))))

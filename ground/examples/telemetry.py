"""Print a message of every vehicle by one key expression, as fast as it is asked for.

zmav demo --stay                              # in another terminal: three simulated copters, quad1 to quad3
python ground/examples/telemetry.py           # or with the endpoint of a router: tcp/10.0.0.7:7447
"""

from __future__ import annotations

import math
import sys

import zmav


async def main(*endpoints: str) -> None:
    async with zmav.open(connect=endpoints) as z, z.stream("*/ATTITUDE", hz=2) as messages:
        async for vehicle, message in messages:
            roll, pitch, yaw = (math.degrees(message.fields[name]) for name in ("roll", "pitch", "yaw"))
            print(f"{vehicle}: roll {roll:+.1f}, pitch {pitch:+.1f}, yaw {yaw:+.1f} degrees", flush=True)


if __name__ == "__main__":
    zmav.run(main(*sys.argv[1:]))

"""The embedded simulator with a pilot beside it, whose radio is on and whose hands rest.

python -m agents.controllers.bench.simulator FLEET.toml
"""

from __future__ import annotations

import signal
import sys

from zmav.sim import World
from zmav.sim.fleetfile import load_simulated
from zmav.sim.values import parse_wind


def main(path: str) -> None:
    """Run the fleet file's world until SIGTERM."""
    file = load_simulated(path)
    table = file.world
    wind, gusts = parse_wind(table.wind)
    world = World(
        file.vehicles, home=file.home, tick_hz=table.tick_hz, noise=table.noise, wind=wind, gusts=gusts, seed=table.seed
    )
    signal.signal(signal.SIGTERM, lambda *_: world.stop())
    px4 = world.vehicles[0].px4
    px4.sticks.pilot.sticks(throttle=0.5)
    px4.sticks.radio = True
    try:
        world.run()
    finally:
        world.close()


if __name__ == "__main__":
    main(sys.argv[1])

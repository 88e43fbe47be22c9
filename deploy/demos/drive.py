"""An agent that drives a rover along a way: 'zmav agent run deploy/demos/drive.py --vehicle rover1 -o way=walk'.

It streams positions with velocities under a lease, as any agent for a rover or a boat would.
"""

from __future__ import annotations

from typing import Literal

import msgspec

import zmav
from agents.demo.rover import drive, eight, walk


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    way: Literal["eight", "walk"] = "eight"
    speed: float = 1.0
    """m/s at most"""
    seconds: float = 120.0
    seed: int = 1
    """of a walk"""


class Drive(zmav.Agent):
    """Drives from where the rover stands: a figure of eight, or a random walk."""

    name = "drive"
    settings_type = Settings

    async def run(self) -> None:
        how: Settings = self.settings
        state = await self.vehicle.wait_until(lambda s: s.ready is True and s.local is not None, 60.0)
        assert state.local is not None
        way = eight(how.speed) if how.way == "eight" else walk(how.speed, how.seed)
        self.status("drive", f"{how.way}, up to {how.speed:g} m/s")
        await drive(self.vehicle, way, (state.local[0], state.local[1]), how.seconds)
        self.status("done")

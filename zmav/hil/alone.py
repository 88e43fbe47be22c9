"""A vehicle whose flight stack has physics of its own: nothing of it is known here but that its program runs."""

from __future__ import annotations

from collections.abc import Callable

from zmav.hil.plant import Plant
from zmav.hil.vehicle import External
from zmav.sim.endpoints import Wiring
from zmav.sim.spec import PX4


class Alone(External):
    """Its ``plant`` stands at the start and never moves."""

    def __init__(self, name: str, sysid: int, plant: Plant, say: Callable[[str], None], autopilot: str) -> None:
        super().__init__(name, sysid, plant, say)
        self.autopilot = PX4 if autopilot == PX4 else "ardupilot"

    def open(self, wiring: Wiring) -> None:
        self.connected = True

    def close(self) -> None:
        self.connected = False

    @property
    def url(self) -> str:
        return ""

    @property
    def waits(self) -> bool:
        return True

    def proceed(self) -> None:
        """Its time is its own."""

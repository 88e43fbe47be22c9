"""EV1 that also tells what its clock shows: for measuring."""

from __future__ import annotations

from collections.abc import Mapping

from agents.controllers.ev1 import Ev1
from agents.controllers.types import Reference, State, TorqueThrust


class Clocked(Ev1):
    """EV1, with the sum of its dt and the time of each state as signals."""

    def __init__(self, tuned: Mapping[str, float] | None = None) -> None:
        super().__init__(tuned)
        self._sum = 0.0

    def update(self, state: State, reference: Reference) -> TorqueThrust:
        output = super().update(state, reference)
        self._sum += state.dt
        self.signals = {**self.signals, "clock": self._sum, "state_t": state.t}
        return output

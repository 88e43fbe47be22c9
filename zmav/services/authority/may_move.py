"""What lets something move the vehicle, and what is counted of setpoints: below all that asks for either."""

from __future__ import annotations

import collections
import threading
from typing import ParamSpec, Protocol

P = ParamSpec("P")


class MayMove(Protocol[P]):
    """Asked each time before something moves the vehicle: returns where it may, raises a
    :class:`~zmav.errors.ZmavError` that says why not.

    What moves a vehicle takes it where it is built, without a default: what was forgotten permits nothing.
    """

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> None: ...


class SetpointCounts(collections.Counter[str]):
    """What became of the setpoints, by reason; :meth:`add` from any thread."""

    def __init__(self) -> None:
        super().__init__()
        self._adding = threading.Lock()

    def add(self, what: str) -> None:
        with self._adding:
            self[what] += 1

"""What the conductor asks of what keeps a way home ready for each vehicle (:mod:`agents.planner.returning`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from agents.planner.execute.commit import Entry, Part, Stamp
from agents.planner.model.problem import Floats


class Home(NamedTuple):
    """What a vehicle flies by itself where nothing comes after the segment that this is put with. Times are ours."""

    begins: float
    rows: Floats
    """(K, 7): t, place, velocity, as of a segment"""


class Homes(Protocol):
    """Called in this order: :meth:`begin`, then for each part what is asked, then :meth:`sent` for what was put."""

    def begin(self, parts: Sequence[Part], now: float) -> None:
        """Something is decided for these."""

    def blocker(self, part: Part, entry: Entry, now: float) -> str | None:
        """Whose way home would meet ``part`` on ``entry``; None: nobody's."""

    def yields(self, part: Part, now: float) -> bool:
        """It is to be put what it has again, with another way home."""

    def home(self, part: Part, entry: Entry, ends: float, now: float) -> Home | None:
        """What goes along with ``entry``, which is put so that it ends at ``ends``; None: nothing is clear."""

    def sent(self, part: Part, stamp: Stamp, deadline: float) -> None:
        """It was put, to be taken by ``deadline`` (the vehicle's clock)."""

    def heard(self, part: Part, stamp: Stamp | None, said: float) -> None:
        """Which segment it is on."""

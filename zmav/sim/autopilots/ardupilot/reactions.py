"""What a kind of ArduPilot does when one of its failsafes or its fence trips; :mod:`.failsafe` and :mod:`.fence` say
when.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar


class Reactions(ABC):
    """One vehicle's answers, with its own texts, parameters and modes."""

    BATTERY_URGENCY: ClassVar[tuple[int, ...]]
    """the values of BATT_FS_LOW_ACT, the one that others give way to first"""

    @abstractmethod
    def gcs_lost(self) -> None:
        """The ground station is silent. Its overrides are dropped already."""

    @abstractmethod
    def gcs_back(self) -> None:
        """The ground station is heard again."""

    @abstractmethod
    def radio_changed(self, lost: bool) -> None:
        """The radio was lost, or is back."""

    @abstractmethod
    def battery_failed(self, action: int) -> None:
        """The battery is low or critical; ``action``: BATT_FS_LOW_ACT or BATT_FS_CRT_ACT."""

    @abstractmethod
    def estimate_lost(self) -> None:
        """The position estimate is gone ("EKF variance" was said)."""

    @abstractmethod
    def fence_breached(self, new: int, beyond_m: float) -> None:
        """Fences of those types (FENCE_TYPE) were breached, by at most so many metres; FENCE_ACTION asks for
        something.
        """

    def gps_glitched(self, on: bool) -> None:  # noqa: B027 - not every kind says anything
        """The filter has come to doubt the GPS, or trusts it again."""

    def lane_switched(self, lane: int) -> None:  # noqa: B027 - likewise
        """The filter of another inertial sensor was chosen."""

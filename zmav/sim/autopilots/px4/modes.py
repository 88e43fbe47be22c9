"""PX4's flight modes as data: their numbers in the custom mode, and what each needs.

Numbers: https://docs.px4.io/v1.16/en/flight_modes_mc/ and px4_custom_mode.h; needs as in the user guide's pages of the
modes.
"""

from __future__ import annotations

import msgspec


class Mode(msgspec.Struct, frozen=True, kw_only=True):
    """One flight mode. ``number`` is its bit in the arming reports; ``standard``: MAV_STANDARD_MODE."""

    name: str
    number: int
    main: int
    sub: int = 0
    auto: bool = False
    manual: bool = False
    position: bool = True
    """needs a position estimate"""
    height: bool = True
    """needs an estimate of the height"""
    arms: bool = True
    """the vehicle may be armed in it"""
    standard: int = 0

    @property
    def custom(self) -> int:
        return self.main << 16 | self.sub << 24

    @property
    def bit(self) -> int:
        """In the sets of modes of the arming reports."""
        return 1 << self.number


MANUAL = Mode(name="MANUAL", number=0, main=1, manual=True, position=False, height=False)
ALTCTL = Mode(name="ALTCTL", number=1, main=2, manual=True, position=False, standard=4)
POSCTL = Mode(name="POSCTL", number=2, main=3, manual=True, standard=1)
MISSION = Mode(name="MISSION", number=3, main=4, sub=4, auto=True, standard=6)
HOLD = Mode(name="HOLD", number=4, main=4, sub=3, auto=True)
RTL = Mode(name="RTL", number=5, main=4, sub=5, auto=True, arms=False, standard=5)
DESCEND = Mode(name="DESCEND", number=12, main=4, sub=6, auto=True, position=False, height=False, arms=False)
TERMINATION = Mode(name="TERMINATION", number=13, main=10, position=False, height=False, arms=False)
OFFBOARD = Mode(name="OFFBOARD", number=14, main=6, position=False, height=False)
STABILIZED = Mode(name="STABILIZED", number=15, main=7, manual=True, position=False, height=False)
TAKEOFF = Mode(name="TAKEOFF", number=17, main=4, sub=2, auto=True, standard=8)
LAND = Mode(name="LAND", number=18, main=4, sub=6, auto=True, arms=False, standard=7)

# Those that can be asked for: DESCEND is a failsafe's only.
MODES = (MANUAL, ALTCTL, POSCTL, MISSION, HOLD, RTL, TERMINATION, OFFBOARD, STABILIZED, TAKEOFF, LAND)
BY_NUMBERS = {(mode.main, mode.sub): mode for mode in MODES}
NOT_SIMULATED = {(3, 1): "Orbit", (3, 2): "Position slow", (4, 8): "Follow", (4, 9): "Precision land", (5, 0): "Acro"}

# COM_FLTMODE1..6 and COM_FLTMODE: what a position of the pilot's switch means.
SWITCH: dict[int, Mode] = {
    0: MANUAL,
    1: ALTCTL,
    2: POSCTL,
    3: MISSION,
    4: HOLD,
    5: RTL,
    7: OFFBOARD,
    8: STABILIZED,
    10: TAKEOFF,
    11: LAND,
}

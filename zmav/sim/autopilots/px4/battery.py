"""The battery as PX4 takes it: what is left, its voltage, and how it warns.

An airframe that PX4's own simulation flies has PX4's simulated battery: full until it is armed, then emptied evenly in
SIM_BAT_DRAIN seconds down to SIM_BAT_MIN_PCT, and full again after disarming, as was recorded. Any other has the pack
of its body. https://docs.px4.io/v1.16/en/config/battery.html, .../config/safety.html#battery-level-failsafe
"""

from __future__ import annotations

import enum

from zmav.sim.autopilots.px4.state import Px4State
from zmav.sim.dynamics.battery import BatteryHandle

REFILL_S = 15.0  # of a whole simulated battery, once disarmed
_SAME_V = 1e-3
_EMPTY_CELL_V = 3.2  # under load: beyond what BAT1_V_EMPTY takes for empty, whatever the count of charge says


class Warning(enum.IntEnum):
    """How bad it is; the thresholds are BAT_LOW_THR, BAT_CRIT_THR and BAT_EMERGEN_THR."""

    NONE = 0
    LOW = 1
    CRITICAL = 2
    EMERGENCY = 3


_CHARGE_STATE = {Warning.NONE: 1, Warning.LOW: 2, Warning.CRITICAL: 3, Warning.EMERGENCY: 4}  # MAV_BATTERY_CHARGE_STATE
_THRESHOLDS = {Warning.EMERGENCY: "BAT_EMERGEN_THR", Warning.CRITICAL: "BAT_CRIT_THR", Warning.LOW: "BAT_LOW_THR"}


class Battery:
    """One vehicle's battery; ``pack`` is the one of its body."""

    def __init__(self, copter: Px4State) -> None:
        self._copter = copter
        self._simulated = 1.0
        self._looked = copter.now
        self._worst = Warning.NONE

    @property
    def pack(self) -> BatteryHandle:
        return self._copter.power

    @property
    def measured(self) -> bool:
        """It is the body's own, with a current that is measured."""
        return self.pack.pack.capacity_mah > 0.0

    @property
    def remaining(self) -> float:
        """What is left, 0 to 1."""
        left = self.pack.charge if self.measured else min(self._simulated, self.pack.charge)
        return 0.0 if self.volts < _EMPTY_CELL_V * self._cells else left

    @property
    def volts(self) -> float:
        if self.measured or self.pack.volts < self.pack.pack.full_v - _SAME_V:
            return self.pack.volts
        p = self._copter.params
        empty, full = p["BAT1_V_EMPTY"], p["BAT1_V_CHARGED"]
        return float(self._cells * (empty + self._simulated * (full - empty)))

    @property
    def amperes(self) -> float | None:
        """None: it does not say."""
        return float(self._copter.sense.current_a) if self.measured else None

    @property
    def consumed_mah(self) -> float:
        return self._copter.consumed_mah if self.measured else 0.0

    @property
    def warning(self) -> Warning:
        """In flight it never gets better."""
        return self._worst

    @property
    def charge_state(self) -> int:
        return _CHARGE_STATE[self._worst]

    @property
    def _cells(self) -> int:
        return self.pack.pack.cells

    def update(self) -> None:
        """Ten times a second."""
        copter, p = self._copter, self._copter.params
        dt, self._looked = copter.now - self._looked, copter.now
        if not self.measured:
            if copter.armed:
                least, whole = p["SIM_BAT_MIN_PCT"] / 100.0, max(p["SIM_BAT_DRAIN"], 1.0)
                self._simulated = max(self._simulated - dt / whole, min(least, self._simulated))
            else:
                self._simulated = min(self._simulated + dt / REFILL_S, 1.0)
        left = self.remaining
        now = next((each for each, name in _THRESHOLDS.items() if left < p[name]), Warning.NONE)
        self._worst = max(self._worst, now) if copter.armed else now

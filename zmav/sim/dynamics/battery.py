"""Lithium-polymer packs of N vehicles: voltage from charge and current, and charge from current.

    V = V_oc(s) - R I,      s' = -I / Q

The open-circuit voltage of a cell over its state of charge s is that of M. Chen and G. A. Rincon-Mora, "Accurate
electrical battery model capable of predicting runtime and I-V performance", IEEE Transactions on Energy Conversion
21(2), 2006, equation 2 (measured on polymer lithium-ion cells), scaled so that a full pack has its nominal full
voltage. The resistance is the ohmic one, the same at every charge; the cells' slow relaxation is left out.

A pack without a capacity is an ideal source, as an ArduPilot's simulation has by default.
"""

from __future__ import annotations

import msgspec
import numpy as np

from zmav.sim.arrays import Array, Flags

AS_PER_MAH = 3.6
_CHARGE = np.linspace(0.0, 1.0, 513)
HIGHEST_V = 60.0


def open_circuit_share(charge: Array) -> Array:
    """Open-circuit voltage at a state of charge 0..1, as a share of the full pack's; any shape."""
    return _cell(charge) / float(_cell(np.ones(1))[0])


def _cell(s: Array) -> Array:
    volts: Array = -1.031 * np.exp(-35.0 * s) + 3.685 + s * (0.2156 + s * (-0.1178 + 0.3201 * s))
    return volts


class Pack(msgspec.Struct, frozen=True, kw_only=True):
    """A battery: cells in series, capacity (0: an ideal source), resistance of the pack, volts when full."""

    cells: int = 3
    capacity_mah: float = 0.0
    resistance_ohm: float = 0.0
    full_v: float = 12.6


class Battery:
    """``volts``, ``current`` (A), ``charge`` (0..1) and ``consumed`` (mAh since the start), (N,) each.

    :meth:`step` is called once a tick; the rest changes one vehicle's column.
    """

    def __init__(self, pack: Pack, n: int) -> None:
        self.pack = pack
        self.full_v: Array = np.full(n, pack.full_v)
        self.capacity_mah: Array = np.full(n, pack.capacity_mah)
        self.resistance: Array = np.full(n, pack.resistance_ohm)
        self.charge: Array = np.ones(n)
        self.consumed: Array = np.zeros(n)
        self.current: Array = np.zeros(n)
        self.volts: Array = self.full_v.copy()
        self._source_v: Array = self.full_v.copy()  # of ideal sources
        self._finite: Flags = self.capacity_mah > 0.0
        self._steady = not self._finite.any()  # no voltage changes with the current

    def step(self, current: Array, dt: float) -> None:
        """Draw ``current`` (N,) amperes for ``dt`` seconds."""
        self.current = current
        used = current * (dt / AS_PER_MAH)
        self.consumed += used
        if self._steady:
            return
        self.charge = np.maximum(self.charge - used / np.where(self._finite, self.capacity_mah, np.inf), 0.0)
        resting = open_circuit_share(self.charge) * self.full_v
        # An empty cell gives nothing any more.
        loaded = (resting - self.resistance * current) * (self.charge > 0.0)
        volts = np.where(self._finite, loaded, self._source_v)
        self.volts = np.maximum(volts, 0.0)

    def fit(self, index: int, *, volts: float, capacity_mah: float) -> None:
        """Give one vehicle another pack: of ``capacity_mah`` (0: an ideal source), with ``volts`` at rest now; its
        charge is what that voltage says of a pack that has :attr:`full_v` when full.
        """
        volts = min(max(volts, 0.0), HIGHEST_V)
        self.capacity_mah[index] = capacity_mah
        self._finite[index] = capacity_mah > 0.0
        self._steady = not self._finite.any()
        self._source_v[index] = self.volts[index] = volts
        share = volts / float(self.full_v[index]) if self.full_v[index] > 0.0 else 0.0
        self.charge[index] = float(np.interp(share, open_circuit_share(_CHARGE), _CHARGE))

    def drain(self, index: int, left: float) -> None:
        """Take charge out until the share ``left`` (0..1) remains; an ideal source falls to that charge's voltage."""
        left = min(max(left, 0.0), 1.0)
        taken = max(float(self.charge[index]) - left, 0.0)
        self.consumed[index] += taken * self.capacity_mah[index]
        self.charge[index] = left
        share = float(open_circuit_share(np.array([left]))[0]) if left > 0.0 else 0.0
        self._source_v[index] = self.volts[index] = share * self.full_v[index]


class BatteryHandle:
    """One vehicle's column of :class:`Battery`."""

    def __init__(self, battery: Battery, index: int) -> None:
        self.battery = battery
        self.index = index

    @classmethod
    def bench(cls) -> BatteryHandle:
        """Of a pack that no vehicle has: until one is plugged in."""
        return cls(Battery(Pack(), 1), 0)

    @property
    def pack(self) -> Pack:
        return self.battery.pack

    @property
    def volts(self) -> float:
        return float(self.battery.volts[self.index])

    @property
    def charge(self) -> float:
        """What is left, 0..1."""
        return float(self.battery.charge[self.index])

    @property
    def consumed_mah(self) -> float:
        return float(self.battery.consumed[self.index])

    def fit(self, *, volts: float, capacity_mah: float) -> None:
        """See :meth:`Battery.fit`."""
        self.battery.fit(self.index, volts=volts, capacity_mah=capacity_mah)

"""Thinning: how often each message of each vehicle may leave through a radio that has a budget.

Zenoh's down-sampling drops at our door what comes sooner than a rule's period. A rule has one timer for all that its
key expression matches, on each link, so there is one for each vehicle and message. What must arrive and what is
real-time is never thinned, and what nobody behind a link reads does not come to its door at all.

Where no rate is given, a quarter of the budget is shared among the fleet's raw messages as if each vehicle were read
for :data:`READ` of them at once, and another quarter among the states; both within bounds. Rates that are given count
on any host that has a radio with a budget; the others only where every radio has one, because the same link may go
through either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from zmav import keys
from zmav.config import FleetConfig, Radio
from zmav.config.mesh import parse_budget

READ = 12
"""messages of a vehicle that are read at once: those of a ground station's usual picture"""
MESSAGE_BYTES, STATE_BYTES = 130, 1100
"""of one raw message and one state on the wire, headers included, measured"""
PART = 0.25
"""of a budget, for each of the two"""
RAW_HZ = (0.5, 4.0)
"""bounds of what is worked out"""
STATE_HZ = (1.0, keys.STATE.rate_hz or 5.0)
"""a state older than two seconds counts as stale"""
MARGIN = 1.05
"""a rule is so much faster than the rate it stands for: what comes just at that rate must not lose every other one"""


@dataclass(frozen=True)
class Thin:
    """One rate: of a message of all vehicles, or of their ``state``."""

    name: str
    hz: float
    source: str

    def key(self, fleet: str, vehicle: str) -> str:
        if self.name == keys.STATE.name:
            return keys.STATE.key(fleet, vehicle)
        return keys.RX.key(fleet, vehicle, sys="*", comp="*", msg=self.name)


def thinned(file: FleetConfig, radios: Sequence[Radio]) -> tuple[Thin, ...]:
    """The rates for a host with those radios, by name; none where none of them has a budget."""
    budgets = [parse_budget(radio.budget) for radio in radios if radio.budget]
    if not budgets:
        return ()
    found: dict[str, Thin] = {}
    if len(budgets) == len(radios):
        found.update(_worked_out(min(budgets), len(file.vehicles) or 1))
    found.update({name: Thin(name, hz, f"fleet file: mesh.thin.{name}") for name, hz in file.mesh.thin.items()})
    own: dict[str, Thin] = {}
    for radio in radios:
        for name, hz in radio.thin.items():
            if name not in own or hz < own[name].hz:
                own[name] = Thin(name, hz, f"fleet file: thin of {radio.interface or radio.address}")
    found.update(own)
    return tuple(found[name] for name in sorted(found))


def _worked_out(budget: float, vehicles: int) -> dict[str, Thin]:
    from zmav.mavlink import load_dialect  # with the autopilots' rules, which a router without a budget need not load
    from zmav.services.rates.demand import NOT_STREAMED

    raw = _within(PART * budget / (vehicles * READ * MESSAGE_BYTES), RAW_HZ)
    state = _within(PART * budget / (vehicles * STATE_BYTES), STATE_HZ)
    source = f"budget of {budget / 1e3:.4g} kB/s among {vehicles}"
    streamed = (
        name
        for name, message in load_dialect().by_name.items()
        if message.target_system is None and name not in NOT_STREAMED
    )
    found = {name: Thin(name, raw, source) for name in streamed}
    return {**found, keys.STATE.name: Thin(keys.STATE.name, state, source)}


def _within(value: float, bounds: tuple[float, float]) -> float:
    return round(min(max(value, bounds[0]), bounds[1]), 2)


def downsampling(file: FleetConfig, fleet: str, name: str, thin: Sequence[Thin]) -> list[dict[str, Any]]:
    """Zenoh's ``downsampling`` for the host ``name``: on its router's links (``udp``, ``quic``) through the bearer."""
    vehicles = list(file.vehicles) or [name]
    rules = [{"key_expr": each.key(fleet, vehicle), "freq": each.hz * MARGIN} for vehicle in vehicles for each in thin]
    if not rules:
        return []
    where = {"interfaces": ["lo"], "link_protocols": ["udp", "quic"]}
    return [{"messages": ["put"], "flows": ["egress"], **where, "rules": rules}]

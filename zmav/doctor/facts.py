"""All that is known of one vehicle at one moment: what rules judge and reports are made from."""

from __future__ import annotations

import collections
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from zmav import keys, wire
from zmav.doctor.ways import Way
from zmav.vehicle import Vehicle

Presence = Literal["ok", "stale", "gone", "silent"]
"""ok: its state is fresh; stale: old, but its presence token is there; gone: old, and no token; silent: a token, and
never a state that could be believed"""

LINK_STALE = keys.LINK.stale_after or 5.0
"""s after which what a vehicle said of its link is no longer shown"""


class Happening(msgspec.Struct, kw_only=True, frozen=True):
    """An event of the vehicle's."""

    age: float
    kind: str
    severity: str
    text: str


class AgentReport(msgspec.Struct, kw_only=True, frozen=True):
    """A program that says what it does."""

    name: str
    fleet: str
    host: str
    """the vehicle or other host it speaks under"""
    state: str
    text: str
    age: float
    stale: bool

    @classmethod
    def of(cls, fleet: str, host: str, status: wire.AgentStatus, age: float) -> AgentReport:
        stale = age > (keys.AGENT_STATUS.stale_after or 0.0)
        return cls(
            name=status.agent, fleet=fleet, host=host, state=status.state, text=status.text, age=age, stale=stale
        )


@dataclass(frozen=True)
class Facts:
    """Ages are seconds; those of what the vehicle said itself are by its own clock."""

    name: str
    presence: Presence = "ok"
    age: float | None = 0.0
    state: wire.VehicleState | None = None
    link: wire.LinkQuality | None = None
    """None: never heard, or not for a while"""
    rtt: float | None = None
    """s of the last query there and back; None: none was answered lately"""
    way: Way | None = None
    """from here to it"""
    agents: tuple[AgentReport, ...] = ()
    events: tuple[Happening, ...] = ()
    """the newest first"""
    recent: collections.Counter[str] = field(default_factory=collections.Counter)
    """setpoints and orders dropped within the last seconds, by reason"""
    twins: tuple[str, ...] = ()
    """other vehicles present with its system id"""
    disbelieved: tuple[str, ...] = ()

    @property
    def now(self) -> float:
        """UTC by the vehicle's clock, so that a wrong one spoils no age."""
        return (self.state.t if self.state else 0.0) + (self.age or 0.0)


def facts_of(vehicle: Vehicle, **more: Any) -> Facts:
    """What a client knows of a vehicle by itself; ``more``: what was heard of it besides."""
    age = vehicle.age
    return Facts(
        name=vehicle.name,
        presence=_presence(age, vehicle.present),
        age=age,
        state=vehicle.last_state,
        disbelieved=tuple(vehicle.disbelieved),
        **more,
    )


def _presence(age: float | None, token: bool) -> Presence:
    if age is not None and age <= (keys.STATE.stale_after or 0.0):
        return "ok"
    if age is None:
        return "silent" if token else "gone"
    return "stale" if token else "gone"

"""What a host's router is opened with, worked out from the fleet file; each value with where it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec

from zmav.config import FleetConfig, Host, Profile, Radio
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials


@dataclass(frozen=True)
class Setting:
    """One value of Zenoh's configuration."""

    value: Any
    source: str
    """in words: ``profile mesh``, ``fleet file: mesh.lease``, ``-l``, ``zmav``"""


@dataclass(frozen=True)
class Way:
    """One way to a neighbour: out of our radio, to its address."""

    radio: Radio
    address: str
    port: int


@dataclass(frozen=True)
class Neighbour:
    """A host that our router is to be linked with by name."""

    name: str
    ways: tuple[Way, ...]
    """the cheapest first"""


@dataclass(frozen=True)
class RouterPlan:
    """One host's router."""

    fleet: str
    name: str
    profile: Profile
    host: Host
    settings: dict[str, Setting]
    """by Zenoh configuration path"""
    file: FleetConfig = field(default_factory=FleetConfig)
    """the whole fleet file: the rules at our door are about the other hosts, too"""
    neighbours: tuple[Neighbour, ...] = ()
    credentials: Credentials | None = None
    vehicle: bool = False
    """it is a vehicle's, and not a ground host's"""

    def session(self, base: SessionSettings) -> SessionSettings:
        """``base`` as a router's settings, with what was worked out here."""
        values = {path: setting.value for path, setting in self.settings.items()}
        return msgspec.structs.replace(base, mode="router", values={**values, **base.values})

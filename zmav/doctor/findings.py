"""What ``zmav doctor`` tells: findings, each about one of the :data:`zmav.doctor.topics.TOPICS`."""

from __future__ import annotations

import enum
from typing import Any

import msgspec

from zmav.doctor.words import clean

HOST, LINK, NETWORK, FLEET = "this host", "autopilot's port", "routers and links", "fleet"
VEHICLE = "vehicle"
"""the group of what is said of each vehicle or other host; it is headed by ``fleet/name``"""
GROUPS = (HOST, LINK, NETWORK, VEHICLE, FLEET)
"""in the order of the page"""


class Level(enum.Enum):
    """How it is."""

    OK = "ok"
    ADVICE = "advice"
    """no fault: what would be better, or what could not be looked at"""
    RED = "red"


class Finding(msgspec.Struct, frozen=True):
    """One line: how is it, what was looked at (and of whom), what was found, and what to do about it."""

    level: Level
    topic: str
    found: str
    advice: str = ""
    who: str = ""
    """``fleet/name`` of a vehicle or other host, or a part's name; empty: this host, or the fleet as a whole"""
    group: str = HOST

    @property
    def ok(self) -> bool:
        """Nothing is wrong; advice is no fault."""
        return self.level is not Level.RED

    @property
    def subject(self) -> str:
        """What it is about, of all lines: ``demo/quad1 clock``, ``router quad1``."""
        words = (self.who, self.topic) if self.group == VEHICLE else (self.topic, self.who)
        return " ".join(filter(None, words))

    @property
    def heading(self) -> str:
        """Under which heading of the page it stands."""
        return self.who if self.group == VEHICLE else self.group

    def document(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        return {
            "ok": self.ok,
            "level": self.level.value,
            "group": self.group,
            "subject": clean(self.subject),
            "topic": self.topic,
            "found": clean(self.found),
            "advice": clean(self.advice),
        }

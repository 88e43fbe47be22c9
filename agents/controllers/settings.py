"""What a supervisor of a controller is given."""

from __future__ import annotations

import re
from pathlib import Path

import msgspec

from agents.controllers import loading


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fixed while it runs."""

    controller: str
    """a file that ends in .py, or the name of one that is installed"""
    cls: str = ""
    """which class of the file, where it has several"""
    name: str = ""
    """in keys; empty: that of the file"""
    rate_hz: float = 250.0
    """cycles a second that are wanted of the autopilot"""
    back: str = ""
    """the mode it is handed back in; empty: the autopilot is told to hold"""
    rc: tuple[int, int, int, int] = (1, 2, 3, 4)
    """channels of the pilot's roll, pitch, throttle and yaw"""
    by_switch: bool = False
    """the pilot's switch (``[pilot_switch]`` in the fleet file) turned away from him engages it, too"""
    priority: int = 0
    lease_s: float = 3.0


def slug(what: str) -> str:
    """A name for keys from a file's or a controller's."""
    stem = Path(what).stem.lower() if loading.is_file(what) else what
    return re.sub("[^a-z0-9_-]+", "-", stem).strip("-") or "controller"

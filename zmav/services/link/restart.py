"""Whether the autopilot may have restarted, by the boot time that its messages carry."""

from __future__ import annotations

import time

from zmav.mavlink import decode
from zmav.services.link.port import Port

MESSAGES = ("ATTITUDE", "GLOBAL_POSITION_INT", "SYSTEM_TIME")
FRESH = 1.0
"""s: an older one says little of now"""
BACKWARDS = 1.0
"""s by which frames may overtake one another"""
BEHIND = 5.0
"""s by which the uptime may fall behind our clock over a silence (a slow simulation, a full link)"""


class Uptime:
    """Remembers how long the autopilot has been running. Lives on the event loop."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._last: tuple[float, float] | None = None

    def forget(self) -> None:
        self._last = None

    def restarted(self, source: tuple[int, int]) -> bool:
        """It has restarted since the last call, or may have over a silence: for caution, and not to be said."""
        uptime, now = self._read(source), time.monotonic()
        if uptime is None:
            return False
        last, self._last = self._last, (uptime, now)
        if last is None:
            return False
        passed = now - last[1]
        silent = passed > BEHIND
        return uptime < last[0] - BACKWARDS or (silent and uptime < last[0] + 0.5 * passed - BEHIND)

    def _read(self, source: tuple[int, int]) -> float | None:
        """Seconds since its boot, by the newest message that tells."""
        found = [heard for name in MESSAGES if (heard := self._port.latest(name, source)) and heard.age < FRESH]
        if not found:
            return None
        newest = min(found, key=lambda heard: heard.age)
        return float(decode(newest.frame, self._port.dialect)["time_boot_ms"]) / 1000.0

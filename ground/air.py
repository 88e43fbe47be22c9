"""What all sources tell of aircraft that are not of the fleet, as programs on the ground hear it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import msgspec

import zmav
from ground.program import hear_proven
from zmav import keys, wire
from zmav.traffic import BYTES, MOST_SOURCES, AirPicture, Seen, approach, on_earth, read
from zmav.waiting import on_loop


class Listener:
    """What all sources tell, judged where there are credentials: ``with Listener(z)``, on the event loop."""

    def __init__(self, z: zmav.Client, also: Callable[[wire.Traffic], object] = lambda report: None) -> None:
        self._z, self._also = z, also
        self.picture = AirPicture()
        self.refused = 0
        """reports that were none, or of nobody who may tell"""

    def __enter__(self) -> Listener:
        hear, key = on_loop(asyncio.get_running_loop(), self._hear), keys.TRAFFIC.key(self._z.fleet_name)
        how: dict[str, Any] = {"largest": BYTES, "most": 2 * MOST_SOURCES, "refuse": self._refuse}
        self._intake = hear_proven(self._z, key, read, lambda _, report: hear(report), **how)
        return self

    def _refuse(self) -> None:
        self.refused += 1

    def __exit__(self, *_: object) -> None:
        self._intake.close()

    def _hear(self, report: wire.Traffic) -> None:
        self.picture.hear(report, time.monotonic(), time.time())
        self._also(report)

    def rows(self) -> list[dict[str, Any]]:
        """Every aircraft, and the vehicle that it is nearest to; the nearest first."""
        rows = []
        for seen in self.picture.aircraft(time.monotonic()):
            vehicle, found = _nearest(self._z, seen)
            rows.append(
                msgspec.structs.asdict(seen.aircraft)
                | {
                    "age": round(seen.age, 1),
                    "source": seen.source,
                    "alt_amsl": None if seen.amsl is None else round(seen.amsl),
                    "alt_error": seen.height_error,
                    "vehicle": vehicle,
                    "distance": None if found is None else round(found.distance),
                    "height": None if found is None or found.height is None else round(found.height),
                    "nearest": None if found is None else round(found.nearest),
                    "time": None if found is None else round(found.time),
                }
            )
        return sorted(rows, key=lambda row: (row["distance"] is None, row["distance"]))


def _nearest(z: zmav.Client, seen: Seen) -> tuple[str | None, Any]:
    found = [
        (approach(seen, p, s.velocity), v.name)
        for v in z.fleet()
        if (s := v.last_state) is not None
        and (p := s.position) is not None
        and on_earth(p.lat_deg, p.lon_deg, p.alt_amsl)
    ]
    if not found:
        return None, None
    best, name = min(found, key=lambda each: each[0].distance)
    return name, best


async def watch(z: zmav.Client, seconds: float) -> list[dict[str, Any]]:
    """What all sources told within some seconds."""
    with Listener(z) as listener:
        await asyncio.sleep(seconds)
        return listener.rows()

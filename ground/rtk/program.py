"""``zmav rtk`` as it runs: one source, its publisher, and what it says of both."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

import msgspec

import zmav
from ground.corrections import LISTEN_S, Publisher
from ground.program import say_status
from ground.rtk.options import Caster, Fixed, Receiver, Recording, Survey, Where
from zmav import geo

AGENT = "rtk"
"""under which its status is found"""
SILENT_S = 5.0
"""s without a message of the source after which its corrections are old"""
MOST_NUMBERS = 20


class Source(Protocol):
    """Where corrections come from."""

    async def run(self) -> None:
        """Bring them; returns where there are no more."""


class RtkSettings(msgspec.Struct, frozen=True, kw_only=True):
    """One source, and how it is used."""

    where: Where
    name: str
    """the host under whose name the status is"""
    priority: int = 0
    rover: str | Fixed | None = None
    """the vehicle, or the place, that a caster is told"""
    base: Survey | Fixed | None = None
    port: str | None = None


class Rtk:
    """``async with Rtk(z, settings, say) as rtk: await rtk.run()``; on the event loop."""

    def __init__(self, z: zmav.Client, settings: RtkSettings, say: Callable[[str], None]) -> None:
        self._z, self.settings, self._say = z, settings, say
        self.publisher = Publisher(z, settings.name, say, settings.priority)
        self._state, self._words = "connecting", ""
        self._source = self._open()
        self._task: asyncio.Task[None] | None = None

    def _open(self) -> Source:
        where, put = self.settings.where, self.publisher.put
        if isinstance(where, Recording):
            from ground.rtk.file import FileSource

            return FileSource(where.path, put, self._told)
        if isinstance(where, Receiver):
            from ground.rtk.receiver import ReceiverSource

            return ReceiverSource(where, put, self._told, self.settings.base, self.settings.port)
        from ground.rtk.ntrip import NtripSource

        return NtripSource(where, put, self._told, None if self.settings.rover is None else self._rover)

    async def __aenter__(self) -> Rtk:
        self.publisher.__enter__()
        self._task = asyncio.create_task(say_status(self._z, AGENT, self.settings.name, self.status))
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
        self.publisher.__exit__()

    async def run(self) -> None:
        """Until the source has no more."""
        if isinstance(self.settings.where, Recording):
            await asyncio.sleep(LISTEN_S)  # its first moment is heard, too
        await self._source.run()
        await asyncio.sleep(0.2)  # what it brought last is gathered and sent

    def _rover(self) -> Fixed | None:
        rover = self.settings.rover
        if not isinstance(rover, str):
            return rover
        heard = self._z.heard(rover, self._z.fleet_name)
        at = heard.state.position if heard is not None else None
        return None if at is None else Fixed(at.lat_deg, at.lon_deg, at.alt_amsl)

    def _told(self, state: str, text: str) -> None:
        """What the source does; each change is told to who watches."""
        if state != self._state or (state not in ("survey", "streaming") and text != self._words):
            self._say(f"{state}: {text}" if text else state)
        self._state, self._words = state, text

    def status(self) -> tuple[str, str, dict[str, Any]]:
        """A word, a sentence and the details, as the status has them."""
        p = self.publisher
        state, text, age = self._state, self._words, p.age
        if state == "streaming":
            if age is None or age > SILENT_S:
                state, text = "silent", f"nothing more from {self.settings.where.words}"
            elif p.stands_by_for:
                state, text = "standby", f"{p.stands_by_for} is in charge"
            elif p.in_charge:
                state, text = "in-charge", f"{p.rate:.0f} B/s from {self.settings.where.words}"
        detail: dict[str, Any] = {
            "source": self.settings.where.words,
            "in_charge": p.in_charge,
            "standby_for": p.stands_by_for or None,
            "priority": self.settings.priority,
            "age": None if age is None else round(age, 1),
            "rate": round(p.rate),
            "station": p.station,
            "messages": {str(number): count for number, count in p.numbers.most_common(MOST_NUMBERS)},
            "too_many": p.flooded,
        }
        if p.base is not None:
            lat, lon, height = geo.from_ecef(p.base)
            detail["base"] = {"lat_deg": round(lat, 9), "lon_deg": round(lon, 9), "height": round(height, 3)}
        progress = getattr(getattr(self._source, "base", None), "progress", None)
        if progress is not None:
            detail["survey"] = dict(progress._asdict())
        return state, text, detail


def check(settings: RtkSettings) -> None:
    """Raise :class:`~zmav.errors.BadInput` for options that do not go with the source."""
    where = settings.where
    if settings.rover is not None and not isinstance(where, Caster):
        _refuse("gga", "only a caster is told where the rover is")
    if settings.base is not None and not isinstance(where, Receiver):
        _refuse("survey" if isinstance(settings.base, Survey) else "at", "only a base receiver can be told so")
    if settings.port is not None and settings.base is None:
        _refuse("port", "it says to which port of a receiver --survey and --at have RTCM 3 sent")


def _refuse(field: str, why: str) -> None:
    raise zmav.errors.BadInput(f"--{field}: {why}", field=field, expected="an option that goes with the source")

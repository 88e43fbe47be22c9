"""Single questions about parameters, put until they are answered: read by name, set and read back.

https://mavlink.io/en/services/parameter.html
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from zmav.autopilots.base import Fields
from zmav.errors import Refused, Stale, TimedOut
from zmav.mavlink import Frame, paramvalue
from zmav.mavlink.paramvalue import ParamEncoding
from zmav.services.companion import Companion
from zmav.services.link.heard import AutopilotMessages
from zmav.services.link.port import RoundTrip, is_ours
from zmav.services.params.values import Entry, ParamSet, ParamValue
from zmav.waiting import within

SET_TRIES = 10
"""at 20 % loss each way three attempts in ten fail: ten in a row are one in 30,000"""
BY_NAME = -1
DOES_NOT_EXIST = 1


@dataclass(frozen=True)
class ParamError:
    """One PARAM_ERROR for us; ``error`` is MAV_PARAM_ERROR."""

    name: str
    index: int
    error: int


Answer = ParamValue | ParamError


class Inbox:
    """What the autopilot says about parameters, in order."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[Answer] = asyncio.Queue()
        self.put = self._queue.put_nowait

    async def get(self, timeout: float) -> Answer | None:
        """The next one; None when none came within ``timeout`` seconds."""
        if not self._queue.empty():
            return self._queue.get_nowait()
        try:
            return await within(timeout, self._queue.get())
        except asyncio.TimeoutError:
            return None


class ParamTalk:
    """Hears the autopilot's PARAM_VALUEs into ``params`` and asks it questions. Lives on the event loop."""

    list_tries = 6
    list_timeout = 1.0
    """s for the first answer to PARAM_REQUEST_LIST; half as long again each time"""
    index_tries = 25
    read_tries = 4
    longest_wait = 3.0
    """s for one attempt"""

    def __init__(self, companion: Companion, params: ParamSet) -> None:
        self._port, self._identity, self._events = companion.port, companion.identity, companion.events
        self.params = params
        self._inboxes: set[Inbox] = set()
        self._answers = AutopilotMessages(companion, {"PARAM_VALUE": self._on_value, "PARAM_ERROR": self._on_error})
        self._setting: dict[str, asyncio.Lock] = {}
        self.encoding = ParamEncoding.C_CAST
        self.pace = RoundTrip()
        self._heard = 0.0
        """monotonic seconds of the last PARAM_VALUE"""

    def start(self) -> None:
        self._answers.start()

    def close(self) -> None:
        self._answers.close()

    def forget(self) -> None:
        """Another autopilot, or another link: what was learnt of its speed says nothing."""
        self.pace = RoundTrip()
        self._setting.clear()

    @contextmanager
    def hearing(self) -> Iterator[Inbox]:
        inbox = Inbox()
        self._inboxes.add(inbox)
        try:
            yield inbox
        finally:
            self._inboxes.discard(inbox)

    def send(self, name: str, **fields: object) -> bool:
        """A message to the autopilot; False where the link is down or full."""
        system, component = self._identity.source or (0, 0)
        return self._port.send(name, target_system=system, target_component=component, **fields)

    def check(self, heard_within: float = 0.0) -> None:
        """Raises :class:`Stale` where no autopilot is heard; a PARAM_VALUE within so many seconds is enough, too:
        where a fifth of all frames is lost, three heartbeats in a row soon are.
        """
        if self._identity.source is None:
            raise Stale(f"no autopilot has been heard on {self._port.link.url}", vehicle=self._port.name)
        if not self._identity.connected and time.monotonic() - self._heard >= heard_within:
            raise Stale("the autopilot is silent", vehicle=self._port.name)

    # In.

    def _on_value(self, fields: Fields, frame: Frame) -> None:
        kind = paramvalue.type_name(fields["param_type"])
        if kind is None:
            self.params.junk += 1
            return
        raw = frame.payload[:4].ljust(4, b"\0")  # as it came: as a number, some bytes would not survive
        heard = ParamValue(fields["param_id"], Entry(raw, kind), fields["param_count"], fields["param_index"])
        self._heard = time.monotonic()
        if self.params.hear(heard):
            self._tell(heard)

    def _on_error(self, fields: Fields, frame: Frame) -> None:
        if is_ours(fields, self._port):
            self._tell(ParamError(fields["param_id"], fields["param_index"], fields["error"]))

    def _tell(self, answer: Answer) -> None:
        for inbox in self._inboxes:
            inbox.put(answer)

    # Questions.

    async def read(self, name: str) -> Entry | None:
        """The parameter of that name, asked for by it; None where the autopilot has none or does not answer."""
        with self.hearing() as inbox:
            for attempt in range(self.read_tries):
                self.check()
                asked = time.monotonic()
                self.send("PARAM_REQUEST_READ", param_id=name, param_index=BY_NAME)
                while (answer := await self._about(name, inbox, asked, attempt)) is not None:
                    if isinstance(answer, ParamValue):
                        return answer.entry
                    if answer.error == DOES_NOT_EXIST:
                        return None
        return None

    async def write(self, name: str, wanted: float | int, kind: str) -> paramvalue.Value:
        """Set it and read it back; the value it then has.

        Raises :class:`BadInput` for what its type cannot hold, :class:`Refused` where it has another value afterwards
        or PARAM_ERROR says no, :class:`TimedOut` and :class:`Stale`.
        """
        raw = paramvalue.raw_of(name, wanted, kind, self.encoding)
        field = paramvalue.as_field(raw)
        async with self._setting.setdefault(name, asyncio.Lock()):
            with self.hearing() as inbox:
                return await self._write(inbox, name, Entry(raw, kind), field)

    async def _write(self, inbox: Inbox, name: str, entry: Entry, field: float) -> paramvalue.Value:
        """A value that differs may have been on its way before ours arrived, where a download runs: only one that is
        neither the old nor the new, or the old one again after a second attempt, is the autopilot's answer.
        """
        before, since, wanted = self.params.entries.get(name), time.monotonic(), self.value(entry)
        differed = 0
        for attempt in range(SET_TRIES):
            self.check()
            asked = time.monotonic()
            self.send("PARAM_SET", param_id=name, param_value=field, param_type=paramvalue.type_number(entry.kind))
            got: Entry | None = None
            while (answer := await self._about(name, inbox, asked, attempt)) is not None:
                if isinstance(answer, ParamError):
                    raise self._refusal(name, f"PARAM_ERROR {self._error_name(answer.error)}", since)
                got = answer.entry
                if paramvalue.same(self.value(got), wanted):
                    return self.value(got)
                if before is not None and got != before:
                    break
            if got is None:
                continue
            differed += 1
            if differed > 1 or (before is not None and got != before):
                raise self._refusal(name, f"it is {self.value(got)} after it was set to {wanted}", since, got)
        text = f"{name}: no PARAM_VALUE after {SET_TRIES} PARAM_SETs; it may be set or not"
        raise TimedOut(text, vehicle=self._port.name, name=name)

    async def _about(self, name: str, inbox: Inbox, asked: float, attempt: int) -> Answer | None:
        """The next answer about ``name``; None once the question of monotonic time ``asked`` counts as lost."""
        deadline = asked + min(self.pace.timeout * (1.0 + attempt / 2), self.longest_wait)
        while (answer := await inbox.get(deadline - time.monotonic())) is not None:
            if answer.name == name:
                if attempt == 0:
                    self.pace.sample(time.monotonic() - asked)
                return answer
        return None

    def value(self, entry: Entry) -> paramvalue.Value:
        return paramvalue.value_of(entry.raw, entry.kind, self.encoding)

    def _error_name(self, error: int) -> str:
        name = self._port.dialect.enum_name("MAV_PARAM_ERROR", error)
        return name.removeprefix("MAV_PARAM_ERROR_") if name else str(error)

    def _refusal(self, name: str, why: str, since: float, got: Entry | None = None) -> Refused:
        reasons = [text for text in self._events.texts_since(since) if name in text]
        text = f"{name} was not set: {why}" + (f" ({'; '.join(reasons)})" if reasons else "")
        value = None if got is None else self.value(got)
        return Refused(text, vehicle=self._port.name, name=name, value=value, reasons=reasons)

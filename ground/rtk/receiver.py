"""Corrections from a base receiver on a serial port or behind TCP, or from anything that sends RTCM 3 there."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from ground.rtk.options import Fixed, Receiver, Survey
from ground.rtk.ublox import UbloxBase
from zmav.errors import ZmavError
from zmav.formats.rtcm3 import Cutter, Message
from zmav.links import LinkState, open_link
from zmav.waiting import in_thread, on_loop

SILENCE_S = 10.0
"""s without a message after which it is said that nothing comes"""
FRESH_S = 3.0
"""s for which a word on the survey-in holds: one comes each second"""
AGAIN_S = 10.0
"""s until a receiver that did not take its settings is told again"""
PORTS = ("USB", "UART1", "UART2")
MOST_PENDING = 64
"""pieces of the line that wait for the event loop: what is more is thrown away"""


class ReceiverSource:
    """``take`` gets the messages on the event loop, ``told`` a state and words about it.

    ``wanted``: what the receiver is told to do, where it is told anything; ``port``: its own, to which the line goes.
    """

    def __init__(
        self,
        receiver: Receiver,
        take: Callable[[list[Message]], object],
        told: Callable[[str, str], None],
        wanted: Survey | Fixed | None = None,
        port: str | None = None,
    ) -> None:
        self._take, self._told, self._words = take, told, receiver.words
        self._link = open_link(receiver.url)
        port = port or ("USB" if "ttyACM" in receiver.url else "UART1")
        self.base = None if wanted is None else UbloxBase(self._link.send, wanted, port)
        self._cutter, self._heard = Cutter(), 0.0
        self._up, self._pending = asyncio.Event(), 0

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        feed, changed = on_loop(loop, self._feed), on_loop(loop, self._changed)

        def on_data(data: bytes) -> None:
            if self._pending < MOST_PENDING:
                self._pending += 1
                feed(data)

        self._told("connecting", f"to {self._words}")
        self._link.start(on_data, changed)
        try:
            await asyncio.gather(self._configure(), self._watch())
        finally:
            await in_thread(self._link.close)

    def _feed(self, data: bytes) -> None:
        self._pending -= 1
        if self.base is not None:
            self.base.feed(data)
        if messages := self._cutter.feed(data):
            self._heard = time.monotonic()
            if self.base is not None and not self.base.ready:
                return  # nobody has any use for what it observes before it knows where it is
            self._told("streaming", f"from {self._words}")
            self._take(messages)

    def _surveys(self, now: float) -> bool:
        base = self.base
        return base is not None and base.progress is not None and base.progress.active and now - base.heard < FRESH_S

    def _changed(self, state: LinkState, text: str) -> None:
        if state is LinkState.UP:
            self._up.set()
        elif state is LinkState.DOWN:
            self._up.clear()
            if self.base is not None:
                self.base.told = False
            self._told("lost", text)

    async def _configure(self) -> None:
        """Tell the receiver what to do, each time that the line comes up: it has forgotten it where it was off."""
        while self.base is not None:
            await self._up.wait()
            try:
                await self.base.configure()
                while self._up.is_set() and self.base.told:
                    await asyncio.sleep(0.5)
            except ZmavError as e:
                self._told("refused", f"{e}; again in {AGAIN_S:.0f} s")
                await asyncio.sleep(AGAIN_S)

    async def _watch(self) -> None:
        """Say how the survey-in goes, and when nothing comes."""
        since = told = time.monotonic()
        while True:
            await asyncio.sleep(1.0)
            now, base = time.monotonic(), self.base
            waits = base is not None and base.told and not base.ready
            told = told if waits else now
            if base is not None and base.progress is not None and self._surveys(now):
                p, since, told = base.progress, now, now
                self._told("survey", f"{p.seconds} s, exact by {p.metres:.2f} m, {p.observations} observations")
            elif waits and now - told > SILENCE_S:
                self._told("silent", f"{self._words} does not say how its survey-in goes (NAV-SVIN): nothing is sent")
            elif self._up.is_set() and now - max(self._heard, since) > SILENCE_S:
                other = f"{self._cutter.skipped} bytes of something else" if self._cutter.skipped else "nothing at all"
                self._told("silent", f"no RTCM 3 from {self._words}, {other}: is it set up as a base?")

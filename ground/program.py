"""What ``zmav rtk``, ``traffic`` and ``tak`` share: what others prove is heard, servers are connected to again, and how
they do is said.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import click
import zenoh

from zmav import keys
from zmav.cli.common import dump
from zmav.client import Client
from zmav.errors import BadInput, Forbidden, ZmavError
from zmav.process import until_stopped
from zmav.services.queries.intake import Intake
from zmav.services.queries.proven import attached
from zmav.trust.member import Place
from zmav.waiting import until_any

T = TypeVar("T")
STATUS_S = 1.0
AGAIN_S, LONGEST_AGAIN_S = 1.0, 30.0


def hear_proven(
    z: Client,
    key: str,
    read: Callable[[bytes], T],
    hear: Callable[[str, T], object],
    *,
    largest: int,
    most: int,
    refuse: Callable[[], object] = lambda: None,
) -> Intake:
    """``hear(key, read(payload))`` for what comes on ``key``, in a thread of its own: anybody may put there, however
    fast. ``refuse()`` for what has more than ``largest`` bytes, what ``read`` refuses, and with credentials what nobody
    proves who may put it. ``most``: that wait to be looked at, the newest.
    """
    member, newest = z.member, dict[Place, float]()

    def take(sample: zenoh.Sample) -> None:
        where, payload = str(sample.key_expr), sample.payload.to_bytes() if len(sample.payload) <= largest else b""
        try:
            found = read(payload)
            if member is not None:
                member.judge(where, payload, attached(sample), newest)
            if keys.hears(key, where):
                hear(where, found)
        except (Forbidden, BadInput):
            refuse()

    return Intake(z.session.declare_subscriber, key, take, most)


class Connecting(ABC):
    """A server, connected to again and again; ``told`` its words, a state and a text when these change."""

    def __init__(self, words: str, told: Callable[[str], None]) -> None:
        self._words, self._told = words, told
        self.state, self.text = "connecting", ""

    @abstractmethod
    async def serve(self) -> str:
        """Connect, say that it is up, and go on until it ends: why it did."""

    @abstractmethod
    def why(self, error: Exception) -> str:
        """What :meth:`serve` raised, in words; or raise it, which ends :meth:`run`."""

    async def run(self) -> None:
        """Until cancelled."""
        pause = AGAIN_S
        while True:
            began = time.monotonic()
            try:
                why = await self.serve()
            except Exception as e:
                why = self.why(e)
            pause = AGAIN_S if time.monotonic() - began > LONGEST_AGAIN_S else min(2 * pause, LONGEST_AGAIN_S)
            self.turn("lost", f"{why}; again in {pause:.0f} s")
            await asyncio.sleep(pause)

    def turn(self, state: str, text: str = "") -> None:
        if (state, text) != (self.state, self.text):
            self._told(f"{self._words}: {state}{': ' if text else ''}{text}")
        self.state, self.text = state, text


Status = Callable[[], tuple[str, str, dict[str, Any]]]
"""a word, a sentence and the details"""


async def say_status(z: Client, agent: str, host: str, status: Status) -> None:
    """Once a second, until cancelled."""
    while True:
        state, text, detail = status()
        with contextlib.suppress(ZmavError, zenoh.ZError):  # no router at present
            z.say_status(agent, state, text, vehicle=host, **detail)
        await asyncio.sleep(STATUS_S)


async def until_over(status: Status, as_json: bool, work: Coroutine[Any, Any, None] | None = None) -> None:
    """Until the process is asked to end or ``work`` has ended, whose error is raised; with ``as_json`` a line of the
    status is printed each second.
    """

    def tell() -> None:
        state, text, detail = status()
        click.echo(dump({"state": state, "text": text, **detail}))

    async def tell_on() -> None:
        while True:
            await asyncio.sleep(STATUS_S)
            tell()

    await until_any(until_stopped(), *([work] if work else []), *([tell_on()] if as_json else []))
    if as_json:
        tell()

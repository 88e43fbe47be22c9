"""Who asks and does not read holds up its own answers: no order, and no answer of another member's."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from tests.conftest import PATIENCE_S
from tests.trust.conftest import StartGuarded
from zmav.services.queries.proven import Answers

if TYPE_CHECKING:
    from tests.trust.conftest import Guarded


class Stuck:
    """Answers to the orders that are named wait, as they do on a link that nobody reads."""

    def __init__(self, *verbs: str) -> None:
        self._verbs, self.met, self._go = verbs, threading.Event(), threading.Event()
        self.on_loop = 0

    def hold_up(self, answer: Callable[..., None]) -> Callable[..., None]:
        def wait(answers: Answers, query: zenoh.Query, *args: Any, **more: Any) -> None:
            if asyncio._get_running_loop() is not None:
                self.on_loop += 1
            elif str(query.key_expr).rpartition("/")[2] in self._verbs:
                self.met.set()
                self._go.wait(PATIENCE_S)
            answer(answers, query, *args, **more)

        return wait

    @contextlib.contextmanager
    def until_left(self) -> Iterator[None]:
        try:
            yield
        finally:
            self._go.set()


async def met(stuck: Stuck) -> None:
    assert await asyncio.to_thread(stuck.met.wait, PATIENCE_S)


@pytest.mark.parametrize(
    ("who", "role", "verb"), [("alice", "operator", "disarm"), ("eye", "viewer", "arm"), ("eye", "viewer", "ping")]
)
async def test_another_members_hold_is_done_and_told(
    guarded: StartGuarded, monkeypatch: pytest.MonkeyPatch, who: str, role: str, verb: str
) -> None:
    g: Guarded = await guarded()
    async with g.client("bob", "operator") as z:
        await g.b.flying()
        by, key = g.authority.member(who, role), g.key(verb=verb)
        stuck = Stuck(verb)
        for name in ("give", "refuse"):
            monkeypatch.setattr(Answers, name, stuck.hold_up(getattr(Answers, name)))
        asked = asyncio.create_task(g.ask(g.proof(by, key, b"{}"), b"{}", key))
        with stuck.until_left():
            await met(stuck)
            await z.vehicle("quad1").hold()
        with contextlib.suppress(Exception):
            await asked
        assert stuck.on_loop == 0

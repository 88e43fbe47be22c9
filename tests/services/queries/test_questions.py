"""The lane of questions: no order waits for one, they are bounded, take turns, and are not answered once given up."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from zenoh import handlers

from tests.services.params.param_peer import many, scenes
from zmav import keys, wire
from zmav.errors import BadInput
from zmav.services.orders import orders
from zmav.services.queries import questions
from zmav.services.queries.proven import Answers
from zmav.services.queries.questions import Questions, Reply
from zmav.trust.gate import anybody
from zmav.trust.verify import Allowance
from zmav.waiting import on_loop

if TYPE_CHECKING:
    from tests.conftest import Ground, Net
    from tests.services.conftest import StartBench
    from tests.services.params.param_peer import StartScene

PATIENCE_S = 30.0
HELD = "zmav/demo/lane/held"
READ = "zmav/demo/lane/read"
FLOOD = 4 * questions.MOST


class Asker:
    """Asks much at once; ``ended`` has what was asked in the order in which it was over, and how many answers came."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self.ended = session, list[tuple[str, list[zenoh.Reply]]]()
        self._news, self._loop = asyncio.Event(), asyncio.get_running_loop()

    def ask(self, key: str, payload: bytes = b"") -> None:
        replies: list[zenoh.Reply] = []
        over = on_loop(self._loop, self._over)
        handler: Any = handlers.Callback(replies.append, lambda: over(key, replies), indirect=False)
        self._session.get(key, handler, payload=payload, timeout=PATIENCE_S)

    def _over(self, key: str, replies: list[zenoh.Reply]) -> None:
        self.ended.append((key, replies))
        self._news.set()

    def answered(self) -> list[str]:
        return [key for key, replies in self.ended if replies]

    async def until(self, count: int) -> None:
        """Wait until so many are over."""

        async def wait() -> None:
            while len(self.ended) < count:
                self._news.clear()
                await self._news.wait()

        await asyncio.wait_for(wait(), PATIENCE_S)


class Held:
    """A question that the lane is busy with until it is let go."""

    def __init__(self, lane: Questions) -> None:
        self.begun, self.go = threading.Event(), threading.Event()
        lane.declare(HELD, self._answer)

    def _answer(self, query: zenoh.Query) -> Iterator[Reply]:
        self.begun.set()
        assert self.go.wait(PATIENCE_S)
        yield Reply(HELD, b"at last")

    async def hold(self, asker: Asker) -> None:
        asker.ask(HELD)
        assert await asyncio.to_thread(self.begun.wait, PATIENCE_S)


@contextlib.asynccontextmanager
async def lane(net: Net) -> AsyncIterator[tuple[Questions, Ground]]:
    session, endpoint = net.router()
    ground, made = net.ground(endpoint), Questions(session, Answers(None, None), anybody)
    yield made, ground
    made.close()


@pytest.fixture
async def scene(bench: StartBench) -> AsyncIterator[StartScene]:
    async with scenes(bench) as start:
        yield start


def word(key: str) -> Any:
    return lambda query: iter([Reply(key, b"{}")])


async def linked(ground: Ground, *asked: str) -> None:
    """Wait until the client's router knows who answers."""
    for key in asked:
        while not await ground.ask(key):
            pass


async def test_orders_are_answered_while_every_question_waits(bench: StartBench) -> None:
    b = await (await bench()).connected()
    held, asker = Held(b.vehicle.questions), Asker(b.ground.session)
    b.vehicle.questions.given_up = PATIENCE_S  # the asker waits that long
    await held.hold(asker)
    asked = [keys.STATE, keys.BODY, keys.RATES, keys.HOST, keys.PARAMS]
    for _ in range(FLOOD):
        for channel in asked:
            asker.ask(channel.key("demo", "quad1"))
        asker.ask(keys.DO.key("demo", "quad1", verb="ping"), b"{}")  # it moves nothing, and a viewer may ask it
    lost = (FLOOD - questions.MOST) * (len(asked) + 1)
    await asker.until(lost)
    for verb in ("hold", "land", "disarm"):
        await b.ground.do(verb)
    assert asker.answered() == []
    assert (await b.ground.do("lease", holder="swap", ttl=5.0)).result["holder"] == "swap"
    assert asker.answered() == []
    held.go.set()
    await asker.until(1 + FLOOD * (len(asked) + 1))
    assert len(asker.answered()) == 1 + questions.MOST * (len(asked) + 1)


async def test_land_is_answered_before_the_parameters_that_were_asked_first(scene: StartScene) -> None:
    s = await (await scene(many(1000))).read()
    asker = Asker(s.b.ground.session)
    for _ in range(FLOOD):
        asker.ask("zmav/demo/quad1/param/*")
    await s.b.ground.do("land")
    before = len(asker.answered())
    await asker.until(FLOOD)
    assert before < len(asker.answered())
    whole = [len(replies) for _, replies in asker.ended if replies]
    assert set(whole) == {1000}


async def test_of_what_waits_the_oldest_gives_way_and_is_counted(net: Net) -> None:
    async with lane(net) as (made, ground):
        held, asker = Held(made), Asker(ground.session)
        made.declare("zmav/demo/lane/x/*", lambda query: iter([Reply(str(query.key_expr), b"{}")]))
        told: list[tuple[float, int]] = []
        made.bus.on(questions.QuestionsDropped, lambda dropped: told.append((time.monotonic(), made.counts["dropped"])))
        await linked(ground, "zmav/demo/lane/x/first")
        await held.hold(asker)
        for number in range(questions.MOST):
            asker.ask(f"zmav/demo/lane/x/{number}")
        while made.waiting < questions.MOST:
            await asyncio.sleep(0.001)  # they are on their way
        for number in range(questions.MOST):
            asker.ask(f"zmav/demo/lane/x/{questions.MOST + number}")
            await asker.until(number + 1)
        assert asker.answered() == []
        assert made.counts["dropped"] == questions.MOST
        assert told[0][1] == 1  # at once
        assert len(told) <= 1 + (told[-1][0] - told[0][0]) / questions.TOLD_S + 0.5
        held.go.set()
        await asker.until(1 + 2 * questions.MOST)
        newest = [f"zmav/demo/lane/x/{n}" for n in range(questions.MOST, 2 * questions.MOST)]
        assert asker.answered() == [HELD, *newest]


async def test_who_has_given_up_is_not_answered(net: Net) -> None:
    async with lane(net) as (made, ground):
        made.declare("zmav/demo/lane/x", word("zmav/demo/lane/x"))
        await linked(ground, "zmav/demo/lane/x")
        made.given_up = -1.0
        assert await ground.ask("zmav/demo/lane/x") == []
        assert made.counts["given_up"] == 1


async def test_a_long_answer_is_given_in_slices_with_others_between(net: Net) -> None:
    other = threading.Event()

    def endless(query: zenoh.Query) -> Iterator[Reply]:
        yield Reply("zmav/demo/lane/long", b"first")
        while not other.is_set():
            yield Reply("zmav/demo/lane/long", b"more")

    def short(query: zenoh.Query) -> Iterator[Reply]:
        other.set()
        yield Reply("zmav/demo/lane/short", b"{}")

    async with lane(net) as (made, ground):
        made.declare("zmav/demo/lane/short", short)
        await linked(ground, "zmav/demo/lane/short")
        made.declare("zmav/demo/lane/long", endless)
        await linked(ground, "zmav/demo/lane/long")
        other.clear()
        asker = Asker(ground.session)
        asker.ask("zmav/demo/lane/long")
        asker.ask("zmav/demo/lane/short")
        await asker.until(2)
        assert len(asker.answered()) == 2


async def test_what_waits_for_something_else_keeps_nobody_waiting(net: Net) -> None:
    results = [Future[bytes]() for _ in range(questions.PENDING + 1)]
    left = iter(results)

    def slow(query: zenoh.Query) -> Iterator[Reply | Future[bytes]]:
        yield (result := next(left))
        yield Reply(str(query.key_expr), result.result())

    async with lane(net) as (made, ground):
        made.declare("zmav/demo/lane/slow/*", slow)
        made.declare("zmav/demo/lane/x", word("zmav/demo/lane/x"))
        await linked(ground, "zmav/demo/lane/x")
        asker = Asker(ground.session)
        for number in range(questions.PENDING + 1):
            asker.ask(f"zmav/demo/lane/slow/{number}")
        await asker.until(1)
        (said,) = asker.ended[0][1]
        assert said.err is not None
        assert wire.error_from(said.err.payload.to_bytes()).detail["reason"] == "busy"
        assert await ground.ask("zmav/demo/lane/x")
        for result in results[:-1]:
            result.set_result(b"{}")
        await asker.until(questions.PENDING + 1)
        assert len(asker.answered()) == questions.PENDING + 1
        assert results[-1].cancelled()


async def test_an_answer_that_fails_is_said_and_the_next_is_given(net: Net) -> None:
    async with lane(net) as (made, ground):
        made.declare("zmav/demo/lane/bad", lambda query: iter([1 / 0]))  # type: ignore[list-item]
        made.declare("zmav/demo/lane/x", word("zmav/demo/lane/x"))
        (said,) = await ground.ask("zmav/demo/lane/bad")
        assert said.err is not None
        assert "ZeroDivisionError" in wire.error_from(said.err.payload.to_bytes()).message
        assert await ground.ask("zmav/demo/lane/x")


async def test_names_like_an_unknown_one_are_looked_for_seldom_and_for_short_ones(scene: StartScene) -> None:
    s = await (await scene({"ABCDEFGHIJKLMNOP": (1.0, 9), "SHORT_NAME": (2.0, 9)})).read()
    s.b.vehicle.params._queries._hints = Allowance(2.0, lambda: 0.0)  # a second that does not end
    with pytest.raises(BadInput, match=r"no parameter 'ABCDEFGHIJKLMNOPQ'$"):
        await s.get("ABCDEFGHIJKLMNOPQ")
    said = []
    for _ in range(4):
        with pytest.raises(BadInput) as e:
            await s.get("SHORT_NAMF")
        said.append("did you mean SHORT_NAME?" in e.value.message)
    assert said == [True, True, False, False]


async def test_what_only_looks_is_bounded_for_each_who_asks(bench: StartBench) -> None:
    b = await (await bench()).connected()
    go = asyncio.Event()

    async def waits(args: wire.Order, report: object, origin: object) -> dict[str, Any]:
        await go.wait()
        return {}

    b.vehicle.orders.add("log_list", waits)
    asker, key = Asker(b.ground.session), keys.DO.key("demo", "quad1", verb="log_list")
    for number in range(orders.MOST_LOOKING + 3):
        asker.ask(key, b'{"id": "%d", "wait": 0.0}' % number)
        await asker.until(number + 1)
    said = [replies[0] for _, replies in asker.ended]
    refused = [wire.error_from(r.err.payload.to_bytes()).detail["reason"] for r in said if r.err is not None]
    assert refused == ["busy"] * 3
    assert b.vehicle.orders.under_way == orders.MOST_LOOKING
    assert (await b.ground.do("hold")).status == "done"
    go.set()


async def test_a_selectors_parameters_that_nobody_reads_are_refused(net: Net) -> None:
    async with lane(net) as (questions, ground):
        questions.declare(HELD, word(HELD))
        questions.declare(READ, word(READ), parameters=("newer",))
        await linked(ground, HELD, READ)
        (reply,) = await ground.ask(f"{HELD}?to=10")
        assert reply.err is not None
        refused = wire.error_from(reply.err.payload.to_bytes())
        assert isinstance(refused, BadInput)
        assert "parameter 'to' is not read: give what you want as JSON" in str(refused)
        for asked in (f"{HELD}?_anyke", f"{READ}?newer=3"):
            (reply,) = await ground.ask(asked)
            assert reply.ok is not None

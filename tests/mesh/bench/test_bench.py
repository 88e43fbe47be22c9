"""Measurements between real routers: what is sent arrives and is counted, and nothing goes on that nobody wants."""

from __future__ import annotations

import asyncio
import contextlib
import math
from pathlib import Path
from typing import Any

import msgspec
import pytest

import zmav
from mesh.bench.asker import HERE, Bench
from mesh.bench.flow import Flow, Stream
from mesh.bench.responder import Responder
from mesh.bench.run import HEAD, check, tag_of
from mesh.credentials.ca import Authority
from mesh.credentials.rosterwatch import watch_roster
from mesh.router import Router
from tests import waiting
from tests.conftest import PATIENCE_S, Net, endpoint_of
from tests.mesh.bench.conftest import Line, Start, idle, plan_of
from tests.services.queries.test_questions import FLOOD, Asker, Held
from zmav import keys, wire
from zmav.doctor.credentials import rosters
from zmav.errors import BadInput, Clash, Forbidden, NoSuchVehicle, Refused
from zmav.services.queries.questions import MOST
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials
from zmav.waiting import within
from zmav.wire.bench import BenchInterval, BenchOrder, BenchOutage

SHORT = Stream(seconds=1.0, hz=50.0, size=100, guard=5.0)


async def test_a_stream_arrives_and_both_ends_tell_of_it(line: Start) -> None:
    made, bench = await line("quad1", "quad2", "ground")
    seen: list[BenchInterval] = []
    flow = await bench.stream("quad1", "ground", SHORT, on_interval=lambda flow, each: seen.append(each))
    assert flow.faults == _skipped(flow)
    assert (flow.source, flow.target, flow.sender.sent + flow.sender.skipped) == ("quad1", "ground", 50)
    total = flow.total
    assert (total.received, total.lost, total.bytes) == (flow.sender.sent, 0, 100 * flow.sender.sent)
    assert flow.loss == 0.0
    assert len(seen) == 1 and seen == flow.intervals
    assert 0 < seen[0].received <= total.received
    assert flow.sender.lateness is not None and flow.sender.lateness.min >= 0.0
    assert flow.clock is not None
    assert abs(flow.clock.offset) <= flow.clock.within  # the hosts of a test share one clock
    assert flow.idle is not None and flow.idle.sent == 5
    assert flow.loaded is not None and flow.loaded.sent == 5
    await asyncio.gather(*map(idle, made.responders.values()))


async def test_each_class_of_datagrams(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    for qos in ("realtime", "latest-wins", "bulk"):
        flow = await bench.stream("quad1", "quad2", _in(qos, 0.2))
        assert flow.faults == _skipped(flow), qos
        assert flow.total.received == flow.sender.sent > 0, qos
        assert flow.clock is not None
        await asyncio.gather(*map(idle, made.responders.values()))
    with pytest.raises(BadInput, match="must-arrive is for round trips"):
        await bench.stream("quad1", "quad2", _in("must-arrive", 0.2))


def _skipped(flow: Flow) -> list[str]:
    """The one fault that a busy computer may bring: datagrams whose time was over were not sent, and it says so."""
    count = flow.sender.skipped
    return [f"{flow.source} could not keep up: {count} datagrams were not sent"] if count else []


def _in(qos: Any, seconds: float) -> Stream:
    return msgspec.structs.replace(SHORT, qos=qos, seconds=seconds)


async def test_round_trips(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    for qos in ("realtime", "must-arrive"):
        trip = await bench.round_trips("quad1", "quad2", _in(qos, 0.4))
        assert (trip.peer, trip.sent, trip.lost) == ("quad2", 20, 0)
        assert trip.rtt is not None
        assert 0.0 < trip.rtt.min <= trip.rtt.median <= trip.rtt.max < 60.0
        assert trip.rtt.count == 20
        await asyncio.gather(*map(idle, made.responders.values()))


async def test_here_is_the_host_of_our_own_router(line: Start) -> None:
    _, bench = await line("quad1", "quad2", "ground")
    here, there = await bench.pair(HERE, "ground")
    assert (here.host, there.host) == ("quad1", "ground")
    trip = await bench.round_trips(here.host, there.host, _in("realtime", 0.3))
    assert (trip.peer, trip.sent, trip.lost) == ("ground", 15, 0)


async def test_who_is_not_there_or_not_another_is_said(line: Start) -> None:
    _, bench = await line("quad1", "quad2")
    with pytest.raises(NoSuchVehicle, match=r"quad9.*quad1, quad2"):
        await bench.stream("quad1", "quad9", SHORT)
    for other in ("quad1", HERE):
        with pytest.raises(BadInput, match="one host"):
            await bench.stream("quad1", other, SHORT)
    with pytest.raises(BadInput, match="Quad"):
        await bench.stream("quad1", "Quad 2", SHORT)


async def test_two_hosts_of_one_name_are_a_clash(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    await made.add(plan_of("quad1"), made.endpoints["quad2"])

    async def until_both() -> None:
        while sum(pong.host == "quad1" for pong in await bench.everyone()) < 2:
            pass

    await within(PATIENCE_S, until_both())
    with pytest.raises(Clash, match="2 hosts are named quad1"):
        await bench.stream("quad1", "quad2", SHORT)


ORDER = BenchOrder(run="one", role="send", peer="quad2", seconds=1.0, hz=10.0, size=100, qos="bulk")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("seconds", 1e9),
        ("seconds", 0.0),
        ("seconds", math.nan),
        ("seconds", -math.inf),
        ("hz", math.nan),
        ("hz", 0.0),
        ("hz", math.inf),
        ("hz", 1e6),
        ("size", 0),
        ("size", -1),
        ("size", 10**12),
        ("gap", math.nan),
        ("guard", 1e4),
        ("patience", math.inf),
        ("patience", 1e9),
        ("qos", "must-arrive"),
        ("peer", ""),
        ("peer", "quad1"),
        ("peer", "*"),
        ("peer", "Quad 2"),
        ("asker", "x" * 101),
        ("asker", "\x1b[2J"),
        ("run", "a/b"),
        ("run", "*"),
        ("run", "x" * 41),
        ("run", ""),
    ],
)
def test_hostile_orders_are_refused_with_the_field(field: str, value: Any) -> None:
    with pytest.raises(BadInput) as caught:
        check(msgspec.structs.replace(ORDER, **{field: value}), "quad1")
    assert caught.value.detail["field"] == field
    check(ORDER, "quad1")


def test_too_much_altogether_is_refused() -> None:
    with pytest.raises(BadInput, match="datagrams in a run"):
        check(msgspec.structs.replace(ORDER, hz=50_000.0, seconds=3600.0), "quad1")
    with pytest.raises(BadInput, match="queries a second"):
        check(msgspec.structs.replace(ORDER, role="query", hz=501.0), "quad1")
    with pytest.raises(BadInput, match="Mbit/s"):
        check(msgspec.structs.replace(ORDER, hz=50_000.0, size=60_000), "quad1")


async def test_garbage_instead_of_an_order_is_answered_with_an_error(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    for order, payload in (("start", b"{"), ("start", b"{}"), ("stop", b'{"run": 7}'), ("dance", b""), ("stop", b"")):
        (answer,) = await bench.client.ask(keys.BENCH.key("demo", "quad2", order=order), payload, 30.0, keys.BENCH)
        assert isinstance(answer, BadInput), answer
    unknown = keys.BENCH_REPORT.key("demo", "quad2", run="none")
    (answer,) = await bench.client.ask(unknown, b"", 30.0, keys.BENCH_REPORT)
    assert isinstance(answer, Refused)
    assert made.responders["quad2"].busy is None


async def test_questions_about_runs_are_answered_beside_the_event_loop_and_bounded(line: Start) -> None:
    lines, bench = await line("quad1")
    report, ping = (f"zmav/demo/quad1/bench/{what}" for what in ("report/x", "ping"))
    lane, session = lines.responders["quad1"].questions, bench.client.session
    held = Held(lane)
    asker = Asker(session)
    await held.hold(asker)
    for _ in range(FLOOD):
        asker.ask(report, b"{}")
    await asker.until(FLOOD - MOST)
    asker.ask(ping)
    await asker.until(FLOOD - MOST + 1)
    assert asker.answered() == [ping]
    held.go.set()
    await asker.until(FLOOD + 2)
    assert len(asker.answered()) == MOST + 2


async def test_one_at_a_time_and_the_second_hears_of_whom(line: Start) -> None:
    made, bench = await line("quad1", "quad2", "quad3")
    until = asyncio.Event()
    first = asyncio.ensure_future(bench.stream("quad1", "quad2", _in("bulk", 30.0), until=until))
    other = await made.ask("quad3")

    async def refused() -> Refused:
        while not made.responders["quad1"].busy:
            await asyncio.sleep(0.01)
        with pytest.raises(Refused) as caught:
            await other.stream("quad3", "quad2", SHORT)
        return caught.value

    error = await within(PATIENCE_S, refused())
    assert "quad2 measures already: receive with quad1 for" in error.message
    until.set()
    flow = await first
    assert flow.faults == _skipped(flow)
    await idle(made.responders["quad2"])
    flow = await other.stream("quad3", "quad2", _in("bulk", 0.2))
    assert flow.faults == _skipped(flow)


async def test_what_is_stopped_ends_on_the_hosts_and_its_report_can_be_had_later(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    until = asyncio.Event()
    task = asyncio.ensure_future(
        bench.stream("quad1", "quad2", _in("bulk", 60.0), until=until, on_interval=lambda *_: until.set())
    )
    flow = await task
    assert flow.total.received == flow.sender.sent > 0
    assert flow.sender.state == "stopped"
    await asyncio.gather(*map(idle, made.responders.values()))
    later = await bench.report("quad2", flow.sender.run)
    assert later.state == "stopped"
    assert later.total is not None and later.total.received == flow.total.received


async def test_a_cancelled_measurement_ends_on_the_hosts(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    begun = asyncio.Event()
    stream = msgspec.structs.replace(_in("bulk", 300.0), patience=300.0)
    task = asyncio.ensure_future(bench.stream("quad1", "quad2", stream, on_interval=lambda *_: begun.set()))
    await within(PATIENCE_S, begun.wait())
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await asyncio.gather(*map(idle, made.responders.values()))


async def test_an_asker_that_vanishes_is_not_waited_for(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    order = msgspec.structs.replace(ORDER, seconds=600.0, patience=1.0)
    await bench.tell("quad2", "start", msgspec.structs.replace(order, role="receive", peer="quad1"))
    await bench.tell("quad1", "start", order)
    assert made.responders["quad1"].busy and made.responders["quad2"].busy
    await asyncio.gather(*map(idle, made.responders.values()))
    report = await bench.report("quad1", "one")
    assert (report.state, "no word" in report.why) == ("stopped", True)
    assert report.sent < 600


async def test_a_host_that_vanishes_midway_is_said_and_the_rest_is_told(line: Start) -> None:
    made, bench = await line("quad1", "quad2")

    def vanish(flow: Flow, interval: BenchInterval) -> None:
        made.sessions["quad2"].close()

    flow = await within(PATIENCE_S, bench.stream("quad1", "quad2", _in("realtime", 2.0), on_interval=vanish))
    assert any("quad2 does not answer" in fault for fault in flow.faults)
    assert len(flow.intervals) == 1
    assert flow.sender.sent > flow.total.received > 0
    await idle(made.responders["quad1"])


async def test_what_is_not_of_the_run_is_left_out(line: Start) -> None:
    made, bench = await line("quad1", "quad2")
    until = asyncio.Event()

    def meddle(flow: Flow, interval: BenchInterval) -> None:
        if not until.is_set():
            key = keys.BENCH_FLOW.key("demo", "quad1", run=flow.sender.run)
            old = HEAD.pack(tag_of("older"), 1, 0)
            huge = HEAD.pack(tag_of(flow.sender.run), 2**32 - 1, 0)
            for payload in (old, huge, b"", b"garbage" * 9):
                made.sessions["quad1"].put(key, payload)
        until.set()

    task = bench.stream("quad1", "quad2", _in("realtime", 30.0), until=until, on_interval=meddle)
    flow = await within(PATIENCE_S, task)
    assert flow.total.received == flow.sender.sent


async def test_a_cut_is_an_outage_with_its_losses(line: Start) -> None:
    """The router in the middle is closed, and another one takes its place.

    A receiver that gets no processor for a while sees an outage, too, after which all comes that was sent meanwhile.
    """
    made, bench = await line("quad1", "middle", "quad2")
    until = asyncio.Event()
    flows: asyncio.Queue[Flow] = asyncio.Queue()
    stream = msgspec.structs.replace(_in("realtime", 60.0), patience=60.0, guard=0.0)

    def on_outage(_: Flow, outage: BenchOutage) -> None:
        if outage.lost:
            until.set()

    task = asyncio.ensure_future(
        bench.stream(
            "quad1", "quad2", stream, until=until, on_interval=lambda f, _: flows.put_nowait(f), on_outage=on_outage
        )
    )
    flow = await within(PATIENCE_S, flows.get())
    await asyncio.to_thread(made.sessions["middle"].close)
    sent = flow.sender.sent
    await asyncio.sleep(1.0)  # longer than the silence that counts
    await waiting.until(lambda: flow.sender.sent > sent + 60, "datagrams that go nowhere")
    await made.add(plan_of("middle2"), made.endpoints["quad1"], made.endpoints["quad2"])
    flow = await task
    assert until.is_set(), f"no outage with losses: {flow.outages}"
    outage = next(each for each in flow.outages if each.lost)
    assert outage.length > 0.2
    assert outage.lost > 0
    assert flow.total.lost >= outage.lost
    assert flow.total.received > 0


# Who may.


ORDER_BACK = msgspec.structs.replace(ORDER, role="receive", peer="quad1", seconds=60.0, patience=60.0)


async def test_only_an_operator_may_start_one(line: Start, net: Net, tmp_path: Path) -> None:
    """With credentials; a run's report may be had by every member."""
    authority = Authority.create(tmp_path / "ca", "demo")
    folders = {
        name: authority.issue(name, role, out=tmp_path / name)
        for name, role in (
            ("quad1", Role.VEHICLE),
            ("quad2", Role.VEHICLE),
            ("ann", Role.OPERATOR),
            ("vic", Role.VIEWER),
            ("pat", Role.PLANNER),
        )
    }
    async with contextlib.AsyncExitStack() as stack:
        made = Line(net, stack)
        await made.add(plan_of("quad1", Credentials.load(folders["quad1"])))
        await made.add(plan_of("quad2", Credentials.load(folders["quad2"])), made.endpoints["quad1"])
        for who in ("vic", "pat", "quad1"):
            with pytest.raises(Forbidden, match="allowed: operator"):
                await (await made.ask("quad1", str(folders[who]))).tell("quad2", "start", ORDER_BACK)
        with pytest.raises(Forbidden, match="proof"):
            await (await made.ask("quad1")).tell("quad2", "start", ORDER_BACK)
        ann = await made.ask("quad1", str(folders["ann"]))
        assert (await ann.tell("quad2", "start", ORDER_BACK)).state == "waiting"
        viewer = await made.ask("quad1", str(folders["vic"]))
        assert (await viewer.report("quad2", "one")).host == "quad2"


async def test_who_was_turned_out_starts_none(net: Net, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the newest roster that the router was told, which a service does not keep in its folder of credentials."""
    (tmp_path / "state").mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    authority = Authority.create(tmp_path / "ca", "demo")
    folders = {n: authority.issue(n, r, out=tmp_path / n) for n, r in (("quad2", Role.VEHICLE), ("ann", Role.OPERATOR))}
    settings = SessionSettings(mode="router", listen=["tcp/127.0.0.1:0"], cfg=("scouting/delay:0",))
    plan = plan_of("quad2", Credentials.load(folders["quad2"]))
    async with contextlib.AsyncExitStack() as stack:
        router = await stack.enter_async_context(Router(plan, settings, (watch_roster, Responder)))
        client = zmav.open(fleet="demo", connect=[endpoint_of(router.session)], credentials=str(folders["ann"]))
        z = await stack.enter_async_context(client)
        ann = Bench(z)
        assert (await ann.tell("quad2", "start", ORDER_BACK)).state == "waiting"
        authority.revoke("ann")
        told = wire.encode(authority.roster())
        await rosters(z, "demo", payload=told)

        async def refused() -> None:
            while True:  # the same order again changes nothing
                await ann.tell("quad2", "start", ORDER_BACK)

        with pytest.raises(Forbidden, match="revoked"):
            await within(PATIENCE_S, refused())

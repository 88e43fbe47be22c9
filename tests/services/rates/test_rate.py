"""Rates by demand: asked for while somebody reads, as fast as the fastest wants, and put back when nobody does."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from tests.services.rates.rate_peer import SET_INTERVAL, StreamPeer
from zmav import keys, wire
from zmav.autopilots.ardupilot import ArduPilot
from zmav.autopilots.px4 import Px4
from zmav.errors import BadInput
from zmav.mavlink import Packer, load_dialect
from zmav.services.link.clock import AutopilotClock
from zmav.services.rates.demand import PLAIN_HZ
from zmav.services.rates.meter import WINDOW
from zmav.services.rates.rates import OWN
from zmav.vehicle.rates import want_key

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, StartOnboard
    from tests.services.conftest import Bench, StartBench

PX4 = 12
FLOOR = dict(ArduPilot.floor)


@pytest.fixture(autouse=True)
def quick(onboard: StartOnboard) -> None:
    """Housekeeping at twice its pace."""
    onboard.pace = 2.0


@pytest.fixture
async def one() -> AsyncIterator[StreamPeer]:
    """An autopilot that streams as it is told."""
    peer = StreamPeer()
    await peer.open()
    yield peer
    await peer.close()


async def on(bench: StartBench, peer: StreamPeer, **settings: Any) -> Bench:
    """It and its vehicle, with the floor flowing."""
    b = await (await bench(peer, **settings)).connected()
    floor = b.vehicle.identity.autopilot
    assert floor is not None
    await peer.until(lambda: floor.floor.items() <= rounded(peer).items(), "floor")
    return b


def rounded(peer: StreamPeer) -> dict[str, float]:
    return {name: round(hz, 3) for name, hz in peer.rates.items()}


async def flows(peer: StreamPeer, name: str, hz: float | None) -> None:
    """Wait until the autopilot sends a message at a rate; None: not at all."""
    await peer.until(lambda: rounded(peer).get(name) == hz, f"{name} at {hz} Hz instead of {peer.rates.get(name)}")


def token(ground: Ground, name: str, hz: object, instance: str = "test-1") -> zenoh.LivelinessToken:
    """A reader's wish."""
    key = keys.WANT.key("demo", "quad1", msg=name, hz=hz, instance=instance)
    return ground.session.liveliness().declare_token(key)


def read(ground: Ground, name: str) -> zenoh.Subscriber[None]:
    """A plain subscriber, as any Zenoh tool is one."""
    return ground.session.declare_subscriber(f"zmav/demo/quad1/mav/rx/*/*/{name}", lambda sample: None)


async def table(b: Bench) -> wire.RateTable:
    (reply,) = await b.ground.ask(keys.RATES.key("demo", "quad1"))
    assert reply.ok is not None
    return wire.decode(reply.ok.payload.to_bytes(), wire.RateTable, "rates")


async def row(b: Bench, name: str) -> wire.MessageRate | None:
    return next((m for m in (await table(b)).messages if m.name == name), None)


def extra(peer: StreamPeer) -> set[str]:
    """What it was asked for beside what the vehicle itself wants."""
    asked = {peer.dialect.name_of(int(t.fields["param1"])) for t in peer.commands(SET_INTERVAL)}
    return asked - FLOOR.keys() - OWN.keys()


async def rounds(b: Bench, count: int = 2) -> None:
    """So many seconds of housekeeping."""
    reports = b.ground.samples(keys.LINK, link="autopilot")
    await reports.until(lambda: len(reports.items) >= count, f"{count} rounds")


# The floor.


async def test_the_floor_is_asked_for_until_it_flows_and_again_after_a_restart(
    bench: StartBench, one: StreamPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    # At 2 Hz a message counts as flowing for one and a half seconds, however busy this machine is.
    floor = dict.fromkeys(list(FLOOR)[:2], 2.0)
    monkeypatch.setattr(ArduPilot, "floor", floor)
    one.mute = {SET_INTERVAL}
    b = await bench(one)
    b.vehicle.rates.unanswered_pause = 0.2
    await b.connected()
    await one.until(lambda: all(len(one.asked(name)) >= 2 for name in floor), "second asking")
    one.mute = set()
    for name in floor:
        await flows(one, name, 2.0)
    before = {name: len(one.asked(name)) for name in floor}
    await rounds(b, 3)
    assert {name: len(one.asked(name)) for name in floor} == before
    one.rates.clear()  # it restarts behind a link that stays open, and answers no TIMESYNC that would tell
    one.answers_within = 0.0
    for name in floor:
        await flows(one, name, 2.0)


async def test_the_rates_are_the_autopilot_s(bench: StartBench, one: StreamPeer) -> None:
    await on(bench, one)
    assert {name: one.asked(name) for name in FLOOR} == {n: [pytest.approx(1e6 / hz)] for n, hz in FLOOR.items()}
    assert all(t.fields["target_system"] == 1 for t in one.commands(SET_INTERVAL))


async def test_px4_is_asked_for_nothing_that_comes_by_itself(bench: StartBench) -> None:
    """But for its mode, which comes too seldom."""
    assert Px4.floor == {"CURRENT_MODE": 20.0}
    mode = load_dialect().message("CURRENT_MODE").id
    peer = StreamPeer(autopilot=PX4, unasked={"ATTITUDE": 20.0, "SYSTEM_TIME": 1.0})
    async with contextlib.AsyncExitStack() as stack:
        await peer.open()
        stack.push_async_callback(peer.close)
        b = await on(bench, peer)
        read(b.ground, "ATTITUDE")
        held = token(b.ground, "ATTITUDE", 20)
        await rounds(b, 4)
        held.undeclare()
        await rounds(b, 2)
        assert {t.fields["param1"] for t in peer.commands(SET_INTERVAL)} == {mode}


# Tokens.


async def test_a_token_is_heard_at_once_and_its_end_leaves_it_alone(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    held = token(b.ground, "VFR_HUD", 20)
    await flows(one, "VFR_HUD", 20.0)
    held.undeclare()
    await flows(one, "VFR_HUD", None)
    assert one.asked("VFR_HUD") == [50_000.0, 0.0]


async def test_the_fastest_reader_decides(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    slow, fast = token(b.ground, "VFR_HUD", 2.5, "a"), token(b.ground, "VFR_HUD", 40, "b")
    await flows(one, "VFR_HUD", 40.0)
    fast.undeclare()
    await flows(one, "VFR_HUD", 2.5)
    slow.undeclare()
    await flows(one, "VFR_HUD", None)
    floor = token(b.ground, "ATTITUDE", 50)
    await flows(one, "ATTITUDE", 50.0)
    slower = token(b.ground, "ATTITUDE", 1, "c")
    floor.undeclare()
    await flows(one, "ATTITUDE", FLOOR["ATTITUDE"])
    slower.undeclare()
    await rounds(b)
    assert rounded(one)["ATTITUDE"] == FLOOR["ATTITUDE"]


async def test_what_another_station_has_faster_is_not_slowed(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    first = token(b.ground, "VFR_HUD", 5, "a")
    await flows(one, "VFR_HUD", 5.0)
    one.rates["VFR_HUD"] = 40.0
    await asyncio.sleep(WINDOW + 1.5)
    while (found := await row(b, "VFR_HUD")) is None or found.hz < 30.0:
        await rounds(b, 1)
    second = token(b.ground, "VFR_HUD", 10, "b")
    await rounds(b)
    first.undeclare()
    second.undeclare()
    await rounds(b)
    assert one.rates["VFR_HUD"] == 40.0
    assert one.asked("VFR_HUD") == [200_000.0]


async def test_a_simulation_that_hurries_is_no_other_station(
    bench: StartBench, one: StreamPeer, monkeypatch: pytest.MonkeyPatch
) -> None:
    b = await on(bench, one)
    monkeypatch.setattr(AutopilotClock, "drift", -7.0)  # eight times real time, and so is what it sends
    reader = token(b.ground, "VFR_HUD", 5)
    await flows(one, "VFR_HUD", 5.0)
    one.rates["VFR_HUD"] = 40.0
    await asyncio.sleep(WINDOW + 1.5)
    while (found := await row(b, "VFR_HUD")) is None or found.hz < 30.0:
        await rounds(b, 1)
    reader.undeclare()
    await flows(one, "VFR_HUD", None)


async def test_a_session_that_dies_takes_its_wishes_along(bench: StartBench, one: StreamPeer, net: Net) -> None:
    b = await on(bench, one)
    other = net.ground(b.endpoint)
    _held = token(other, "VFR_HUD", 10)
    await flows(one, "VFR_HUD", 10.0)
    other.session.close()
    await flows(one, "VFR_HUD", None)


async def test_a_wish_from_before_and_one_for_many_vehicles(bench: StartBench, one: StreamPeer, net: Net) -> None:
    _, elsewhere = net.router()
    ground = net.ground(elsewhere)
    _held = ground.session.liveliness().declare_token(want_key("zmav/demo/quad$*/mav/rx/*/*/VFR_HUD", 5.0))
    await on(bench, one, connect=(elsewhere,))
    await flows(one, "VFR_HUD", 5.0)


async def test_a_message_may_be_named_by_its_number(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    _held = [token(b.ground, "UNKNOWN_74", 20), token(b.ground, "UNKNOWN_60000", 10)]
    await flows(one, "VFR_HUD", 20.0)
    await flows(one, "UNKNOWN_60000", 10.0)


async def test_wishes_that_make_no_sense_are_counted_and_left_out(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    held, junk = (
        [],
        [("VFR_HUD", rate) for rate in ("0", "-1", "501", "inf", "nan", "fast", "1e999", "-0")]
        + [(name, "5") for name in ("NO_SUCH", "vfr_hud", "UNKNOWN_x", "UNKNOWN_", "UNKNOWN_16777216")],
    )
    for name, rate in junk:
        held.append(token(b.ground, name, rate))
    good = token(b.ground, "VFR_HUD", "1e1")
    await flows(one, "VFR_HUD", 10.0)
    assert (await table(b)).junk == len(junk)
    good.undeclare()
    await flows(one, "VFR_HUD", None)
    assert extra(one) == {"VFR_HUD"}


# Plain subscribers.


async def test_a_plain_subscriber_makes_its_message_flow_and_its_end_stops_it(
    bench: StartBench, one: StreamPeer
) -> None:
    b = await on(bench, one)
    reader = read(b.ground, "VFR_HUD")
    await flows(one, "VFR_HUD", PLAIN_HZ)
    found = await row(b, "VFR_HUD")
    assert found is not None
    assert found.wanted_hz == PLAIN_HZ
    assert found.readers == ["subscriber"]
    reader.undeclare()
    await flows(one, "VFR_HUD", None)


async def test_one_behind_another_router_counts_too(bench: StartBench, one: StreamPeer, net: Net) -> None:
    b = await on(bench, one)
    _, far = net.router(b.endpoint)
    reader = net.ground(far).session.declare_subscriber("zmav/*/quad$*/mav/rx/1/1/VFR_HUD", lambda sample: None)
    await flows(one, "VFR_HUD", PLAIN_HZ)
    reader.undeclare()
    await flows(one, "VFR_HUD", None)


async def test_who_takes_everything_asks_for_nothing(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    for key in (
        "zmav/demo/quad2/mav/rx/*/*/VFR_HUD",
        "zmav/demo/quad1/mav/rx/1/100/WIND",
        "zmav/demo/quad1/mav/rx/*/*/STATUSTEXT",
        "zmav/demo/quad1/mav/rx/*/*/PARAM_SET",
        "zmav/demo/quad1/mav/rx/*/*/NO_SUCH",
        "zmav/demo/quad1/mav/rx/*/*/HEARTBEAT",
        "zmav/demo/quad1/state",
    ):
        b.ground.session.declare_subscriber(key, lambda sample: None)
    last = b.ground.session.declare_subscriber("**/VFR_HUD", lambda sample: None)
    await flows(one, "VFR_HUD", PLAIN_HZ)
    last.undeclare()
    await flows(one, "VFR_HUD", None)
    assert extra(one) == {"VFR_HUD"}


@pytest.mark.parametrize(
    "key",
    [
        "zmav/**",
        "**",
        "zmav/demo/quad1/mav/rx/**",
        "zmav/demo/quad1/mav/rx/*/*/*",
        "zmav/demo/*/mav/rx/1/1/*",
        "zmav/demo/quad1/mav/rx/*/*/$*A$*",
    ],
)
async def test_beside_who_takes_everything_what_flows_goes_on(bench: StartBench, one: StreamPeer, key: str) -> None:
    b = await on(bench, one)
    b.ground.session.declare_subscriber("**/VFR_HUD", lambda sample: None)
    await flows(one, "VFR_HUD", PLAIN_HZ)
    everything = b.ground.session.declare_subscriber(key, lambda sample: None)
    held = token(b.ground, "WIND", 5)
    await flows(one, "WIND", 5.0)
    await rounds(b, 3)
    assert extra(one) == {"VFR_HUD", "WIND"}
    assert one.rates["VFR_HUD"] == PLAIN_HZ
    everything.undeclare()
    held.undeclare()


async def test_declarations_and_looks_at_subscribers_do_not_lock_each_other(bench: StartBench, one: StreamPeer) -> None:
    """Zenoh's admin space did: the vehicle's process stood still for good."""
    b = await on(bench, one)
    demands = b.vehicle.rates.demands

    def declare() -> None:
        for n in range(3000):
            key = f"zmav/demo/quad1/mav/rx/*/*/N{n % 50}"
            b.ground.session.declare_subscriber(key, lambda sample: None).undeclare()

    declaring = asyncio.create_task(asyncio.to_thread(declare))
    while not declaring.done():
        demands.poll((1, 1))
        await asyncio.sleep(0)
    await declaring
    read(b.ground, "VFR_HUD")
    await flows(one, "VFR_HUD", PLAIN_HZ)


async def test_a_pattern_that_fits_a_few_names_them(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    b.ground.session.declare_subscriber("zmav/demo/quad1/mav/rx/*/*/VIBR$*", lambda sample: None)
    await flows(one, "VIBRATION", PLAIN_HZ)


async def test_hundreds_of_subscribers_do_not_stop_the_vehicle(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    for n in range(300):
        b.ground.session.declare_subscriber(f"zmav/demo/quad1/mav/rx/*/*/N{n}", lambda sample: None)
    read(b.ground, "VFR_HUD")
    await flows(one, "VFR_HUD", PLAIN_HZ)


# What the autopilot and others have to say.


async def test_what_the_autopilot_sends_by_itself_comes_again_as_it_did(bench: StartBench) -> None:
    peer = StreamPeer(unasked={"VFR_HUD": 3.0, "WIND": 8.0})
    async with contextlib.AsyncExitStack() as stack:
        await peer.open()
        stack.push_async_callback(peer.close)
        b = await on(bench, peer)
        faster, enough = token(b.ground, "VFR_HUD", 30), token(b.ground, "WIND", 8)
        await flows(peer, "VFR_HUD", 30.0)
        faster.undeclare()
        enough.undeclare()
        await flows(peer, "VFR_HUD", 3.0)
        await rounds(b)
        assert peer.asked("WIND") == []
        assert peer.rates["WIND"] == 8.0


async def test_a_refusal_is_said_once_and_not_asked_for_again(bench: StartBench, one: StreamPeer) -> None:
    one.denied = {"ODOMETRY"}
    b = await on(bench, one)
    held = token(b.ground, "ODOMETRY", 10)
    said = await b.event("ODOMETRY at 10 Hz refused: DENIED (wanted by test-1)")
    assert (said["kind"], said["severity"]) == ("rate", "warning")
    await rounds(b, 3)
    assert one.asked("ODOMETRY") == [100_000.0]
    found = await row(b, "ODOMETRY")
    assert found is not None
    assert (found.refused, found.asked_hz, found.wanted_hz, found.compid) == ("DENIED", None, 10.0, None)
    held.undeclare()
    held = token(b.ground, "ODOMETRY", 10, "test-2")
    await rounds(b, 2)
    assert len(one.asked("ODOMETRY")) == 1
    one.denied = set()
    one.reboot()
    await flows(one, "ODOMETRY", 10.0)
    assert len([e for e in b.events.objects() if "refused" in e["text"]]) == 1


async def test_what_is_too_fast_is_had_slower(bench: StartBench, one: StreamPeer) -> None:
    one.fastest = 120.0
    b = await on(bench, one)
    held = token(b.ground, "VFR_HUD", 400)
    await flows(one, "VFR_HUD", 100.0)
    await rounds(b)
    assert one.asked("VFR_HUD") == [2_500.0, 5_000.0, 10_000.0]
    held.undeclare()
    await flows(one, "VFR_HUD", None)


async def test_others_refusals_are_not_ours(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    before = one.obey
    one.mute = {SET_INTERVAL}
    held = token(b.ground, "VFR_HUD", 5)
    await one.until(lambda: bool(one.asked("VFR_HUD")), "asking")
    one.acknowledge(SET_INTERVAL, 2, (255, 190))
    one.acknowledge(SET_INTERVAL - 1, 2, (1, 191))
    one.raw(Packer(one.dialect, 1, 100).pack("COMMAND_ACK", command=SET_INTERVAL, result=2))
    one.mute = set()
    await flows(one, "VFR_HUD", 5.0)
    assert not [e for e in b.events.objects() if "refused" in e["text"]]
    held.undeclare()
    assert one.obey == before


async def test_the_companion_s_end_puts_everything_back(
    bench: StartBench, one: StreamPeer, onboard: StartOnboard
) -> None:
    b = await on(bench, one)
    _held = [token(b.ground, "VFR_HUD", 20), token(b.ground, "ATTITUDE", 50)]
    await flows(one, "VFR_HUD", 20.0)
    await flows(one, "ATTITUDE", 50.0)
    await onboard.close(b.vehicle)
    await flows(one, "VFR_HUD", None)
    await flows(one, "ATTITUDE", FLOOR["ATTITUDE"])


# Statistics.


async def test_the_table_counts_frames_and_bytes_as_they_came(bench: StartBench, one: StreamPeer) -> None:
    b = await on(bench, one)
    camera = Packer(one.dialect, 1, 100)
    frames = [camera.pack("VFR_HUD", groundspeed=float(n)) for n in range(50)]
    for frame in frames:
        one.raw(frame)
    while (found := await row(b, "VFR_HUD")) is None or found.count < 50:
        await rounds(b, 1)
    assert (found.sysid, found.compid, found.count, found.wanted_hz, found.readers) == (1, 100, 50, None, [])
    t = await table(b)
    assert t.capacity is None
    attitude = next(m for m in t.messages if m.name == "ATTITUDE")
    assert attitude.readers == ["floor"]
    assert attitude.asked_hz == attitude.wanted_hz == FLOOR["ATTITUDE"]
    assert attitude.bytes_rate == pytest.approx(attitude.hz * len(Packer(one.dialect, 1, 1).pack("ATTITUDE")))
    assert sum(m.bytes_rate for m in t.messages) == pytest.approx(t.used)
    flow = next(f for f in b.vehicle.adapter.flows() if (f.name, f.compid) == ("VFR_HUD", 100))
    assert (flow.total, flow.size) == (50, sum(map(len, frames)))


async def test_the_key_of_a_wish() -> None:
    key = want_key("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", 2.5, "echo")
    assert key.startswith("zmav/demo/quad1/want/ATTITUDE/2.5/echo-")
    assert keys.match(key)[0] is keys.WANT
    assert want_key("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", 2.5) != want_key("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", 2.5)
    for bad, hz in (
        ("zmav/demo/quad1/state", 5.0),
        ("zmav/demo/quad1/mav/rx/*/*/*", 5.0),
        ("zmav/demo/quad1/mav/rx/**", 5.0),
        ("zmav/demo/quad1/mav/tx/1/1/ATTITUDE", 5.0),
        ("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", 0.0),
        ("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", 501.0),
        ("zmav/demo/quad1/mav/rx/*/*/ATTITUDE", float("nan")),
    ):
        with pytest.raises(BadInput):
            want_key(bad, hz)

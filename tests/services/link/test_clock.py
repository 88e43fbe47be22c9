"""The autopilot's clock: what is said of it is never wronger than it is said to be."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING
from unittest import mock

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.services.rates.rate_peer import StreamPeer
from zmav import wire
from zmav.mavlink import Frame, Packer, encode, load_dialect, parse_frame
from zmav.services.link import timesync
from zmav.services.link.clock import SETTLED, WRAP_MS, AutopilotClock

if TYPE_CHECKING:
    from tests.conftest import StartOnboard
    from tests.services.conftest import Bench, StartBench

UTC_AHEAD = 1.7e9


class Twin:
    """An autopilot's clock that runs ``drift`` fast of ours and was zero at our time ``boot``; ``clock`` asks it."""

    def __init__(self, drift: float = 0.0, boot: float = 1000.0, start: float = 1100.0) -> None:
        self.drift, self.boot, self.now = drift, boot, start
        self.clock = AutopilotClock(lambda: UTC_AHEAD, lambda: self.now)

    def theirs(self, ours: float) -> float:
        return (ours - self.boot) * (1.0 + self.drift)

    def ask(self, out: float, back: float) -> str:
        sent, received = self.now, self.now + out + back
        self.now = received
        return self.clock.sample(sent, received, self.theirs(sent + out))

    def check(self, ago: float) -> float:
        """What is said of a moment some seconds ago must hold; the error that is said."""
        stamp = self.clock.at(self.theirs(self.now - ago))
        assert stamp is not None
        assert abs(stamp.utc - (self.now - ago + UTC_AHEAD)) <= stamp.error + 1e-5
        return stamp.error


DELAYS = st.tuples(st.floats(0.0, 0.3), st.floats(0.0, 0.3))
"""s there and back: as uneven as can be"""


@example(drift=100e-6, delays=[(0.0, 0.0)] * 4 + [(0.0, 0.25)], every=1.0, ago=0.0)
@given(
    drift=st.floats(-100e-6, 100e-6),
    delays=st.lists(DELAYS, min_size=SETTLED, max_size=80),
    every=st.floats(0.2, 20.0),
    ago=st.floats(0.0, 100.0),
)
def test_never_wronger_than_said(drift: float, delays: list[tuple[float, float]], every: float, ago: float) -> None:
    twin = Twin(drift)
    for n, (out, back) in enumerate(delays, 1):
        assert twin.ask(out, back) == "good"
        if n >= SETTLED:
            twin.check(ago)
        twin.now += every


@given(st.randoms(use_true_random=False))
def test_short_round_trips_count_and_long_ones_do_no_harm(random: object) -> None:
    twin = Twin(20e-6)
    for n in range(60):
        slow = n % 3 != 0
        twin.ask(0.2 * random.random() if slow else 0.001, 0.0005)  # type: ignore[attr-defined]
        twin.now += 1.0
    assert twin.check(0.0) < 0.0025


def test_nothing_is_said_before_it_has_settled() -> None:
    twin = Twin()
    assert twin.clock.at(1.0) is None
    for _ in range(SETTLED - 1):
        twin.ask(0.01, 0.01)
        assert twin.clock.at(1.0) is None
    twin.ask(0.01, 0.01)
    assert twin.clock.at(1.0) is not None
    twin.clock.forget()
    assert twin.clock.at(1.0) is None


def test_a_restart_is_seen_and_what_was_known_is_forgotten() -> None:
    twin = Twin()
    for _ in range(10):
        assert twin.ask(0.01, 0.01) == "good"
        twin.now += 1.0
    before = twin.theirs(twin.now)
    twin.boot = twin.now
    twin.now += 1.0
    assert twin.ask(0.01, 0.01) == "restarted"
    assert twin.clock.at(0.5) is None
    assert [twin.ask(0.01, 0.01) for _ in range(SETTLED)] == ["good"] * SETTLED
    twin.check(0.5)
    assert twin.clock.at(before) is None  # it is of before: there has been no such time since


@pytest.mark.parametrize(("up", "verdict"), [(5.0, "restarted"), (190.0, "behind")])
def test_only_a_time_that_went_back_during_a_silence_is_a_restart(up: float, verdict: str) -> None:
    """One that went forward by less than ours may be of a simulation that was stopped for a while."""
    twin = Twin(boot=1090.0)
    for _ in range(10):
        twin.ask(0.01, 0.01)
        twin.now += 1.0
    assert twin.theirs(twin.now) == pytest.approx(20.2)
    twin.now += 200.0
    twin.boot = twin.now - up
    assert twin.ask(0.01, 0.01) == verdict


def test_a_clock_that_jumps_ahead_is_no_restart_and_begins_again() -> None:
    twin = Twin()
    for _ in range(10):
        twin.ask(0.01, 0.01)
    twin.boot -= 5.0
    assert twin.ask(0.01, 0.01) == "stepped"
    assert twin.clock.at(1.0) is None


@given(
    pace=st.floats(0.1, 0.8) | st.floats(1.3, 50.0),
    unsteady=st.lists(st.floats(-0.03, 0.03), min_size=10, max_size=60),
    every=st.floats(0.2, 1.0),
)
def test_a_simulation_is_believed_at_its_own_pace(pace: float, unsteady: list[float], every: float) -> None:
    twin = Twin(pace - 1.0)
    for n, off in enumerate(unsteady):
        twin.ask(0.001, 0.002)
        if n >= 2 + SETTLED:
            assert twin.clock.simulated
            assert twin.check(0.0) < 0.2 * max(pace, 1.0 / pace)
            twin.check(every / 2)
        twin.boot -= off * every * pace / (1.0 + twin.drift)  # it gains or loses a little
        twin.now += every


def test_a_simulation_may_change_its_pace_and_stand_still() -> None:
    twin = Twin(3.0)

    def go(drift: float) -> None:
        """Twenty answers at another pace, from where the clock is now."""
        twin.boot = twin.now - twin.theirs(twin.now) / (1.0 + drift) if drift > -1.0 else twin.boot
        twin.drift = drift
        for _ in range(20):
            twin.ask(0.001, 0.001)
            twin.now += 0.2

    for drift in (3.0, -0.5, 9.0):
        go(drift)
        assert twin.clock.simulated
        twin.check(0.1)
    go(0.0)
    assert not twin.clock.simulated
    assert twin.check(0.1) < 0.002
    frozen = twin.theirs(twin.now)
    for _ in range(20):
        twin.clock.sample(twin.now - 0.001, twin.now, frozen)
        twin.now += 0.2
    assert twin.clock.at(frozen) is None


def test_a_step_is_not_taken_for_a_pace() -> None:
    twin = Twin()
    for _ in range(10):
        twin.ask(0.01, 0.01)
        twin.now += 5.0
    twin.boot -= 0.2
    assert twin.ask(0.01, 0.01) == "stepped"
    assert not twin.clock.simulated


def test_small_contradictions_make_it_less_sure() -> None:
    twin = Twin()
    for _ in range(10):
        twin.ask(0.0001, 0.0001)
    sure = twin.check(0.0)
    twin.boot += 0.02
    assert twin.ask(0.0001, 0.0001) == "good"
    unsure = twin.check(0.0)
    assert sure < 0.001 < unsure <= 0.0125
    twin.ask(0.0001, 0.0001)
    assert twin.check(0.0) < 0.001


def test_milliseconds_wrap() -> None:
    twin = Twin(boot=-WRAP_MS / 1e3, start=100.0)
    for _ in range(SETTLED):
        twin.ask(0.01, 0.01)
    for ours in (50.0, -50.0):
        stamp = twin.clock.utc(int(twin.theirs(ours) * 1e3) % WRAP_MS)
        assert stamp is not None
        assert stamp.utc == pytest.approx(ours + UTC_AHEAD, abs=0.03)


# Beside an autopilot.


@pytest.fixture(autouse=True)
def quick(onboard: StartOnboard) -> None:
    """Housekeeping at twice its pace."""
    onboard.pace = 2.0


async def last(b: Bench, name: str) -> wire.LastMessage:
    (reply,) = await b.ground.ask(f"zmav/demo/quad1/msg/{name}")
    assert reply.ok is not None
    return wire.decode(reply.ok.payload.to_bytes(), wire.LastMessage, name)


async def streaming(bench: StartBench, peer: StreamPeer) -> Bench:
    return await (await bench(peer)).connected()


@pytest.fixture
async def one() -> AsyncIterator[StreamPeer]:
    peer = StreamPeer()
    await peer.open()
    yield peer
    await peer.close()


async def test_the_state_says_when_it_was_booted(bench: StartBench, one: StreamPeer) -> None:
    b = await streaming(bench, one)
    state = await b.state(lambda s: s["clock"], "clock")
    clock = state["clock"]
    assert clock["boot_t"] == pytest.approx(time.time() - one.boot, abs=clock["error_s"] + 0.001)
    assert 0.0 < clock["error_s"] < 1.0
    assert clock["gps_offset_s"] is None
    asked = len(one.heard("TIMESYNC"))
    start = asyncio.get_running_loop().time()
    await one.count("TIMESYNC", asked + 3)
    assert asyncio.get_running_loop().time() - start > 1.5  # settled: once a second


async def test_messages_are_dated_by_their_own_time(bench: StartBench, one: StreamPeer) -> None:
    b = await streaming(bench, one)
    await b.state(lambda s: s["clock"], "clock")
    taken = time.time() - 2.0
    boot = one.boot - 2.0
    one.send("ATTITUDE_QUATERNION", time_boot_ms=int(boot * 1e3))
    one.send("RAW_IMU", time_usec=int(boot * 1e6))
    one.send("SCALED_PRESSURE")
    one.send("GPS_INPUT", time_usec=1_700_000_000_000_000)
    one.raw(Packer(one.dialect, 1, 100).pack("SCALED_IMU", time_boot_ms=int(boot * 1e3)))
    one.send("VFR_HUD", groundspeed=1.0)
    while "VFR_HUD" not in b.vehicle.adapter.names():
        await b.state(lambda s: True, "a moment")
    for name in ("ATTITUDE_QUATERNION", "RAW_IMU"):
        found = await last(b, name)
        assert found.t is not None
        assert found.t_error is not None
        assert abs(found.t - taken) <= found.t_error + 0.001
        assert found.t_error < 1.0
    assert [((m := await last(b, name)).t, m.t_error) for name in ("VFR_HUD", "SCALED_PRESSURE", "SCALED_IMU")] == [
        (None, None)
    ] * 3
    assert ((m := await last(b, "GPS_INPUT")).t, m.t_error) == (1.7e9, None)


async def test_a_restart_is_said_and_everything_is_asked_for_again(bench: StartBench, one: StreamPeer) -> None:
    b = await streaming(bench, one)
    await b.state(lambda s: s["clock"] and s["attitude"], "clock and attitude")
    one.reboot()
    said = await b.event("the autopilot has restarted")
    assert said["severity"] == "warning"
    await one.until(lambda: one.rates.get("ATTITUDE") == 10.0, "asking again")
    await b.state(lambda s: s["clock"] and s["clock"]["boot_t"] > time.time() - 60.0, "the new boot")


async def test_a_restart_before_the_first_answer_is_seen(bench: StartBench, one: StreamPeer) -> None:
    one.answers_within = 0.0
    b = await streaming(bench, one)
    await one.count("TIMESYNC", 2)
    one.reboot()
    one.answers_within = math.inf
    said = await b.event("the autopilot has restarted")
    assert said["severity"] == "warning"


async def test_an_answer_before_the_autopilot_is_taken_in_is_no_restart() -> None:
    """The companion runs for days, the autopilot since a minute; its HEARTBEAT comes between a question and its answer,
    and no tick since."""
    companion, sent, restarts = mock.Mock(), list[int](), list[timesync.AutopilotRestarted]()
    listeners: dict[str, Callable[[Frame], None]] = {}
    companion.identity.source, companion.port.dialect = None, load_dialect()
    companion.port.send = lambda name, **fields: sent.append(fields["ts1"])
    companion.port.bus.tell = restarts.append
    companion.port.listen = listeners.__setitem__
    sync = timesync.TimeSync(companion)
    sync.start()
    sync.tick()
    companion.identity.source = (1, 1)
    answer = encode(load_dialect(), "TIMESYNC", {"tc1": 10**9, "ts1": sent[0]}, sysid=1, compid=1)
    listeners["TIMESYNC"](parse_frame(answer, load_dialect()))
    await asyncio.sleep(0.01)
    assert sync.take_rtt() is None and not restarts


async def test_a_time_that_went_forward_is_no_restart(
    bench: StartBench,
    one: StreamPeer,
) -> None:
    b = await streaming(bench, one)
    b.vehicle.timesync.clock.silence = 0.5
    await b.state(lambda s: s["clock"] and s["attitude"], "clock and attitude")
    one.answers_within = 0.0
    await one.count("TIMESYNC", len(one.heard("TIMESYNC")) + 3)
    one.booted += 0.5
    one.rates = dict(one.unasked)
    one.answers_within = 0.3  # of one that waited longer, 0.5 s prove nothing
    said = await b.event("the autopilot was silent, and its time went on by")
    assert said["severity"] == "notice"
    await one.until(lambda: one.rates.get("ATTITUDE") == 10.0, "asking again, in case it has")
    assert not [e for e in b.events.objects() if "restarted" in e["text"]]


async def test_a_computer_without_the_time_is_told_by_gps(bench: StartBench, one: StreamPeer) -> None:
    b = await streaming(bench, one)
    await b.state(lambda s: s["clock"], "clock")

    async def tell(ahead: float) -> None:
        now = time.time()
        one.send("SYSTEM_TIME", time_unix_usec=round((now + ahead) * 1e6), time_boot_ms=round(one.boot * 1e3))
        await b.state(
            lambda s: s["clock"]["gps_offset_s"] == pytest.approx(ahead, abs=s["clock"]["error_s"] + 0.01), "offset"
        )

    one.send("SYSTEM_TIME", time_unix_usec=5, time_boot_ms=round(one.boot * 1e3))  # no GPS time yet
    await tell(0.1)
    await tell(3600.0)
    said = await b.event("this computer's clock is 3600.0 s behind GPS time")
    assert (said["kind"], said["severity"]) == ("clock", "warning")
    await tell(-5000.0)
    await tell(timesync.RIGHT / 2)
    await b.event("agrees with GPS time")
    await tell(-10.0)
    await b.event("this computer's clock is 10.0 s ahead of GPS time")
    assert len([e for e in b.events.objects() if e["kind"] == "clock"]) == 3


async def test_only_the_autopilot_s_answers_to_us_count(bench: StartBench, one: StreamPeer) -> None:
    one.answers_within = 0.0
    b = await streaming(bench, one)
    for _ in range(3):
        await one.count("TIMESYNC", len(one.heard("TIMESYNC")) + 1)
        asked = one.heard("TIMESYNC")[-1].fields["ts1"]
        one.send("TIMESYNC", tc1=0, ts1=asked)
        one.send("TIMESYNC", tc1=5, ts1=asked + 1)
        one.raw(Packer(one.dialect, 1, 100).pack("TIMESYNC", tc1=5, ts1=asked))
    assert (await b.state(lambda s: True, "state"))["clock"] is None
    one.answers_within = math.inf
    await b.state(lambda s: s["clock"], "clock")


async def test_the_autopilot_is_told_our_time_and_nobody_else(bench: StartBench, one: StreamPeer) -> None:
    await streaming(bench, one)
    before = time.monotonic_ns()
    one.raw(Packer(one.dialect, 1, 100).pack("TIMESYNC", tc1=0, ts1=76))
    one.send("TIMESYNC", tc1=0, ts1=77)
    await one.until(lambda: any(m.fields["tc1"] for m in one.heard("TIMESYNC")), "an answer")
    answers = [m.fields for m in one.heard("TIMESYNC") if m.fields["tc1"]]
    assert [a["ts1"] for a in answers] == [77]
    assert before < answers[0]["tc1"] < time.monotonic_ns()

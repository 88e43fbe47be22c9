"""Nobody comes back: the configured action, or the next safer one that the autopilot takes."""

from __future__ import annotations

import contextlib

import pytest

from tests.failsafe.conftest import Agent, agent, another, held, moves, stops
from tests.services.conftest import FAILED, GUIDED, LAND, LOITER, SET_MODE, TAKEOFF, Bench, Peer, StartBench
from zmav.config import Failsafe
from zmav.errors import ZmavError
from zmav.services.authority import watchdog

RTL, SPEED = 6, 178
MODES = {"rtl": ("RTL", 6), "land": ("LAND", 9), "loiter": ("BRAKE", 17)}  # LOITER would follow the sticks


def failsafe(action: str = "rtl", land_after: float = 1.0) -> dict[str, Failsafe]:
    return {"failsafe": Failsafe(hold_after=0.2, land_after=land_after, action=action)}  # type: ignore[arg-type]


async def lost(b: Bench) -> Agent:
    alice = await agent(b)
    await alice.fly()
    return alice


@pytest.mark.parametrize("action", ["rtl", "land", "loiter"])
async def test_the_action_follows_the_hold(bench: StartBench, action: str) -> None:
    b = await bench(settings=failsafe(action))
    alice = await lost(b)
    name, number = MODES[action]
    await b.peer.until(lambda: b.peer.mode == number, action)
    assert b.peer.commands(SET_MODE)[0].at - moves(b)[-1].at > 0.6
    assert stops(b)
    said = await b.event(f"no setpoint for 1 s: {name}", kind="failsafe")
    assert said["severity"] == "critical"
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert end["reason"] == "failsafe"
    # Its stream does not take it back, a new lease does.
    alice.put()
    await b.state(lambda s: s["setpoints"].get("lease") == 1, "refused setpoint")
    assert b.peer.mode == number
    bob = await another(b, "bob")
    bob.put()
    await b.peer.until(lambda: b.peer.mode == GUIDED, "GUIDED")


async def test_a_stream_that_comes_back_in_time_goes_on(bench: StartBench) -> None:
    b = await bench(settings=failsafe(land_after=2.0))
    alice = await lost(b)
    await held(b)
    await alice.fly()
    await b.peer.until(lambda: sum(t.at > moves(b)[-1].at for t in stops(b)) > 0, "hold again")
    assert b.peer.mode == GUIDED


class Stubborn(Peer):
    """Refuses the modes it is told to."""

    refused: tuple[int, ...] = ()

    def obey(self, number: int, fields: dict[str, float]) -> None:
        if number != SET_MODE or int(fields["param2"]) not in self.refused:
            super().obey(number, fields)


async def stubborn(bench: StartBench, *refused: int, **more: object) -> Bench:
    one = Stubborn()
    one.refused = refused
    await one.open()
    return await bench(one, **more)


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watchdog, "GIVE_UP", 0.5)
    monkeypatch.setattr(watchdog, "RETRY_ACTION", 0.5)


@pytest.mark.usefixtures("hurry")
async def test_the_next_safer_one_where_it_is_refused(bench: StartBench) -> None:
    b = await stubborn(bench, RTL, settings=failsafe())
    await lost(b)
    await b.peer.until(lambda: b.peer.mode == LAND, "LAND")
    await b.event("rtl is not to be had (mode RTL does not come): land instead", kind="failsafe")
    await b.event("LAND", kind="failsafe", severity="critical")
    await b.peer.close()


@pytest.mark.usefixtures("hurry")
async def test_where_all_is_refused_it_says_so_and_keeps_trying(bench: StartBench) -> None:
    b = await stubborn(bench, RTL, LAND, settings=failsafe())
    await lost(b)
    said = await b.event("neither rtl nor land is taken: holding position", kind="failsafe")
    assert said["severity"] == "emergency"
    holds = len(stops(b))
    assert isinstance(b.peer, Stubborn)
    await b.peer.until(lambda: len(stops(b)) > holds, "the hold goes on")
    b.peer.refused = ()
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL after all")
    await b.peer.close()


async def test_an_order_that_comes_to_nothing_does_not_end_the_action(bench: StartBench) -> None:
    """RTL is on its way: a takeoff is tried, and refused. Nobody flies the vehicle then, and it goes home after all."""
    b = await stubborn(bench, RTL, settings=failsafe())
    await lost(b)
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "RTL asked for")
    b.peer.results[TAKEOFF] = [FAILED]
    with pytest.raises(ZmavError):
        await b.ground.do("takeoff", alt_rel=5.0)
    await b.event("takeoff came to nothing: holding position")
    assert isinstance(b.peer, Stubborn)
    b.peer.refused = ()
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL after all")
    await b.peer.close()


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("how", ["lease", "arm"])
async def test_what_moves_nothing_does_not_end_the_action(bench: StartBench, how: str) -> None:
    """It tries again and again: who takes a lease and gives it back, or orders nothing that moves, flies nothing."""
    b = await stubborn(bench, RTL, LAND, settings=failsafe())
    await lost(b)
    await b.event("neither rtl nor land is taken: holding position", kind="failsafe")
    if how == "arm":
        await b.ground.do("arm")  # it is
    else:
        bob = await another(b, "bob")
        await b.ground.do("release", lease=bob.token)
    assert isinstance(b.peer, Stubborn)
    b.peer.refused = ()
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL after all")
    await b.peer.close()


@pytest.mark.parametrize("refused", [True, False], ids=["refused", "done"])
async def test_a_command_that_moves_nothing_does_not_end_the_action(bench: StartBench, refused: bool) -> None:
    b = await stubborn(bench, RTL, LAND, settings=failsafe())
    await lost(b)
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "RTL asked for")
    if refused:
        b.peer.results[SPEED] = [FAILED]
    with pytest.raises(ZmavError) if refused else contextlib.nullcontext():
        await b.ground.do("command", command="DO_CHANGE_SPEED", params={"param1": 1, "param2": 3.0})
    assert isinstance(b.peer, Stubborn)
    b.peer.refused = ()
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL after all")
    await b.peer.close()


async def test_a_second_panic_ends_the_action_only_by_what_it_does(bench: StartBench) -> None:
    """A hold is an operator's, who is above the failsafe; one that comes to nothing leaves the action to come."""
    b = await stubborn(bench, RTL, settings=failsafe())
    await lost(b)
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "RTL asked for")
    await b.ground.do("hold")
    assert isinstance(b.peer, Stubborn)
    b.peer.refused = ()
    for _ in range(8):  # 5 Hz: longer than land_after
        await b.state(lambda s: True, "a moment")
    assert b.peer.mode == GUIDED
    await b.peer.close()


async def test_the_pilot_wins_over_the_action_too(bench: StartBench) -> None:
    b = await bench(settings=failsafe())
    await lost(b)
    await held(b)
    b.peer.mode = LOITER
    b.peer.heartbeat()
    await b.event("released", kind="pilot")
    for _ in range(8):  # 5 Hz: longer than land_after
        await b.state(lambda s: True, "a moment")
    assert b.peer.commands(SET_MODE) == []


async def test_a_lease_that_was_lost_is_followed_by_the_action(bench: StartBench) -> None:
    b = await bench(settings=failsafe())
    alice = await lost(b)
    await b.ground.do("lease", holder="alice", ttl=0.1, lease=alice.token)
    await b.event("lease of alice ran out")
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")


async def test_a_setpoint_that_comes_between_the_action_and_the_lease_s_end(
    bench: StartBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watchdog acts in its own thread; the lease ends a moment later, and that moment is guarded, too."""
    b = await bench(settings=failsafe())
    monkeypatch.setattr(b.vehicle.leases, "end", lambda *said: None)
    alice = await lost(b)
    await b.peer.until(lambda: b.peer.mode == RTL, "RTL")
    flown = len(moves(b))
    alice.put()
    await b.state(lambda s: s["setpoints"].get("failsafe") == 1, "refused setpoint")
    assert (len(moves(b)), b.peer.mode) == (flown, RTL)

"""The stream of setpoints stops, and nobody says why."""

from __future__ import annotations

import contextlib

import pytest

from tests.failsafe.conftest import PATIENT, Px4Peer, agent, held, moves, stops
from tests.services.conftest import GUIDED, SET_MODE, StartBench
from zmav.errors import ZmavError

HOLD_MODE, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16


async def test_it_holds_after_half_a_second(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    await alice.fly()
    await held(b)
    silent = stops(b)[0].at - moves(b)[0].at
    assert 0.45 < silent < 2.0  # 0.5 s, and what a busy machine adds; the bench measures it
    assert b.peer.mode == GUIDED
    await b.event("no setpoint for 0.5 s: holding position", kind="setpoint")


async def test_it_is_kept_alive_until_then(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    await alice.fly()
    await held(b)
    assert len(moves(b)) >= 2
    assert not [t for t in moves(b) if t.at > stops(b)[0].at]


async def test_px4_is_put_into_hold(bench: StartBench, px4: Px4Peer) -> None:
    b = await bench(px4)
    alice = await agent(b, mode=OFFBOARD)
    b.peer.results[SET_MODE] = [4, 0]  # refused once: asked for again
    await alice.fly()
    await b.peer.until(lambda: b.peer.mode == HOLD_MODE, "HOLD")
    assert {(t.fields["param2"], t.fields["param3"]) for t in b.peer.commands(SET_MODE)} == {(4.0, 3.0)}
    assert len(b.peer.commands(SET_MODE)) >= 2


async def test_a_rover_is_put_into_hold(bench: StartBench) -> None:
    b = await bench(mav_type=10)
    alice = await agent(b, mode=15)
    alice.put(vel=(1.0, 0.0, 0.0))
    await b.peer.until(lambda: b.peer.mode == 4, "HOLD")


async def test_it_goes_on_when_the_stream_does(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    await alice.fly()
    await held(b)
    await alice.fly()
    assert moves(b)[-1].at > stops(b)[0].at


@pytest.mark.parametrize(
    ("verb", "args"),
    [
        ("disarm", {}),  # refused in the air
        ("arm", {"ready_timeout": 0}),
        ("command", {"command": "DO_CHANGE_SPEED", "params": {"param2": 5.0}}),
    ],
)
async def test_an_order_that_moves_nothing_leaves_nothing_flying(
    bench: StartBench, verb: str, args: dict[str, object]
) -> None:
    """It ends the stream: what was flown must not be flown on."""
    b = await bench(settings={"failsafe": PATIENT})
    b.peer.results[400] = [4]
    alice = await agent(b)
    await alice.fly()
    with contextlib.suppress(ZmavError):
        await b.ground.do(verb, lease=alice.token, **args)
    await held(b)


@pytest.mark.parametrize(
    ("verb", "args"), [("goto", {}), ("takeoff", {"alt_rel": 5000}), ("set_mode", {"mode": "WARP"})]
)
async def test_an_order_that_is_refused_leaves_the_stream_as_it_was(
    bench: StartBench, verb: str, args: dict[str, object]
) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    with pytest.raises(ZmavError):
        await b.ground.do(verb, lease=alice.token, **args)
    flown = (await b.state(lambda s: s["setpoints"].get("flown"), "flown"))["setpoints"]["flown"]
    await alice.fly()
    await b.state(lambda s: s["setpoints"].get("flown", 0) > flown, "flown on")
    assert "held" not in b.states.objects()[-1]["setpoints"]

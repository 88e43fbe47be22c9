"""The pilot wins: by a mode, by a switch, by disarming; so does the autopilot's own failsafe."""

from __future__ import annotations

import asyncio

import pytest

from tests.failsafe.conftest import PATIENT, agent, another, moves, nothing_more, stops
from tests.services.conftest import GUIDED, LAND, LOITER, SET_MODE, Bench, StartBench
from zmav.config import PilotSwitch
from zmav.errors import NotHolder, Refused

RTL, POSCTL, OFFBOARD = 6, 3 << 16, 6 << 16


async def released(b: Bench, words: str) -> None:
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert end["reason"] == "pilot"
    assert words in end["text"]
    await b.event("released", kind="pilot")
    await nothing_more(b)
    assert stops(b) == []


@pytest.mark.parametrize("mode", [LOITER, RTL, LAND])
async def test_mode_change(bench: StartBench, mode: int) -> None:
    """... by the pilot, another station, or a battery failsafe: it looks the same."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    b.peer.mode = mode
    b.peer.heartbeat()
    await released(b, "which was not ordered here")
    alice.put()
    await b.state(lambda s: s["setpoints"].get("pilot") == 1, "refused setpoint")
    with pytest.raises(NotHolder, match="any more: the mode is now"):
        await b.ground.do("set_mode", mode="GUIDED", lease=alice.token)
    assert b.peer.mode == mode
    # Whoever asks anew may have it again.
    bob = await another(b, "bob")
    bob.put()
    await b.peer.until(lambda: b.peer.mode == GUIDED, "GUIDED again")


async def test_mode_change_on_px4(bench: StartBench) -> None:
    b = await bench(autopilot=12, settings={"failsafe": PATIENT})
    alice = await agent(b, mode=OFFBOARD)
    await alice.fly()
    b.peer.mode = POSCTL
    b.peer.heartbeat()
    await released(b, "the mode is now POSCTL")


async def test_mode_change_while_the_mode_is_asked_for(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    b.peer.mute = {SET_MODE}
    alice = await agent(b, mode=LOITER)
    alice.put()
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "GUIDED asked for")
    b.peer.mode = 0
    b.peer.heartbeat()
    await released(b, "the mode is now STABILIZE")


async def test_disarmed(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    b.peer.armed = False
    b.peer.heartbeat()
    await released(b, "it was disarmed")


async def test_modes_that_we_ordered_are_nobody_s_taking_over(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    for mode in ("LOITER", "GUIDED", "LOITER"):
        await b.ground.do("set_mode", mode=mode, lease=alice.token)
        assert (await b.state(lambda s, mode=mode: s["mode"] == mode, mode))["lease"]["holder"] == "alice"  # type: ignore[misc]
    alice.put()
    await b.peer.until(lambda: b.peer.mode == GUIDED, "GUIDED by the stream")
    assert (await b.state(lambda s: s["mode"] == "GUIDED", "GUIDED"))["lease"]["holder"] == "alice"


async def test_landing_under_a_lease_is_no_taking_over(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    landing = asyncio.create_task(b.ground.do("land", lease=alice.token))
    await b.state(lambda s: s["mode"] == "LAND", "LAND")
    b.peer.armed = False
    assert (await landing).status == "done"
    assert (await b.state(lambda s: s["armed"] is False, "disarmed"))["lease"]["holder"] == "alice"


def switch(b: Bench, pwm: int) -> None:
    b.peer.send("RC_CHANNELS", chancount=16, chan7_raw=pwm)


async def test_switch(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT, "pilot_switch": PilotSwitch(channel=7)})
    alice = await agent(b)
    switch(b, 1100)
    await alice.fly()
    switch(b, 1900)
    await released(b, "the pilot's switch (channel 7) is at 1900 µs")
    flown = len(moves(b))
    for refused in (
        b.ground.do("lease", holder="bob"),
        b.ground.do("goto", frame="global", lat_deg=-35.0, lon_deg=149.0, alt_rel=5.0),
        b.ground.do("land"),
    ):
        with pytest.raises(Refused, match=r"the pilot has it: his switch \(channel 7\) is at 1900 µs"):
            await refused
    state = await b.state(lambda s: s["pilot"], "the pilot")
    assert state["lease"] is None
    switch(b, 1100)
    await b.state(lambda s: s["pilot"] is None, "no pilot")
    assert len(moves(b)) == flown
    bob = await another(b, "bob")
    await bob.fly()


async def test_switch_is_asked_for(bench: StartBench) -> None:
    b = await (await bench(settings={"pilot_switch": PilotSwitch(channel=7)})).connected()
    number = float(b.peer.dialect.message("RC_CHANNELS").id)
    await b.peer.until(lambda: any(t.fields["param1"] == number for t in b.peer.commands(511)), "RC_CHANNELS asked for")

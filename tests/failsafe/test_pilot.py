"""The pilot wins: by a mode, by a switch, by disarming; so does the autopilot's own failsafe."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from tests.failsafe.conftest import PATIENT, agent, another, moves, nothing_more, stops
from tests.services.conftest import GUIDED, LAND, LOITER, SET_MODE, Bench, StartBench
from zmav.config import Failsafe, PilotSwitch
from zmav.errors import NotHolder, Refused
from zmav.services.authority.stream import ActiveStream

RTL, BRAKE, POSCTL, OFFBOARD = 6, 17, 3 << 16, 6 << 16
HOLD, LANDS, MISSION = 4 << 16 | 3 << 24, 4 << 16 | 6 << 24, 4 << 16 | 4 << 24


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
    # Anyone who asks again may have it again.
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


@pytest.mark.parametrize("again", [False, True])
async def test_a_hold_that_px4_shows_after_a_landing_was_ordered_is_nobody_s_wish(
    bench: StartBench, again: bool
) -> None:
    """A segment ends, its hold is asked for, and a landing ordered before PX4 shows that hold: once LAND came, another
    hold is the pilot's."""
    b = await bench(autopilot=12, settings={"failsafe": Failsafe(hold_after=0.3, land_after="never")})
    alice = await agent(b, mode=OFFBOARD)
    await alice.fly()
    b.peer.obedient = False
    await b.peer.until(lambda: modes_asked(b)[-1:] == [HOLD], "the hold after the stream")
    landing = asyncio.create_task(b.ground.do("land", lease=alice.token, wait=20.0))
    await b.peer.until(lambda: modes_asked(b)[-1:] == [LANDS], "the landing")
    for mode in (HOLD, LANDS, HOLD) if again else (HOLD, LANDS):
        b.peer.mode = mode
        b.peer.heartbeat()
        shown = {HOLD: "HOLD", LANDS: "LAND"}[mode]
        await b.state(_shows(shown), shown)
    if again:
        with pytest.raises(Refused, match="taken over: the mode is now HOLD"):
            await landing
        return
    b.peer.armed = False
    b.peer.heartbeat()
    assert (await landing).result == {"armed": False}
    assert [e for e in b.events.objects() if e["kind"] == "pilot"] == []


async def test_a_mode_that_was_shown_and_left_is_the_pilot_s_if_it_comes_again(bench: StartBench) -> None:
    """A mission ends in HOLD by itself, and a hold is ordered, which it shows already: MISSION again is his wish."""
    b = await bench(autopilot=12, settings={"failsafe": PATIENT})
    alice = await agent(b, mode=HOLD)
    b.vehicle.commander.ordered = "MISSION"
    for mode, shown in ((MISSION, "MISSION"), (HOLD, "HOLD")):
        b.peer.mode = mode
        b.peer.heartbeat()
        await b.state(_shows(shown), shown)
    await b.ground.do("hold", lease=alice.token)
    b.peer.mode = MISSION
    b.peer.heartbeat()
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert (end["reason"], "the mode is now MISSION" in end["text"]) == ("pilot", True)


async def test_an_overtaken_mode_that_stays_is_somebody_s_wish(bench: StartBench) -> None:
    """OFFBOARD is asked for, a hold ordered before it is shown, and then OFFBOARD is shown, and nothing after it."""
    b = await bench(autopilot=12, settings={"failsafe": PATIENT})
    alice = await agent(b, mode=HOLD)
    b.vehicle.commander.ordered = "OFFBOARD"
    await b.ground.do("hold", lease=alice.token)
    b.peer.mode = OFFBOARD
    b.peer.heartbeat()
    await b.state(_shows("OFFBOARD"), "OFFBOARD")
    assert [e for e in b.events.objects() if e["kind"] == "pilot"] == []
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert "the mode is still OFFBOARD, and HOLD was ordered here since" in end["text"]


def _shows(mode: str) -> Callable[[dict[str, Any]], bool]:
    return lambda state: state["mode"] == mode


def modes_asked(b: Bench) -> list[int]:
    return [int(t.fields["param2"]) << 16 | int(t.fields["param3"]) << 24 for t in b.peer.commands(SET_MODE)]


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


async def test_a_mode_that_is_granted_after_the_switch_was_turned_is_left_again(bench: StartBench) -> None:
    """The autopilot would wait there for a stream that nobody sends."""
    b = await bench(settings={"failsafe": PATIENT, "pilot_switch": PilotSwitch(channel=7)})
    b.peer.mute = {SET_MODE}
    alice = await agent(b, mode=LOITER)
    alice.put()
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "GUIDED asked for")
    switch(b, 1900)
    await b.state(lambda s: s["pilot"], "the pilot")
    b.peer.mute = set()
    b.peer.mode = GUIDED
    b.peer.heartbeat()
    await b.peer.until(lambda: b.peer.mode == BRAKE, "BRAKE")
    # Entered later, it is the pilot's own wish.
    b.vehicle.authority._asked -= 60.0
    asked = len(b.peer.commands(SET_MODE))
    b.peer.mode = GUIDED
    b.peer.heartbeat()
    await b.state(lambda s: s["mode"] == "GUIDED", "GUIDED")
    await nothing_more(b)
    assert len(b.peer.commands(SET_MODE)) == asked


async def test_switch_is_asked_for(bench: StartBench) -> None:
    b = await (await bench(settings={"pilot_switch": PilotSwitch(channel=7)})).connected()
    number = float(b.peer.dialect.message("RC_CHANNELS").id)
    await b.peer.until(lambda: any(t.fields["param1"] == number for t in b.peer.commands(511)), "RC_CHANNELS asked for")


async def test_switch_unheard_is_not_the_switch_put_back(bench: StartBench) -> None:
    """A radio that is lost says nothing of the switch: the pilot may still mean to have it."""
    b = await (await bench(settings={"pilot_switch": PilotSwitch(channel=7)})).connected()
    switch(b, 1900)
    await b.state(lambda s: s["pilot"], "the pilot")
    for silent in (0, 65535):
        switch(b, silent)
    await b.state(lambda s: True, "a moment")
    await b.state(lambda s: s["pilot"], "the pilot still")
    with pytest.raises(Refused, match="the pilot has it"):
        await b.ground.do("lease", holder="bob")


async def test_mode_change_soon_after_a_command_that_changes_none(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await b.ground.do("command", command="DO_CHANGE_SPEED", params={"param2": 5.0}, lease=alice.token)
    await alice.fly()
    b.peer.mode = LOITER
    b.peer.heartbeat()
    await b.state(lambda s: s["mode"] == "LOITER", "LOITER")
    alice.put()
    await released(b, "the mode is now LOITER")
    assert b.peer.mode == LOITER


async def test_a_mode_that_was_ordered_before_the_pilot_took_over_is_no_order_any_more(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await b.ground.do("set_mode", mode="LOITER", lease=alice.token)
    b.peer.mode = 0
    b.peer.heartbeat()
    await released(b, "the mode is now STABILIZE")
    await another(b, "bob")
    b.peer.mode = LOITER
    b.peer.heartbeat()
    await released(b, "the mode is now LOITER")


async def test_nothing_is_asked_for_between_the_pilot_s_mode_and_the_release(
    bench: StartBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The watchdog's thread may run while the event loop is about to let go."""
    b = await bench(settings={"failsafe": Failsafe(hold_after=0.2, land_after="never")})
    alice = await agent(b)
    await alice.fly()
    await b.state(lambda s: s["setpoints"].get("held"), "hold")
    authority, allowed = b.vehicle.authority, list[bool]()
    take = authority.taken

    def taken(text: str) -> ActiveStream | None:
        allowed.append(authority.pilot.allowed("LOITER"))
        return take(text)

    monkeypatch.setattr(authority, "taken", taken)
    b.peer.mode = LOITER
    b.peer.heartbeat()
    await b.state(lambda s: s["lease"] is None, "no lease")
    assert allowed == [False]


async def test_a_command_is_not_repeated_once_the_pilot_has_it(bench: StartBench) -> None:
    """Its acknowledgement was lost; said again it would take the vehicle back."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    b.peer.mute = {SET_MODE}
    args = {"Mode": 1, "Custom Mode": 5}
    order = asyncio.create_task(b.ground.do("command", command="DO_SET_MODE", params=args, lease=alice.token))
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "LOITER asked for")
    b.peer.mode = 0
    b.peer.heartbeat()
    with pytest.raises(Refused, match="taken over"):
        await order
    assert len(b.peer.commands(SET_MODE)) == 1


async def test_an_order_that_replaces_a_mode_change_is_not_taken_for_the_pilot(bench: StartBench) -> None:
    b = await bench()
    alice = await agent(b)
    b.peer.mute = {SET_MODE}
    first = asyncio.create_task(b.ground.do("set_mode", mode="LOITER", lease=alice.token))
    await b.peer.until(lambda: bool(b.peer.commands(SET_MODE)), "LOITER asked for")
    landing = asyncio.create_task(b.ground.do("land", lease=alice.token))
    with pytest.raises(Refused, match="superseded"):
        await first
    b.peer.mute = set()
    await b.state(lambda s: s["mode"] == "LAND", "LAND")
    b.peer.armed = False
    assert (await landing).status == "done"
    assert not [e for e in b.events.objects() if e["kind"] == "pilot"]


@pytest.mark.parametrize("after", ["arrival", "takeover"])
async def test_a_goto_by_command_from_another_mode(bench: StartBench, after: str) -> None:
    """It changes the mode by itself, which HEARTBEAT shows up to a second later; from then on a mode is the pilot's."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b, mode=LOITER)
    b.peer.beating = False
    here = {"lat": -350000000, "lon": 1490000000, "alt": 600000, "relative_alt": 10000}
    place = {"frame": "global", "lat_deg": -35.001, "lon_deg": 149.0, "alt_rel": 10.0}
    b.peer.send("GLOBAL_POSITION_INT", **here)
    await b.state(lambda s: s["position"] is not None, "its position")
    order = asyncio.create_task(b.ground.do("goto", speed=5.0, lease=alice.token, **place))
    await b.peer.until(lambda: bool(b.peer.heard("COMMAND_INT", command=192)), "DO_REPOSITION")
    b.peer.mode = GUIDED
    for _ in range(3):
        b.peer.send("GLOBAL_POSITION_INT", **here)
        await b.state(lambda s: True, "a moment")
    b.peer.beating = True
    await b.state(lambda s: s["mode"] == "GUIDED", "GUIDED")
    b.peer.send("GLOBAL_POSITION_INT", **here)
    await b.state(lambda s: True, "a moment")
    if after == "arrival":
        b.peer.send("GLOBAL_POSITION_INT", **{**here, "lat": -350010000})
        await b.state(lambda s: True, "a moment")
        b.peer.send("GLOBAL_POSITION_INT", **{**here, "lat": -350010000})
        assert (await order).status == "done"
    else:
        b.peer.mode = LOITER
        b.peer.heartbeat()
        with pytest.raises(Refused, match="taken over"):
            await order
        await released(b, "the mode is now LOITER")


async def test_his_switch_is_read_whatever_else_has_read_the_radio(bench: StartBench) -> None:
    """What looks at a place reads the gimbal's channels for a while, and then no more."""
    b = await (await bench(settings={"pilot_switch": PilotSwitch(channel=7)})).connected()
    rates = b.vehicle.rates
    for hz in (5.0, 0.0):
        rates.need("RC_CHANNELS", hz)
        wanted = {row.name: row.wanted_hz for row in rates.table().messages}
        assert wanted["RC_CHANNELS"] == 10.0

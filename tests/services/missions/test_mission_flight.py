"""Missions are begun, watched to their end, superseded, and taken over by the pilot."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.services.conftest import ARM, SET_MODE, Bench
from tests.services.missions.mission_peer import MISSION, MissionBench, MissionPeer, raw, waypoints
from zmav import keys
from zmav.errors import BadInput, Refused, TimedOut
from zmav.services.authority.control import Mover

START, SET_CURRENT = 300, 224
AUTO, LOITER, RTL, LAND = 3, 5, 6, 9
PX4_MISSION, PX4_HOLD = 4 << 16 | 4 << 24, 4 << 16 | 3 << 24
ACCEPTED, UNSUPPORTED, FAILED = 0, 3, 4
PLACELESS = {
    "frame": 2,
    "autocontinue": 1,
    "param1": 0.0,
    "param2": 0.0,
    "param3": 0.0,
    "param4": 0.0,
    "x": 0,
    "y": 0,
    "z": 0.0,
}


def item(command: int, **more: Any) -> dict[str, Any]:
    return {**PLACELESS, "command": command, **more}


async def ready(b: Bench, peer: MissionPeer, *tail: dict[str, Any]) -> None:
    """Armed, with a mission of three waypoints and what comes behind them."""
    peer.load(MISSION, [*raw(waypoints(3)), *tail])
    peer.armed = True
    await b.state(lambda s: s["armed"], "armed")


class Fly:
    """``mission_start`` under way, its progress asked for by its id."""

    def __init__(self, b: Bench, **args: Any) -> None:
        self.b, self.args = b, {"id": "fly", "wait": 0.0, "wait_end": True, **args}

    async def ask(self) -> dict[str, Any]:
        """How far it is; raises how it ended."""
        outcome = await self.b.ground.do("mission_start", **self.args)
        return {"status": outcome.status, **outcome.result}

    async def until(self, **wanted: Any) -> dict[str, Any]:
        async def wait() -> dict[str, Any]:
            while True:
                told = await self.ask()
                if wanted.items() <= told.items():
                    return told
                await asyncio.sleep(0.01)

        return await asyncio.wait_for(wait(), 20.0)

    async def begun(self) -> None:
        """The autopilot is in its mission's mode, and is watched."""
        await self.ask()
        rules = self.b.vehicle.identity.autopilot
        assert rules is not None
        await self.b.states.object(lambda s: s["mode"] == rules.missions.mode, "mission mode")


async def test_the_orders_that_begin_a_mission(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    outcome = await b.ground.do("mission_start", first=1)
    assert outcome.result == {"mode": "AUTO", "total": 3}
    orders = [
        t.fields
        for t in peer.told
        if t.name == "COMMAND_LONG" and t.fields["command"] in (START, SET_MODE, SET_CURRENT)
    ]
    assert [(f["command"], f["param1"], f["param2"]) for f in orders] == [
        (SET_CURRENT, 2.0, 0.0),
        (SET_MODE, 1.0, float(AUTO)),
        (START, 0.0, 0.0),
    ]


async def test_a_rover_needs_no_start(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot", mav_type=10)
    await ready(b, peer)
    await b.ground.do("mission_start")
    assert peer.mode == 10
    assert not peer.commands(START)
    assert peer.commands(SET_CURRENT)[0].fields["param1"] == 1.0


async def test_px4_flies_it_in_mission_mode(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("px4")
    obey = peer.obey

    def px4(number: int, fields: dict[str, Any]) -> None:
        obey(number, fields)
        if number == SET_MODE:
            peer.mode = int(fields["param2"]) << 16 | int(fields["param3"]) << 24

    peer.obey = px4  # type: ignore[method-assign]
    peer.on_mission_set_current = lambda told: peer.say_current(told.fields["seq"])  # type: ignore[attr-defined]
    peer.results[SET_MODE] = [FAILED, ACCEPTED]  # it has not looked at the mission yet
    peer.mode = PX4_HOLD
    await ready(b, peer)
    fly = Fly(b)
    await fly.begun()
    assert peer.mode == PX4_MISSION
    assert peer.heard("MISSION_SET_CURRENT")[0].fields["seq"] == 0
    assert not peer.commands(SET_CURRENT)  # it does not know the command
    await _watched(b)
    peer.send("MISSION_ITEM_REACHED", seq=0)
    assert (await fly.until(reached=0))["status"] == "running"
    peer.send("MISSION_ITEM_REACHED", seq=2)
    assert (await fly.until(status="done"))["reached"] == 2


async def _watched(b: Bench) -> None:
    """The watch over the flight listens."""
    adapter = b.vehicle.adapter
    number = adapter.dialect.message("MISSION_ITEM_REACHED").id

    async def wait() -> None:
        while len(adapter._listeners.get(number, ())) < 2:
            await asyncio.sleep(0.01)

    await asyncio.wait_for(wait(), 20.0)


async def test_progress_and_the_end_by_the_last_item(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer, item(178))  # a change of speed comes last, and is never "reached"
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(1, state=3)
    assert (await fly.until(current=0))["total"] == 4
    peer.send("MISSION_ITEM_REACHED", seq=1)
    peer.say_current(2, state=3)
    assert (await fly.until(current=1, reached=0))["status"] == "running"
    peer.send("MISSION_ITEM_REACHED", seq=3)
    ended = await fly.until(status="done")
    assert (ended["reached"], ended["total"]) == (2, 4)
    got = await b.ground.ask(keys.MISSION.key("demo", "quad1", kind="mission"))
    assert got[0].ok and b'"reached":2' in got[0].ok.payload.to_bytes()


async def test_the_end_by_the_autopilot_s_word(mission_bench: MissionBench) -> None:
    """Where the mission jumps back, only the autopilot knows the end; what it says of the flight before is not it."""
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer, item(177, param1=1.0, param2=2.0))
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(1, state=5)
    peer.send("MISSION_ITEM_REACHED", seq=3)
    assert (await fly.until(reached=2))["status"] == "running"
    peer.say_current(2, state=3)
    await fly.until(current=1)
    peer.say_current(3, state=5)
    await fly.until(status="done", current=2)


@pytest.mark.parametrize(("command", "mode"), [(21, AUTO), (20, AUTO), (20, RTL), (21, LAND)])
async def test_the_end_by_landing(mission_bench: MissionBench, command: int, mode: int) -> None:
    """RTL and LAND are the mission's own, whichever mode the autopilot shows for them."""
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer, item(command))
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(4, state=3)
    await fly.until(current=3)
    peer.mode = mode
    name = {AUTO: "AUTO", RTL: "RTL", LAND: "LAND"}[mode]
    await b.states.object(lambda s: s["mode"] == name, name)
    peer.say_current(1, state=3)  # ArduPilot goes back to the first item when it disarms
    await fly.until(current=0)
    peer.armed = False
    await fly.until(status="done")


async def test_disarmed_on_the_way(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(2, state=3)
    await fly.until(current=1)
    peer.armed = False
    with pytest.raises(Refused, match="it disarmed at item 1 of 3"):
        await fly.until(status="done")


async def test_the_pilot_takes_over(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(1, state=3)
    await fly.until(current=0)
    peer.mode = LOITER
    with pytest.raises(Refused, match="taken over: the mode is now LOITER"):
        await fly.until(status="done")
    assert peer.mode == LOITER


@pytest.mark.parametrize("told", [True, False])
async def test_the_mode_after_the_end_is_no_takeover_if_the_autopilot_says_so(
    mission_bench: MissionBench, told: bool
) -> None:
    """A plane returns by itself when its mission is complete; the word for that may come after the mode."""
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    peer.say_current(3, state=3)
    await fly.until(current=2)
    peer.mode = RTL
    await b.states.object(lambda s: s["mode"] == "RTL", "RTL")
    if told:
        peer.say_current(3, state=5)
        await fly.until(status="done")
    else:
        with pytest.raises(Refused, match="taken over: the mode is now RTL"):
            await fly.until(status="done")


async def test_a_later_order_supersedes_it(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    fly = Fly(b)
    await fly.begun()
    await _watched(b)
    await b.ground.do("set_mode", mode="LOITER")
    with pytest.raises(Refused, match="superseded"):
        await fly.until(status="done")
    assert not b.vehicle.authority.control.claimed(Mover.ORDER)


async def test_a_later_order_is_not_ended_by_one_that_was_judged_meanwhile(mission_bench: MissionBench) -> None:
    """To judge a mission it is read first, which takes its time: who orders otherwise meanwhile has the last word."""
    b, peer = await mission_bench("ardupilot")
    await ready(b, peer)
    answer, peer.on_mission_request_list = peer.on_mission_request_list, lambda told: None  # type: ignore[method-assign]
    start = asyncio.create_task(b.ground.do("mission_start"))
    await peer.count("MISSION_REQUEST_LIST", 1)
    await b.ground.do("set_mode", mode="LOITER")
    peer.on_mission_request_list = answer  # type: ignore[method-assign]
    with pytest.raises(Refused, match="mission_start was overtaken"):
        await start
    assert peer.mode == LOITER


async def test_what_cannot_be_begun(mission_bench: MissionBench) -> None:
    b, peer = await mission_bench("ardupilot")
    with pytest.raises(Refused, match="disarmed: arm it first"):
        await b.ground.do("mission_start")
    peer.armed = True
    await b.state(lambda s: s["armed"], "armed")
    with pytest.raises(Refused, match="no mission on the autopilot: upload one"):
        await b.ground.do("mission_start")
    await b.ground.do("mission_upload", items=waypoints(3))
    with pytest.raises(BadInput, match="no item 3: the mission has 3, from 0 to 2") as caught:
        await b.ground.do("mission_start", first=3)
    assert caught.value.detail["field"] == "first"
    with pytest.raises(BadInput, match="no item -1"):
        await b.ground.do("mission_current", index=-1)
    peer.results[START] = [FAILED]
    with pytest.raises(Refused, match="MAV_CMD_MISSION_START refused: FAILED"):
        await b.ground.do("mission_start")
    assert not peer.commands(ARM)


@pytest.mark.parametrize("hears", [True, False])
async def test_the_item_is_set_by_message_where_the_command_is_unknown(
    mission_bench: MissionBench,
    hears: bool,
) -> None:
    b, peer = await mission_bench("ardupilot")
    b.vehicle.mission_flight.set_timeout = 0.3
    peer.results[SET_CURRENT] = [UNSUPPORTED]
    peer.load(MISSION, raw(waypoints(3)))
    if hears:
        peer.on_mission_set_current = lambda told: peer.say_current(told.fields["seq"])  # type: ignore[attr-defined]
        outcome = await b.ground.do("mission_current", index=2)
        assert outcome.result == {"current": 2, "total": 3}
    else:
        with pytest.raises(TimedOut, match="does not go to item 3 \\(as it counts\\)"):
            await b.ground.do("mission_current", index=2)
    assert peer.heard("MISSION_SET_CURRENT")[0].fields["seq"] == 3

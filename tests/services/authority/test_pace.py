"""Setpoints that are commands: given when they change, and again only after a while."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.autopilots import Target, autopilot_for
from zmav.services.authority.stream import REPEAT_AFTER, CommandRepeats

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench

SERVO, REPOSITION = 183, 192
DENIED = 2
PLANE_GUIDED = 15


def due(pace: CommandRepeats, target: Target, at: float, mav_type: int = 2) -> list[bool]:
    return [pace.due(action, at) for action in autopilot_for(3, mav_type).setpoint(target)]


def test_commands_are_repeated_when_they_change_and_after_a_while() -> None:
    pace, servo = CommandRepeats(), Target(servo=(1500, None, 1600))
    assert due(pace, servo, 0.0) == [True, True]
    assert due(pace, servo, 0.5) == [False, False]
    assert due(pace, Target(servo=(1500, None, 1700)), 0.6) == [False, True]
    assert due(pace, servo, REPEAT_AFTER) == [True, True]
    pace.reset()
    assert due(pace, servo, REPEAT_AFTER) == [True, True]
    for at in (0.0, 0.01, 0.02):
        assert due(pace, Target(vel=(1.0, 0.0, 0.0)), at) == [True]


def test_what_begins_again_is_not_given_sooner_though_it_changes() -> None:
    pace = CommandRepeats()
    assert due(pace, Target(1.0, 2.0, alt_rel=50.0), 0.0, mav_type=1) == [True]
    assert due(pace, Target(1.0, 2.1, alt_rel=50.0), 0.9, mav_type=1) == [False]
    assert due(pace, Target(1.0, 2.1, alt_rel=50.0), 1.0, mav_type=1) == [True]


class Agent:
    """One with the lease, who puts setpoints."""

    def __init__(self, b: Bench, token: str) -> None:
        self.b, self.token, self.seq = b, token, 0

    def put(self, **fields: Any) -> None:
        self.seq += 1
        point = wire.Setpoint(lease=self.token, seq=self.seq, deadline=time.time() + 2.0, **fields)
        self.b.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")


async def agent(b: Bench, mode: int) -> Agent:
    await b.connected()
    b.peer.mode, b.peer.armed = mode, True
    await b.state(lambda s: s["armed"], "arming")
    return Agent(b, (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"])


async def test_a_plane_is_told_once_where_to_circle(bench: StartBench) -> None:
    b = await bench(mav_type=1)
    b.peer.place = (-35.0, 149.0)
    alice = await agent(b, PLANE_GUIDED)
    await b.state(lambda s: s["position"], "its position")
    there = {"frame": "global", "lat_deg": -35.0, "lon_deg": 149.0, "alt_rel": 50.0}
    for _ in range(10):
        alice.put(**there)
    await b.state(lambda s: s["setpoints"].get("flown") == 10, "ten setpoints")
    heard = b.peer.heard("COMMAND_INT", command=REPOSITION)
    told = heard[0]
    assert len(heard) <= 2.0 + (heard[-1].at - told.at) / REPEAT_AFTER
    assert (told.fields["x"], told.fields["y"], told.fields["z"]) == (-350000000, 1490000000, 50.0)
    assert told.fields["param2"] == 0.0, "it never changes the mode"


@pytest.mark.parametrize("result", [0, DENIED])
async def test_a_servo_that_the_autopilot_refuses_is_counted_and_said(bench: StartBench, result: int) -> None:
    b = await bench()
    alice = await agent(b, 0)
    b.peer.results = {SERVO: [result]}
    alice.put(servo=[None, 1500])
    await b.peer.until(lambda: b.peer.commands(SERVO) != [], "DO_SET_SERVO")
    if result:
        said = await b.event("servo setpoint: MAV_CMD_DO_SET_SERVO refused: DENIED", kind="setpoint")
        assert said["detail"]["why"] == "refused"
        await b.state(lambda s: s["setpoints"].get("refused") == 1, "the count")
    else:
        state = await b.state(lambda s: s["setpoints"].get("flown") == 1, "the count")
        assert "refused" not in state["setpoints"]


async def test_a_level_that_a_parameter_forbids_is_not_sent(bench: StartBench) -> None:
    b = await bench(sysid=7)
    alice = await agent(b, 0)
    b.peer.send("PARAM_VALUE", param_id="MAV_GCS_SYSID", param_value=255.0, param_type=6, param_count=1, param_index=0)
    while b.vehicle.params.get("MAV_GCS_SYSID") is None:
        await b.state(lambda s: True, "a state")
    alice.put(manual=wire.ManualControl())
    await b.event("set MAV_GCS_SYSID to 7 (it is 255)", kind="setpoint")
    await b.state(lambda s: s["setpoints"] == {"parameter": 1}, "the count")
    assert b.peer.heard("MANUAL_CONTROL") == []
    b.peer.send("PARAM_VALUE", param_id="MAV_GCS_SYSID", param_value=7.0, param_type=6, param_count=1, param_index=0)
    while b.peer.heard("MANUAL_CONTROL") == []:
        alice.put(manual=wire.ManualControl(x=0.5))
        await b.state(lambda s: True, "a state")
    assert b.peer.heard("MANUAL_CONTROL")[0].fields["x"] == 500

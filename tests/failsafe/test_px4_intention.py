"""PX4 keeps the mode it was last asked for as its intention: OFFBOARD comes back with the next setpoint, a mission that
was flown takes off when it is armed, and sticks that end are a lost pilot. CURRENT_MODE tells, where it comes.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any

import pytest

from tests.failsafe.conftest import LOCAL, PATIENT, Agent, Px4Peer, agent, another, nothing_more
from tests.services.conftest import ARM, SET_INTERVAL, SET_MODE, Bench, StartBench, Told
from zmav import keys, wire
from zmav.config import Failsafe
from zmav.errors import Refused, ZmavError
from zmav.verbs import VERBS

if TYPE_CHECKING:
    from tests.conftest import StartOnboard

HOLD, MISSION, TAKEOFF, POSCTL, OFFBOARD = 4 << 16 | 3 << 24, 4 << 16 | 4 << 24, 4 << 16 | 2 << 24, 3 << 16, 6 << 16
RTL, LAND = 4 << 16 | 5 << 24, 4 << 16 | 6 << 24
ON_GROUND, IN_THE_AIR, ACTIVE, CRITICAL = 1, 2, 4, 5


class Intending(Px4Peer):
    """A PX4 in flight, that goes back to the mode intended as soon as setpoints come."""

    def __init__(self, *, tells: bool) -> None:
        super().__init__()
        self.tells, self.intended, self.status, self.landed_state = tells, HOLD, ACTIVE, IN_THE_AIR
        self.on_told = self._on_told

    def _on_told(self, told: Told) -> None:
        if told.name == LOCAL and self.intended == OFFBOARD and self.mode != OFFBOARD:
            self.mode = OFFBOARD
            self.heartbeat()

    def obey(self, number: int, fields: dict[str, Any]) -> None:
        super().obey(number, fields)
        if number == SET_MODE:
            self.intended = self.mode

    def heartbeat(self) -> None:
        self.send("EXTENDED_SYS_STATE", landed_state=self.landed_state)
        self.heartbeat_alone()
        if self.tells:
            self.current_mode()

    def heartbeat_alone(self) -> None:
        self.send(
            "HEARTBEAT",
            type=2,
            autopilot=12,
            base_mode=1 | 128 * self.armed,
            custom_mode=self.mode,
            system_status=self.status,
        )

    def current_mode(self) -> None:
        self.send("CURRENT_MODE", standard_mode=0, custom_mode=self.mode, intended_custom_mode=self.intended)

    def modes(self) -> list[int]:
        """The modes it was asked for."""
        return [int(t.fields["param2"]) << 16 | int(t.fields["param3"]) << 24 for t in self.commands(SET_MODE)]


@pytest.fixture(params=[True, False], ids=["CURRENT_MODE", "HEARTBEAT alone"])
async def intending(request: pytest.FixtureRequest) -> AsyncIterator[Intending]:
    one = Intending(tells=request.param)
    await one.open()
    yield one
    await one.close()


async def ready(b: Bench) -> None:
    b.peer.send("SYS_STATUS", onboard_control_sensors_health=0x10000000)
    await b.state(lambda s: s["ready"], "ready")


async def streaming(bench: StartBench, intending: Intending) -> tuple[Bench, Agent]:
    """One that flies by a stream in OFFBOARD, and intends that; and whose stream it is."""
    b = await bench(intending, settings={"failsafe": PATIENT})
    intending.intended = OFFBOARD
    alice = await agent(b, mode=OFFBOARD)
    await alice.fly()
    return b, alice


async def test_after_a_lost_stream_the_next_lease_flies(bench: StartBench, intending: Intending) -> None:
    b, _ = await streaming(bench, intending)
    intending.mode = HOLD  # COM_OBL_RC_ACT 5
    intending.heartbeat()
    await b.state(lambda s: s["lease"] is None, "no lease")
    if intending.tells:  # the hold becomes its intention
        await intending.until(lambda: intending.intended == HOLD, "HOLD")
    bob = await another(b, "bob")
    for _ in range(40):
        bob.put()
        await asyncio.sleep(0.05)
    state = await b.state(lambda s: s["mode"] == "OFFBOARD", "OFFBOARD")
    assert state["lease"] is not None and state["lease"]["holder"] == "bob"
    flown = state["setpoints"].get("flown", 0)
    bob.put()
    await b.state(lambda s: s["setpoints"].get("flown", 0) > flown, "another one flown")


@pytest.mark.parametrize("first", ["the mode", "the lease's end", "an arm"])
async def test_a_lost_stream_becomes_a_hold_whichever_thread_sees_its_end_first(
    bench: StartBench, intending: Intending, first: str
) -> None:
    """The watchdog's lets go as soon as the mode is there; what judges the mode lives on an event loop that is busy. It
    may have something else to do first that ends the stream, too.
    """
    b, alice = await streaming(bench, intending)
    intending.mode = HOLD
    intending.heartbeat()
    time.sleep(0.3)  # several rounds of the watchdog
    if first == "the lease's end":
        b.vehicle.leases.end("revoked", "its operator had enough")
    elif first == "an arm":
        b.vehicle.authority.begin(VERBS["arm"], wire.Arm(lease=alice.token), None)
    await b.state(lambda s: s["lease"] is None, "no lease")
    if intending.tells:
        await intending.until(lambda: intending.intended == HOLD, "HOLD")
    else:
        assert intending.modes() == []


async def test_who_waits_to_order_that_hold_ends_with_the_vehicle_s_program(
    bench: StartBench, intending: Intending, onboard: StartOnboard
) -> None:
    b, _ = await streaming(bench, intending)
    intending.mode = HOLD
    intending.heartbeat()
    await b.state(lambda s: s["lease"] is None, "no lease")
    await onboard.close(b.vehicle)
    assert [task for task in asyncio.all_tasks() if "_hold_lost" in repr(task)] == []


async def test_a_failsafe_that_waits_in_hold_is_not_ended_by_a_hold(bench: StartBench, intending: Intending) -> None:
    """A battery's, just after a takeoff: it goes on to RTL by itself unless somebody changes the mode."""
    b, _ = await streaming(bench, intending)
    if intending.tells:  # else it looks as the takeoff's end
        b.vehicle.authority.pilot.order_begins("takeoff")
    intending.on_told = lambda told: None
    intending.mode, intending.status = HOLD, CRITICAL
    if intending.tells:  # what it intends comes later than the mode, by so much that the mode is judged without it
        intending.beating = False
        intending.heartbeat_alone()
        await b.state(lambda s: s["mode"] == "HOLD" and s["lease"] is not None, "HOLD, and the lease kept")
    intending.heartbeat()
    await b.state(lambda s: s["lease"] is None and s["lease_end"]["reason"] == "pilot", "the lease's end")
    await nothing_more(b)
    intending.beating, intending.mode = True, RTL
    intending.heartbeat()
    await b.state(lambda s: s["mode"] == "RTL", "RTL")
    await nothing_more(b)
    assert intending.modes() == []


@pytest.mark.parametrize("mode", [POSCTL, HOLD], ids=["POSCTL", "HOLD"])
async def test_a_pilot_whose_mode_comes_by_heartbeat_first_keeps_it(
    bench: StartBench, intending: Intending, mode: int
) -> None:
    b, _ = await streaming(bench, intending)
    intending.beating, intending.on_told = False, lambda told: None
    intending.mode = intending.intended = mode
    intending.heartbeat_alone()
    await b.state(lambda s: s["lease"] is None and s["lease_end"]["reason"] == "pilot", "the lease's end")
    told = len(intending.modes())
    intending.heartbeat()
    await nothing_more(b)
    assert len(intending.modes()) == told == 0


async def test_the_end_of_a_climb_by_heartbeat_first_is_no_failsafe(bench: StartBench, intending: Intending) -> None:
    b = await bench(intending, settings={"failsafe": PATIENT})
    intending.intended = TAKEOFF
    await agent(b, mode=TAKEOFF)
    intending.beating = False
    intending.mode = intending.intended = HOLD
    intending.heartbeat_alone()
    state = await b.state(lambda s: s["mode"] == "HOLD", "HOLD")
    assert state["lease"] is not None


@pytest.mark.parametrize(("name", "mode"), [("POSCTL", POSCTL), ("RTL", RTL), ("LAND", LAND)])
async def test_a_mode_is_entered_while_armed_on_the_ground(
    bench: StartBench, intending: Intending, name: str, mode: int
) -> None:
    b = await bench(intending)
    intending.landed_state = ON_GROUND
    alice = await agent(b, mode=HOLD)
    await b.ground.do("set_mode", mode=name, lease=alice.token)
    assert intending.modes() == [mode]


async def test_an_intention_no_longer_told_is_forgotten(bench: StartBench, intending: Intending) -> None:
    b = await bench(intending)
    intending.intended = OFFBOARD
    alice = await agent(b, mode=HOLD)
    intending.tells = False
    identity = b.vehicle.identity
    await b.state(lambda s: identity.intended is None, "no intention")
    await b.ground.do("set_mode", mode="HOLD", lease=alice.token)


async def test_in_the_air_it_is_asked_for_with_the_first_setpoint(bench: StartBench, intending: Intending) -> None:
    b = await bench(intending, settings={"failsafe": PATIENT})
    alice = await agent(b, mode=HOLD)
    alice.put()
    await intending.until(lambda: OFFBOARD in intending.modes(), "OFFBOARD asked for")
    asked = next(k for k, t in enumerate(intending.told) if t.fields.get("command") == SET_MODE)
    assert 1 <= sum(t.name == LOCAL for t in intending.told[:asked]) <= 10  # 20 a second


@pytest.mark.parametrize("mode", [MISSION, TAKEOFF])
async def test_it_is_not_armed_in_a_mode_that_takes_off(bench: StartBench, intending: Intending, mode: int) -> None:
    b = await bench(intending)
    await b.connected()
    intending.mode = intending.intended = mode
    await ready(b)
    await b.ground.do("arm", ready_timeout=10.0)
    assert intending.modes() == [HOLD]
    orders = [t.fields["command"] for t in intending.told if t.fields.get("command") in (SET_MODE, ARM)]
    assert orders == [SET_MODE, ARM]


async def test_it_is_not_armed_while_a_mission_is_intended(bench: StartBench, intending: Intending) -> None:
    b = await bench(intending)
    await b.connected()
    intending.mode, intending.intended = HOLD, MISSION
    await ready(b)
    await b.ground.do("arm", ready_timeout=10.0)
    assert intending.modes() == ([HOLD] if intending.tells else [])


@pytest.mark.parametrize("mode", [MISSION, TAKEOFF])
async def test_a_mode_that_comes_while_it_waits_to_arm_is_left(
    bench: StartBench, intending: Intending, mode: int
) -> None:
    """Each arming is asked for in the mode of that moment, not in the one that was seen before the first."""
    b = await bench(intending)
    await b.connected()
    intending.mode = intending.intended = HOLD
    await ready(b)
    armed_in: list[int] = []

    def on_told(told: Told) -> None:
        if told.fields.get("command") == ARM:
            armed_in.append(intending.mode)
            intending.mode = intending.intended = mode
            intending.heartbeat()

    intending.results[ARM], intending.on_told = [1, 0], on_told
    await b.ground.do("arm", ready_timeout=20.0)
    assert armed_in == [HOLD, HOLD]
    assert intending.modes() == [HOLD]


async def test_a_refused_arming_names_the_ground_station_it_waits_for(bench: StartBench, px4: Px4Peer) -> None:
    b = await bench(px4)
    await b.connected()
    px4.mode = HOLD
    value = struct.unpack("<f", struct.pack("<i", 2))[0]
    px4.send("PARAM_VALUE", param_id="NAV_DLL_ACT", param_value=value, param_type=6, param_count=1, param_index=0)
    await ready(b)
    px4.results[ARM] = [1]
    with pytest.raises(Refused, match=r"hears a ground station.*set NAV_DLL_ACT to 0"):
        await b.ground.do("arm", ready_timeout=0.0)


async def test_rates_that_it_does_not_grant_are_not_asked_for(bench: StartBench, px4: Px4Peer) -> None:
    b = await bench(px4)
    session = b.ground.session
    wanted = ("HEARTBEAT", "MISSION_CURRENT", "ATTITUDE")
    tokens = [
        session.liveliness().declare_token(keys.WANT.key("demo", "quad1", msg=name, hz="10", instance="tester"))
        for name in wanted
    ]
    await b.connected()

    def asked() -> set[float]:
        return {t.fields["param1"] for t in px4.commands(SET_INTERVAL)}

    await px4.until(lambda: {30.0, 436.0} <= asked(), "ATTITUDE and CURRENT_MODE asked for")
    assert not asked() & {0.0, 42.0}
    del tokens


async def test_sticks_fly_in_posctl_and_their_end_is_held(bench: StartBench, intending: Intending) -> None:
    """Once: HOLD that is ordered while a failsafe waits in it (a lost pilot's, a battery's) ends the failsafe."""
    b = await bench(intending, settings={"failsafe": Failsafe(hold_after=0.5, land_after="never")})
    alice = await agent(b, mode=HOLD)
    while POSCTL not in intending.modes():
        alice.put(vel=None, manual={"x": 0.5})
        await asyncio.sleep(0.05)
    await intending.until(lambda: intending.modes()[-1] == HOLD, "HOLD")
    await b.state(lambda s: s["mode"] == "HOLD", "HOLD shown")
    intending.status = CRITICAL
    await b.state(lambda s: s["status"] == "CRITICAL", "CRITICAL")
    await nothing_more(b)


async def test_an_order_that_comes_to_nothing_in_hold_leaves_the_action_to_come(bench: StartBench) -> None:
    """PX4 holds in a mode of its own: what the refused order ended is held again there, and RTL follows."""
    peer = Intending(tells=True)
    await peer.open()
    b = await bench(peer, settings={"failsafe": Failsafe(hold_after=0.2, land_after=3.0, action="rtl")})
    peer.intended = OFFBOARD
    alice = await agent(b, mode=OFFBOARD)
    await alice.fly()
    await b.event("no setpoint for 0.2 s")
    await b.state(lambda s: s["mode"] == "HOLD", "HOLD")
    peer.results[22] = [4]  # MAV_CMD_NAV_TAKEOFF
    with pytest.raises(ZmavError):
        await b.ground.do("takeoff", alt_rel=5.0)
    await peer.until(lambda: peer.mode == RTL, "RTL after all")
    await peer.close()

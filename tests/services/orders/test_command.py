"""Commands beside the autopilot: acknowledged, retried, refused with reasons, in progress, superseded, taken over."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import pytest

from zmav.errors import Refused, Stale, TimedOut, Unsupported
from zmav.mavlink import encode

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench, Told

TAKEOFF, SET_MODE, ARM = 22, 176, 400
ACCEPTED, DENIED, FAILED, IN_PROGRESS = 0, 2, 4, 5
STABILIZE, GUIDED, LOITER, LAND = 0, 4, 5, 9
TARGET = "SET_POSITION_TARGET_GLOBAL_INT"
PLACE = {"lat_deg": -35.0, "lon_deg": 149.0}


def ready(b: Bench) -> None:
    """The autopilot says that it may be armed."""
    b.peer.send("EKF_STATUS_REPORT", flags=0x33F)
    b.peer.send("SYS_STATUS", onboard_control_sensors_health=0x10000000)


def at(b: Bench, alt_rel: float, north: float = 0.0) -> None:
    """The autopilot says where it is: that many metres above PLACE, and north of it."""
    lat, lon, height = PLACE["lat_deg"] + north / 111_320.0, PLACE["lon_deg"], round(alt_rel * 1e3)
    b.peer.send("GLOBAL_POSITION_INT", lat=round(lat * 1e7), lon=round(lon * 1e7), relative_alt=height, alt=height)


async def knows_its_place(b: Bench) -> None:
    """The autopilot says again and again that it is 12 m north of PLACE."""
    b.peer.place = (PLACE["lat_deg"] + 12.0 / 111_320.0, PLACE["lon_deg"])
    await b.state(lambda s: s["position"], "its position")


async def test_what_is_sent(bench: StartBench) -> None:
    b = await (await bench(sysid=12)).connected()
    await b.ground.do("arm", ready_timeout=0)
    (told,) = b.peer.commands(ARM)
    assert told.source == (12, 191)
    f = told.fields
    assert (f["target_system"], f["target_component"], f["confirmation"]) == (12, 1, 0)
    assert [f[f"param{n}"] for n in range(1, 8)] == [1, 0, 0, 0, 0, 0, 0]
    await b.ground.do("set_mode", mode="loiter")
    assert b.peer.mode == LOITER
    await b.ground.do("set_mode", mode="LOITER")  # it is there already
    assert len(b.peer.commands(SET_MODE)) == 1


@pytest.mark.parametrize("lost", [1, 3])
async def test_repeated_until_it_is_acknowledged(bench: StartBench, lost: int) -> None:
    b = await (await bench()).connected()
    answer = b.peer.command

    def lossy(told: Told) -> None:
        if told.fields["command"] != ARM or told.fields["confirmation"] >= lost:
            answer(told)

    b.peer.command = lossy  # type: ignore[method-assign]
    assert (await b.ground.do("arm", ready_timeout=0)).result == {"armed": True}
    assert [t.fields["confirmation"] for t in b.peer.commands(ARM)] == list(range(lost + 1))


async def test_never_acknowledged(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.mute = {ARM}
    with pytest.raises(TimedOut, match="no acknowledgement of MAV_CMD_COMPONENT_ARM_DISARM after 4 attempts"):
        await b.ground.do("arm", ready_timeout=0)
    assert [t.fields["confirmation"] for t in b.peer.commands(ARM)] == [0, 1, 2, 3]


async def test_refused_with_the_autopilot_s_words(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[ARM] = [FAILED]
    answer = b.peer.command

    def grumble(told: Told) -> None:
        if told.fields["command"] == ARM:
            b.peer.send("STATUSTEXT", severity=2, text="Arm: Need Position Estimate")
        answer(told)
        if told.fields["command"] == ARM:
            b.peer.send("STATUSTEXT", severity=2, text="PreArm: Hardware safety switch")

    b.peer.send("STATUSTEXT", severity=6, text="an older word")
    await b.event("an older word")
    b.peer.command = grumble  # type: ignore[method-assign]
    with pytest.raises(Refused) as e:
        await b.ground.do("arm", ready_timeout=0)
    assert e.value.message == (
        "MAV_CMD_COMPONENT_ARM_DISARM refused: FAILED (Arm: Need Position Estimate; PreArm: Hardware safety switch)"
    )
    assert e.value.detail["reasons"] == ["Arm: Need Position Estimate", "PreArm: Hardware safety switch"]
    assert e.value.detail["result"] == "MAV_RESULT_FAILED"
    assert len(b.peer.commands(ARM)) == 1


async def test_an_arming_is_asked_for_again_while_there_is_time(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[ARM] = [FAILED, ACCEPTED]
    ready(b)
    assert (await b.ground.do("arm")).result == {"armed": True}
    assert len(b.peer.commands(ARM)) == 2


@pytest.mark.parametrize(
    ("mav_type", "mode", "guided"),
    [(1, 10, 15), (1, 13, 15), (10, 10, 4), (10, 6, 4), (2, 3, 4)],
    ids=["plane AUTO", "plane TAKEOFF", "rover AUTO", "rover FOLLOW", "copter AUTO"],
)
async def test_it_is_not_armed_in_a_mode_that_sets_off(
    bench: StartBench, mav_type: int, mode: int, guided: int
) -> None:
    b = await (await bench(mav_type=mav_type)).connected()
    b.peer.mode = mode
    await b.ground.do("arm", ready_timeout=0)
    orders = [
        (t.fields["command"], t.fields["param2"]) for t in b.peer.told if t.fields.get("command") in (SET_MODE, ARM)
    ]
    assert orders == [(SET_MODE, guided), (ARM, 0)]


async def test_in_progress_is_waited_for(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.vehicle.commander.ack_timeout = 0.2
    b.peer.results[ARM] = [IN_PROGRESS]
    asked = asyncio.create_task(b.ground.do("arm", ready_timeout=0))
    await b.peer.until(lambda: bool(b.peer.commands(ARM)), "command")
    for _ in range(3):
        await b.state(lambda s: True, "a moment")
        b.peer.acknowledge(ARM, IN_PROGRESS)
    b.peer.armed = True
    b.peer.acknowledge(ARM, ACCEPTED)
    assert (await asked).result == {"armed": True}
    assert len(b.peer.commands(ARM)) == 1


async def test_in_progress_that_never_ends(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.vehicle.commander.in_progress_timeout = 0.2
    b.peer.results[ARM] = [IN_PROGRESS]
    with pytest.raises(TimedOut, match="no acknowledgement"):
        await b.ground.do("arm", ready_timeout=0)


async def test_answers_to_others_and_to_other_commands_do_not_count(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.mute = {ARM}
    asked = asyncio.create_task(b.ground.do("arm", ready_timeout=0))
    await b.peer.until(lambda: bool(b.peer.commands(ARM)), "command")
    b.peer.acknowledge(ARM, DENIED, to=(255, 190))
    b.peer.acknowledge(ARM, DENIED, to=(1, 190))
    b.peer.acknowledge(SET_MODE, DENIED)
    b.peer.raw(encode(b.peer.dialect, "COMMAND_ACK", {"command": ARM, "result": DENIED}, sysid=2, compid=1))
    b.peer.armed = True
    b.peer.acknowledge(ARM, ACCEPTED, to=(1, 191))
    assert (await asked).status == "done"


async def test_an_acknowledgement_that_does_not_come_true(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.vehicle.commander.confirm_timeout = 0.3
    b.peer.obedient = False
    for verb, args, words in (
        ("arm", {"ready_timeout": 0}, "armed, but HEARTBEAT does not show it"),
        ("set_mode", {"mode": "GUIDED"}, "mode GUIDED was acknowledged, but does not come"),
    ):
        with pytest.raises(TimedOut, match=words):
            await b.ground.do(verb, **args)


async def test_takeoff(bench: StartBench) -> None:
    b = await (await bench()).connected()
    with pytest.raises(Refused, match="disarmed: arm it first"):
        await b.ground.do("takeoff", alt_rel=5)
    b.peer.armed = True
    await b.state(lambda s: s["armed"], "arming")
    asked = asyncio.create_task(b.ground.do("takeoff", alt_rel=5))
    await b.peer.until(lambda: bool(b.peer.commands(TAKEOFF)), "takeoff command")
    assert b.peer.commands(TAKEOFF)[0].fields["param7"] == 5
    assert b.peer.mode == GUIDED
    for _ in range(2):
        at(b, 4.6)  # not yet: the last 0.3 m are as good as there
        await b.state(lambda s: True, "a moment")
    assert not asked.done()
    while not asked.done():
        at(b, 4.8)
        await b.state(lambda s: True, "a moment")
    assert (await asked).result == {"alt_rel": 4.8}


@pytest.mark.parametrize(
    ("change", "words"),
    [({"mode": LOITER}, "taken over: the mode is now LOITER"), ({"armed": False}, "it was disarmed")],
    ids=["pilot", "disarmed"],
)
async def test_a_takeoff_ends_with_what_ends_it(bench: StartBench, change: dict[str, Any], words: str) -> None:
    b = await (await (await bench()).connected()).flying()
    asked = asyncio.create_task(b.ground.do("takeoff", alt_rel=5))
    await b.peer.until(lambda: bool(b.peer.commands(TAKEOFF)), "takeoff command")
    for name, value in change.items():
        setattr(b.peer, name, value)
    while not asked.done():
        at(b, 1.0)
        await b.state(lambda s: True, "a moment")
    with pytest.raises(Refused, match=words):
        await asked


async def test_goto_repeats_its_target_and_arrives(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    await knows_its_place(b)
    asked = asyncio.create_task(b.ground.do("goto", frame="global", alt_rel=10.0, tolerance=2.0, **PLACE))
    await b.peer.count(TARGET, 1)
    while len(b.peer.heard(TARGET)) < 2:  # a target has no acknowledgement: it is said again
        at(b, 10.0, north=12.0)  # near enough to be told the place itself
        await b.state(lambda s: True, "a moment")
    told = b.peer.heard(TARGET)[-1].fields
    assert (told["lat_int"], told["lon_int"], told["alt"]) == (-350000000, 1490000000, 10.0)
    assert (told["coordinate_frame"], told["type_mask"]) == (6, 0b1101_1111_1000)
    at(b, 8.5, north=1.0)
    assert (await asked).result["away"] == pytest.approx(1.8, abs=0.01)


async def test_goto_ends_when_the_pilot_takes_over(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    await knows_its_place(b)
    asked = asyncio.create_task(b.ground.do("goto", frame="global", alt_rel=10.0, **PLACE))
    await b.peer.count(TARGET, 1)
    b.peer.mode = LOITER
    await b.state(lambda s: s["mode"] == "LOITER", "the pilot's mode")
    sent = len(b.peer.heard(TARGET))
    at(b, 10.0, north=50.0)
    with pytest.raises(Refused, match="taken over: the mode is now LOITER"):
        await asked
    assert len(b.peer.heard(TARGET)) == sent
    assert b.peer.commands(SET_MODE) == []


async def test_an_autopilot_that_falls_silent_ends_the_order(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    await knows_its_place(b)
    asked = asyncio.create_task(b.ground.do("goto", frame="global", alt_rel=10.0, **PLACE))
    await b.peer.count(TARGET, 1)
    b.peer.beating = False
    with pytest.raises(Stale, match="the autopilot is silent"):
        await asked


async def test_a_later_order_ends_an_earlier_one(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    await knows_its_place(b)
    asked = asyncio.create_task(b.ground.do("goto", frame="global", alt_rel=10.0, **PLACE))
    await b.peer.count(TARGET, 1)
    assert (await b.ground.do("hold")).result == {"mode": "GUIDED"}
    with pytest.raises(Refused, match="goto was superseded by a later order"):
        await asked
    stop, *_ = b.peer.heard("SET_POSITION_TARGET_LOCAL_NED")
    assert (stop.fields["vx"], stop.fields["vy"], stop.fields["vz"]) == (0, 0, 0)
    assert stop.fields["type_mask"] == 0b1101_1100_0111


async def test_land_ends_with_disarming_or_with_the_pilot(bench: StartBench) -> None:
    b = await (await (await bench()).connected()).flying()
    asked = asyncio.create_task(b.ground.do("land"))
    await b.state(lambda s: s["mode"] == "LAND", "LAND")
    b.peer.mode = LOITER
    with pytest.raises(Refused, match="taken over: the mode is now LOITER"):
        await asked
    asked = asyncio.create_task(b.ground.do("land"))
    await b.state(lambda s: s["mode"] == "LAND", "LAND")
    b.peer.armed = False
    assert (await asked).result == {"armed": False}


async def test_disarm_ends_a_waiting_arming(bench: StartBench) -> None:
    b = await (await bench()).connected()
    asked = asyncio.create_task(b.ground.do("arm"))
    await b.state(lambda s: s["mover"] == "order", "the order")
    await b.ground.do("disarm")
    with pytest.raises(Refused, match="arm was superseded"):
        await asked
    ready(b)
    await b.state(lambda s: s["ready"], "readiness")
    assert [t.fields["param1"] for t in b.peer.commands(ARM)] == [0]


async def test_what_a_rover_cannot_do(bench: StartBench) -> None:
    b = await (await bench(mav_type=10)).connected()
    b.peer.armed = True
    await b.state(lambda s: s["kind"] == "rover" and s["armed"], "armed rover")
    for verb, args in (("takeoff", {"alt_rel": 5.0}), ("land", {})):
        with pytest.raises(Unsupported, match=f"{verb} is not something ardupilot does with a rover"):
            await b.ground.do(verb, **args)
    await b.ground.do("hold")
    assert b.peer.mode == 4

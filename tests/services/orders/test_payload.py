"""What a vehicle carries, any command by name, and the orders around them: what is sent, and what is refused."""

from __future__ import annotations

import asyncio
import math
import time
from typing import TYPE_CHECKING, Any

import pytest

from zmav.errors import BadInput, NotHolder, Refused, TimedOut

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench, Told

SPEED, SERVO, REPOSITION, REBOOT, ACTUATOR = 178, 183, 192, 246, 187
ACCEPTED, DENIED, IN_PROGRESS = 0, 2, 5


def params(told: Told) -> list[float]:
    return [told.fields[f"param{n}"] for n in range(1, 8)]


async def one(b: Bench, number: int) -> Told:
    """The one COMMAND_LONG of that number it was told."""
    (told,) = b.peer.commands(number)
    return told


async def test_a_servo(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await b.ground.do("servo", output=9, pwm=1200)
    assert params(await one(b, SERVO))[:2] == [9, 1200]


async def test_a_servo_of_px4_is_an_actuator(bench: StartBench) -> None:
    b = await (await bench(autopilot=12)).connected()
    await b.ground.do("servo", output=2, pwm=1750)
    sent = params(await one(b, ACTUATOR))
    assert sent[1] == 0.5
    assert math.isnan(sent[0]) and math.isnan(sent[5])


CANNOT_BE: list[tuple[str, dict[str, Any], str]] = [
    ("servo", {"output": 0, "pwm": 1500}, "output"),
    ("servo", {"output": 9, "pwm": 0}, "pwm"),
    ("command", {"command": "NONSENSE"}, "command"),
    ("command", {"command": "DO_CHANGE_SPEED", "params": {"Sped": 1}}, "params"),
    ("command", {"command": "DO_REPOSITION", "params": {"param5": 300.0}, "frame": "GLOBAL"}, "params"),
    ("command", {"command": "DO_REPOSITION", "frame": "MARS"}, "MAV_FRAME"),
    ("goto", {"frame": "global", "lat_deg": 1.0, "lon_deg": 1.0, "alt_rel": 5.0, "speed": 0.0}, "speed"),
]


async def test_what_cannot_be_is_not_sent(bench: StartBench, subtests: pytest.Subtests) -> None:
    b = await (await bench()).connected()
    b.peer.armed = True
    await b.state(lambda s: s["armed"] is True, "armed")
    before = len([t for t in b.peer.told if t.name.startswith("COMMAND") and t.fields["command"] not in (511, 512)])
    for verb, args, field in CANNOT_BE:
        with subtests.test(verb, **args):
            with pytest.raises(BadInput) as caught:
                await b.ground.do(verb, **args)
            assert caught.value.detail["field"] == field
    told = [t for t in b.peer.told if t.name.startswith("COMMAND") and t.fields["command"] not in (511, 512)]
    assert len(told) == before


async def test_any_command_by_name(bench: StartBench) -> None:
    b = await (await bench()).connected()
    outcome = await b.ground.do(
        "command", command="do_change_speed", params={"Speed": 7.5, "Speed Type": "GROUNDSPEED"}
    )
    assert outcome.result["command"] == "MAV_CMD_DO_CHANGE_SPEED"
    assert params(await one(b, SPEED)) == [1, 7.5, 0, 0, 0, 0, 0]
    b.peer.place = (-35.5, 149.25)
    await b.state(lambda s: s["position"], "its position")
    place = {"Latitude": -35.5, "Longitude": 149.25, "Altitude": 20.0}
    await b.ground.do("command", command="DO_REPOSITION", params=place, frame="GLOBAL_RELATIVE_ALT")
    (told,) = b.peer.heard("COMMAND_INT", command=REPOSITION)
    assert [told.fields[name] for name in "xyz"] == [-355000000, 1492500000, 20.0]
    assert told.fields["frame"] == 3


async def test_progress_is_passed_on(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.results[SPEED] = [IN_PROGRESS]
    asked = asyncio.create_task(b.ground.do("command", id="long", wait=0.1, command="DO_CHANGE_SPEED"))
    await b.peer.until(lambda: bool(b.peer.commands(SPEED)), "the command")
    b.peer.send("COMMAND_ACK", command=SPEED, result=IN_PROGRESS, progress=40)
    outcome = await asked
    while outcome.result.get("progress") != 0.4:
        assert outcome.status == "running"
        outcome = await b.ground.do("command", id="long", wait=0.1, command="DO_CHANGE_SPEED")
    b.peer.send("COMMAND_ACK", command=SPEED, result=ACCEPTED, result_param2=17)
    while outcome.status == "running":
        outcome = await b.ground.do("command", id="long", wait=0.1, command="DO_CHANGE_SPEED")
    assert outcome.result["result_param2"] == 17


async def test_payload_orders_need_the_lease_and_leave_the_stream_alone(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    with pytest.raises(NotHolder, match="planner commands"):
        await b.ground.do("servo", output=9, pwm=1200)
    await b.ground.do("servo", output=9, pwm=1200, lease=lease)
    assert len(b.peer.commands(SERVO)) == 1


async def test_px4_s_second_acknowledgement_refuses_at_once(bench: StartBench) -> None:
    """The receiver says yes, the commander then no: the reason is told, and nobody waits for the heartbeat."""
    b = await (await bench(autopilot=12)).connected()
    answer = b.peer.command

    def two_acks(told: Told) -> None:
        if told.fields["command"] == 176:
            b.peer.acknowledge(176, ACCEPTED, told.source)
            b.peer.acknowledge(176, DENIED, told.source)
        else:
            answer(told)

    b.peer.command = two_acks  # type: ignore[method-assign]
    with pytest.raises(Refused, match="DO_SET_MODE refused: DENIED"):
        await b.ground.do("set_mode", mode="HOLD")


async def test_reboot_waits_for_the_clock_to_begin_again(bench: StartBench) -> None:
    b = await (await bench()).connected()
    begun = time.monotonic_ns() - 100_000_000_000

    def answer_timesync(told: Told) -> None:
        if told.name == "TIMESYNC" and told.fields["tc1"] == 0:
            b.peer.send("TIMESYNC", tc1=time.monotonic_ns() - begun, ts1=told.fields["ts1"])

    b.peer.on_told = answer_timesync
    await b.state(lambda s: s["clock"], "its clock")
    asked = asyncio.create_task(b.ground.do("reboot"))
    await b.peer.until(lambda: bool(b.peer.commands(REBOOT)), "reboot")
    assert params(await one(b, REBOOT))[0] == 1
    begun = time.monotonic_ns() - 1_000_000_000
    assert (await asked).status == "done"

    b.vehicle.flight.reboot_timeout = 0.5
    with pytest.raises(TimedOut, match="has not come back"):
        await b.ground.do("reboot")


async def test_an_armed_vehicle_is_not_restarted(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.armed = True
    await b.state(lambda s: s["armed"] is True, "armed")
    with pytest.raises(Refused, match="it is armed"):
        await b.ground.do("reboot")
    assert b.peer.commands(REBOOT) == []


async def test_rtl_ends_on_the_ground_or_for_a_rover_in_the_mode(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.armed = True
    await b.state(lambda s: s["armed"] is True, "armed")
    asked = asyncio.create_task(b.ground.do("rtl", id="home", wait=0.2))
    await b.peer.until(lambda: b.peer.mode == 6, "RTL")
    assert (await asked).status == "running"
    b.peer.armed = False
    await b.state(lambda s: s["armed"] is False, "disarmed")
    outcome = await b.ground.do("rtl", id="home", wait=0.2)
    assert (outcome.status, outcome.result["armed"]) == ("done", False)


async def test_rtl_of_a_rover(bench: StartBench) -> None:
    b = await (await bench(mav_type=10)).connected()
    b.peer.armed = True
    await b.state(lambda s: s["armed"] is True, "armed")
    outcome = await b.ground.do("rtl")
    assert (b.peer.mode, outcome.result) == (11, {"mode": "RTL", "armed": True})


@pytest.mark.parametrize(("autopilot", "landed_in", "armed_in"), [(3, 9, 4), (12, 6 << 16, 4 << 16 | 3 << 24)])
async def test_a_mode_that_cannot_be_armed_in_is_left_first(
    bench: StartBench, autopilot: int, landed_in: int, armed_in: int
) -> None:
    """A landing leaves ArduCopter in LAND, a lost stream PX4 in OFFBOARD: neither can be armed there."""
    b = await (await bench(autopilot=autopilot)).connected()
    b.peer.mode = landed_in
    await b.state(lambda s: s["mode"] in ("LAND", "OFFBOARD"), "the mode it landed in")
    obey = b.peer.obey

    def obey_px4(number: int, fields: dict[str, Any]) -> None:
        obey(number, fields)
        if number == 176 and autopilot == 12:
            b.peer.mode = int(fields["param2"]) << 16 | int(fields["param3"]) << 24

    b.peer.obey = obey_px4  # type: ignore[method-assign]
    await b.ground.do("arm", ready_timeout=0)
    assert (b.peer.mode, b.peer.armed) == (armed_in, True)


TRIGGER = 206


def triggers(b: Bench) -> list[list[float]]:
    """Distance and whether at once, of each that it was told."""
    return [[told.fields["param1"], told.fields["param3"]] for told in b.peer.commands(TRIGGER)]


async def test_a_camera_is_triggered_by_distance_and_no_more(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await b.ground.do("camera_trigger", distance=7.5)
    await b.ground.do("camera_trigger", distance=0)
    assert triggers(b) == [[7.5, 1.0], [0.0, 0.0]]
    for distance in (-1.0, 0.01, 1e4):
        with pytest.raises(BadInput) as caught:
            await b.ground.do("camera_trigger", distance=distance)
        assert caught.value.detail["field"] == "distance"
    with pytest.raises(BadInput, match="distance"):
        await b.ground.do("camera_trigger")
    b.peer.results[TRIGGER] = [DENIED]
    with pytest.raises(Refused, match="DO_SET_CAM_TRIGG_DIST refused: DENIED"):
        await b.ground.do("camera_trigger", distance=5.0)


@pytest.mark.parametrize("end", ["release", "revoke", "hold"])
async def test_a_camera_that_was_switched_on_under_a_lease_ends_with_it(bench: StartBench, end: str) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    with pytest.raises(NotHolder, match="planner commands"):
        await b.ground.do("camera_trigger", distance=5.0)
    await b.ground.do("camera_trigger", distance=5.0, lease=lease)
    await b.ground.do(end, **({"lease": lease} if end == "release" else {}))
    await b.peer.until(lambda: triggers(b) == [[5.0, 1.0], [0.0, 0.0]], "the end of the pictures")


async def test_a_camera_ends_with_a_lease_that_ran_out(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner", ttl=0.3)).result["lease"]
    await b.ground.do("camera_trigger", distance=5.0, lease=lease)
    await b.peer.until(lambda: triggers(b) == [[5.0, 1.0], [0.0, 0.0]], "the end of the pictures")


async def test_a_camera_switched_on_without_a_lease_goes_on_under_a_later_one(bench: StartBench) -> None:
    b = await (await bench()).connected()
    await b.ground.do("camera_trigger", distance=5.0)
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    await b.ground.do("release", lease=lease)
    await b.ground.do("servo", output=9, pwm=1200)
    assert triggers(b) == [[5.0, 1.0]]


async def test_a_camera_that_could_not_be_stopped_is_told_of(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    await b.ground.do("camera_trigger", distance=5.0, lease=lease)
    b.peer.results[TRIGGER] = [DENIED]
    await b.ground.do("release", lease=lease)
    await b.event("the lease has ended, and the camera could not be stopped", kind="camera")


async def test_a_camera_that_was_not_seen_to_stop_is_stopped_with_its_lease(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    await b.ground.do("camera_trigger", distance=5.0, lease=lease)
    b.peer.results[TRIGGER] = [DENIED]
    with pytest.raises(Refused):
        await b.ground.do("camera_trigger", distance=0, lease=lease)
    del b.peer.results[TRIGGER]
    await b.ground.do("release", lease=lease)
    await b.peer.until(lambda: triggers(b) == [[5.0, 1.0], [0.0, 0.0], [0.0, 0.0]], "the end of the pictures")


async def test_a_camera_is_stopped_when_the_autopilot_answers_again(bench: StartBench) -> None:
    b = await (await bench()).connected()
    lease = (await b.ground.do("lease", holder="planner")).result["lease"]
    await b.ground.do("camera_trigger", distance=5.0, lease=lease)
    b.peer.mute.add(TRIGGER)
    await b.ground.do("release", lease=lease)
    await b.event("it is tried again until the autopilot answers", kind="camera")
    b.peer.mute.clear()
    heard = len(triggers(b))
    await b.peer.until(lambda: triggers(b)[heard:] == [[0.0, 0.0]], "the end of the pictures")
    await b.ground.do("camera_trigger", distance=6.0)
    assert triggers(b)[heard:] == [[0.0, 0.0], [6.0, 1.0]], "nothing stops what was asked for since"

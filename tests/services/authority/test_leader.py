"""The near target: never farther ahead than the vehicle needs, always on the way, and the target itself at the end."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.failsafe.conftest import PATIENT
from zmav import geo, keys, wire
from zmav.autopilots import Target
from zmav.config import Limits
from zmav.errors import Refused
from zmav.services.authority.control import Control, Mover
from zmav.services.authority.leader import AHEAD_M, AHEAD_S, PositionLeader, pursuit, within_reach

if TYPE_CHECKING:
    from tests.services.conftest import StartBench

ORIGIN = wire.Origin(lat_deg=-35.0, lon_deg=149.0, alt_amsl=600.0)
GLOBAL = "SET_POSITION_TARGET_GLOBAL_INT"


def at(north: float = 0.0, east: float = 0.0, up: float = 10.0, v: wire.Vector = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    lat, lon, alt = geo.to_global(ORIGIN, (north, east, -up))
    vx, vy, vz = (round(100 * each) for each in v)
    place = {"lat": round(lat * 1e7), "lon": round(lon * 1e7), "alt": round(alt * 1e3), "relative_alt": round(up * 1e3)}
    return {**place, "vx": vx, "vy": vy, "vz": vz}


def target(north: float, east: float, up: float = 10.0) -> Target:
    lat, lon, alt = geo.to_global(ORIGIN, (north, east, -up))
    return Target(lat, lon, alt)


def ned(target: Target) -> wire.Vector:
    assert target.lat_deg is not None and target.lon_deg is not None and target.alt_amsl is not None
    return geo.to_ned(ORIGIN, target.lat_deg, target.lon_deg, target.alt_amsl)


def test_what_is_near_stays_as_it_is() -> None:
    near = target(10.0, 5.0, 20.0)
    assert within_reach(near, at()) is near
    velocity = Target(vel=(1.0, 0.0, 0.0))
    assert within_reach(velocity, at()) is velocity


@pytest.mark.parametrize("speed", [0.0, 5.0, 12.0])
def test_how_far_ahead(speed: float) -> None:
    north, east, down = ned(within_reach(target(300.0, 400.0), at(v=(0.6 * speed, 0.8 * speed, 0.0))))
    ahead = AHEAD_M + AHEAD_S * speed
    assert (north, east, down) == pytest.approx((0.6 * ahead, 0.8 * ahead, -10.0), abs=0.1)


def test_height_is_led_by_itself() -> None:
    far = within_reach(target(5.0, 0.0, 200.0), at(up=10.0, v=(0.0, 0.0, -2.0)))
    assert ned(far) == pytest.approx((5.0, 0.0, -(10.0 + AHEAD_M + AHEAD_S * 2.0)), abs=0.1)
    relative = within_reach(Target(-35.0, 149.0, alt_rel=1.0), at(up=50.0))
    assert relative.alt_rel == pytest.approx(50.0 - AHEAD_M)
    assert relative.alt_amsl is None


@given(st.floats(-5000, 5000), st.floats(-5000, 5000), st.floats(-20, 20), st.floats(-20, 20))
def test_it_is_on_the_way_and_nearer(north: float, east: float, vn: float, ve: float) -> None:
    given = target(north, east)
    n, e, _ = ned(within_reach(given, at(v=(vn, ve, 0.0))))
    away, ahead = math.hypot(north, east), math.hypot(n, e)
    assert ahead <= min(away, AHEAD_M + AHEAD_S * math.hypot(vn, ve)) + 0.5
    assert math.hypot(north - n, east - e) == pytest.approx(away - ahead, abs=0.5)  # on the straight line


async def test_a_goto_is_led_there_and_its_end_is_said(bench: StartBench) -> None:
    b = await (await (await bench(settings={"origin": ORIGIN})).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())
    await b.state(lambda s: s["position"], "position")
    await b.ground.do("goto", pos=[400.0, 0.0, -10.0], arrive=False)
    await b.peer.count(GLOBAL, 3)
    assert [norths(t) for t in b.peer.heard(GLOBAL)] == pytest.approx([AHEAD_M] * len(b.peer.heard(GLOBAL)), abs=0.2)
    b.peer.send("GLOBAL_POSITION_INT", **at(390.0))
    await b.peer.until(lambda: norths(b.peer.heard(GLOBAL)[-1]) == pytest.approx(400.0, abs=0.2), "the target itself")
    leader = b.vehicle.authority.leader
    await b.state(lambda s: not leader.leading, "the end of it")


@pytest.mark.parametrize("ends", ["hold", "pilot"])
async def test_a_goto_that_is_over_is_led_no_more(bench: StartBench, ends: str) -> None:
    b = await (await (await bench(settings={"origin": ORIGIN})).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())
    await b.state(lambda s: s["position"], "position")
    await b.ground.do("goto", pos=[400.0, 0.0, -10.0], arrive=False)
    await b.peer.count(GLOBAL, 2)
    if ends == "hold":
        await b.ground.do("hold")
    else:
        b.peer.mode = 5
        b.peer.heartbeat()
        await b.event("released", kind="pilot")
    told = len(b.peer.heard(GLOBAL))
    for _ in range(4):
        await b.state(lambda s: True, "a moment")
    assert len(b.peer.heard(GLOBAL)) == told


async def test_it_leads_only_while_it_may(bench: StartBench) -> None:
    b = await (await (await bench(settings={"origin": ORIGIN})).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())
    await b.state(lambda s: s["position"], "position")
    control = Control("quad1")
    leader = PositionLeader(b.vehicle.companion, control, b.vehicle.authority.bounds)
    assert leader.lead(target(400.0, 0.0))
    await b.peer.count(GLOBAL, 2)
    assert control.claimed(Mover.TARGET)
    control.take("pilot", Mover.PILOT, "his switch")
    await b.state(lambda s: not leader.leading, "the end of it")
    control.leave("pilot")
    assert not control.claimed(Mover.TARGET), "what was led is led no more"
    control.take("pilot", Mover.PILOT, "his switch")
    with pytest.raises(Refused, match="his switch"):
        leader.lead(target(400.0, 0.0))


async def test_a_stream_to_a_far_point_is_led_too(bench: StartBench) -> None:
    b = await (await (await bench(settings={"origin": ORIGIN})).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())
    lease = (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"]
    point = wire.Setpoint(lease=lease, seq=1, deadline=time.time() + 2, pos=(400.0, 0.0, -10.0))
    await b.state(lambda s: s["position"], "position")
    b.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")
    await b.peer.count(GLOBAL, 1)
    assert norths(b.peer.heard(GLOBAL)[0]) == pytest.approx(AHEAD_M, abs=0.2)


@pytest.mark.parametrize(
    ("by", "vel"),
    [("goto", None), ("stream", None), ("stream", (2.0, 0.0, 0.0))],
    ids=["goto", "stream", "stream with a velocity"],
)
async def test_who_does_not_know_where_it_is_any_more_is_led_no_farther_and_says_so(
    bench: StartBench, by: str, vel: wire.Vector | None
) -> None:
    """A far target, given as it is, would be flown to however long nothing more is heard, whatever comes with it."""
    settings = {"origin": ORIGIN, "failsafe": PATIENT}
    b = await (await (await bench(settings=settings)).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())  # once, so that it is old in two seconds
    await b.state(lambda s: s["position"], "position")
    if by == "goto":
        await b.ground.do("goto", pos=[400.0, 0.0, -10.0], id="g", wait=0)
    else:
        lease = (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"]
    for seq in range(16):  # 5 Hz: longer than a position is fresh
        if by == "stream":
            point = wire.Setpoint(lease=lease, seq=seq, deadline=time.time() + 2, pos=(400.0, 0.0, -10.0), vel=vel)
            b.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")
        state = await b.state(lambda s: True, "a moment")
    assert max(norths(t) for t in b.peer.heard(GLOBAL)) < 2 * AHEAD_M
    await b.event("it does not say any more where it is", kind="setpoint", severity="warning")
    if by == "stream":
        became = state["setpoints"]
        assert became["position"] > 0 and became["flown"] + became["position"] <= 16
    told = len(b.peer.heard(GLOBAL))
    b.peer.send("GLOBAL_POSITION_INT", **at(north=10.0))
    await b.peer.count(GLOBAL, told + 1)
    assert norths(b.peer.heard(GLOBAL)[-1]) == pytest.approx(10.0 + AHEAD_M, abs=0.5)


async def test_who_is_brought_back_from_afar_keeps_to_the_limit_of_speed(bench: StartBench) -> None:
    """The farther a rover is behind, the faster it is told to drive, but no faster than the fleet file has it."""
    settings = {"origin": ORIGIN, "limits": Limits(speed=2.0)}
    b = await (await bench(settings=settings, mav_type=10)).connected()
    b.peer.mode, b.peer.armed = 15, True
    await b.state(lambda s: s["mode"] == "GUIDED" and s["armed"], "armed GUIDED")
    b.peer.send("GLOBAL_POSITION_INT", **at())
    lease = (await b.ground.do("lease", holder="alice", ttl=30)).result["lease"]
    await b.state(lambda s: s["position"], "position")
    b.peer.send("GLOBAL_POSITION_INT", **at())  # so that it is fresh however long that took
    point = wire.Setpoint(lease=lease, seq=1, deadline=time.time() + 2, pos=(200.0, 0.0, 0.0), vel=(1.0, 0.0, 0.0))
    b.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")
    await b.peer.count("SET_POSITION_TARGET_LOCAL_NED", 1)
    told = b.peer.heard("SET_POSITION_TARGET_LOCAL_NED")[0].fields
    assert 1.0 < math.hypot(told["vx"], told["vy"]) <= 2.0 + 1e-6


def norths(told: Any) -> float:
    return round((float(told.fields["lat_int"]) / 1e7 + 35.0) * 110_941.0, 2)


async def test_a_command_beside_a_goto_leaves_it_led(bench: StartBench) -> None:
    b = await (await (await bench(settings={"origin": ORIGIN})).connected()).flying()
    b.peer.send("GLOBAL_POSITION_INT", **at())
    await b.state(lambda s: s["position"], "position")
    await b.ground.do("goto", pos=[400.0, 0.0, -10.0], id="g", wait=0)
    await b.peer.count(GLOBAL, 1)
    await b.ground.do("command", command="DO_CHANGE_SPEED", params={"param2": 5.0})
    before = len(b.peer.heard(GLOBAL))
    while len(b.peer.heard(GLOBAL)) < before + 3:
        b.peer.send("GLOBAL_POSITION_INT", **at())
        await b.state(lambda s: True, "a moment")
    assert max(norths(t) for t in b.peer.heard(GLOBAL)) < 2 * AHEAD_M


def test_a_rover_is_brought_back_to_a_moving_place_and_never_turns_round_for_it() -> None:
    """ArduRover goes to positions in its own way: it is given the velocity that takes it there."""
    here = at()

    def told(metres: float, speed: float) -> tuple[float, float, float] | None:
        return pursuit(msgspec.structs.replace(target(metres, 0.0), vel=(speed, 0.0, 0.0)), here, 30.0).vel

    assert told(0.0, 2.0) == pytest.approx((2.0, 0.0, 0.0), abs=1e-3)
    assert told(2.0, 1.0) == pytest.approx((2.4, 0.0, 0.0), abs=0.01)
    assert told(-1.0, 1.0) == pytest.approx((0.3, 0.0, 0.0), abs=0.01)
    assert told(-3.0, 1.0) == (0.0, 0.0, 0.0)
    assert told(0.2, 0.0) == (0.0, 0.0, 0.0)
    assert told(-1.0, 0.0) == pytest.approx((-0.7, 0.0, 0.0), abs=0.01)
    assert pursuit(place := target(90.0, 0.0), here, 30.0) is place

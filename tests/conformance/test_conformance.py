"""What any vehicle must do under zmav, in the order of a day at the field; each check can be run alone. What a check
means for a kind of vehicle, and what it must refuse, is in :mod:`.kinds`.

``make conformance LINK=udpin:127.0.0.1:14540`` flies a real autopilot; without LINK the simulated ones are flown.
"""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.conformance.conftest import speed
from zmav import geo, wire
from zmav.errors import BadInput, NotHolder, Refused, Unsupported
from zmav.rotation import from_euler

if TYPE_CHECKING:
    from tests.conformance.conftest import Flight

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.timeout(600)]

STALE_HOLD_S = 0.6
"""s from the last setpoint to the hold, at worst"""


async def test_connect(flight: Flight) -> None:
    """It is heard, known by its uid and firmware, and what a state is made of flows by itself."""
    await flight.connected()
    state = flight.state
    assert state.autopilot in ("ardupilot", "px4", "generic")
    assert state.sysid and state.kind != "other" and state.uid and state.firmware
    await flight.until(
        lambda s: s.ages.get("attitude", 9.0) < 2.0 and s.ages.get("battery", 9.0) < 2.0, 30.0, "attitude and battery"
    )


async def test_ready(flight: Flight) -> None:
    """It becomes ready to arm; until then it says what is missing, and then nothing is."""
    await flight.ready()
    assert flight.state.armed or flight.state.not_ready == []
    assert flight.state.position is not None


async def test_params(flight: Flight) -> None:
    """The whole set, one of it set and read back and put back, and names that do not exist."""
    await flight.connected()
    params = flight.vehicle.params
    table = await params.list()
    assert table.complete and table.count == len(table.params) > 100
    assert (await params.list()).hash == table.hash
    known = {p.name: p for p in table.params}
    name = next(n for n in flight.kind.harmless if n in known)
    before = known[name].value
    assert before is not None
    assert (await params.set(name, before + 1)).value == pytest.approx(before + 1)
    assert (await params.get(name)).value == pytest.approx(before + 1)
    assert (await params.set(name, before)).value == pytest.approx(before)
    with pytest.raises(BadInput):
        await params.set("NO_SUCH_PARAM", 1)


def round_trip(flight: Flight, count: int) -> list[wire.MissionItem]:
    """A takeoff, for what has one, and the corners of a triangle about where it stands, again and again."""
    position, kind = flight.state.position, flight.kind
    assert position is not None
    here = wire.Origin(lat_deg=position.lat_deg, lon_deg=position.lon_deg, alt_amsl=0.0)
    items = []
    if kind.height:
        items = [wire.MissionItem(command="MAV_CMD_NAV_TAKEOFF", x=here.lat_deg, y=here.lon_deg, z=kind.height)]
    for i in range(count - len(items)):
        angle = math.tau * i / 3  # so that corners are turned, however few there are
        lat, lon, _ = geo.to_global(here, (kind.reach * math.cos(angle), kind.reach * math.sin(angle), 0.0))
        items.append(wire.MissionItem(command="MAV_CMD_NAV_WAYPOINT", x=lat, y=lon, z=kind.height))
    return items


async def test_mission(flight: Flight) -> None:
    """A mission goes up and comes down as it was, a bad one leaves the old one in force, and it can be cleared."""
    await flight.ready()
    missions, items = flight.vehicle.missions, round_trip(flight, 25)
    await missions.upload(items)
    there = await missions.download()
    assert [item.command for item in there.items] == [item.command for item in items]
    assert [item.z for item in there.items] == pytest.approx([item.z for item in items])
    for axis in ("x", "y"):
        here, sent = ([getattr(item, axis) for item in some] for some in (there.items[1:], items[1:]))
        assert here == pytest.approx(sent, abs=2e-7)
    with pytest.raises(BadInput):
        await missions.upload([*items, wire.MissionItem(command="MAV_CMD_NONSENSE")])
    assert len((await missions.download()).items) == 25
    await missions.clear()
    assert (await missions.download()).items == []


async def test_arm(flight: Flight) -> None:
    """It arms and disarms on the ground."""
    await flight.on_ground()
    await flight.vehicle.arm()
    assert flight.onboard.identity.armed
    await flight.vehicle.disarm()
    assert not flight.onboard.identity.armed


async def test_takeoff(flight: Flight) -> None:
    """It climbs to the height asked for; what cannot leave the ground says so."""
    await flight.connected()
    kind = flight.kind
    if not kind.height:
        with pytest.raises(Unsupported, match=kind.kind):
            await flight.vehicle.takeoff(5.0)
        return
    await flight.under_way()
    position = flight.state.position
    assert position and position.alt_rel == pytest.approx(kind.height, abs=max(1.5, 0.4 * kind.height))


async def test_hold(flight: Flight) -> None:
    """On its way to a place it is told to hold: it comes to rest short of it, or circles where it was."""
    await flight.under_way()
    kind = flight.kind
    target = flight.offset(3.0 * kind.reach, 0.0)
    await flight.vehicle.goto(pos=target, arrive=False)
    await flight.until(lambda s: speed(s) > 1.0, 20.0, "moving")
    await flight.vehicle.hold()
    if kind.rests:
        await flight.until(lambda s: speed(s) < 0.3, 20.0, "at rest")
    assert flight.away(target) > kind.reach


async def test_position(flight: Flight) -> None:
    """A stream of position setpoints brings it there, and the mode that follows them is entered by itself."""
    await flight.under_way()
    kind = flight.kind
    target = flight.offset(kind.reach, 0.0)
    async with flight.vehicle.lease("tester") as lease, flight.streaming(lease, pos=target):
        await flight.until(lambda s: flight.away(target) < kind.near, kind.patience, "there")
    counts = flight.state.setpoints
    assert counts.get("flown", 0) > 10


async def test_goto(flight: Flight) -> None:
    """A goto ends at its place."""
    await flight.under_way()
    kind = flight.kind
    target = flight.offset(0.0, -kind.reach)
    await flight.vehicle.goto(pos=target, tolerance=kind.tolerance)
    assert flight.away(target) < 1.2 * kind.tolerance + 1.0  # it may be on its way through


async def test_velocity(flight: Flight) -> None:
    """A stream of velocities is flown at that velocity; who takes none says so."""
    await flight.under_way()
    wanted = flight.kind.velocity
    if wanted is None:
        before = unsupported(flight)
        async with flight.vehicle.lease("tester") as lease, flight.streaming(lease, vel=(0.0, 2.0, 0.0)):
            await refused(flight, before)
        return
    async with flight.vehicle.lease("tester") as lease, flight.streaming(lease, vel=wanted):
        await flight.until(
            lambda s: s.velocity is not None and math.dist(s.velocity, wanted) < 0.4, 20.0, f"{wanted} m/s"
        )


async def test_trajectory_segment(flight: Flight) -> None:
    """A segment is flown by the vehicle itself: one message, and it ends at rest where the segment ends."""
    await flight.under_way()
    start, end, t = flight.offset(0.0, 0.0), flight.offset(8.0, 0.0), time.time() + 0.3
    half = flight.offset(4.0, 0.0)
    points = [
        wire.SegmentPoint(t=t, pos=start, vel=(0.0, 0.0, 0.0)),
        wire.SegmentPoint(t=t + 4.0, pos=half, vel=(1.5, 0.0, 0.0)),
        wire.SegmentPoint(t=t + 8.0, pos=end),
    ]
    async with flight.vehicle.lease("tester", ttl=20.0) as lease:
        before = unsupported(flight)
        lease.segment(points)
        if flight.kind.trajectories:
            await flight.until(lambda s: flight.away(end) < flight.kind.near, 30.0, "the segment's end")
        else:
            await refused(flight, before)


async def test_attitude(flight: Flight) -> None:
    """An attitude with thrust is held: it leans as told. A rover turns to its heading, and drives."""
    await flight.under_way()
    kind = flight.kind
    yaw = flight.state.attitude.yaw if flight.state.attitude else 0.0
    yaw += math.radians(60.0) if kind.lean is None else 0.0
    lean = kind.lean or 0.0
    point = {"attitude": from_euler(kind.bank, -lean, yaw), "thrust": kind.thrust}

    def held(state: wire.VehicleState) -> bool:
        a = state.attitude
        if a is None:
            return False
        if kind.lean is None:
            return math.cos(a.yaw - yaw) > math.cos(math.radians(5.0)) and speed(state) > 0.5
        return abs(a.pitch + lean) < math.radians(3.0) + 0.2 * kind.bank and abs(a.roll - kind.bank) < math.radians(5.0)

    async with flight.vehicle.lease("tester") as lease, flight.streaming(lease, **point):
        await flight.until(held, 15.0, "as told")


async def test_hold_on_stale(flight: Flight) -> None:
    """The stream stops: within STALE_HOLD_S the hold is said, and the vehicle comes to rest, or circles there."""
    await flight.under_way()
    kind = flight.kind
    async with flight.vehicle.lease("tester", ttl=10.0) as lease:
        async with flight.streaming(lease, **motion(flight)):
            await flight.until(lambda s: speed(s) > 1.5 and follows(s), 20.0, "moving")
        since, stopped = len(flight.events), time.time()
        event = await flight.event("hold", since)
        assert event.t - stopped < STALE_HOLD_S + 0.1  # by the same clock; the tenth is the stream's own period
        if kind.rests:
            await flight.until(lambda s: speed(s) < 0.3, 20.0, "at rest")


async def test_lease_conflict(flight: Flight) -> None:
    """One commander at a time; a higher priority preempts, and the first is told by whom."""
    await flight.under_way()
    other = flight.client.vehicle(flight.vehicle.name)
    async with flight.vehicle.lease("first") as first:
        with pytest.raises(NotHolder, match="first"):
            async with other.lease("second"):
                raise AssertionError("two commanders")
        with pytest.raises(NotHolder):
            await other.goto(pos=flight.offset(5.0, 0.0))
        async with other.lease("third", priority=50):
            await flight.until(lambda s: s.lease is not None and s.lease.holder == "third", 5.0, "the third's lease")
            with pytest.raises(NotHolder, match="third"):
                for _ in range(100):
                    first.setpoint(pos=flight.offset(0.0, 0.0))
                    await asyncio.sleep(0.1)


async def test_pilot_takes_over(flight: Flight) -> None:
    """A change of mode by anybody else ends the lease at once; nothing is taken back without a new one."""
    await flight.under_way()
    mode, point = flight.kind.pilots_mode, motion(flight)
    async with flight.vehicle.lease("tester") as lease:
        async with flight.streaming(lease, **point):
            await flight.until(lambda s: s.mode != mode and speed(s) > 0.7 and follows(s), 20.0, "moving")
        with pytest.raises(NotHolder):
            async with flight.streaming(lease, **point):
                await flight.gcs_mode(mode)
                await flight.until(lambda s: s.lease is None, 3.0, "no lease")
                for _ in range(100):
                    lease.setpoint(**point)
                    await asyncio.sleep(0.1)
    assert flight.state.mode == mode


async def test_fly_a_mission(flight: Flight) -> None:
    """A short mission is flown to its last item."""
    await flight.under_way()
    await flight.vehicle.missions.upload(round_trip(flight, 3))
    seen: list[Any] = []
    with flight.hurried():
        await flight.vehicle.missions.start(first=1, wait_end=True, progress=seen.append)
    assert seen, "no progress was told"
    await flight.vehicle.hold()


async def test_rtl(flight: Flight) -> None:
    """From some way off it returns: a copter lands and disarms itself, a rover stops, a plane circles there."""
    await flight.connected()
    kind = flight.kind
    if kind.rests or flight.home is None:
        await flight.on_ground()
    await flight.under_way()
    home = flight.home
    assert home is not None
    with flight.hurried():
        await flight.vehicle.goto(pos=flight.offset(0.7 * kind.reach, 0.0), tolerance=kind.tolerance)
        await flight.vehicle.rtl()
        if kind.lands_at_home:
            assert not flight.onboard.identity.armed
            return
        await flight.until(lambda s: math.dist((s.local or home)[:2], home[:2]) < kind.near, kind.patience, "home")
    assert flight.state.armed
    if kind.rests:
        await flight.until(lambda s: speed(s) < 0.3, 20.0, "at rest")


async def test_land(flight: Flight) -> None:
    """It lands and disarms by itself; what is on the ground already says so."""
    await flight.under_way()
    if not flight.kind.lands:
        with pytest.raises((Unsupported, Refused)):
            await flight.vehicle.land()
        return
    with flight.hurried():
        await flight.vehicle.land()
    assert not flight.onboard.identity.armed
    await flight.until(lambda s: s.armed is False, 10.0, "disarmed")


async def test_log_download(flight: Flight, tmp_path: Path) -> None:
    """The newest log comes down whole."""
    await flight.on_ground()
    await flight.vehicle.arm()  # which begins a log
    await flight.vehicle.disarm()
    logs = await flight.vehicle.logs.list()
    if not logs:
        pytest.skip("this autopilot has no logs (logging is off, or there is no card)")
    newest = logs[-1]
    file = await flight.vehicle.logs.get(newest.id, tmp_path / "log")
    data = file.read_bytes()
    assert len(data) >= newest.size
    assert data.startswith(flight.kind.log_magic)


def motion(flight: Flight) -> dict[str, Any]:
    """A setpoint that keeps it moving: a velocity, or a far place for who takes none."""
    if flight.kind.velocity is None:
        return {"pos": flight.offset(3.0 * flight.kind.reach, 0.0)}
    return {"vel": flight.kind.velocity}


def follows(state: wire.VehicleState) -> bool:
    """It is in the mode that follows setpoints."""
    return state.mode in ("GUIDED", "OFFBOARD")


def unsupported(flight: Flight) -> int:
    """Setpoints so far that the vehicle has no such level for."""
    return (flight.state.setpoints or {}).get("unsupported", 0)


async def refused(flight: Flight, before: int) -> None:
    """Another such setpoint was dropped, and counted."""
    await flight.until(lambda s: unsupported(flight) > before, 10.0, "a setpoint of a level there is not")

"""What a script sees of a vehicle: real routers, the real agent beside the embedded simulator, the real client."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, NamedTuple

import pytest
import zenoh

import zmav
from zmav import keys, wire
from zmav.errors import BadInput, BadKey, BadMessage, NoSuchVehicle, NotHolder, Refused, Stale, TimedOut
from zmav.mavlink import describe, load_dialect, parse_frame
from zmav.session import LARGEST_PAYLOAD
from zmav.sim import SimVehicle, VehicleSpec, World
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard

SPEED = 8.0
PATIENCE_S = 30.0
ORIGIN = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Scene(NamedTuple):
    z: zmav.Client
    quad: zmav.Vehicle
    sim: SimVehicle
    world: World
    endpoint: str

    def pilot(self, mode: str) -> None:
        """The pilot turns the mode switch."""
        self.world.call(lambda: self.sim.pilot_mode(mode))

    def off(self, *ned: float) -> float:
        """Metres from a place about the origin, by the simulator's truth."""
        return math.dist(self.sim.status().ned_m, ned)


MakeScene = Callable[..., Awaitable[Scene]]


@pytest.fixture
async def make_scene(net: Net, onboard: StartOnboard) -> AsyncIterator[MakeScene]:
    """A simulated copter, its agent in a router, and a client of that router that has heard of it."""
    async with contextlib.AsyncExitStack() as stack:

        async def make(ready_s: float = 0.5) -> Scene:
            spec = VehicleSpec(params={"DISARM_DELAY": 0.0})  # eight seconds pass in one here
            world = stack.enter_context(World([spec], endpoint="tcp:0", speed=SPEED, ready_s=ready_s))
            session, endpoint = net.router()
            await onboard(session, world.urls[0], origin=ORIGIN)
            z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
            (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
            await quad.wait_until(lambda s: s.connected and (s.position is not None or ready_s > 60.0), PATIENCE_S)
            return Scene(z, quad, world.vehicles[0], world, endpoint)

        yield make


@pytest.fixture
async def scene(make_scene: MakeScene) -> Scene:
    return await make_scene()


@pytest.fixture
async def airborne(scene: Scene) -> Scene:
    """Six metres up."""
    await scene.quad.arm(ready_timeout=PATIENCE_S)
    await scene.quad.takeoff(6.0)
    return scene


class Ghost:
    """Publishes the state of a vehicle that is not there: nobody answers for it."""

    def __init__(self, session: zenoh.Session, fleet: str, name: str) -> None:
        self._session, self._fleet, self._name = session, fleet, name

    def speak(self) -> None:
        state = wire.VehicleState(t=time.time(), fleet=self._fleet, name=self._name, instance="ghost")
        # It speaks once: not dropped where the link is full of what was put before.
        key, blocking = keys.STATE.key(self._fleet, self._name), zenoh.CongestionControl.BLOCK
        self._session.put(key, wire.encode(state), congestion_control=blocking)

    async def haunt(self) -> None:
        while True:
            self.speak()
            await asyncio.sleep(0.05)


# State.


async def test_state_is_typed_and_has_an_age(scene: Scene) -> None:
    quad = scene.quad
    state = await quad.wait_until(lambda s: bool(s.ready and s.attitude and s.uid and s.gps), PATIENCE_S)
    assert (state.name, state.fleet, state.sysid, state.compid) == ("quad1", "demo", 1, 1)
    assert (state.autopilot, state.kind, state.mode, state.armed) == ("ardupilot", "copter", "STABILIZE", False)
    assert state.position and state.position.alt_amsl == pytest.approx(ORIGIN.alt_amsl, abs=1.0)
    assert state.local == pytest.approx((0.0, 0.0, 0.0), abs=1.0)
    assert state.uid == scene.sim.uid.to_bytes(8, "little").hex()
    assert state.gps and state.gps.satellites
    assert set(state.ages) >= {"position", "attitude"}
    assert quad.present
    assert quad.age is not None and quad.age < 2.0
    assert quad.state.t <= time.time()
    assert [v.name for v in scene.z.fleet()] == ["quad1"]


async def test_a_vehicle_that_stops_speaking_is_stale_and_then_forgotten(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        ghost = Ghost(session, "demo", "quad1")
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        quad = z.vehicle("quad1")
        with pytest.raises(NoSuchVehicle, match="quad1 has not been heard"):
            _ = quad.state
        assert (quad.age, quad.last_state, quad.present) == (None, None, False)
        ghost.speak()
        await z.wait_for("quad1")
        assert quad.state.instance == "ghost"
        assert quad.present
        await asyncio.sleep(keys.STATE.stale_after or 0.0)
        with pytest.raises(Stale, match="last heard 2") as caught:
            _ = quad.state
        assert caught.value.detail["vehicle"] == "quad1"
        assert caught.value.detail["age"] >= 2.0
        assert not quad.present
        assert quad.last_state is not None
        assert [v.name for v in z.fleet()] == ["quad1"]
        with pytest.raises(NoSuchVehicle, match="not heard within 0 s: quad1"):
            await z.wait_for("quad1", timeout=0.1)


async def test_presence_is_the_token_or_the_state(net: Net) -> None:
    session, endpoint = net.router()
    key = keys.ALIVE.key("demo", "quad1", role=keys.VEHICLE, sys=0, autopilot="-", uid="-", instance="x")
    with session.liveliness().declare_token(key):
        async with zmav.open(connect=[endpoint]) as z:
            assert [v.name for v in await z.settle(PATIENCE_S)] == ["quad1"]
            quad = z.vehicle("quad1")
            assert quad.present
            assert quad.age is None
            with session.liveliness().declare_token(key.replace("quad1", "quad2")):
                assert [v.name for v in await z.settle()] == ["quad1", "quad2"]


async def test_a_state_that_cannot_be_read_is_left_out(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        for bad in (b"", b"\xff", b"{}", b"[" * 100_000, b'{"t":1,"fleet":"demo","name":"quad1","instance":1}'):
            session.put(keys.STATE.key("demo", "quad1"), bad)
        Ghost(session, "demo", "quad2").speak()
        await z.wait_for("quad2", timeout=PATIENCE_S)
        assert z.vehicle("quad1").last_state is None


async def test_fleets_are_kept_apart(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(fleet="*", connect=[endpoint]) as z:
        await net.linked(session, keys.STATE.key("north", "quad1"))
        for fleet, name in (("north", "quad1"), ("south", "quad1"), ("south", "quad2")):
            Ghost(session, fleet, name).speak()
        found = await z.settle(PATIENCE_S)
        assert [(v.fleet, v.name) for v in found] == [("north", "quad1"), ("south", "quad1"), ("south", "quad2")]
        assert [v.state.fleet for v in found] == ["north", "south", "south"]
        assert z.vehicle("quad2").fleet == "south"
        with pytest.raises(BadInput, match="quad1 is in the fleets north, south"):
            _ = z.vehicle("quad1").fleet
        with pytest.raises(NoSuchVehicle, match="quad3 has not been heard in any fleet"):
            await z.vehicle("quad3").hold()
    async with zmav.open(fleet="south", connect=[endpoint]) as z:
        for name in ("quad1", "quad2"):
            await net.linked(session, keys.STATE.key("south", name))
            Ghost(session, "south", name).speak()
        assert [v.fleet for v in await z.wait_for("quad1", "quad2")] == ["south", "south"]


async def test_what_no_router_would_take_is_refused_before_it_is_sent(net: Net) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        payload = bytes(LARGEST_PAYLOAD + 1)
        with pytest.raises(BadInput, match="too much for one message"):
            await z.ask(keys.DO.key("demo", "quad1", verb="hold"), payload)
        with pytest.raises(BadInput, match="too much for one message"):
            z.put(keys.FLEET, keys.FLEET.key("demo", topic="goal"), payload)


def test_bad_names_are_refused_before_anything_is_opened() -> None:
    with pytest.raises(BadKey, match="fleet 'Demo'"):
        zmav.open(fleet="Demo")
    with pytest.raises(BadKey, match=r"vehicle 'quad\*'"):
        zmav.open().vehicle("quad*")
    with pytest.raises(RuntimeError, match="async with"):
        _ = zmav.open().session


# Orders.


async def test_a_flight(scene: Scene, net: Net) -> None:
    quad, sim = scene.quad, scene.sim
    climbing: list[float] = []
    events = net.ground(scene.endpoint).samples(keys.EVENT)
    await quad.arm(ready_timeout=PATIENCE_S)
    assert sim.status().armed
    await quad.takeoff(6.0, progress=lambda news: climbing.append(news.get("alt_rel", 0.0)))
    assert sim.status().height_m == pytest.approx(6.0, abs=0.5)
    assert sim.status().mode == "GUIDED"
    assert climbing == sorted(climbing)
    away = (await quad.order("goto", wire.GoTo(pos=(8.0, -4.0, -6.0), tolerance=0.5)))["away"]
    assert away <= 0.5
    assert scene.off(8.0, -4.0, -6.0) < 1.0
    there = lambda s: s.local is not None and math.dist(s.local, (8.0, -4.0, -6.0)) < 1.0  # noqa: E731
    state = await quad.wait_until(there, PATIENCE_S)
    assert (state.ready, state.landed, state.status) == (True, False, "ACTIVE")
    lat, lon, alt = zmav.geo.to_global(ORIGIN, (0.0, 5.0, -7.0))
    await quad.goto(lat_deg=lat, lon_deg=lon, alt_rel=7.0, tolerance=0.6)
    assert scene.off(0.0, 5.0, -7.0) < 0.8
    await quad.goto(lat_deg=lat, lon_deg=lon, alt_amsl=alt + 1.0, arrive=False)
    assert sim.status().mode == "GUIDED"
    await quad.hold()
    await quad.set_mode("loiter")
    assert sim.status().mode == "LOITER"
    await quad.land()
    assert not sim.status().armed
    assert sim.status().landed
    state = await quad.wait_until(lambda s: s.armed is False, PATIENCE_S)
    assert state.mode == "LAND"
    await quad.disarm()
    modes = [e["text"] for e in events.objects() if e["kind"] == "mode"]
    assert modes == ["mode GUIDED", "mode LOITER", "mode LAND"]


async def test_a_refusal_brings_the_autopilots_own_reason(scene: Scene) -> None:
    scene.world.call(lambda: scene.sim.copter.pilot.sticks(throttle=0.9))
    with pytest.raises(Refused, match=r"MAV_CMD_COMPONENT_ARM_DISARM refused: .*Throttle too high") as caught:
        await scene.quad.arm(ready_timeout=0.0)
    detail = caught.value.detail
    assert detail["vehicle"] == "quad1"
    assert detail["command"] == "MAV_CMD_COMPONENT_ARM_DISARM"
    assert detail["result"] in ("MAV_RESULT_FAILED", "MAV_RESULT_DENIED")
    assert any("Throttle too high" in reason for reason in detail["reasons"])
    assert not scene.sim.status().armed


async def test_what_is_not_ready_is_said_while_it_is_waited_for(make_scene: MakeScene) -> None:
    scene = await make_scene(ready_s=10_000.0)
    said: list[dict[str, object]] = []
    with pytest.raises(Refused, match=r"not ready to arm: .*EKF has no position estimate"):
        await scene.quad.arm(ready_timeout=1.0, progress=said.append)
    assert any("EKF has no position estimate" in str(news.get("waiting_for")) for news in said)
    assert scene.quad.state.ready is False


async def test_orders_that_make_no_sense_are_bad_input(airborne: Scene) -> None:
    quad = airborne.quad
    with pytest.raises(BadInput, match=r"no mode 'HOVER'.*LOITER") as bad:
        await quad.set_mode("HOVER")
    assert (bad.value.detail["field"], bad.value.detail["value"]) == ("mode", "HOVER")
    for order, field in (
        (quad.takeoff(-5.0), "alt_rel"),
        (quad.takeoff(math.nan), "alt_rel"),
        (quad.goto(), "pos"),
        (quad.goto(pos=(0.0, 0.0, -5.0), lat_deg=1.0, lon_deg=1.0), "lat_deg"),
        (quad.goto(pos=(1e7, 0.0, 0.0)), "pos"),
        (quad.goto(pos=(0.0, 0.0, -5.0), speed=300.0, radius=20.0), "speed"),
        (quad.goto(pos=(0.0, 0.0, -5.0), speed=math.nan), "speed"),
        (quad.goto(lat_deg=95.0, lon_deg=0.0, alt_rel=5.0), "lat_deg"),
        (quad.goto(lat_deg=5.0, lon_deg=0.0), "alt_rel"),
        (quad.goto(lat_deg=5.0, lon_deg=0.0, alt_rel=5.0, alt_amsl=5.0), "alt_rel"),
    ):
        with pytest.raises(BadInput) as bad:
            await order
        assert bad.value.detail["field"] == field
    assert airborne.sim.status().mode == "GUIDED"


async def test_how_an_order_ends_before_it_is_done(airborne: Scene) -> None:
    quad = airborne.quad
    # By a later one.
    flying = asyncio.create_task(quad.goto(pos=(500.0, 0.0, -6.0)))
    await quad.wait_until(lambda s: bool(s.velocity and s.velocity[0] > 1.0), PATIENCE_S)
    await quad.hold()
    with pytest.raises(Refused, match="goto was superseded"):
        await flying
    await quad.wait_until(lambda s: bool(s.velocity and abs(s.velocity[0]) < 0.2), PATIENCE_S)
    # By the pilot.
    flying = asyncio.create_task(quad.goto(pos=(500.0, 0.0, -6.0)))
    await quad.wait_until(lambda s: bool(s.velocity and s.velocity[0] > 1.0), PATIENCE_S)
    airborne.pilot("LOITER")
    with pytest.raises(Refused, match="taken over: the mode is now LOITER"):
        await flying
    await asyncio.to_thread(airborne.world.wait_for, lambda: airborne.sim.status().speed_mps < 0.2, 120.0)
    assert airborne.sim.status().mode == "LOITER"
    # By its time.
    with pytest.raises(TimedOut, match="not there after 1 s") as caught:
        await quad.goto(pos=(500.0, 0.0, -6.0), timeout=0.6)
    assert caught.value.detail["vehicle"] == "quad1"
    with pytest.raises(TimedOut, match="quad1: it did not come true within 0 s"):
        await quad.wait_until(lambda s: s.mode == "LAND", 0.3)


async def test_a_vehicle_that_is_not_there(scene: Scene) -> None:
    """... is told soon, though another one speaks all the time."""
    start = time.monotonic()
    with pytest.raises(NoSuchVehicle, match="no vehicle ghost is present in fleet demo"):
        await scene.z.vehicle("ghost").arm()
    assert time.monotonic() - start < PATIENCE_S
    with pytest.raises(NoSuchVehicle, match=r"ghost \(present: quad1\)") as caught:
        await scene.z.wait_for("quad1", "ghost", timeout=0.3)
    assert caught.value.detail["missing"] == ["ghost"]


async def test_a_vehicle_that_is_there_but_does_not_answer(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        quad = z.vehicle("quad1")
        quad.give_up = 0.5
        ghost = Ghost(session, "demo", "quad1")
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        ghost.speak()
        await z.wait_for("quad1")
        haunting = asyncio.create_task(ghost.haunt())
        with pytest.raises(TimedOut, match="quad1 does not answer on zmav/demo/quad1/do/hold"):
            await quad.hold()
        haunting.cancel()
        quad.give_up = 2.5
        with pytest.raises(Stale, match="quad1 was last heard"):
            await quad.hold()


async def test_an_answer_may_take_longer_than_the_next_attempt(net: Net) -> None:
    """Over bad hops every one does: what was asked before stays open."""
    session, endpoint = net.router()
    key, asked = keys.DO.key("demo", "quad1", verb="ping"), list[zenoh.Query]()

    def answer_the_first(query: zenoh.Query) -> None:
        asked.append(query)
        if len(asked) == 3:
            asked[0].reply(key, b"late")
            asked[0].drop()

    session.declare_queryable(key, answer_the_first)
    async with zmav.open(connect=[endpoint]) as z:
        ghost = Ghost(session, "demo", "quad1")
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        ghost.speak()
        await z.wait_for("quad1")
        quad = z.vehicle("quad1")
        quad.ask_again = 0.3
        await quad.ping()
    assert len(asked) == 3
    for query in asked:
        query.drop()


# Leases and setpoints.


async def test_one_commander_at_a_time(airborne: Scene) -> None:
    quad, other = airborne.quad, airborne.z.vehicle("quad1")
    async with quad.lease("planner") as lease:
        await quad.wait_until(lambda s: bool(s.lease and s.lease.holder == "planner"), PATIENCE_S)
        for refused in (other.takeoff(5.0), other.set_mode("LOITER"), other.goto(pos=(5.0, 0.0, -6.0))):
            with pytest.raises(NotHolder, match="planner commands quad1") as caught:
                await refused
            assert caught.value.detail == {"vehicle": "quad1", "holder": "planner", "priority": 0}
        with pytest.raises(NotHolder):
            async with other.lease("rival"):
                pytest.fail("two hold the lease")
        await quad.goto(pos=(3.0, 0.0, -6.0))  # the holder itself may
        await other.hold()  # open to everybody, and it ends the lease
        with pytest.raises(NotHolder):
            while True:
                lease.setpoint(pos=(0.0, 0.0, -6.0))
                await asyncio.sleep(0.1)
    await quad.wait_until(lambda s: s.lease is None, PATIENCE_S)
    async with other.lease("rival", ttl=1.0):
        await other.set_mode("LOITER")


async def test_setpoints_fly_the_vehicle_and_silence_holds_it(airborne: Scene) -> None:
    quad = airborne.quad
    airborne.world.set_speed(3.0)
    async with quad.lease("planner") as lease:
        with pytest.raises(BadInput, match=r"segment\.yaw is nan"):
            lease.segment([wire.SegmentPoint(t=time.time(), pos=(0.0, 0.0, -9.0), yaw=math.nan)])
        end = time.monotonic() + PATIENCE_S
        while airborne.off(6.0, 2.0, -7.0) > 0.5 and time.monotonic() < end:
            lease.setpoint(pos=(6.0, 2.0, -7.0))
            await asyncio.sleep(0.05)
        assert airborne.off(6.0, 2.0, -7.0) <= 0.5
        state = await quad.wait_until(lambda s: s.setpoints.get("held", 0) == 1, PATIENCE_S)
        assert 0 < state.setpoints["flown"] <= lease.sent
        for _ in range(40):
            lease.setpoint(vel=(3.0, 0.0, 0.0))
            await asyncio.sleep(0.05)
        assert airborne.sim.status().ned_m[0] > 8.0
        await quad.wait_until(lambda s: bool(s.velocity and abs(s.velocity[0]) < 0.2), PATIENCE_S)
        held = airborne.sim.status()
        assert (held.mode, held.armed) == ("GUIDED", True)
        assert held.height_m == pytest.approx(7.0, abs=0.7)
    assert (await quad.wait_until(lambda s: s.lease is None, PATIENCE_S)).setpoints["held"] == 2


async def test_a_lease_that_ran_out_is_not_taken_back_in_silence(scene: Scene) -> None:
    """The holder's process was stopped for longer than the lease lasts: it must ask again."""
    with pytest.raises(BadKey, match="holder 'the boss'"):
        async with scene.quad.lease("the boss"):
            pytest.fail("it was granted")
    assert scene.quad.state.lease is None
    async with scene.quad.lease("planner", ttl=0.6) as lease:
        time.sleep(1.0)  # the point: nothing runs meanwhile
        with pytest.raises(NotHolder):
            while True:
                lease.setpoint(pos=(0.0, 0.0, -6.0))
                await asyncio.sleep(0.05)
    await scene.quad.wait_until(lambda s: s.lease is None, PATIENCE_S)


# Messages.


async def test_the_last_message_of_a_name(scene: Scene) -> None:
    m = await scene.quad.message("GLOBAL_POSITION_INT")
    assert (m.name, m.id, m.sysid, m.compid, m.verified) == ("GLOBAL_POSITION_INT", 33, 1, 1, True)
    assert m.fields["lat"] / 1e7 == pytest.approx(ORIGIN.lat_deg, abs=1e-4)
    assert m.units["lat"] == "degE7"
    assert 0.0 <= m.age < PATIENCE_S
    heartbeat = await scene.quad.message("HEARTBEAT")
    assert heartbeat.fields["type"] == "MAV_TYPE_QUADROTOR"
    assert heartbeat.fields["autopilot"] == "MAV_AUTOPILOT_ARDUPILOTMEGA"
    # Those that are not there say why.
    with pytest.raises(BadMessage, match="did you mean ATTITUDE"):
        await scene.quad.message("ATITUDE")
    with pytest.raises(BadInput, match=r"no WIND_COV has come from quad1; heard so far: .*HEARTBEAT"):
        await scene.quad.message("WIND_COV")
    for hostile in ("*", "A/B", "", "ATT*", "?"):
        with pytest.raises(BadKey, match="cannot be a message's name"):
            await scene.quad.message(hostile)
        with pytest.raises(BadKey):
            scene.quad.stream(hostile)
    with pytest.raises(BadMessage):
        scene.quad.stream("ATITUDE")
    # Questions to nobody and to everybody.
    z = scene.z
    assert await z.ask("zmav/demo/nobody/state") == []
    answers = await z.ask("zmav/*/*/msg/HEARTBEAT")
    assert [type(answer).__name__ for answer in answers] == ["Answer"]
    (error,) = await z.ask("zmav/demo/quad1/msg/WIND_COV")
    assert isinstance(error, BadInput)
    with pytest.raises(BadKey, match="cannot query"):
        await z.ask("zmav//x")
    assert await scene.quad.ping() > 0.0


async def test_a_stream_is_every_message_decoded_and_true_to_the_byte(scene: Scene) -> None:
    dialect = load_dialect()
    raw_key = keys.RX.key("demo", "quad1", sys="*", comp="*", msg="ATTITUDE")
    async with scene.quad.stream("ATTITUDE") as stream, scene.z.subscribe(raw_key) as samples:
        messages = [await stream.get() for _ in range(20)]
        frames = [(await samples.get()).payload.to_bytes() for _ in range(20)]
    seen = [describe(parse_frame(data, dialect), dialect) for data in frames]
    overlap = [message for message in messages if message.seq in {other.seq for other in seen}]
    assert len(overlap) >= 15
    assert [m for m in seen if m.seq in {other.seq for other in overlap}] == overlap
    boot = [m.fields["time_boot_ms"] for m in messages]
    assert boot == sorted(set(boot))
    assert messages[0].units["roll"] == "rad"


async def test_a_stream_leaves_out_what_is_no_frame_and_names_the_unknown_by_number(net: Net) -> None:
    dialect = load_dialect()
    session, endpoint = net.router()
    key = keys.RX.key("demo", "quad1", sys=1, comp=1, msg="UNKNOWN_60000")
    unknown = bytes.fromhex("fd02000007010160ea00") + b"\xab\xcd" + b"\x12\x34"
    assert parse_frame(unknown, dialect).msgid == 60000
    async with zmav.open(connect=[endpoint]) as z, z.vehicle("quad1").stream("UNKNOWN_60000") as stream:
        await net.linked(session, key)
        for data in (b"", b"\xfd", b"no frame", unknown[:-1], unknown):
            session.put(key, data)
        message = await within(PATIENCE_S, stream.get())
        assert (message.name, message.seq, message.fields) == ("UNKNOWN_60000", 7, {"payload": "abcd"})
        assert stream.bad == 4

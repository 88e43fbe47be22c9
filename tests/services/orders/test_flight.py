"""A simulated copter behind an Onboard: the orders, the stream, the hold and the pilot, as they go in flight."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from zmav import keys, wire
from zmav.errors import NotHolder, Refused, ZmavError
from zmav.sim import SimVehicle, VehicleStatus, World

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, Samples, StartOnboard
    from tests.services.conftest import StartBench

SPEED = 8.0
HOME = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)


class Flight(NamedTuple):
    """A world of one copter, and the ground from where it is flown."""

    world: World
    ground: Ground
    states: Samples
    events: Samples

    @property
    def copter(self) -> SimVehicle:
        return self.world.vehicles[0]

    async def see(self, true: Callable[[VehicleStatus], bool], sim_s: float = 120.0) -> VehicleStatus:
        """Wait until the simulated copter itself is as wanted."""
        await asyncio.to_thread(self.world.wait_for, lambda: true(self.copter.status()), sim_s)
        return self.copter.status()

    async def state(self, true: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        return await self.states.object(true, what, after=len(self.states.items))

    async def done(self, verb: str, **args: Any) -> dict[str, Any]:
        """See an order through, as a client does."""
        order = {"id": f"{verb} {args}", "wait": 5.0, **args}
        while (outcome := await self.ground.do(verb, **order)).status == "running":
            pass
        return outcome.result

    async def up(self, alt_rel: float = 5.0) -> Flight:
        if not self.states.items or not self.states.objects()[-1]["connected"]:
            await self.state(lambda s: s["connected"], "connection")
        await self.done("arm")
        assert (await self.done("takeoff", alt_rel=alt_rel))["alt_rel"] > alt_rel - 0.4
        return self


@pytest.fixture
async def flight(request: pytest.FixtureRequest, net: Net, onboard: StartOnboard) -> AsyncIterator[Flight]:
    """A copter on the ground, ready in two simulated seconds, or in as many as the parameter says."""
    ready_s = getattr(request, "param", 2.0)
    with World(copters=1, endpoint="tcp:127.0.0.1:0", speed=SPEED, ready_s=ready_s) as world:
        session, endpoint = net.router()
        ground = net.ground(endpoint)
        states, events = ground.samples(keys.STATE), ground.samples(keys.EVENT)
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        vehicle = await onboard(session, world.urls[0], origin=HOME)
        yield Flight(world, ground, states, events)
        await onboard.close(vehicle)


@pytest.mark.parametrize("flight", [1000.0], indirect=True)
async def test_not_ready_is_refused_with_the_autopilot_s_reasons(flight: Flight) -> None:
    await flight.state(lambda s: s["connected"], "connection")
    with pytest.raises(Refused, match="MAV_CMD_COMPONENT_ARM_DISARM refused: FAILED") as e:
        await flight.ground.do("arm", ready_timeout=0)
    assert any("Arm:" in reason or "PreArm:" in reason for reason in e.value.detail["reasons"])
    assert not flight.copter.status().armed


async def test_a_plane_is_there_when_it_circles(net: Net, onboard: StartOnboard) -> None:
    """It comes no nearer to a place than its circle about it, whatever tolerance is asked for."""
    with World(planes=1, endpoint="tcp:127.0.0.1:0", speed=SPEED, ready_s=2.0) as world:
        session, endpoint = net.router()
        ground = net.ground(endpoint)
        flight = Flight(world, ground, ground.samples(keys.STATE), ground.samples(keys.EVENT))
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        vehicle = await onboard(session, world.urls[0], origin=HOME)
        await flight.state(lambda s: s["connected"], "connection")
        await flight.done("arm")
        await flight.done("takeoff", alt_rel=50.0)
        away = (await flight.done("goto", pos=[500.0, 0.0, -60.0], timeout=40.0))["away"]
        assert away < 1.3 * 80.0
        assert vehicle.params.value("WP_LOITER_RAD") == 80.0
        again = (await flight.done("goto", pos=[500.0, 0.0, -60.0], timeout=41.0))["away"]
        assert again < 1.3 * 80.0, "on its circle it is there as well"
        await onboard.close(vehicle)


async def test_a_takeoff_that_px4_ends_too_low_is_led_to_its_height(net: Net, onboard: StartOnboard) -> None:
    """PX4 is there 0.8 m below (NAV_MC_ALT_RAD), and holds the height that it has then: 11.2 m of 12 for ever."""
    with World(px4=1, endpoint="tcp:127.0.0.1:0", speed=SPEED, ready_s=2.0) as world:
        session, endpoint = net.router()
        ground = net.ground(endpoint)
        flight = Flight(world, ground, ground.samples(keys.STATE), ground.samples(keys.EVENT))
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        vehicle = await onboard(session, world.urls[0], origin=HOME)
        await flight.state(lambda s: s["connected"], "connection")
        await flight.done("arm")
        assert (await flight.done("takeoff", alt_rel=12.0))["alt_rel"] >= 12.0 - 0.03 * 12.0
        there = await flight.see(lambda s: abs(s.height_m - 12.0) < 0.3 and s.speed_mps < 0.1)
        assert (there.mode, there.armed) == ("HOLD", True)
        await onboard.close(vehicle)


async def test_what_is_refused_ends_no_landing(flight: Flight) -> None:
    """It is judged before the mode is touched: the landing goes on, and its own order with it."""
    await flight.up(8.0)
    landing = asyncio.create_task(flight.done("land"))
    await flight.see(lambda s: s.mode == "LAND" and s.height_m < 7.5)
    refused: list[tuple[str, dict[str, Any], str]] = [
        ("takeoff", {"alt_rel": 8.0}, "in the air already"),
        ("goto", {"pos": [0.0, 0.0, 5.0]}, "under the ground"),
        ("goto", {"pos": [9000.0, 0.0, -5.0], "speed": 5.0}, "beyond the geofence"),
        ("set_mode", {"mode": "NO_SUCH_MODE"}, "no mode"),
        ("mission_start", {}, "no mission"),
    ]
    for verb, args, why in refused:
        with pytest.raises(ZmavError, match=why):
            await flight.ground.do(verb, **args)
        still = flight.copter.status()
        assert (still.mode, still.landed) == ("LAND", False), verb
    assert await landing == {"armed": False}
    assert "mode GUIDED" not in [e["text"] for e in flight.events.objects() if e["kind"] == "mode"][2:]


async def test_a_disarmed_vehicle_is_not_put_into_rtl(flight: Flight) -> None:
    state = await flight.state(lambda s: s["connected"] and s["mode"], "connection")
    with pytest.raises(Refused, match="it is disarmed: there is nothing to bring back"):
        await flight.ground.do("rtl")
    assert await flight.done("land") == {"armed": False}
    assert flight.copter.status().mode == state["mode"] == "STABILIZE"


async def test_the_pilot_takes_it_from_the_stream(flight: Flight) -> None:
    await flight.up()
    flight.world.set_speed(3.0)
    lease = (await flight.ground.do("lease", holder="alice", ttl=30)).result["lease"]
    put(flight, lease, 1, (2.0, 0.0, 0.0))
    await flight.state(lambda s: s["setpoints"].get("flown") == 1, "flown setpoint")
    flight.world.call(lambda: flight.copter.pilot_mode("LOITER"))
    await flight.state(lambda s: s["mode"] == "LOITER", "the pilot's mode")
    for seq in range(2, 12):
        put(flight, lease, seq, (2.0, 0.0, 0.0))
    await flight.state(lambda s: s["setpoints"].get("pilot") == 10, "dropped setpoints")
    there = await flight.see(lambda s: s.speed_mps < 0.2)
    assert there.mode == "LOITER"
    # Somebody asks for it again: the old lease is no good for that.
    with pytest.raises(NotHolder, match="the mode is now LOITER"):
        await flight.done("set_mode", mode="GUIDED", lease=lease)
    lease = (await flight.ground.do("lease", holder="alice", ttl=30)).result["lease"]
    for seq in range(1, 100):
        put(flight, lease, seq, (2.0, 0.0, 0.0))
        if (await flight.state(lambda s: True, "a moment"))["setpoints"].get("flown", 0) > 10:
            break
    await flight.see(lambda s: s.mode == "GUIDED" and s.speed_mps > 0.5)


def put(flight: Flight, lease: str, seq: int, vel: wire.Vector) -> None:
    point = wire.Setpoint(lease=lease, seq=seq, deadline=time.time() + 2.0, vel=vel)
    flight.ground.put(keys.SETPOINT, wire.encode(point), agent="alice")


async def test_a_stop_is_said_more_than_once(bench: StartBench) -> None:
    """It has no acknowledgement, and who is in GUIDED already is asked for nothing that has."""
    b = await (await (await bench()).connected()).flying()
    await b.ground.do("hold")
    await b.peer.count("SET_POSITION_TARGET_LOCAL_NED", 3)


async def test_a_mode_that_is_still_shown_is_asked_for_where_another_was_ordered_since(bench: StartBench) -> None:
    """HEARTBEAT is up to a second behind: the autopilot may have left the mode by now."""
    b = await (await (await bench()).connected()).flying()
    b.vehicle.commander.ordered = "LOITER"  # as the watchdog asks for its mode
    await b.ground.do("hold")
    assert [t.fields["param2"] for t in b.peer.commands(176)] == [4.0]

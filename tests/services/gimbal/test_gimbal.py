"""A gimbal by its autopilot's manager: who controls it, where it looks, and what it never does: turn the vehicle."""

from __future__ import annotations

import asyncio
import math
import uuid
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from zmav import geo, keys, wire
from zmav.errors import BadInput, Refused
from zmav.rotation import from_euler
from zmav.sim import VehicleSpec, World
from zmav.sim.autopilots.ardupilot.vehicle import ArduVehicle
from zmav.sim.protocol.gimbal import NOBODY, OTHER

if TYPE_CHECKING:
    from tests.conftest import Ground, Net, Samples, StartOnboard
    from zmav.onboard import Onboard
    from zmav.sim.protocol.gimbal import SimGimbal

HOME = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
FITTED: dict[str, dict[str, float]] = {
    "arducopter": {"MNT1_TYPE": 1},
    "px4": {"MNT_MODE_IN": 4},
}
CLOSE = math.radians(1.0)


class Aboard(NamedTuple):
    world: World
    ground: Ground
    states: Samples
    events: Samples
    vehicle: Onboard

    @property
    def gimbal(self) -> SimGimbal:
        return self.world.vehicles[0].node.gimbal

    @property
    def us(self) -> tuple[int, int]:
        return self.vehicle.adapter.address

    async def do(self, verb: str, **args: Any) -> dict[str, Any]:
        """See an order through."""
        order = {"id": uuid.uuid4().hex, "wait": 5.0, **args}
        while (outcome := await self.ground.do(f"gimbal_{verb}", **order)).status == "running":
            pass
        return outcome.result

    async def looks(self, pitch: float, yaw: float) -> None:
        """It comes to look there: rad, from the horizon and from the nose."""
        for _ in range(100):
            seen = self.gimbal.angles
            if max(abs(seen[0] - pitch), abs(seen[1] - yaw)) < CLOSE:
                return
            await asyncio.sleep(0.05)
        pytest.fail(f"it looks to {self.gimbal.angles}, not to {pitch, yaw}")

    def place(self, north: float, east: float, up: float = 0.0) -> dict[str, float]:
        """Relative to the vehicle, above its home."""
        found = self.states.objects()[-1]["position"]
        origin = wire.Origin(lat_deg=found["lat_deg"], lon_deg=found["lon_deg"], alt_amsl=found["alt_amsl"])
        lat, lon, _ = geo.to_global(origin, (north, east, 0.0))
        return {"lat_deg": lat, "lon_deg": lon, "alt_rel": up}

    @property
    def heading(self) -> float:
        return float(self.world.vehicles[0].brain.sense.yaw)


@pytest.fixture(params=["arducopter", "px4"])
async def aboard(request: pytest.FixtureRequest, net: Net, onboard: StartOnboard) -> AsyncIterator[Aboard]:
    spec = VehicleSpec(name="quad1", autopilot=request.param, params=FITTED[request.param])
    with World([spec], endpoint="tcp:0", ready_s=0.5) as world:
        yield await start(world, net, onboard)
        for vehicle in reversed(onboard.running.copy()):
            await onboard.close(vehicle)


async def start(world: World, net: Net, onboard: StartOnboard) -> Aboard:
    session, endpoint = net.router()
    ground = net.ground(endpoint)
    states, events = ground.samples(keys.STATE), ground.samples(keys.EVENT)
    await net.linked(session, keys.STATE.key("demo", "quad1"))
    vehicle = await onboard(session, world.urls[0], origin=HOME)
    await states.object(lambda s: s["connected"] and s["position"] is not None, "a position")
    return Aboard(world, ground, states, events, vehicle)


async def test_angles_are_taken_with_control_that_is_given_back(aboard: Aboard) -> None:
    assert aboard.gimbal.control == NOBODY
    said = await aboard.do("turn", pitch=-0.5, yaw=0.3)
    assert said == {"pitch": -0.5, "yaw": pytest.approx(0.3), "lock": False}
    assert aboard.gimbal.control == aboard.us
    await aboard.looks(-0.5, 0.3)
    status = await aboard.do("status")
    assert (status["controller"], status["turns"]) == ("us", True)
    assert status["pitch"] == pytest.approx(-0.5, abs=1e-3)
    assert status["yaw"] == pytest.approx(0.3, abs=1e-3)
    assert status["heading"] == pytest.approx(0.3 + aboard.heading, abs=0.05)
    assert status["pitch_range"][0] == pytest.approx(-math.pi / 2)
    await aboard.do("turn", pitch=-0.2, yaw=1.0, lock=True)
    await aboard.looks(-0.2, 1.0 - aboard.heading)
    await aboard.do("turn")
    await aboard.looks(0.0, 0.0)
    assert (await aboard.do("release"))["controller"] == "nobody"
    assert aboard.gimbal.control == NOBODY


async def test_it_looks_at_a_place_until_the_next_order(aboard: Aboard) -> None:
    said = await aboard.do("point", **aboard.place(10.0, 10.0, -10.0))
    down = -math.atan2(10.0, math.hypot(10.0, 10.0))
    assert said["pitch"] == pytest.approx(down, abs=CLOSE)
    await aboard.looks(down, math.radians(45.0) - aboard.heading)
    assert (await aboard.do("status"))["at"] == "a place"
    await aboard.do("turn", pitch=-0.1)
    await aboard.looks(-0.1, 0.0)
    await asyncio.sleep(0.6)
    await aboard.looks(-0.1, 0.0)
    assert (await aboard.do("status"))["at"] == ""


async def test_it_follows_another_vehicle_by_what_that_says(aboard: Aboard, net: Net) -> None:
    key = keys.STATE.key("demo", "rover1")

    def tell(north: float, east: float) -> None:
        place = aboard.place(north, east)
        found = wire.GlobalPosition(lat_deg=place["lat_deg"], lon_deg=place["lon_deg"], alt_amsl=584.09, alt_rel=0.0)
        state = wire.VehicleState(t=0.0, fleet="demo", name="rover1", instance="x", position=found)
        aboard.ground.session.put(key, wire.encode(state))

    with pytest.raises(Refused, match="rover1 is not heard"):
        await aboard.do("point", vehicle="rover1")
    with pytest.raises(BadInput, match="another vehicle of this fleet"):
        await aboard.do("point", vehicle="quad1")
    with pytest.raises(BadInput, match="a vehicle and a place"):
        await aboard.do("point", vehicle="rover1", **aboard.place(1.0, 0.0))

    async def talk() -> None:
        while True:
            tell(*where)
            await asyncio.sleep(0.05)

    where = (20.0, 0.0)
    talking = asyncio.create_task(talk())
    assert (await aboard.do("point", vehicle="rover1"))["at"] == "rover1"
    await aboard.looks(0.0, -aboard.heading)
    where = (20.0, 20.0)
    await aboard.looks(0.0, math.radians(45.0) - aboard.heading)
    talking.cancel()


async def test_another_s_control_is_not_stolen(aboard: Aboard) -> None:
    aboard.world.fault("quad1", "gimbal", how="taken")
    for verb, args in (("turn", {"pitch": 0.0}), ("turn", {}), ("point", aboard.place(5.0, 5.0))):
        with pytest.raises(Refused, match="controlled by 255/190: it is taken with take") as caught:
            await aboard.do(verb, **args)
        assert caught.value.detail["controller"] == "255/190"
    assert aboard.gimbal.control == OTHER
    await aboard.do("turn", pitch=-0.3, take=True)
    await aboard.looks(-0.3, 0.0)
    await aboard.events.object(lambda e: "is taken from 255/190" in e["text"], "words")


async def test_who_takes_it_while_it_looks_is_left_with_it(aboard: Aboard) -> None:
    await aboard.do("point", **aboard.place(10.0, 10.0))
    aboard.gimbal.control = OTHER
    await aboard.events.object(lambda e: "controlled by 255/190 now" in e["text"], "words")
    before = aboard.gimbal.control
    await asyncio.sleep(0.5)
    assert aboard.gimbal.control == before == OTHER
    assert (await aboard.do("release"))["controller"] == "255/190"


async def test_the_pilot_s_stick_ends_what_is_looked_at(net: Net, onboard: StartOnboard) -> None:
    """ArduPilot does not tell that he moves it: his channel does. What is asked for by another need goes on."""
    spec = VehicleSpec(name="quad1", params={**FITTED["arducopter"], "RC6_OPTION": 213})
    with World([spec], endpoint="tcp:0", ready_s=0.5) as world:
        aboard = await start(world, net, onboard)
        node = world.vehicles[0].node
        assert isinstance(node.brain, ArduVehicle)
        radio = node.brain.rc
        await aboard.do("point", **aboard.place(10.0, 10.0))
        radio.pwm[6] += 200  # another channel moves nothing of it
        await asyncio.sleep(1.0)
        assert (await aboard.do("status"))["at"] == "a place"
        radio.pwm[5] += 200
        await aboard.events.object(lambda e: "the pilot moves the gimbal (channel 6)" in e["text"], "words")
        assert (await aboard.do("status"))["at"] == ""
        aboard.gimbal.set_attitude(node.channels[0], {"q": from_euler(0.0, -1.0, 0.0), "flags": 0}, OTHER)
        await asyncio.sleep(0.5)
        await aboard.looks(-1.0, 0.0)
        await onboard.close(aboard.vehicle)


async def test_a_gimbal_that_does_not_answer_is_refused(aboard: Aboard) -> None:
    aboard.world.fault("quad1", "gimbal")
    for verb, args in (("turn", {"pitch": 0.0}), ("point", aboard.place(5.0, 5.0)), ("status", {}), ("release", {})):
        with pytest.raises(Refused, match="no gimbal answers") as caught:
            await aboard.do(verb, **args)
        assert caught.value.detail["reason"] == "no gimbal"


async def test_what_is_out_of_reach_is_refused(aboard: Aboard) -> None:
    with pytest.raises(BadInput, match="out of the gimbal's reach"):
        await aboard.do("turn", pitch=1.6)
    assert aboard.gimbal.control == NOBODY, "and nothing is taken for it"
    with pytest.raises(BadInput, match="one of alt_amsl and alt_rel"):
        await aboard.do("point", lat_deg=1.0, lon_deg=2.0, alt_amsl=3.0, alt_rel=1.0)
    with pytest.raises(BadInput, match="lat_deg"):
        await aboard.do("point")


async def test_one_without_a_yaw_axis_only_tilts(aboard: Aboard) -> None:
    aboard.world.fault("quad1", "gimbal", how="stiff")
    with pytest.raises(BadInput, match="no yaw axis"):
        await aboard.do("turn", pitch=0.0, yaw=0.5)
    said = await aboard.do("point", **aboard.place(0.0, 10.0, -10.0))
    assert said["turns"] is False
    await aboard.looks(-math.radians(45.0), 0.0)


async def test_a_lease_is_neither_asked_for_nor_ended(aboard: Aboard) -> None:
    lease = (await aboard.ground.do("lease", holder="planner")).result["lease"]
    await aboard.do("turn", pitch=-0.4)
    await aboard.looks(-0.4, 0.0)
    assert aboard.vehicle.leases.holder == "planner"
    await aboard.ground.do("release", lease=lease)


async def test_control_is_given_back_at_the_end(aboard: Aboard, onboard: StartOnboard) -> None:
    await aboard.do("turn", pitch=-0.4)
    await onboard.close(aboard.vehicle)
    await asyncio.to_thread(aboard.world.wait_for, lambda: aboard.gimbal.control == NOBODY, 20.0)


async def test_none_is_fitted_by_default(net: Net, onboard: StartOnboard) -> None:
    with World(copters=1, endpoint="tcp:0", ready_s=0.5) as world:
        aboard = await start(world, net, onboard)
        with pytest.raises(Refused, match="no gimbal answers"):
            await aboard.do("point", **aboard.place(5.0, 5.0))
        assert world.vehicles[0].node.gimbal.information() is None
        await onboard.close(aboard.vehicle)

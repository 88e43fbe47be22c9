"""A mapping survey among simulated copters: the planner has their autopilots trigger the cameras, and what these
took covers the area.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
import shapely
from shapely import affinity

import zmav
from tests.agents.planner.execute.fleet import ORIGIN
from tests.agents.planner.live.led import PATIENCE_S, Field, led
from tests.descents import COPTER_DOWN
from tests.waiting import until
from zmav import geo
from zmav.sim.autopilots.arducopter.copter import ArduCopter
from zmav.wire import swarm

pytestmark = pytest.mark.asyncio(loop_scope="module")
NAMES = ("quad1", "quad2")
HEIGHT, CAMERA, FRONT, SIDE = 8.0, (1.5, 1.0), 0.6, 0.3
EVERY = HEIGHT * CAMERA[1] * (1.0 - FRONT)
AREA = [(4.0, 0.0), (26.0, 0.0), (26.0, 33.0), (4.0, 33.0)]
OFF = 1.0
"""m by which a picture is off its lane, or late: planning keeps 0.4 m for the vehicle, and ArduCopter looks every
0.02 s, 0.1 m apart; and its yaw, a degree of which moves a corner by 0.2 m
"""


class Pictures:
    """What each vehicle's autopilot said of its pictures."""

    def __init__(self) -> None:
        self.by: dict[str, list[dict[str, Any]]] = {}

    async def listen(self, vehicle: zmav.Vehicle) -> None:
        taken = self.by.setdefault(vehicle.name, [])
        async with vehicle.stream("CAMERA_FEEDBACK") as stream:
            while True:
                taken.append(dict((await stream.get()).fields))

    @property
    def count(self) -> int:
        return sum(map(len, self.by.values()))


def place(taken: dict[str, Any]) -> tuple[float, float, float]:
    return geo.to_ned(ORIGIN, taken["lat"] / 1e7, taken["lng"] / 1e7, taken["alt_msl"])


def footprint(taken: dict[str, Any], less: float = 0.0) -> Any:
    """The ground in a picture (east, north), narrower by ``less`` on each side."""
    north, east, down = place(taken)
    across, along = (-down * ratio / 2.0 - less for ratio in CAMERA)
    level = shapely.box(-across, -along, across, along)  # looking north
    return affinity.translate(affinity.rotate(level, -taken["yaw"], origin=(0.0, 0.0)), east, north)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field() -> AsyncIterator[Field]:
    async with led([(0.0, 4.0), (0.0, 21.0)], HEIGHT, params={**COPTER_DOWN, "CAM1_TYPE": 1.0}) as field:
        yield field


@pytest_asyncio.fixture(loop_scope="module")
async def pictures(field: Field) -> AsyncIterator[Pictures]:
    pictures = Pictures()
    tasks = [asyncio.create_task(pictures.listen(field.me.vehicle(name))) for name in NAMES]
    await until(lambda: len(pictures.by) == len(NAMES), PATIENCE_S)
    await asyncio.sleep(0.5)
    yield pictures
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def copter(field: Field, name: str) -> ArduCopter:
    brain = field.fleet.world.vehicles[field.fleet.names.index(name)].brain
    assert isinstance(brain, ArduCopter)
    return brain


def survey(*names: str, **more: Any) -> swarm.Survey:
    fields = {"polygon": AREA, "height": HEIGHT, "camera": CAMERA, "front": FRONT, "overlap": SIDE, "trigger": True}
    return swarm.Survey(vehicles=list(names), **{**fields, **more})


async def test_the_pictures_cover_the_area_with_the_overlap_that_was_asked(field: Field, pictures: Pictures) -> None:
    preview = await (await field.planner()).order("preview", swarm.Preview(goal=survey(*NAMES)))
    assert pictures.count == 0
    (figures,) = [step["figures"] for step in preview["steps"] if "figures" in step]
    wanted = {name: each["pictures"] for name, each in figures.items()}
    name = await field.submit(survey(*NAMES))
    await field.until(name, lambda entry: entry.state == "done")
    said = [event.text for event in field.agent.context.events]
    assert not [text for text in said if "not as prepared" in text], "lanes are flown on one clock"

    taken = [each for name in NAMES for each in pictures.by[name]]
    area = shapely.Polygon([(east, north) for north, east in AREA])
    covered = shapely.union_all([footprint(each) for each in taken])
    assert area.difference(covered.buffer(OFF)).is_empty
    assert covered.intersection(area).area / area.area > 0.99
    for vehicle in NAMES:
        own = pictures.by[vehicle]
        assert len(own) == pytest.approx(wanted[vehicle], abs=3)
        apart = [math.dist(place(a)[:2], place(b)[:2]) for a, b in itertools.pairwise(own)]
        assert max(apart) < EVERY + OFF
        for before, after in itertools.pairwise(own):
            if abs(place(before)[1] - place(after)[1]) > 0.3 * abs(place(before)[0] - place(after)[0]):
                continue  # around a corner
            again = footprint(before).intersection(footprint(after)).area / footprint(before).area
            assert again > FRONT - OFF / HEIGHT
    inner = area.buffer(-HEIGHT * CAMERA[1] / 2.0)
    twice = HEIGHT * CAMERA[0] * (SIDE / 2.0)
    narrow = shapely.union_all([footprint(each, twice - OFF) for each in taken])
    assert inner.difference(narrow).area < 0.02 * inner.area, "lanes overlap by less than was asked"


async def test_a_pause_ends_the_pictures_until_it_goes_on_and_a_pilot_s_vehicle_takes_no_more(
    field: Field, pictures: Pictures
) -> None:
    planner, cameras = await field.planner(), [copter(field, name).camera for name in NAMES]
    name = await field.submit(survey(*NAMES))
    await field.until(name, lambda entry: pictures.count > 6)
    assert [camera.every for camera in cameras] == pytest.approx([EVERY] * 2)
    await planner.order("pause", swarm.GoalId(goal=name))
    await until(lambda: not any(camera.every for camera in cameras), PATIENCE_S)
    assert all(math.hypot(*field.me.vehicle(each).state.velocity or ()) < 0.6 for each in NAMES)
    await planner.order("resume", swarm.GoalId(goal=name))
    await until(lambda: all(camera.every for camera in cameras), PATIENCE_S)
    field.fleet.world.call(lambda: copter(field, NAMES[0]).set_mode(5))  # his switch, to LOITER
    await until(lambda: cameras[0].every == 0.0, PATIENCE_S)
    await until(lambda: cameras[1].every, PATIENCE_S)
    await planner.order("abort", swarm.GoalId())
    await until(lambda: not any(camera.every for camera in cameras), PATIENCE_S)


async def test_who_has_no_camera_is_named_before_anybody_moves(field: Field) -> None:
    without = NAMES[1]
    vehicle = field.me.vehicle(without)
    await vehicle.params.set("CAM1_TYPE", 0)
    try:
        await vehicle.wait_until(lambda state: state.lease is None, PATIENCE_S)
        before = field.fleet.places()
        name = await field.submit(survey(without))
        with pytest.raises(AssertionError, match=r"the autopilot has no camera: CAM1_TYPE is 0"):
            await field.until(name, lambda entry: entry.state == "done")
        assert math.dist(field.fleet.places()[without], before[without]) < 0.5
    finally:
        await vehicle.params.set("CAM1_TYPE", 1)

"""The planner among simulated copters: goals are flown, paused, replaced, taken over; hostile orders change nothing."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import msgspec
import numpy as np
import pytest
import pytest_asyncio
import zenoh

import zmav
from agents.planner.cli.asking import Planner
from agents.planner.execute.offset import Offset
from agents.planner.execute.vehicle_command import SURE
from agents.planner.goals.steps import PlanTo
from agents.planner.live import fleet as heard
from agents.planner.live import plan as planning
from agents.planner.live import resting
from agents.planner.live import run as running
from agents.planner.live.agent import Agent
from agents.planner.live.checks import check_goal
from agents.planner.live.clocks import Clocks
from agents.planner.live.leased_vehicles import LeasedVehicles
from agents.planner.live.order_handlers import MOST_PREVIEWS, check_known
from agents.planner.live.run import Run
from agents.planner.live.settings import PlannerSettings
from agents.planner.model.errors import PlanError
from tests.agents.planner.live.led import PATIENCE_S, Field, led
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import BadInput, Refused, ZmavError
from zmav.waiting import together, within
from zmav.wire import swarm

PLACES = {"quad1": (0.0, 0.0), "quad2": (0.0, 7.0), "quad3": (7.0, 0.0), "quad4": (7.0, 7.0)}
pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def field() -> AsyncIterator[Field]:
    async with led(list(PLACES.values()), 10.0) as field:
        watching = asyncio.create_task(field.watch())
        yield field
        watching.cancel()
        assert field.closest > 2.0, "nobody was ever nearer to another than their radii"


def swap(height: float) -> swarm.GoTo:
    """Two to the places of each other, right across; the others stand beside."""
    places = [(*PLACES[name], -height) for name in ("quad4", "quad1")]
    return swarm.GoTo(vehicles=["quad1", "quad4"], to=places)


async def test_a_goal_is_previewed_and_flown(field: Field) -> None:
    planner = await field.planner()
    assert (planner.name, planner.vehicles) == ("ground", list(PLACES))
    await field.at_rest()
    preview = await planner.order("preview", swarm.Preview(goal=swap(10.0)))
    assert preview["makespan"] > 3.0
    assert preview["clearance"] > 0.9
    (step,) = preview["steps"]
    assert step["tracks"]["quad1"][-1][1:] == [7.0, 7.0, -10.0]
    begins = {name: track[0][1:] for name, track in step["tracks"].items()}
    assert {name: field.away(name, begins[name]) < 0.5 for name in begins} == {"quad1": True, "quad4": True}, begins
    assert field.agent.context.ledger.goals == []

    name = await field.submit(swap(10.0))
    entry = await field.until(name, lambda entry: entry.state == "flying")  # a machine that is too slow plans again
    assert entry.clearance is not None
    assert entry.clearance > 0.9
    said = (preview["makespan"], preview["clearance"])
    assert said == pytest.approx((entry.makespan, entry.clearance), rel=0.1), (step, preview["positions"])
    await field.until(name, lambda entry: entry.state == "done")
    for vehicle, place in zip(swap(10.0).vehicles, swap(10.0).to, strict=True):
        assert field.away(vehicle, place) < 1.0
    await field.me.vehicle("quad1").wait_until(lambda state: state.lease is None, PATIENCE_S)


async def test_a_preview_knows_the_clocks_as_well_as_a_flight(field: Field) -> None:
    """Where they are known badly vehicles are kept farther apart: it told of a plan that would not be flown."""
    clocks, badly = field.agent.context.clocks, Offset()
    now = clocks.clock.now()
    badly.answered(now - 0.36, now - 0.18, now)
    clocks.offsets["quad1"] = badly
    before = badly.error(now)
    await (await field.planner()).order("preview", swarm.Preview(goal=swap(12.0)))
    assert badly.error(clocks.clock.now()) < 0.5 * before


async def test_two_previews_at_once_both_wait_for_the_clocks(field: Field) -> None:
    clocks = Clocks(field.me)  # by which nobody's first state was taken in
    asked = [asyncio.create_task(clocks.learn(["quad1"])) for _ in range(2)]
    for each in asyncio.as_completed(asked):
        await each
        assert clocks.offsets["quad1"].error(clocks.clock.now()) < SURE


async def test_nobody_who_is_heard_is_said_not_to_be(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal waits for what its vehicles say after it began, which is no reason to call them unheard."""
    told, text = list[str](), Run.text

    def keep(self: Run, words: str) -> None:
        told.append(words)
        text(self, words)

    monkeypatch.setattr(Run, "text", keep)
    for vehicle in PLACES:
        name = await field.submit(swarm.Hold(vehicles=[vehicle]))
        await field.until(name, lambda entry: entry.state == "done")
    assert told
    assert not [words for words in told if "not heard" in words], told


async def test_it_is_paused_goes_on_and_is_replaced(field: Field) -> None:
    planner = await field.planner()
    there = swarm.GoTo(vehicles=["quad1", "quad2"], to=[(45.0, 22.0, -10.0), (45.0, 14.0, -10.0)])
    name = await field.submit(there)
    await field.until(name, lambda entry: entry.state == "flying" and entry.progress > 0.05)
    assert (await planner.order("pause", swarm.GoalId(goal=name)))["goals"] == [name]
    await field.until(name, lambda entry: entry.state == "paused")
    run = field.agent.runs[name]
    assert isinstance(run.flying, LeasedVehicles)
    executor = run.flying
    await within(PATIENCE_S, _until(lambda: executor.phase != "flying"))  # or halted, on a machine that is too slow
    rest = field.fleet.places()["quad1"]
    assert field.away("quad1", there.to[0]) > 5.0
    await planner.order("resume", swarm.GoalId())
    await field.until(name, lambda entry: entry.state == "flying")
    while math.dist(rest, field.fleet.places()["quad1"]) < 2.0:
        await asyncio.sleep(0.1)

    other = await field.submit(swarm.Hold(vehicles=["quad1"]))
    await field.until(name, lambda entry: entry.state == "cancelled")
    await field.until(other, lambda entry: entry.state == "done")
    assert field.away("quad1", there.to[0]) > 1.0
    queued = await field.submit(swarm.Hold(vehicles=["quad2"]), "queue")
    await field.until(queued, lambda entry: entry.state == "done")


async def test_who_is_taken_in_the_midst_of_a_landing_keeps_nobody_in_the_air(field: Field) -> None:
    """The others land under the planner's leases; his lease goes on, and the goal says who is not there."""
    names = ["quad1", "quad2"]
    places = {name: field.me.vehicle(name).local for name in names}
    goal = await field.submit(swarm.Land(vehicles=names))
    entry = next(entry for entry in field.agent.context.ledger.goals if entry.id == goal)
    taken, other = (field.me.vehicle(name) for name in names)
    for vehicle in (taken, other):
        await vehicle.wait_until(lambda s: s.mode == "LAND", PATIENCE_S)
    async with taken.lease("boss", priority=50) as lease:
        with field.fleet.quickly():
            await taken.goto(pos=places["quad1"])  # which ends the planner's landing
            state = await other.wait_until(lambda s: s.armed is False and s.lease is None, PATIENCE_S)
        assert state.lease_end is not None and state.lease_end.reason == "released"
        await field.until(goal, lambda entry: entry.state == "failed")
        assert entry.text.startswith("quad1: "), entry
        assert lease.lost is None
    await field.fleet.up_again(other, places["quad2"])


async def test_who_is_taken_on_the_way_home_keeps_nobody_in_the_air(field: Field) -> None:
    names = ["quad2", "quad3"]
    other, taken = (field.me.vehicle(name) for name in names)
    places = {}
    for vehicle in (taken, other):
        assert vehicle.local is not None
        places[vehicle.name] = vehicle.local
    with field.fleet.quickly():
        await together(*(vehicle.goto(pos=(*places[vehicle.name][:2], -18.0)) for vehicle in (taken, other)))
    seen = field.agent.context.fleet.seen("quad2")
    assert seen is not None and seen.view.home_ned is not None
    home = seen.view.home_ned  # where it took off last: tests before may have landed it elsewhere
    goal = await field.submit(swarm.Return(vehicles=names))
    await field.until(goal, lambda entry: entry.state == "flying" and entry.progress > 0.05)
    async with taken.lease("boss", priority=50):
        await taken.hold()
        await other.wait_until(lambda s: s.mode in ("LAND", "RTL"), PATIENCE_S)
        with field.fleet.quickly():
            await other.wait_until(lambda s: s.armed is False and s.lease is None, PATIENCE_S)
        await field.until(goal, lambda entry: entry.state == "failed" and "quad3" in entry.text)
        assert field.away("quad2", home) < 2.0
        with field.fleet.quickly():
            await taken.goto(pos=places["quad3"])
    await field.fleet.up_again(other, places["quad2"])


async def test_homes_are_asked_and_the_silent_are_known_for_a_while(field: Field) -> None:
    """By a planner that was started when they were in the air already."""
    fleet = heard.Fleet(field.me)
    fleet.watch()
    assert "quad4" in fleet.homeless
    await fleet.ask_home("quad4")
    assert "quad4" not in fleet.homeless
    seen = fleet.seen("quad4")
    assert seen is not None
    assert seen.view.home_ned == pytest.approx((*PLACES["quad4"], 0.0), abs=1.5)
    for silent, known, near in ((0.0, True, True), (heard.TORN + 1.0, True, False), (heard.KNOWN + 1.0, False, False)):
        fleet.last["quad4"] = (seen.state, time.monotonic() - silent)
        assert ("quad4" in fleet.view().vehicles, "quad4" in fleet.hearing().heard) == (known, near)


async def test_clocks_are_learnt_one_after_another_and_the_gone_are_forgotten(field: Field) -> None:
    clocks = Clocks(field.me)
    assert clocks.due(100.0) == "", "nobody was heard"
    clocks.hear()
    offsets = clocks.of(PLACES)
    now = clocks.clock.now()
    assert all(offset.error(now) == math.inf for offset in offsets.values()), "one bound is none"
    asked = []
    while who := clocks.due(time.monotonic()):
        asked.append(who)
        await clocks.ask(who)
    assert sorted(asked) == list(PLACES), "each once, within so short a time"
    now = clocks.clock.now()
    assert all(offset.error(now) < 0.2 for offset in offsets.values())
    assert all(abs(offset.value) <= offset.error(now) for offset in offsets.values()), "it is the same host's clock"
    clocks.of(["ghost"])
    await clocks.ask("ghost")
    clocks.hear()
    assert clocks.of(["quad1"])["quad1"] is offsets["quad1"]
    assert "ghost" not in clocks.offsets


async def test_where_it_is_tight_plans_have_less_margin_and_less_speed(field: Field) -> None:
    """The first margin for which there is a plan is taken."""
    context = field.agent.context
    planner, view = planning.Planner(context, "test", context.solver), context.fleet.view(0.5, tight=PLACES)
    n, e, d = view.vehicles["quad2"].pos_ned
    margins = ((0.9, 1.0), (0.5, 1.0), (0.1, 1.0 / 3.0))

    def beside(metres: float) -> PlanTo:
        places = np.array([(e + 20.0, n + 30.0, -d), (e + 20.0 + metres, n + 30.0, -d)])
        return PlanTo(("quad1", "quad2"), places, True)

    wide, tight = [await planner.plan_to(beside(metres), view, margins) for metres in (5.0, 2.3)]
    assert (wide.margin, tight.margin) == (0.9, 0.1)
    assert tight.makespan > 2.0 * wide.makespan
    assert tight.clearance is not None
    assert 0.2 < tight.clearance <= 0.31, "between the vehicles themselves"
    with pytest.raises(PlanError, match="goals"):
        await planner.plan_to(beside(2.1), view, margins)


async def test_an_obstacle_in_the_way_is_flown_around(field: Field) -> None:
    planner = await field.planner()
    n, e, _ = field.fleet.places()["quad3"]
    name = await field.submit(swarm.GoTo(vehicles=["quad3"], to=[(n - 32.0, e, -10.0)]))
    await field.until(name, lambda entry: entry.state == "flying")
    wall = swarm.Box(low=(n - 17.0, e - 4.0, 5.0), high=(n - 15.0, e + 4.0, -40.0))
    given = swarm.GiveObstacle(obstacle=swarm.Obstacle(name="wall", t=time.time(), what=wall))
    assert (await planner.order("obstacle", given)) == {"news": True, "obstacles": 1}
    nearest = math.inf

    async def watch() -> None:
        nonlocal nearest
        while True:
            n1, e1, _ = field.fleet.places()["quad3"]
            off = math.hypot(max(n - 17.0 - n1, n1 - n + 15.0, 0.0), max(abs(e1 - e) - 4.0, 0.0))
            nearest = min(nearest, off)
            await asyncio.sleep(0.05)

    watching = asyncio.create_task(watch())
    await field.until(name, lambda entry: entry.state == "done")
    watching.cancel()
    assert 0.8 < nearest < 20.0
    assert field.away("quad3", (n - 32.0, e, -10.0)) < 1.0
    assert any("wall" in event.text or "planned again" in event.text for event in field.agent.context.events)
    _forget_all(field)
    assert field.agent.context.world.obstacles == []


async def test_something_that_moves_is_followed_and_kept_clear_of(field: Field) -> None:
    planner = await field.planner()
    n, e, d = field.fleet.places()["quad2"]
    cart = swarm.Ball(center=(n - 10.0, e, d), radius=1.0, velocity=(-1.5, 0.0, 0.0))
    told = swarm.Obstacle(name="cart", t=time.time(), what=cart)
    await planner.order("obstacle", swarm.GiveObstacle(obstacle=told))
    follow = swarm.Follow(vehicles=["quad2"], leader="cart", offsets=[(6.0, 0.0, 0.0)])
    name = await field.submit(follow)
    settled, nearest, deadline = 0, math.inf, time.monotonic() + PATIENCE_S
    while settled < 20:
        assert time.monotonic() < deadline, field.agent.context.ledger.find(name)
        found = field.agent.context.world.ball("cart", time.time())
        assert found is not None
        place = field.fleet.places()["quad2"]
        nearest = min(nearest, math.dist(place, found[0]))
        settled = settled + 1 if math.dist(place, (found[0][0] + 6.0, e, d)) < 1.5 else 0
        await asyncio.sleep(0.1)
    assert nearest > 2.0
    await planner.order("cancel", swarm.GoalId(goal=name))
    await within(PATIENCE_S, _until(lambda: name not in field.agent.runs))
    _forget_all(field)


def _forget_all(field: Field) -> None:
    field.agent.context.world.follow([], time.monotonic(), time.time())


async def _raw(field: Field, verb: str, payload: bytes) -> ZmavError:
    (answer,) = await field.me.ask(keys.SWARM.key("demo", "ground", verb=verb), payload, 10.0, keys.SWARM)
    assert isinstance(answer, ZmavError)
    return answer


HOSTILE = {
    "no JSON": ("submit", b"{", "not JSON"),
    "not text": ("submit", b"\xff\xfe\x00", "not JSON"),
    "no goal": ("submit", b"{}", "goal"),
    "an unknown goal": ("submit", b'{"goal":{"kind":"somersault","vehicles":["quad1"]}}', "somersault"),
    "an unknown field": ("submit", b'{"goal":{"kind":"hold","vehicles":["quad1"],"now":1}}', "now"),
    "no number": ("submit", b'{"goal":{"kind":"goto","vehicles":["quad1"],"to":[[NaN,0,0]]}}', "JSON"),
    "a huge number": ("submit", b'{"goal":{"kind":"goto","vehicles":["quad1"],"to":[[1e300,0,0]]}}', "to[0][0]"),
    "a stranger": ("submit", b'{"goal":{"kind":"hold","vehicles":["ghost"]}}', "ghost"),
    "an unknown verb": ("explode", b"{}", "no order 'explode'"),
    "an unknown id": ("cancel", b'{"goal":"g99"}', "g99"),
    "no id": ("cancel", b"{}", "abort"),
    "a crossed polygon": (
        "obstacle",
        b'{"obstacle": {"name": "x", "t": 1, "what": {"shape": "no_fly", "floor": 0, "ceiling": 9,'
        b' "polygon": [[0, 0], [9, 9], [9, 0], [0, 7]]}}}',
        "cross",
    ),
    "too much": ("obstacle", b'{"obstacle":' + b" " * 1_000_000 + b"}", "too much"),
    "deep brackets": ("submit", b'{"goal":' + b"[" * 200_000, "goal"),
}


@pytest.mark.parametrize(("verb", "payload", "word"), HOSTILE.values(), ids=HOSTILE.keys())
async def test_hostile_orders_are_answered_and_change_nothing(
    field: Field, verb: str, payload: bytes, word: str
) -> None:
    before = (len(field.agent.context.ledger.open), field.agent.context.world.revision)
    error = await _raw(field, verb, payload)
    assert word in str(error)
    assert (len(field.agent.context.ledger.open), field.agent.context.world.revision) == before


async def test_obstacles_of_anybody_are_heard_and_noise_is_not(field: Field) -> None:
    ball = swarm.Ball(center=(100.0, 100.0, -10.0), radius=1.0, velocity=(1.0, 0.0, 0.0))
    key, block = keys.OBSTACLE.key("demo", name="bird"), zenoh.CongestionControl.BLOCK  # behind ten megabytes, too
    for data in (b"{", b"[" * 10_000_000, b'{"name":"bird"}'):
        field.me.session.put(key, data, congestion_control=block)
    good = swarm.Obstacle(name="bird", t=time.time(), what=ball, ttl=3.0)
    field.me.session.put(key, wire.encode(good), congestion_control=block)
    await until(lambda: field.agent.context.world.find("bird") is not None, "no bird", PATIENCE_S)
    assert any("refused" in event.kind for event in field.agent.context.events)
    await until(lambda: field.agent.context.world.find("bird") is None, "the bird stays", PATIENCE_S)


async def test_previews_are_so_many_at_a_time(field: Field) -> None:
    planner, preview = await field.planner(), swarm.Preview(goal=swap(10.0))
    results = await asyncio.gather(*(planner.order("preview", preview) for _ in range(8)), return_exceptions=True)
    refused = [result for result in results if isinstance(result, Refused)]
    assert 0 < len(refused) <= 8 - MOST_PREVIEWS
    assert all(isinstance(result, dict) for result in results if result not in refused)


async def test_a_flood_of_obstacles_leaves_the_log_short_and_none_is_for_ever(field: Field) -> None:
    planner, begun = await field.planner(), time.time()
    for i in range(300):
        post = swarm.Cylinder(center=(500.0 + 3.0 * i, 500.0), radius=1.0, floor=0.0, ceiling=9.0)
        told = swarm.Obstacle(name=f"post{i}", t=9e10, what=post)
        field.me.session.put(keys.OBSTACLE.key("demo", name=told.name), wire.encode(told))
        field.me.session.put(keys.OBSTACLE.key("demo", name=told.name), b"{}")
    await within(PATIENCE_S, _until(lambda: field.agent.context.world.find("post299") is not None))
    assert sum(event.t > begun and event.kind in ("world", "refused") for event in field.agent.context.events) < 25
    gone = swarm.GiveObstacle(obstacle=swarm.Obstacle(name="post7", t=time.time(), what=None))
    assert (await planner.order("obstacle", gone))["news"], "whatever time who put it there believed it to be"
    _forget_all(field)


async def test_who_is_not_heard_at_first_is_gone_without(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    real = resting.heard
    monkeypatch.setattr(resting, "heard", lambda *asked: asked[1] != "quad4" and real(*asked))
    monkeypatch.setattr(running, "LASTING", 1.0)
    there, before = field.fleet.places()["quad1"], field.fleet.places()["quad4"]
    to = [(there[0] - 4.0, there[1], there[2]), (there[0] - 4.0, there[1] - 6.0, there[2])]
    name = await field.submit(swarm.GoTo(vehicles=["quad1", "quad4"], to=to))
    with pytest.raises(AssertionError, match="the others are there; without quad4"):
        await field.until(name, lambda entry: entry.state == "done")
    assert field.away("quad1", to[0]) < 0.7
    assert field.away("quad4", before) < 0.7
    name = await field.submit(swarm.Land(vehicles=["quad1", "quad4"]))
    other = field.me.vehicle("quad1")
    await other.wait_until(lambda s: s.mode == "LAND", PATIENCE_S)
    with field.fleet.quickly():
        with pytest.raises(AssertionError, match="the others are there; without quad4"):  # nobody else is kept up
            await field.until(name, lambda entry: entry.state == "done")
        await other.wait_until(lambda s: s.armed is False and s.lease is None, PATIENCE_S)
    await field.fleet.up_again(other, there)


async def test_a_fault_of_its_own_does_not_end_its_life(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    def fault() -> None:
        monkeypatch.undo()
        raise LookupError("oops")

    monkeypatch.setattr(field.agent.context.fleet, "watch", fault)
    await within(PATIENCE_S, _until(lambda: any("oops" in event.text for event in field.agent.context.events)))
    name = await field.submit(swarm.Hold(vehicles=["quad1"]))
    await field.until(name, lambda entry: entry.state == "done")


async def test_a_namesake_is_told_of_once(field: Field) -> None:
    field.agent.on_book(b"{")
    for _ in range(2):
        field.agent.on_book(wire.encode(swarm.Book(t=0.0, planner="ground", instance="another", term=0)))
    assert sum("is called ground, too" in event.text for event in field.agent.context.events) == 1


async def test_the_fleet_files_fence_is_there_and_a_wrong_origin_is_named(field: Field) -> None:
    fence = swarm.Geofence(polygon=[(-9.0, -9.0), (9.0, -9.0), (0.0, 9.0)], floor=0.0, ceiling=50.0)
    aside = Agent(field.me, PlannerSettings(name="aside", geofence=fence))
    assert [each.name for each in aside.context.world.obstacles] == ["fleet-file"]
    state = field.me.vehicle("quad1").state
    far = msgspec.structs.replace(state, name="far", local=(2e5, 0.0, -10.0))
    aside.context.fleet.last["far"] = (far, time.monotonic())
    with pytest.raises(BadInput, match="far is 200 km from the fleet's origin"):
        check_known(aside.context, swarm.Hold(vehicles=["far"]))


@pytest.mark.parametrize(("told", "known", "state"), [(True, 2, "queued"), (False, 0, "paused")])
async def test_who_takes_over_knows_the_obstacles_or_flies_nothing(
    field: Field, told: bool, known: int, state: str
) -> None:
    """Anyone who was killed has been started again under its name, and says that nothing is in the way."""
    aside = Agent(field.me, PlannerSettings(name="aside"))
    trees = [
        swarm.Obstacle(name=name, t=1.0, what=swarm.Cylinder(center=(0.0, 9.0), radius=1.0, floor=0.0, ceiling=9.0))
        for name in ("oak", "elm")
    ]
    goal = swarm.GoalEntry(id="g1", goal=swarm.Hold(vehicles=["quad1"]), state="flying", t=0.0)
    mine: dict[str, Any] = {"t": 1.0, "planner": "dead"}
    if told:
        aside.on_map(wire.encode(swarm.ObstacleMap(**mine, instance="before", obstacles=trees)))  # sooner than its book
    aside.on_book(wire.encode(swarm.Book(**mine, instance="before", term=1, obstacles=2, goals=[goal])))
    aside.on_map(wire.encode(swarm.ObstacleMap(**mine, instance="again", obstacles=[])))
    aside.on_book(wire.encode(swarm.Book(**mine, instance="again", term=1)))
    book = aside.context.charge.take()
    assert book is not None
    aside.check_map(book, again := aside.context.ledger.take_over(book, check_goal))
    assert len(aside.context.world.obstacles) == known
    assert [entry.state for entry in again] == [state]


async def test_one_planner_commands_however_many_there_are(field: Field) -> None:
    """A second one that believes to be in charge as well: the higher term is, and the other lets go at once."""
    name = await field.submit(swap(12.0))
    await field.until(name, lambda entry: entry.state == "flying")
    own = PlannerSettings(name="other", patience=1.0)
    async with zmav.open(connect=[field.fleet.endpoint]) as z, Agent(z, own) as other:
        await within(PATIENCE_S, _until(lambda: other.context.charge.of == "ground"))
        assert not other.context.charge.in_charge
        assert any(entry.id == name for entry in other.context.book().goals), "a standby keeps the book"
        with pytest.raises(Refused, match="ground is in charge"):
            await Planner(field.me, {"planner": "other"}).order("submit", swarm.Submit(goal=swap(10.0)))
        other.take_charge()  # as it would on the far side of a torn network
        await within(PATIENCE_S, _until(lambda: not field.agent.context.charge.in_charge))
        assert field.agent.runs == {}
        assert field.agent.context.charge.of == "other"
        (entry,) = [entry for entry in other.context.ledger.goals if entry.id == name]
        await within(PATIENCE_S, other.context.solver.until_ready())
        await within(PATIENCE_S, _until(lambda: entry.state in ("done", "failed", "cancelled")))
        assert (entry.state, entry.text) == ("done", "done")
    await within(PATIENCE_S, _until(lambda: field.agent.context.charge.in_charge))
    for vehicle, place in zip(swap(12.0).vehicles, swap(12.0).to, strict=True):
        assert field.away(vehicle, place) < 1.0


async def _until(true: Callable[[], bool]) -> None:
    while not true():
        await asyncio.sleep(0.05)

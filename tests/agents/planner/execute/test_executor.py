"""Plans flown by simulated copters: over a network that loses a third, by a planner that is killed, under a pilot."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.planner.execute.executor import Executor
from agents.planner.execute.flight import Flight, Trouble
from agents.planner.execute.offset import Offset
from agents.planner.execute.vehicle_command import PINGS
from agents.planner.model.problem import Motion
from tests.agents.planner.execute.fleet import BadClient, Fleet, airborne, starting
from tests.agents.planner.execute.virtual import carousel, crossing
from zmav.errors import NotHolder, Refused, TimedOut, ZmavError

RADIUS, DOWNWASH, HEIGHT = 0.6, 1.5, 10.0
ROOT = Path(__file__).resolve().parents[4]


def flight(motions: dict[str, Motion], margin: float = 1.0) -> Flight:
    return Flight(motions, dict.fromkeys(motions, RADIUS), dict.fromkeys(motions, 2.5), DOWNWASH, margin)


def named(motions: dict[str, Motion]) -> dict[str, Motion]:
    return {f"quad{i + 1}": motion for i, motion in enumerate(motions.values())}


def starts(motions: dict[str, Motion]) -> list[tuple[float, float]]:
    return [(float(motion[0, 2]), float(motion[0, 1])) for motion in motions.values()]


async def test_a_swap_over_a_network_that_loses_a_third_and_is_cut_for_two_seconds() -> None:
    motions = named(crossing(np.random.default_rng(4), 3, 8.0, 2.0 * (RADIUS + 1.2)))
    async with airborne(starts(motions), HEIGHT) as fleet, fleet.watch() as watch:
        async with BadClient(fleet.endpoint, 0.3, (0.05, 0.2)) as z:
            await z.wait_for(*fleet.names)
            async with Executor(z, fleet.names, taking=30.0) as executor:
                made = flight(motions, margin=1.2)
                flying = asyncio.create_task(executor.run(made))
                await watch.until(lambda: watch.moved() > 0.3 or flying.done(), "nobody moves")
                z.cut = True
                await asyncio.sleep(2.0)
                z.cut = False
                outcome = await flying
        assert z.lost > 20
    assert outcome.done, outcome.reason
    assert outcome.replans == 0
    # Half a metre, or what was learnt of each: over such a network they are seen late, and so farther off their ways.
    assert all(made.near(name, away, executor.followings[name].within) for name, away in outcome.away.items())
    assert watch.least(DOWNWASH) > 2.0 * RADIUS


PLANNER = """
import asyncio, json, sys
import numpy as np
import zmav
from agents.planner.execute.executor import Executor
from tests.agents.planner.execute.test_executor import flight

async def main():
    motions = {name: np.array(rows) for name, rows in json.load(open(sys.argv[2])).items()}
    async with zmav.open(connect=[sys.argv[1]]) as z:
        await z.wait_for(*motions)
        async with Executor(z, motions) as executor:
            print("ready", flush=True)
            await executor.run(flight(motions))

asyncio.run(main())
"""


async def test_a_planner_killed_in_mid_swap_leaves_everybody_at_rest_and_apart(tmp_path: Path) -> None:
    motions = named(carousel(3, 5.0, turn=2.5, speed=3.0))
    plan = tmp_path / "plan.json"
    plan.write_text(json.dumps({name: motion.tolist() for name, motion in motions.items()}))
    async with airborne(starts(motions), HEIGHT) as fleet, fleet.watch() as watch:
        planner = await asyncio.create_subprocess_exec(
            sys.executable, "-c", PLANNER, fleet.endpoint, str(plan), cwd=ROOT
        )
        try:
            await watch.until(lambda: watch.moved() > 2.0, "nobody moves")
            planner.send_signal(signal.SIGKILL)
            await planner.wait()
            await watch.until(lambda: watch.still(1.0), "they do not come to rest")
        finally:
            if planner.returncode is None:
                planner.kill()
                await planner.wait()
        modes = {fleet.z.vehicle(name).state.mode for name in fleet.names}
    assert watch.least(DOWNWASH) > 2.0 * RADIUS
    assert modes == {"GUIDED"}


async def test_what_cannot_begin_is_refused_and_what_a_pilot_takes_is_not_fought_but_planned_again() -> None:
    motions = named(carousel(3, 6.0, turn=2.0, speed=2.0))
    said: list[str] = []
    troubles: list[Trouble] = []

    async def replan(trouble: Trouble) -> Flight:
        """Those who are left stay where they are."""
        troubles.append(trouble)
        return flight({name: np.array([[0.0, *place]]) for name, place in trouble.places.items()})

    def say(kind: str, severity: str, text: str, detail: dict[str, Any]) -> None:
        said.append(kind)

    async with (
        airborne(starts(motions), HEIGHT) as fleet,
        fleet.watch() as watch,
        Executor(fleet.z, fleet.names, say=say, replan=replan) as executor,
    ):
        await refused(fleet, executor, motions)
        assert watch.moved() < 0.5
        flying = asyncio.create_task(executor.run(flight(motions)))
        await watch.until(lambda: watch.moved() > 2.0, "nobody moves")
        fleet.world.call(lambda: fleet.world.vehicles[0].pilot_mode("LOITER"))
        outcome = await flying
        mode = fleet.world.vehicles[0].status().mode
        assert executor.commands["quad1"].put(np.zeros((2, 7)), 0.0) is None
    assert (outcome.done, outcome.replans) == (True, 1)
    assert mode == "LOITER"
    assert "halt" in said
    (trouble,) = troubles
    assert set(trouble.places) == {"quad2", "quad3"}
    assert set(trouble.gone) == {"quad1"}
    assert any(why in trouble.reason for why in ("LOITER", "no trajectory of ours"))  # whichever it hears first
    assert watch.least(DOWNWASH) > 2.0 * RADIUS


async def refused(fleet: Fleet, executor: Executor, motions: dict[str, Motion]) -> None:
    """Too little margin, a wrong start, another's lease."""
    with pytest.raises(Refused, match=r"keeps 0\.10 m of margin, and quad1 needs 0\.[4-9]"):
        await executor.run(flight(motions, margin=0.1))
    with pytest.raises(Refused, match="quad9 is not under this executor's lease"):
        await executor.run(flight({"quad9": motions["quad1"]}))
    swapped = dict(zip(motions, reversed(list(motions.values())), strict=True))
    with pytest.raises(Refused, match=r"quad1 is 10\.\d m from where its motion begins"):
        await executor.run(flight(swapped))
    with pytest.raises(NotHolder, match="planner"):
        await Executor(fleet.z, ["quad1"], holder="rival").__aenter__()


class Asking:
    """In the place of a client: how often a vehicle was asked for its time."""

    def __init__(self, z: Any) -> None:
        self._z, self.pings = z, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._z, name)

    async def ask(self, key: str, *rest: Any, **more: Any) -> Any:
        self.pings += key.endswith("/do/ping")
        return await self._z.ask(key, *rest, **more)


async def test_a_clock_that_is_known_well_is_asked_for_once_and_one_that_was_set_is_learnt_again() -> None:
    offset = Offset()
    async with starting([(0.0, 0.0)]) as fleet:
        z: Any = Asking(fleet.z)
        async with Executor(z, fleet.names, offsets={"quad1": offset}):
            assert z.pings >= PINGS
        value, before = offset.value, z.pings
        async with Executor(z, fleet.names, offsets={"quad1": offset}):
            assert before < z.pings < before + PINGS
        wrong = Offset()
        now = time.time()
        wrong.answered(now, now + value + 7.0, now)  # as it was before it was set back by 7 s
        async with Executor(z, fleet.names, offsets={"quad1": wrong}) as executor:
            assert wrong.value == pytest.approx(value, abs=0.02)
            assert wrong.error(executor.clock.now()) < 0.02


class Shy:
    """In the place of a helm: some do not answer when they are asked for their lease."""

    silent: dict[str, ZmavError]

    def __init__(self, z: Any, name: str, *rest: Any) -> None:
        self.name, self.asked = name, 0

    async def __aenter__(self) -> Shy:
        self.asked += 1
        if self.name in self.silent:
            raise self.silent[self.name]
        return self

    async def __aexit__(self, *exc: object) -> None:
        given_back.append(self.name)


given_back: list[str] = []


async def test_of_many_those_that_do_not_answer_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.planner.execute.executor.VehicleCommand", Shy)
    nobody, z = TimedOut("it does not answer"), Any
    Shy.silent = {"c": nobody}
    async with Executor(z, "abc", taking=0.05) as executor:  # type: ignore[arg-type]
        assert (set(executor.commands), executor.left) == ({"a", "b"}, {"c": nobody})
    cases: list[tuple[dict[str, ZmavError], str, type[ZmavError]]] = [
        ({"b": nobody, "c": nobody}, "abc", TimedOut),  # not most
        ({"a": nobody}, "a", TimedOut),
        ({"c": NotHolder("another has it")}, "abc", NotHolder),
        ({"c": NotHolder("the pilot has it", reason="pilot")}, "abc", NotHolder),
    ]
    for silent, names, error in cases:
        Shy.silent = silent
        given_back.clear()
        with pytest.raises(error):
            await Executor(z, names, taking=0.05).__aenter__()  # type: ignore[arg-type]
        assert set(given_back) == set(names) - set(silent)

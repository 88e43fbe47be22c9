"""The solver's process: it plans, and whatever becomes of it, anyone who waits hears so and it is there again."""

from __future__ import annotations

import asyncio
import io
import os
import signal
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agents.planner.goals.steps import FleetView, VehicleView
from agents.planner.live import jobs
from agents.planner.live.solver import GRACE, Solver, SolverDied
from agents.planner.live.worker import SolverProcess
from agents.planner.model.deadline import WALL
from agents.planner.model.errors import PlanError
from agents.planner.model.scene import Bounds, Box, NoFly, Scene, Vehicle
from tests.waiting import until
from zmav.config import body_of
from zmav.errors import BadInput, TimedOut, ZmavError
from zmav.waiting import within
from zmav.wire import swarm

PATIENCE_S = 60.0
BOUNDS = Bounds(min=(-50.0, -50.0, 0.0), max=(50.0, 50.0, 40.0))


def scene(*goals: tuple[float, float, float]) -> Scene:
    vehicles = [
        Vehicle(id=f"v{i}", type="copter", start=(6.0 * i, 0.0, 10.0), goal=goal, radius=1.0, vmax=5.0, amax=2.5)
        for i, goal in enumerate(goals)
    ]
    wall = Box(min=(-10.0, 10.0, 0.0), max=(20.0, 14.0, 30.0))
    return Scene(vehicles=vehicles, obstacles=[wall], bounds=BOUNDS, downwash=1.5)


async def test_it_is_the_planners_own_wherever_that_was_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python looks for what is run by '-m' in the folder it is started in first: nobody's 'agents' there is taken for
    ours, and ours through a link there would have its kernels compiled again.
    """
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").write_text("raise SystemExit('somebody else is called agents, too')")
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    async with Solver(said.append) as solver:
        await solver.until_ready(PATIENCE_S)
    assert not [text for text in said if "ended" in text]


async def test_it_plans_dies_and_plans_again() -> None:
    said: list[str] = []
    async with Solver(said.append) as solver:
        await solver.until_ready(PATIENCE_S)
        over = scene((0.0, 30.0, 10.0), (6.0, 30.0, 10.0))
        motions, judged = await solver.do(jobs.Solve(over))
        assert judged.ok and judged.makespan == max(motion[-1, 0] for motion in motions.values())
        assert motions["v0"][-1, 1:].tolist() == [0.0, 30.0, 10.0]
        through = {name: np.array([(t, x, min(y, 12.0), 10.0) for t, x, y, _ in way]) for name, way in motions.items()}
        judged = await solver.do(jobs.Judge(over, through))
        assert not judged.ok
        assert judged.faults

        with pytest.raises(PlanError) as bad:
            await solver.do(jobs.Solve(scene((0.0, 12.0, 10.0))))
        assert (bad.value.kind, bad.value.ids) == ("goal_in_obstacle", ["v0"])
        goal = swarm.GoTo(vehicles=["nobody"], to=[(0.0, 0.0, -10.0)])
        view = FleetView(
            {"v0": VehicleView(name="v0", kind="copter", body=body_of("copter"), pos_ned=(0.0, 0.0, -9.0))}
        )
        with pytest.raises(BadInput, match="no vehicle nobody is known"):
            await solver.do(jobs.Resolve(goal, view, Scene(vehicles=[], bounds=BOUNDS), None))

        pid = solver.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)  # it hangs, with a job in its pipe; and then it dies of it
        job = asyncio.ensure_future(solver.do(jobs.Solve(over)))
        await asyncio.sleep(0)
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(SolverDied, match="ended with -9"):
            await within(PATIENCE_S, _of(job))
        assert any("started again" in text for text in said)

        await solver.until_ready(PATIENCE_S)
        assert solver.pid != pid
        os.kill(solver.pid or 0, signal.SIGSTOP)
        with pytest.raises(TimedOut, match="given up"):
            await solver.do(jobs.Solve(over, seconds=(0.2 - GRACE) / WALL))
        assert not solver.ready


async def test_uncompiled_it_is_ready_at_once_and_plans_for_three_in_the_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    turned = scene((12.0, 0.0, 10.0), (0.0, 0.0, 10.0), (6.0, 0.0, 10.0))
    turned.obstacles = []
    async with Solver(print) as solver:
        await solver.until_ready(PATIENCE_S)
        motions, judged = await solver.do(jobs.Solve(turned))
    assert len(motions) == 3
    assert judged.ok


async def test_one_that_cannot_be_started_just_now_is_started_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    said: list[str] = []
    with monkeypatch.context() as patched:
        patched.setattr("sys.executable", "/nothing/there")
        solver = await Solver(said.append).__aenter__()
        await until(lambda: any("cannot be started" in text for text in said), said, PATIENCE_S)
    await solver.until_ready(PATIENCE_S)
    await solver.__aexit__()


async def test_one_that_hangs_is_given_up_however_large_its_job_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    forest = scene((0.0, 30.0, 10.0))
    forest.obstacles = [Box(min=(-10.0, 10.0, 0.0), max=(20.0, 14.0, 30.0), name=f"tree {k}") for k in range(20_000)]
    async with Solver(print) as solver:
        await solver.until_ready(PATIENCE_S)
        os.kill(solver.pid or 0, signal.SIGSTOP)
        with pytest.raises(TimedOut, match="given up"):
            await within(PATIENCE_S, solver.do(jobs.Solve(forest, seconds=(0.2 - GRACE) / WALL)))
        assert not solver.ready


async def _of(job: asyncio.Future[jobs.JudgedPlan]) -> jobs.JudgedPlan:
    return await job


def test_typed_errors_cross_the_pipe() -> None:
    out = io.BytesIO(jobs.frame(PlanError("unreachable", ["a"], "no way")))
    error = jobs.read(out)
    assert isinstance(error, PlanError)
    assert (error.kind, error.ids, error.message) == ("unreachable", ["a"], "no way")
    wrong = jobs.read(io.BytesIO(jobs.frame(BadInput.wrong("at", (1.0, 2.0), "one place for each"))))
    assert isinstance(wrong, BadInput)
    assert wrong.message == "at is (1.0, 2.0); expected one place for each"
    assert wrong.detail == {"field": "at", "value": (1.0, 2.0), "expected": "one place for each"}


def test_numbers_of_no_world_are_a_typed_error_before_a_map_is_made_of_them() -> None:
    wrong = msgspec.structs.replace(scene((0.0, 30.0, 10.0)), bounds=Bounds(min=(-1e308,) * 3, max=(1e308,) * 3))
    failed = served(jobs.Solve(wrong, seconds=2.0))
    assert failed.detail["kind"] == "invalid_scene" and "bounds" in failed.message


def test_a_scene_that_cannot_be_judged_is_a_typed_error_too() -> None:
    wrong = scene((0.0, 30.0, 10.0))
    wrong.obstacles = [NoFly(polygon=[], floor=0.0, ceiling=5.0)]
    assert served(jobs.Solve(wrong)).detail["kind"] == "invalid_scene"


class Odd(SolverProcess):
    """Finds what does not go through a pipe."""

    def do(self, job: jobs.Job[Any]) -> Any:
        if isinstance(job, jobs.Judge):
            raise BadInput("wrong", value=lambda: None)
        return lambda: None


@pytest.mark.parametrize("job", [jobs.Judge(scene(), {}), jobs.Solve(scene())])
def test_what_cannot_be_told_is_a_fault_that_is_told_and_ends_nothing(job: jobs.Job[Any]) -> None:
    assert "the solver's own fault" in served(job, Odd).message


def served(job: jobs.Job[Any], process: type[SolverProcess] = SolverProcess) -> ZmavError:
    out = io.BytesIO()
    process(out).serve(7, job)
    out.seek(0)
    failed = jobs.read(out)
    assert isinstance(failed.result, ZmavError)
    return failed.result

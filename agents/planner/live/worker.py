"""The solver's process: jobs in by standard input, answers out by standard output, one job after another.

It ends when its parent is gone, in the middle of a job, too. What the static map knows is kept from job to job.
"""

from __future__ import annotations

import math
import os
import queue
import sys
import threading
import time
import traceback
from typing import Any, BinaryIO

from agents.planner.goals import goals
from agents.planner.goals.steps import Step
from agents.planner.live import jobs
from agents.planner.model import verify
from agents.planner.model.errors import PlanError
from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan
from agents.planner.model.scene import Bounds, Fence, Obstacle, Scene, check
from agents.planner.model.staticmap import StaticMap
from agents.planner.solve import jit, pipeline, warm
from zmav.errors import ZmavError


class SolverProcess:
    """Does the jobs."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._static: StaticMap | None = None
        self._key: tuple[Bounds, Fence | None, list[Obstacle]] | None = None

    def warm(self) -> None:
        """Load every stage and have its kernels compiled, by planning for a few vehicles; not where they never are."""
        if not jit.interpreted():
            warm.flown(warm.warm(tell=self._compiling).trajectories)
        jobs.write(self._out, jobs.Ready())

    def _compiling(self, done: int, of: int) -> None:
        jobs.write(self._out, jobs.Compiling(done, of))

    def serve(self, number: int, job: jobs.Job) -> None:
        try:
            jobs.write(self._out, jobs.Done(number, self._do(number, job)))
        except PlanError as e:
            jobs.write(self._out, jobs.Failed(number, e.code, e.message, {"kind": e.kind, "ids": e.ids}))
        except ZmavError as e:
            jobs.write(self._out, jobs.Failed(number, e.code, e.message, e.detail))
        except Exception as e:  # a fault of ours is told like any other: the next job has a map of its own
            traceback.print_exc()
            self._static = None
            jobs.write(self._out, jobs.Failed(number, ZmavError.code, f"the solver's own fault: {e!r}"))

    def _do(self, number: int, job: jobs.Job) -> jobs.JudgedPlan | list[Step] | jobs.Judgement:
        if isinstance(job, jobs.Solve):
            plan = self.solve(job)
            if plan.error is not None:  # the scene itself may be none that can be judged
                return plan, jobs.Judgement(False, None, 0.0, (plan.error.message,))
            jobs.write(self._out, jobs.Solved(number))
            return plan, judge(jobs.Judge(job.scene, plan.trajectories, job.movers))
        if isinstance(job, jobs.Judge):
            return judge(job)
        return list(goals.resolve(job.goal, job.view, job.scene, self._map(job.scene), job.floor))

    def solve(self, job: jobs.Solve) -> Plan:
        start = time.monotonic()
        try:
            check(job.scene)  # before anything is counted by its numbers
            static = self._map(job.scene)
            return pipeline.solve(job.scene, static=static, movers=job.movers, seconds=job.seconds)
        except PlanError as e:
            return Plan.failed(e, time.monotonic() - start)

    def _map(self, scene: Scene) -> StaticMap:
        """The map of the scene's obstacles: the last one, where nothing has changed."""
        key = (scene.bounds, scene.geofence, scene.obstacles)
        if self._static is None or self._key != key:
            self._static, self._key = StaticMap(world_of(scene)), key
        return self._static


def judge(job: jobs.Judge) -> jobs.Judgement:
    """No plan leaves unverified, and by how much it passes is told."""
    report = verify.verify(job.scene, job.trajectories, job.movers)
    clearance = report.clearance if math.isfinite(report.clearance) else None
    return jobs.Judgement(report.ok, clearance, report.makespan, tuple(str(fault) for fault in report.faults[:20]))


def _listen(pipe: BinaryIO, waiting: queue.SimpleQueue[Any]) -> None:
    try:
        while True:
            waiting.put(jobs.read(pipe))
    except (EOFError, OSError):
        os._exit(0)  # our parent is gone: nobody waits for what is being done


def main() -> None:
    """Serve until standard input ends. What libraries print goes to standard error: standard output is the pipe."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, waiting), daemon=True).start()
    worker = SolverProcess(out)
    try:
        worker.warm()
        while True:
            worker.serve(*waiting.get())
    except BaseException:
        traceback.print_exc()
        os._exit(1)  # without a wait for the thread that reads


if __name__ == "__main__":
    main()

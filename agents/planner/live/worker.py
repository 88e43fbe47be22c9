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
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from agents.planner.execute.commit import Entry, Order, Part, Reserved
from agents.planner.execute.offset import Offset
from agents.planner.execute.track import Profile, Track
from agents.planner.goals import goals
from agents.planner.goals.steps import Step
from agents.planner.live import jobs
from agents.planner.model import verify
from agents.planner.model.errors import PlanError
from agents.planner.model.geometry import world_of
from agents.planner.model.plans import Plan, Sample
from agents.planner.model.scene import Bounds, Fence, Obstacle, Scene, check
from agents.planner.model.staticmap import StaticMap
from agents.planner.solve import jit, pipeline, warm
from zmav.errors import ZmavError

Terrain = tuple[float, float, float, float]
TOLERANCE = 0.01
"""m"""


class Worker:
    """Does the jobs."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._static: StaticMap | None = None
        self._key: tuple[Bounds, Fence | None, Terrain | None] | None = None
        self._obstacles: list[Obstacle] = []
        self._said = 0.0

    def warm(self) -> None:
        """Load every stage and have its kernels compiled, by planning for a few vehicles; not where they never are."""
        start = time.monotonic()
        if not jit.interpreted():
            _warm_execution(warm.warm())
        jobs.write(self._out, jobs.Ready(time.monotonic() - start))

    def serve(self, number: int, job: jobs.Job) -> None:
        try:
            jobs.write(self._out, jobs.Done(number, self._do(job)))
        except PlanError as e:
            jobs.write(self._out, jobs.Failed(number, e.code, e.message, {"kind": e.kind, "ids": e.ids}))
        except ZmavError as e:
            jobs.write(self._out, jobs.Failed(number, e.code, e.message, e.detail))
        except Exception as e:  # a fault of ours is told like any other: the next job has a map of its own
            traceback.print_exc()
            self._static = None
            jobs.write(self._out, jobs.Failed(number, ZmavError.code, f"the solver's own fault: {e!r}"))

    def _do(self, job: jobs.Job) -> Plan | list[Step] | jobs.Judgement:
        if isinstance(job, jobs.Solve):
            return self.solve(job)
        if isinstance(job, jobs.Judge):
            report = verify.verify(job.scene, job.trajectories, job.movers)
            words = (*(str(fault) for fault in report.faults[:20]), *too_low(job.trajectories, job.terrain))
            clearance = report.clearance if math.isfinite(report.clearance) else None
            return jobs.Judgement(not words, clearance, report.makespan, words)
        return list(goals.resolve(job.goal, job.view, job.scene, self._map(job.scene, job.terrain)))

    def solve(self, job: jobs.Solve) -> Plan:
        start = time.monotonic()
        try:
            check(job.scene)  # before anything is counted by its numbers
            static = self._map(job.scene, job.terrain)
            return pipeline.solve(
                job.scene, static=static, movers=job.movers, seconds=job.seconds, seed=job.seed, progress=self._news
            )
        except PlanError as e:
            return Plan.failed(e, time.monotonic() - start)

    def _map(self, scene: Scene, terrain: Terrain | None) -> StaticMap:
        """The map of the scene's obstacles: the last one, changed in place, where its frame is the same."""
        key = (scene.bounds, scene.geofence, terrain)
        if self._static is None or self._key != key:
            self._static, self._key = StaticMap(world_of(scene, terrain)), key
        elif scene.obstacles != self._obstacles:
            added = [each for each in scene.obstacles if each not in self._obstacles]
            removed = [each for each in self._obstacles if each not in scene.obstacles]
            self._static.update(added, removed)
        self._obstacles = list(scene.obstacles)
        return self._static

    def _news(self, stage: str, share: float) -> None:
        now = time.monotonic()
        if now - self._said > 0.1:
            self._said = now
            jobs.write(self._out, jobs.News(stage, share))


def too_low(trajectories: Mapping[str, list[Sample]], terrain: Terrain | None) -> list[str]:
    """Who comes nearer to the terrain than its clearance: over a plane, straight pieces are lowest at their ends."""
    found = []
    height, east, north, clearance = terrain or (-math.inf, 0.0, 0.0, 0.0)
    for name, samples in trajectories.items():
        depth, t = max((height + east * x + north * y + clearance - z, t) for t, x, y, z in samples)
        if depth > TOLERANCE:
            found.append(f"{name} is {clearance - depth:.2f} m above the terrain at {t:.2f} s, {clearance:g} are kept")
    return found


def _warm_execution(plan: Plan) -> None:
    """What the agent's own process calls when a plan is flown: it must not stop to compile then."""
    parts = []
    for name, samples in plan.trajectories.items():
        part = Part(name, Track(np.array(samples, dtype=np.float64)), 1.0, 2.5, 0.3, Offset())
        row = np.array([0.0, *samples[0][1:], 0.0, 0.0, 0.0])
        part.entries.append(Entry(Profile.resting(0.0, 1.0), np.array([row, row + np.eye(7)[0]]), 1.0, 1.0))
        parts.append(part)
    Order(parts, 1.5)
    for part in parts:
        Reserved(parts, 1.5).blocker(part, part.known, 0.0)


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
    worker = Worker(out)
    try:
        worker.warm()
        while True:
            worker.serve(*waiting.get())
    except BaseException:
        traceback.print_exc()
        os._exit(1)  # without a wait for the thread that reads


if __name__ == "__main__":
    main()

"""The solver's process: jobs in by standard input, answers out by standard output, one job after another.

It ends when its parent is gone, in the middle of a job, too. What the static map knows is kept from job to job.
"""

from __future__ import annotations

import os
import queue
import sys
import threading
import traceback
from typing import Any, BinaryIO

from agents.planner.goals import goals
from agents.planner.live import jobs
from agents.planner.model.geometry import world_of
from agents.planner.model.scene import Bounds, Fence, Obstacle, Scene, check
from agents.planner.model.staticmap import StaticMap
from agents.planner.model.verify import verify
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
            warm.load_numba()
            warm.flown(warm.warm(tell=self._compiling).motions())
        jobs.write(self._out, jobs.Ready())

    def _compiling(self, done: int, of: int) -> None:
        jobs.write(self._out, jobs.Compiling(done, of))

    def serve(self, number: int, job: jobs.Job[Any]) -> None:
        try:
            data = jobs.frame(jobs.Done(number, self._ended(job)))
        except Exception as e:  # a fault of ours is told like any other: the next job has a map of its own
            traceback.print_exc()
            self._static = None
            data = jobs.frame(jobs.Done(number, ZmavError(f"the solver's own fault: {e!r}")))
        jobs.send(self._out, data)

    def _ended(self, job: jobs.Job[Any]) -> Any:
        """What was found, or the typed error of what cannot be."""
        try:
            return self.do(job)
        except ZmavError as e:
            return e

    def do(self, job: jobs.Job[Any]) -> Any:
        """What was found; raises the typed error of what cannot be. No plan is found that the verifier objects to."""
        if isinstance(job, jobs.Judge):
            return verify(job.scene, job.motions, job.movers)
        if isinstance(job, jobs.Solve):
            check(job.scene)  # before anything is counted by its numbers
            return pipeline.Pipeline(job.scene, self._map(job.scene), job.movers, job.seconds).run()
        assert isinstance(job, jobs.Resolve)
        return list(goals.resolve(job.goal, job.view, job.scene, self._map(job.scene), job.floor))

    def _map(self, scene: Scene) -> StaticMap:
        """The map of the scene's obstacles: the last one, where nothing has changed."""
        key = (scene.bounds, scene.geofence, scene.obstacles)
        if self._static is None or self._key != key:
            self._static, self._key = StaticMap(world_of(scene)), key
        return self._static


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

"""The solver's process as the agent has it: a job at a time, killed and restarted when it dies or takes too long."""

from __future__ import annotations

import asyncio
import contextlib
import pickle
import sys
import time
from collections.abc import Callable
from typing import Any

from agents.planner.live import jobs
from agents.planner.model.deadline import WALL
from agents.planner.solve import jit
from zmav.errors import TimedOut, ZmavError
from zmav.waiting import cancelled, within

ROOT = jit.PACKAGE.parents[1]
"""where the process is started: in another folder Python might find other packages called agents, ours through a link
among them, for which all kernels would be compiled again
"""
START_LIMIT = 600.0
"""s to load and to compile kernels on a machine that never did"""
GRACE = 5.0
"""s beyond its own limit after which a job is given up"""
OTHER_JOBS = 30.0
"""s for a job that has no limit of its own"""
AGAIN = (0.1, 1.0, 5.0, 15.0)
"""s before it is started again, by how often it has died without doing a job in between"""


class SolverDied(ZmavError):
    """The process ended in the middle of a job; it is started again by itself."""

    code = "solver"


class Solver:
    """``async with Solver(say)``; ``say(text)`` is told of starts and deaths. Lives on the event loop."""

    def __init__(self, say: Callable[[str], None], name: str = "solver") -> None:
        self._say, self._name = say, name
        self._process: asyncio.subprocess.Process | None = None
        self._ready = asyncio.Event()
        self.doing = "loads"
        """before it is ready, in words"""
        self._turn = asyncio.Lock()
        self._number = 0
        self._job: asyncio.Future[Any] | None = None
        self._keeper: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Solver:
        self._keeper = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, *exc: object) -> None:
        await cancelled(self._keeper)
        if self._job is not None and not self._job.done():
            self._job.set_exception(SolverDied(f"the {self._name} was ended"))

    @property
    def ready(self) -> bool:
        """It is warm, and alive as far as known."""
        return self._ready.is_set()

    @property
    def pid(self) -> int | None:
        return self._process.pid if self._process else None

    async def until_ready(self, timeout: float = START_LIMIT) -> None:
        """Raises :class:`TimedOut`."""
        try:
            await within(timeout, self._ready.wait())
        except asyncio.TimeoutError:
            raise TimedOut(f"the {self._name} was not ready within {timeout:.0f} s") from None

    async def do(self, job: jobs.Job[jobs.T]) -> jobs.T:
        """Have a job done; raises its typed error, :class:`SolverDied`, or :class:`TimedOut` when it was given up.

        Who stops waiting for it does not end it: loading the process again would take longer than most jobs do.
        """
        seconds = WALL * job.seconds if isinstance(job, jobs.Solve) else OTHER_JOBS
        work = asyncio.ensure_future(self._work(job, seconds))
        work.add_done_callback(_look)
        return await asyncio.shield(work)

    async def _work(self, job: jobs.Job[jobs.T], seconds: float) -> jobs.T:
        async with self._turn:
            await self.until_ready()
            process = self._process
            assert process is not None
            assert process.stdin is not None
            self._number += 1
            self._job = answer = asyncio.get_running_loop().create_future()
            try:
                process.stdin.write(jobs.frame((self._number, job)))  # not waited for: one that hangs reads nothing
                await asyncio.wait({answer}, timeout=seconds + GRACE)
                if answer.done():
                    found: jobs.T = answer.result()
                    return found
                self._kill(process)
                raise TimedOut(f"the {self._name} had no answer after {seconds + GRACE:.0f} s: given up")
            finally:
                self._job = None

    def _kill(self, process: asyncio.subprocess.Process) -> None:
        """It is not asked any more from now on, and started again."""
        self._ready.clear()
        with contextlib.suppress(ProcessLookupError):
            process.kill()

    async def _keep(self) -> None:
        """Have a process running, for ever."""
        died = 0
        while True:
            done = self._number
            try:
                how = f"ended with {await self._run()}"
            except OSError as e:  # no memory or no handles for it just now
                how = f"cannot be started ({e})"
            finally:
                self._ready.clear()
            died = 0 if self._number > done else died + 1
            if self._job is not None and not self._job.done():
                self._job.set_exception(SolverDied(f"the {self._name} {how} in the middle of its work"))
            wait = AGAIN[min(died, len(AGAIN) - 1)]
            self._say(f"the {self._name} {how}; it is started again in {wait:g} s")
            await asyncio.sleep(wait)

    async def _run(self) -> int:
        """One life of the process; its exit code."""
        start, self.doing = time.monotonic(), "loads"
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "agents.planner.live.worker",
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            start_new_session=True,
            limit=2**24,
            cwd=ROOT,
        )
        try:
            assert process.stdout is not None
            with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
                while True:
                    (size,) = jobs.HEAD.unpack(await process.stdout.readexactly(jobs.HEAD.size))
                    self._take(pickle.loads(await process.stdout.readexactly(size)), start)
            return await process.wait()
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _take(self, message: object, start: float) -> None:
        if isinstance(message, jobs.Compiling):
            self.doing = f"compiles itself for this machine, once: {message.done} of {message.of} kernels"
            self._say(f"the {self._name} {self.doing}")
        elif isinstance(message, jobs.Ready):
            what = "load" if self.doing == "loads" else "load and compile"
            self._say(f"the {self._name} is ready ({time.monotonic() - start:.1f} s to {what})")
            self._ready.set()
        elif isinstance(message, jobs.Done):
            if self._job is None or self._job.done() or message.number != self._number:
                return  # of a job that was given up
            if isinstance(message.result, ZmavError):
                self._job.set_exception(message.result)
            else:
                self._job.set_result(message.result)


def _look(task: asyncio.Future[Any]) -> None:
    """So that asyncio does not complain where nobody waits for it any more."""
    if not task.cancelled():
        task.exception()

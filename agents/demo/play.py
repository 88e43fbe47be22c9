"""Plays a demo's story: its steps one after the other, watched from the ground and by the simulator's truth."""

from __future__ import annotations

import asyncio
import contextlib
import fnmatch
import importlib.util
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

import zmav
from agents.demo.stage import DemoFleet
from agents.demo.story import Demo, Step, Wait, called, matching, words
from agents.demo.watch import Truth, Watch
from zmav import keys, wire
from zmav.children import Children, connect_once_up
from zmav.errors import TimedOut, ZmavError
from zmav.subscription import document
from zmav.waiting import alongside

LOOK = 0.1
"""s between two looks at whether a step is over"""
RECORDER = "recorder"


class Mark(NamedTuple):
    """A moment of the story, s since its beginning, that its picture shows."""

    t: float
    text: str


class Play:
    """One performance. :meth:`run` returns when the story is over; what went wrong is raised in words."""

    def __init__(self, demo: Demo, stage: DemoFleet, processes: Children, out: Path, console: Console) -> None:
        self.demo, self.stage, self.processes, self.out, self.console = demo, stage, processes, out, console
        self.truth = Truth(demo.vehicles)
        self.marks: list[Mark] = []
        self.watch: Watch | None = None
        self._brief: list[str] = []
        """what was started and may end by itself"""

    async def run(self) -> None:
        async with contextlib.AsyncExitStack() as stack:
            await self.stage.start()
            z = await connect_once_up(stack, self.demo.fleet.fleet, self.stage.ground, self.processes.check)
            self._record()
            self.watch = Watch(z, tuple(self.demo.vehicles))
            async with alongside(self.watch.run()):
                with self.truth.watching(self.stage.control):
                    await self._ready(z)
                    for step in self.demo.story.steps:
                        await self._step(z, step)
                        self._gone()
            self.processes.end(RECORDER, 20.0)

    def _record(self) -> None:
        """Beside everything else; without its package there are .tlog files alone."""
        more = () if importlib.util.find_spec("mcap") else ("--no-mcap",)
        where = self.stage.environment("ground")
        how = ("--out", str(self.out / "recording"), "--keep-free", "100MB", *more)
        self.processes.start(RECORDER, "record", *how, environment=where)

    def judge(self) -> None:
        """Raise :class:`ZmavError` where two came nearer than the story allows, or nobody can say whether they did."""
        least, truth = self.demo.story.apart, self.truth
        if least is not None and not truth.whole:
            raise ZmavError(f"the simulator did not tell until the end where all were; {least:g} m apart was asked")
        if least is not None and truth.closest < least:
            a, b = truth.pair
            raise ZmavError(f"{a} and {b} came as near as {truth.closest:.2f} m; {least:g} m was asked")

    async def _ready(self, z: zmav.Client) -> None:
        names = self.demo.vehicles
        self._tell(f"waiting until {len(names)} vehicles are there and ready")
        await self._watched(z.wait_for(*names, timeout=self.demo.story.ready))
        for name in names:
            until = z.vehicle(name).wait_until(lambda s: s.ready is True and s.local is not None, self.demo.story.ready)
            await self._watched(until)
        self._mark("ready")

    async def _watched(self, waiting: Coroutine[Any, Any, object]) -> None:
        """Wait, but not for processes that are gone."""
        async with alongside(waiting) as (task,):
            while not task.done():
                self.processes.check()
                await asyncio.wait({task}, timeout=LOOK)
            await task

    # ---- the steps

    async def _step(self, z: zmav.Client, step: Step) -> None:
        if step.say is not None:
            self._tell(step.say)
        if step.run is not None:
            await self._run(step, step.run)
        elif step.start is not None:
            self._command(step, step.start)
            words_, where = self._words(step.start), self.stage.environment(step.on)
            self.processes.start(called(step), *words_, environment=where, may_end=step.ends)
            if step.ends:
                self._brief.append(called(step))
            if step.until is not None:
                await self._said(called(step), step.until, step.within)
        elif step.stop is not None:
            self._mark(f"kill -9 {step.stop}")
            self.processes.kill(step.stop)
        elif step.join is not None:
            await self._join(step.join, step.within)
        elif step.wait is not None:
            await self._wait(z, step.wait, step.within)
        elif step.pause is not None:
            await self._watched(asyncio.sleep(step.pause))
        for pairs, through in ((step.cut, False), (step.mend, True)):
            for pair in pairs or ():
                self._mark(f"{'mended' if through else 'cut'}: {pair[0]} - {pair[1]}")
                self.stage.cut(pair, through)

    def _gone(self) -> None:
        """Say who of those that may end has ended not as it should: it may matter to what comes."""
        for name in list(self._brief):
            code = self.processes.ended(name)
            if code is not None:
                self._brief.remove(name)
                if code != 0:
                    self._tell(f"{name} ended with {code}: {self.processes.said(name, 1)}")

    async def _run(self, step: Step, command: str) -> None:
        self._command(step, command)
        name = f"{len(self.marks)} {' '.join(words(command)[:3])}"
        process = self.processes.start(
            name, *self._words(command), may_end=True, environment=self.stage.environment(step.on)
        )
        told = 0

        def ended() -> bool:
            nonlocal told
            told = self._echo(name, told)
            return process.poll() is not None

        await self._until(ended, step.within, lambda: f"'{command}' was not done within {step.within:g} s")
        self._echo(name, told)
        if step.refused and process.returncode == 0:
            raise ZmavError(f"'{command}' was done, but should have been refused")
        if not step.refused and process.returncode != 0:
            raise ZmavError(f"'{command}' ended with {process.returncode}")

    async def _join(self, name: str, within: float) -> None:
        await self._until(
            lambda: self.processes.ended(name) is not None, within, lambda: self._not_yet(name, "end", within)
        )
        self._mark(f"{name} has ended")

    async def _said(self, name: str, text: str, within: float) -> None:
        told = 0

        def said() -> bool:
            nonlocal told
            told = self._echo(name, told)
            return any(text in line for line in self.processes.lines(name)[:told])

        await self._until(said, within, lambda: self._not_yet(name, f"say {text!r}", within))

    def _not_yet(self, name: str, what: str, within: float) -> str:
        return f"{name} did not {what} within {within:g} s; it said last:\n{self.processes.said(name)}"

    async def _until(self, true: Callable[[], bool], within: float, words: Callable[[], str]) -> None:
        """Look until it is so, but not for processes that are gone. Raises :class:`TimedOut` with those words."""
        deadline = time.monotonic() + within
        while not true():
            self.processes.check()
            if time.monotonic() > deadline:
                raise TimedOut(words())
            await asyncio.sleep(LOOK)

    def _echo(self, name: str, told: int) -> int:
        """Say the lines that it has said since; how many there were."""
        lines = self.processes.lines(name)
        for line in lines[told:]:
            self.console.print(f"    {line}", markup=False, highlight=False, style="dim", soft_wrap=True)
        return len(lines)

    async def _wait(self, z: zmav.Client, wait: Wait, within: float) -> None:
        names = matching(self.demo, wait.vehicles)
        heard: dict[str, str] = {}

        async def hear() -> None:
            async for key, status in statuses:
                heard[key.split("/")[2]] = status.state

        def missing() -> list[str]:
            return [name for name in names if not holds(z.vehicle(name), wait, heard.get(name))]

        key = keys.AGENT_STATUS.key(z.fleet_name, "*", agent=wait.agent or "none")
        async with z.subscribe(key, document(wire.AgentStatus)) as statuses, alongside(hear()):
            await self._until(lambda: not missing(), within, lambda: _late(wait, missing(), within))
        self._mark(_words_of(wait, names))

    # ---- what is said

    def _words(self, command: str) -> list[str]:
        places = {
            "{sim}": str(self.stage.control),
            "{cameras}": self.stage.cameras,
            "{out}": str(self.out),
            "{here}": str(self.demo.path.resolve().parent),
        }
        found = words(command)
        for name, value in places.items():
            found = [word.replace(name, value) for word in found]
        return found

    def _command(self, step: Step, command: str) -> None:
        where = "" if step.on == "ground" else f"{step.on}: "
        self.console.print(
            f"{where}$ {command}{' &' if step.start else ''}", markup=False, highlight=False, style="bold"
        )
        self._mark(" ".join(words(command)[:3]), quiet=True)

    def _tell(self, text: str) -> None:
        self.console.print(f"[{self.now():5.1f} s] {text}", markup=False, highlight=False, soft_wrap=True)

    def _mark(self, text: str, quiet: bool = False) -> None:
        self.marks.append(Mark(self.now(), text))
        if not quiet:
            self._tell(text)

    def now(self) -> float:
        """s since it began."""
        return time.monotonic() - self.truth.begun


def holds(vehicle: zmav.Vehicle, wait: Wait, agent_state: str | None) -> bool:
    """Whether all of it is true of that vehicle, by what was last heard."""
    state, age = vehicle.last_state, vehicle.age
    old = age is None or age > (keys.STATE.stale_after or 0.0)
    if wait.stale is not None and old != wait.stale:
        return False
    if wait.stale:
        return True
    if state is None or old:
        return False
    return (
        (wait.mode is None or (state.mode or "").lower() in [mode.lower() for mode in wait.mode])
        and (wait.armed is None or state.armed == wait.armed)
        and (wait.pilot is None or (state.pilot is not None) == wait.pilot)
        and (wait.agent is None or (agent_state is not None and fnmatch.fnmatch(agent_state, wait.state or "*")))
    )


def _late(wait: Wait, missing: list[str], within: float) -> str:
    return f"within {within:g} s it did not come about: {_words_of(wait, missing)}"


def _words_of(wait: Wait, names: list[str]) -> str:
    who = ", ".join(names) if len(names) <= 4 else f"{len(names)} vehicles"
    what = [
        f"in {' or '.join(wait.mode)}" if wait.mode else "",
        _either(wait.armed, "armed", "disarmed"),
        _either(wait.pilot, "with their pilots", "with nobody's hand on the switch"),
        _either(wait.stale, "not heard any more", "heard again"),
        f"{wait.agent}: {wait.state}" if wait.agent else "",
    ]
    return f"{who} {' and '.join(filter(None, what))}"


def _either(value: bool | None, yes: str, no: str) -> str:
    return "" if value is None else yes if value else no

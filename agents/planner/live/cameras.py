"""The cameras of a survey: each autopilot triggers its own by distance while its vehicle flies the lanes."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from agents.planner.goals.steps import Fly, Pictures, Step
from agents.planner.live.leased_vehicles import GoalUnderWay, LeasedVehicles
from zmav import wire
from zmav.errors import Stale, TimedOut, ZmavError
from zmav.waiting import cancelled, together

LOOK = 0.2
"""s between two looks: shorter than what is sent ahead of a vehicle that goes on, so that it goes on with its camera"""


async def check_cameras(leased: LeasedVehicles, steps: Sequence[Step]) -> None:
    """Raise what a vehicle says that cannot trigger its camera, before anybody moves: each is told to stop it. Those
    that were lost since are not asked.
    """
    names = {name for step in steps if isinstance(step, Fly) for name in _triggered(step.pictures)}
    await together(*(_tell(leased, name, 0.0) for name in sorted(names & leased.commands.keys())))


class Cameras:
    """``async with Cameras(run, leased, pictures)``: on while it lasts, but not while all rest in a pause, and the
    vehicles look along their lanes.

    Raises what a vehicle says that does not switch its camera on. A vehicle switches it off by itself when our lease
    ends: so nothing is asked of it where the flight ends by an error, and one of which we have another lease is told
    again.
    """

    def __init__(self, run: GoalUnderWay, leased: LeasedVehicles, pictures: Mapping[str, Pictures]) -> None:
        self._run, self._leased, self._pictures = run, leased, pictures
        self._triggered = _triggered(pictures)
        self._told: dict[str, tuple[int, float]] = {}
        """the lease, and the distance that was told under it"""
        self._said: dict[str, str] = {}
        self._keeping: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Cameras:
        await together(*(self._tell(name, metres) for name, metres in self._triggered.items()))
        for name, pictures in self._pictures.items():
            self._leased.commands[name].heading = pictures.heading
        if self._triggered:
            self._keeping = asyncio.create_task(self._keep())
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        for name in self._pictures:
            self._leased.commands[name].heading = None
        await cancelled(self._keeping)
        if kind is None:
            await self._tell_all(dict.fromkeys(self._triggered, 0.0))

    async def _keep(self) -> None:
        while True:
            await asyncio.sleep(LOOK)
            await self._tell_all(dict.fromkeys(self._triggered, 0.0) if self._leased.paused else self._triggered)

    async def _tell_all(self, wanted: Mapping[str, float]) -> None:
        """Those that were not told so under the lease in force; who refuses is left alone, and it is said."""
        leases = {name: self._leased.commands[name].lease for name in wanted}
        news = [name for name, lease in leases.items() if lease and self._told.get(name) != (lease, wanted[name])]
        results = await asyncio.gather(*(self._tell(name, wanted[name]) for name in news), return_exceptions=True)
        for name, result in zip(news, results, strict=True):
            if isinstance(result, TimedOut | Stale):
                del self._told[name]  # and once more at the next look
            if isinstance(result, ZmavError) and self._said.get(name) != result.message:
                self._said[name] = result.message
                text = f"{self._run.entry.id}: the camera of {name}: {result.message}"
                self._run.context.say("camera", "warning", text, goal=self._run.entry.id, vehicle=name)

    async def _tell(self, name: str, metres: float) -> None:
        self._told[name] = (self._leased.commands[name].lease, metres)
        await _tell(self._leased, name, metres)


def _triggered(pictures: Mapping[str, Pictures]) -> dict[str, float]:
    """By vehicle whose autopilot is to trigger its camera: m."""
    return {name: each.every for name, each in pictures.items() if each.every > 0.0}


async def _tell(leased: LeasedVehicles, name: str, metres: float) -> None:
    await leased.vehicle(name).order("camera_trigger", wire.CameraTrigger(distance=metres))

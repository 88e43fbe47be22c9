"""What verbs do with every vehicle that matches, side by side."""

from __future__ import annotations

import asyncio
import fnmatch
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from zmav.cli.common import Work, tell
from zmav.cli.progress import Progress
from zmav.errors import BadInput, NoSuchVehicle, ZmavError

if TYPE_CHECKING:
    from zmav.client import Client
    from zmav.vehicle import Vehicle

HEARD_S = 5.0
"""s for a vehicle that is named to be heard"""
Line = dict[str, Any]
"""a result; with an ``error`` and a ``message`` where it failed"""


async def matching(z: Client, pattern: str) -> list[Vehicle]:
    """The vehicles a name or shell pattern means; raises :class:`NoSuchVehicle` naming those present."""
    if not any(c in pattern for c in "*?["):
        if not pattern:
            raise BadInput("no vehicle is named", field="vehicles", value=pattern, expected="a name or a pattern")
        return await z.wait_for(pattern, timeout=HEARD_S)
    known = await z.settle()
    found = [v for v in known if fnmatch.fnmatchcase(v.name, pattern)]
    if not found:
        present = ", ".join(v.name for v in known) or "nobody"
        raise NoSuchVehicle(f"no vehicle matches {pattern!r}; present: {present}")
    return found


async def one(z: Client, name: str) -> Vehicle:
    """The vehicle of that name, once it has been heard."""
    return (await z.wait_for(name, timeout=HEARD_S))[0]


async def attempt(work: Awaitable[Line], **about: Any) -> Line:
    """What the work gives, or how it failed; ``about`` stands before either."""
    try:
        return {**about, **await work}
    except ZmavError as e:
        in_force = {"in_force": e.detail["in_force"]} if "in_force" in e.detail else {}
        return {**about, "error": e.code, "message": e.message, **in_force}


async def for_each(vehicles: list[Vehicle], work: Callable[[Vehicle], Awaitable[list[Line]]]) -> list[Line]:
    """Every vehicle's lines, in the order of the vehicles, each with its name first."""
    found = await asyncio.gather(*map(work, vehicles))
    return [{"vehicle": v.name, **line} for v, lines in zip(vehicles, found, strict=True) for line in lines]


def on_all(
    pattern: str,
    what: str,
    work: Callable[..., Awaitable[Line]],
    words: Callable[[Line], str],
    as_json: bool,
    parts: Sequence[Line] = ({},),
    file: str | None = None,
) -> Work:
    """A verb that does its work with all vehicles that match, side by side, and tells how each ended.

    ``work`` is given the vehicle, whom to tell how it goes, and each of ``parts`` by name; ``file``: where each one's
    goes.
    """

    async def do(z: Client) -> None:
        vehicles = await matching(z, pattern)
        if file is not None:
            check_apart(vehicles, file)
        with Progress(what, quiet=as_json) as progress:

            async def on_one(vehicle: Vehicle) -> list[Line]:
                tell = partial(progress.tell, vehicle.name)
                return [await attempt(work(vehicle, tell, **part), **part) for part in parts]

            lines = await for_each(vehicles, on_one)
        show(lines, lambda line: fault(line) if "error" in line else words(line), as_json)

    return do


def check_apart(vehicles: Sequence[Vehicle], file: str) -> None:
    """Raise :class:`BadInput` where several vehicles' would go to one file."""
    if len(vehicles) > 1 and "{vehicle}" not in file:
        names = ", ".join(vehicle.name for vehicle in vehicles)
        text = f"one file for {names}: put {{vehicle}} into its name"
        raise BadInput(text, field="file", value=file, expected="{vehicle}")


def fault(line: Line) -> str:
    """What failed, and why."""
    what = line.get("kind") or line.get("name")
    return f"{what} not done: {line['message']}" if what else f"not done: {line['message']}"


def show(lines: list[Line], words: Callable[[Line], str], as_json: bool) -> None:
    """Tell the lines; ends the program with 1 where any of them is a failure."""
    for line in lines:
        tell(as_json, line, f"{line['vehicle']}: {words(line)}")
    if any("error" in line for line in lines):
        raise SystemExit(1)


async def together(tasks: Sequence[Awaitable[Any]]) -> list[Any]:
    """All of them to their ends; then the first error, if any."""
    results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            raise result
    return list(results)

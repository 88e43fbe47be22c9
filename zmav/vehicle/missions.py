"""A vehicle's missions, fences and rally points, as a script sees them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from zmav import keys, wire
from zmav.errors import BadInput, Stale
from zmav.formats import plans
from zmav.mavlink import Dialect
from zmav.wire import MissionKind

if TYPE_CHECKING:
    from zmav.vehicle.vehicle import Vehicle

Progress = Callable[[dict[str, Any]], None]
KINDS: tuple[MissionKind, ...] = get_args(MissionKind)
AGAIN = 0.3
"""s before a plan that the vehicle is still reading is asked for again"""


class Missions:
    """``vehicle.missions``. Indices count from 0 without home, whatever the autopilot is.

    Raises what orders raise; :class:`~zmav.errors.BadInput` names every item at fault before anything is sent, and the
    ``in_force`` of a failed upload's detail says which plan the vehicle has: "old" or "unknown".
    """

    def __init__(self, vehicle: Vehicle, dialect: Dialect) -> None:
        self._vehicle, self._dialect = vehicle, dialect

    async def upload(
        self,
        what: Sequence[wire.MissionItem] | str | Path,
        kind: MissionKind | None = None,
        *,
        force: bool = False,
        progress: Progress | None = None,
    ) -> dict[MissionKind, dict[str, Any]]:
        """Replace whole plans: items (of ``kind``, a mission unless said), or all that a file (``.plan``,
        ``.waypoints``) holds, of ``kind`` alone where that is given. Returns what was done, by kind. ``force``: an
        operator's, beyond the usual bounds.
        """
        done: dict[MissionKind, dict[str, Any]] = {}
        by_kind = (
            plans_of(what, kind, self._dialect) if isinstance(what, (str, Path)) else {kind or "mission": list(what)}
        )
        for each, items in by_kind.items():
            args = wire.MissionUpload(kind=each, items=items, force=force)
            done[each] = await self._vehicle.order("mission_upload", args, progress)
        return done

    async def download(self, kind: MissionKind = "mission", *, progress: Progress | None = None) -> wire.Mission:
        """Read the plan again from the autopilot."""
        await self._vehicle.order("mission_download", wire.MissionRefresh(kind=kind), progress)
        return await self.get(kind)

    async def get(self, kind: MissionKind = "mission") -> wire.Mission:
        """The plan as the vehicle's companion knows it, with the item flown and the last one reached."""
        key = keys.MISSION.key(self._vehicle.fleet, self._vehicle.name, kind=kind)
        while True:
            try:
                return wire.decode(await self._vehicle._ask(key), wire.Mission, f"reply to mission/{kind}")
            except Stale as e:
                if not e.detail.get("reading"):
                    raise
                await asyncio.sleep(AGAIN)

    async def clear(self, kind: MissionKind = "mission") -> None:
        """Leave none of that kind."""
        await self._vehicle.order("mission_clear", wire.MissionClear(kind=kind))

    async def start(
        self, first: int = 0, *, wait_end: bool = False, force: bool = False, progress: Progress | None = None
    ) -> dict[str, Any]:
        """Fly the mission from item ``first`` on; with ``wait_end`` it returns at the mission's end, and raises
        :class:`~zmav.errors.Refused` when the pilot takes over.
        """
        return await self._vehicle.order(
            "mission_start", wire.MissionStart(first=first, wait_end=wait_end, force=force), progress
        )

    async def set_current(self, index: int) -> None:
        """Go on with item ``index``."""
        await self._vehicle.order("mission_current", wire.MissionJump(index=index))


def plans_of(file: str | Path, kind: MissionKind | None, dialect: Dialect) -> dict[MissionKind, list[wire.MissionItem]]:
    """What of a file is to be uploaded, by kind; a kind that it says nothing of, or has empty, is left alone.

    Raises :class:`BadInput` where there is nothing, or nothing of the ``kind`` that is asked for.
    """
    plan = plans.load(file, dialect.enums)
    found = {each: items for each in KINDS if (items := getattr(plan, each)) and kind in (None, each)}
    if not found:
        raise BadInput(f"{file} holds no {kind or 'items'}", field="kind", value=kind, expected="a plan with items")
    return found

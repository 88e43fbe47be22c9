"""A vehicle's parameters as scripts see them, and what differs between vehicles."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

import msgspec

from zmav import keys, wire
from zmav.errors import BadInput, TimedOut
from zmav.mavlink.paramvalue import Value, same
from zmav.services.params.values import digest

if TYPE_CHECKING:
    from zmav.vehicle.vehicle import Vehicle

Progress = Callable[[dict[str, Any]], None]
NAME_IN_KEY = frozenset("/*$#?")
ATTEMPTS = 3
"""times a set that changes while it is read is read again"""


class Params:
    """The parameters of one vehicle's autopilot, from the cache on the vehicle: reading costs the radio nothing.

    Raises as orders do, and :class:`~zmav.errors.BadInput` with names like it where there is no such parameter.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._known: wire.ParamTable | None = None

    async def list(self, progress: Progress | None = None) -> wire.ParamTable:
        """All of them; waits until the vehicle has read them. A second list of an unchanged set costs a line.

        Raises :class:`~zmav.errors.TimedOut` where the autopilot does not give them all.
        """
        for _ in range(ATTEMPTS):
            table = await self._ask()
            if table.complete:
                return table
            await self._vehicle.order("param_refresh", wire.ParamRefresh(), progress)
        raise TimedOut(f"{self._vehicle.name}: its parameters change all the time", vehicle=self._vehicle.name)

    async def refresh(self, progress: Progress | None = None) -> wire.ParamTable:
        """All of them, read again from the autopilot; ``progress`` is told ``received`` and ``count``."""
        await self._vehicle.order("param_refresh", wire.ParamRefresh(), progress)
        return await self.list(progress)

    async def get(self, name: str) -> wire.Param:
        """One parameter."""
        if not name or NAME_IN_KEY & set(name):
            raise BadInput(f"{name!r} cannot be a parameter's name", field="name", value=name, expected="a name")
        key = keys.PARAM.key(self._vehicle.fleet, self._vehicle.name, param=name)
        return wire.decode(await self._vehicle._ask(key), wire.Param, f"reply to param/{name}")

    async def set(self, name: str, value: float | int) -> wire.ParamChanged:
        """Set one and read it back. Raises :class:`~zmav.errors.Refused` where it is another than was set."""
        result = await self._vehicle.order("param_set", wire.ParamSet(name=name, value=value))
        return msgspec.convert(result, wire.ParamChanged)

    async def load(self, values: Mapping[str, float | int], progress: Progress | None = None) -> wire.ParamLoaded:
        """Set many; those that could not be are named with the reason, and the others are in force."""
        result = await self._vehicle.order("param_load", wire.ParamLoad(values=dict(values)), progress)
        return msgspec.convert(result, wire.ParamLoaded)

    def note(self, param: wire.Param) -> None:
        """Take in a value that was heard otherwise, say by its PARAM_VALUE: the next :meth:`list` costs a line, not
        the whole set once more. One that is not in the set, or whose set is not known, is let pass.
        """
        known = self._known
        if known is None or param.name not in {held.name for held in known.params}:
            return
        params = [param if held.name == param.name else held for held in known.params]
        self._known = msgspec.structs.replace(known, params=params, hash=digest(params))

    async def _ask(self) -> wire.ParamTable:
        known = self._known
        query = wire.encode(wire.ParamQuery(hash=known.hash if known else ""))
        answer = await self._vehicle._ask(keys.PARAMS.key(self._vehicle.fleet, self._vehicle.name), query)
        table = wire.decode(answer, wire.ParamTable, "reply to param")
        if table.unchanged and known is not None:
            table = msgspec.structs.replace(table, params=known.params, unchanged=False)
        self._known = table
        return table


class Difference(msgspec.Struct, frozen=True):
    """A parameter that is not the same everywhere: its value by column, without those that lack it."""

    name: str
    values: dict[str, Value]


def own_params(autopilot: str, names: Iterable[str]) -> set[str]:
    """Those of ``names`` that are each vehicle's own: its system id, and what the autopilot (``ardupilot``, ``px4``)
    writes by itself: counters, ids of sensors, measurements. Another vehicle's are no use to it.
    """
    from zmav.autopilots.ardupilot import ArduPilot  # beside what they load, which few who read parameters need
    from zmav.autopilots.px4 import Px4

    patterns = next((each.own_params for each in (ArduPilot, Px4) if each.name == autopilot), ())
    return {name for name in names for pattern in patterns if fnmatch.fnmatchcase(name, pattern)}


def values(table: wire.ParamTable) -> dict[str, Value]:
    """A set's values by name."""
    return {param.name: param.value for param in table.params}


def differences(columns: Mapping[str, Mapping[str, Value]], only: Iterable[str] | None = None) -> list[Difference]:
    """What differs between sets of values, by name. ``only``: no other names count, for instance those of a file."""
    names = set(only) if only is not None else {name for column in columns.values() for name in column}
    found = []
    for name in sorted(names):
        held = {title: column[name] for title, column in columns.items() if name in column}
        first = next(iter(held.values()), None)
        if len(held) < len(columns) or not all(same(first, value) for value in held.values()):
            found.append(Difference(name, held))
    return found

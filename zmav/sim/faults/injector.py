"""The faults that are on in a world, and when they end."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import msgspec

from zmav.errors import BadInput
from zmav.sim.faults.base import Fault, FaultStatus, Undo, Victim
from zmav.sim.faults.body import CameraBlackout
from zmav.sim.faults.table import KINDS
from zmav.sim.fleets.base import Seat
from zmav.sim.status import VehicleStatus

if TYPE_CHECKING:
    from zmav.sim.camera.cameras import Cameras
    from zmav.sim.external import Externals
    from zmav.sim.vehicle import SimVehicle

ALL = "all"


class _On(msgspec.Struct):
    """A fault that is on."""

    fault: Fault
    victim: Victim
    undo: Undo
    since_s: float
    until_s: float


class Victims(Protocol):
    """What there is in a world for faults to happen to, and its time."""

    externals: Externals

    @property
    def vehicles(self) -> Sequence[SimVehicle]: ...

    @property
    def cameras(self) -> Cameras | None: ...

    @property
    def time_s(self) -> float: ...


class Faults:
    """All of one world. Everything is called in the world's thread; a vehicle has each kind once at most."""

    def __init__(self, world: Victims, seed: int) -> None:
        self._world = world
        self._seed = seed
        self._on: dict[tuple[str, str], _On] = {}
        self._count = 0

    def put(self, name: str, fault: Fault, for_s: float | None = None) -> list[FaultStatus]:
        """Let ``fault`` happen to the vehicle called ``name`` ("all": to each), for ``for_s`` simulated seconds (None:
        until it is cleared). One of its kind that is on already gives way to it.

        Raises :class:`BadInput` for a vehicle that is not there or cannot have it, and for no time at all; nothing has
        changed then.
        """
        if for_s is not None and not 0.0 < for_s < math.inf:
            raise BadInput.wrong("for_s", for_s, "more than 0", f"{for_s} seconds")
        now = self._world.time_s
        victims = [self._victim(each, fault.KIND) for each in self._named(name)]
        for victim in victims:
            fault.check(victim)
            self._look_outside(victim.name, fault.KIND)
        found = []
        for victim in victims:
            self._end(victim.name, fault.KIND)
            on = _On(fault, victim, fault.begin(victim), now, math.inf if for_s is None else now + for_s)
            if not fault.ONCE:
                self._on[victim.name, fault.KIND] = on
            found.append(_status(on))
        return found

    def clear(self, name: str | None = None, kind: str | None = None) -> int:
        """End all faults, or those of one vehicle, of one kind, or of one kind of one vehicle; gives how many."""
        if kind is not None and kind not in KINDS:
            expected = ", ".join(KINDS)
            raise BadInput(f"no fault {kind!r}; there are {expected}", field="kind", value=kind, expected=expected)
        names = set(self._named(ALL if name is None else name))
        chosen = [key for key in self._on if key[0] in names and kind in (None, key[1])]
        for key in chosen:
            self._end(*key)
        return len(chosen)

    def all(self) -> list[FaultStatus]:
        """Those that are on, oldest first."""
        return [_status(on) for on in self._on.values()]

    def noted(self, vehicles: Sequence[VehicleStatus]) -> tuple[VehicleStatus, ...]:
        """The same, with the kinds that are on at each. Every thread may ask."""
        on = list(self._on)
        kinds = {name: tuple(kind for vehicle, kind in on if vehicle == name) for name, _ in on}
        return tuple(
            msgspec.structs.replace(status, faults=kinds[status.name]) if status.name in kinds else status
            for status in vehicles
        )

    def tick(self, now: float) -> None:
        """End what is over; costs nothing where nothing is on."""
        if not self._on:
            return
        for key, on in list(self._on.items()):
            if now >= on.until_s - 1e-9:
                self._end(*key)

    # ---- vehicles

    def _end(self, name: str, kind: str) -> None:
        on = self._on.pop((name, kind), None)
        if on is not None:
            on.undo()

    def _named(self, name: str) -> list[str]:
        seats = self._seats()
        if name == ALL:
            return list(seats)
        if name not in seats:
            expected = ", ".join(seats)
            raise BadInput(f"no vehicle {name!r}; there are {expected}", field="vehicle", value=name, expected=expected)
        return [name]

    def _seats(self) -> Mapping[str, Seat]:
        """The bodies of all vehicles, by name."""
        own = {vehicle.name: vehicle.node.seat for vehicle in self._world.vehicles}
        return own | {vehicle.name: Seat(vehicle.plant, 0) for vehicle in self._world.externals.vehicles}

    def _victim(self, name: str, kind: str) -> Victim:
        self._count += 1
        seed = f"{self._seed} {name} {kind} {self._count}"
        vehicle = next((v for v in self._world.vehicles if v.name == name), None)
        cameras = self._world.cameras
        camera = None if cameras is None else next((each for each in cameras.all if each.name == name), None)
        end = functools.partial(self._end, name)
        return Victim(name, self._seats()[name], vehicle, camera, seed, end, lambda: self._world.time_s)

    def _look_outside(self, name: str, kind: str) -> None:
        """:class:`BadInput` where a flight stack outside the simulator would notice nothing of it."""
        for vehicle in self._world.externals.vehicles:
            if vehicle.name == name and kind not in (*vehicle.feels, CameraBlackout.KIND):
                expected = ", ".join(sorted(vehicle.feels)) or "nothing: it flies on physics of its own"
                text = f"{name}: its flight stack does not have this {kind} from the simulator; what it has: {expected}"
                raise BadInput(text, field="kind", value=kind, expected=expected)


def _status(on: _On) -> FaultStatus:
    return FaultStatus(
        vehicle=on.victim.name,
        kind=on.fault.KIND,
        parameters=msgspec.structs.asdict(on.fault),
        since_s=on.since_s,
        until_s=on.until_s if math.isfinite(on.until_s) else None,
    )

"""Which vehicle a system id means: whom a client's frame goes to, and whose telemetry counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import zmav
from ground.gcs.kinds import Place, Track
from ground.gcs.options import Options
from zmav.autopilots import Autopilot, autopilot_named
from zmav.errors import Clash, NoSuchVehicle

RECENT = 30.0
"""s for which a system that is nobody's autopilot is remembered to be behind a vehicle"""
SILENT = 1.5
"""s without a frame after which another way to the same autopilot is taken"""
IDS = frozenset(range(1, 256))
MOST_TRACKS = 4096
"""systems of vehicles: invented ones must not fill the memory"""


class Known(NamedTuple):
    """A vehicle that is there."""

    place: Place
    sysid: int
    compid: int
    uid: str | None
    what: str
    """in words, for people"""
    autopilot: Autopilot

    @property
    def name(self) -> str:
        return self.place[1]


class Routes:
    """Renewed by :meth:`refresh` a few times a second; the rest may be called from any thread, for what is asked is
    replaced as a whole.

    Two agents whose autopilots have one uid are two ways to one autopilot: frames go and come by one of them, as long
    as it is heard. Two uids, or an unknown one, are two vehicles with one id.
    """

    def __init__(self, selected: Options, news: Callable[[str], None]) -> None:
        self._selected, self._news = selected, news
        self._odd: set[Place] = set()
        """with ids that no frame can have"""
        self._tracks: dict[tuple[Place, int], Track] = {}
        self.vehicles: dict[Place, Known] = {}
        self.systems: dict[int, tuple[Known, ...]] = {}
        """autopilots, by system id"""
        self.ways: dict[int, Place] = {}
        """of autopilots with several ways, the one in use"""

    def track(self, place: Place, sysid: int) -> Track:
        """What is heard of a system over a vehicle's agent, from now on."""
        new = Track(place, sysid)
        return self._tracks.setdefault((place, sysid), new) if len(self._tracks) < MOST_TRACKS else new

    def refresh(self, fleet: Iterable[zmav.Vehicle]) -> tuple[list[Known], list[Known]]:
        """Look who is there; who came, and who went. On one thread."""
        before, now, odd = self.vehicles, {}, set[Place]()
        systems: dict[int, list[Known]] = {}
        for vehicle in fleet:
            state = vehicle.last_state
            if state is None or state.sysid is None or not vehicle.present or not self._selected.sees(vehicle.name):
                continue
            place, compid = (vehicle.fleet, vehicle.name), state.compid or 1
            if not {state.sysid, compid} <= IDS:  # no frame could be made in its name
                odd.add(place)
                if place not in self._odd:
                    wrong = f"{compid} is no component id" if state.sysid in IDS else f"{state.sysid} is no system id"
                    self._news(f"{vehicle.name}: {wrong} (1 to 255): no station is told of it")
                continue
            recorded = "a recording, which takes no orders" if state.replayed else None
            words = ", ".join(filter(None, (f"system {state.sysid}", state.kind, state.autopilot, recorded)))
            rules = autopilot_named(state.autopilot, state.kind)
            known = Known(place, state.sysid, compid, state.uid, words, rules)
            now[known.place] = known
            systems.setdefault(known.sysid, []).append(known)
        self.ways = {sysid: self._way(found) for sysid, found in systems.items() if len(found) > 1 and _is_one(found)}
        self.vehicles, self.systems = now, {sysid: tuple(found) for sysid, found in systems.items()}
        self._odd = odd
        gone = [known for place, known in before.items() if place not in now]
        return [known for place, known in now.items() if place not in before], gone

    def everybody(self, sees: Callable[[str], bool]) -> list[Place]:
        """Where to send what is for all, of those whose names somebody ``sees``: each autopilot once."""
        return [
            place
            for place, known in self.vehicles.items()
            if sees(place[1]) and self._way_for(known.sysid, sees) in (None, place)
        ]

    def other_way(self, place: Place, sysid: int, compid: int) -> Place | None:
        """The way in use by which an autopilot's frames come, where it is not ``place``; None: they come by this one.

        Other components of its system may be heard by one way alone: theirs come by each.
        """
        way = self.ways.get(sysid)
        if way is None or way == place:
            return None
        used = self.vehicles.get(way)
        return way if used is not None and used.compid == compid else None

    def _way_for(self, sysid: int, sees: Callable[[str], bool]) -> Place | None:
        """The way in use, or one of those that somebody sees; None: the autopilot has not several."""
        way = self.ways.get(sysid)
        if way is None or sees(way[1]):
            return way
        return next((known.place for known in self.systems.get(sysid, ()) if sees(known.name)), way)

    def _way(self, found: Sequence[Known]) -> Place:
        """The way that is in use, while the autopilot is heard by it; else the one by which it was heard last."""
        heard = {known.place: self.track(known.place, known.sysid).heard for known in found}
        used = self.ways.get(found[0].sysid)
        if used in heard and time.monotonic() - heard[used] < SILENT:
            return used
        return max(heard, key=heard.__getitem__)

    def way_to(self, sysid: int, sees: Callable[[str], bool] = lambda name: True) -> Place:
        """The vehicle that frames for a system go to; of several ways to it one that somebody ``sees``, if there is.

        Raises :class:`Clash` that names those who claim the id, and :class:`NoSuchVehicle` where nobody was heard as
        it.
        """
        found = self.systems.get(sysid, ())
        if len(found) == 1:
            return found[0].place
        if found:
            way = self._way_for(sysid, sees)
            if way is None:
                raise clash(found)
            return way
        now, vehicles = time.monotonic(), self.vehicles
        heard = [
            track
            for (place, system), track in list(self._tracks.items())
            if system == sysid and place in vehicles and now - track.heard < RECENT
        ]
        if not heard:
            there = ", ".join(f"{each} {_names(known)}" for each, known in sorted(self.systems.items())) or "none"
            raise NoSuchVehicle(f"no vehicle has system id {sysid}; there are: {there}", sysid=sysid)
        return max(heard, key=lambda track: track.heard).place


def clash(found: Sequence[Known]) -> Clash:
    sysid = found[0].sysid
    return Clash(
        f"{_names(found)} both have system id {sysid}: nothing is sent to it until one is changed", sysid=sysid
    )


def _names(found: Sequence[Known]) -> str:
    return " and ".join(sorted(known.name for known in found))


def _is_one(found: Sequence[Known]) -> bool:
    """All are ways to one autopilot."""
    return found[0].uid is not None and len({known.uid for known in found}) == 1

"""Who stands where on the field, and is called what: names, system ids and starts of all vehicles of a world.

A vehicle without a name is called after its kind and numbered within it: ``quad1``, as 'zmav up' calls one that nobody
named, ``rover1``, ``px4-1``. One without a system id has its number among all vehicles, or the next that is free.
Multirotors stand in a row going east from the world's origin, rovers in another row south of it, and planes on a runway
of their own that leads past both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from zmav.errors import BadConfig
from zmav.sim.camera.spec import CameraSpec, PadSpec
from zmav.sim.environment import Vector
from zmav.sim.spec import ARDUCOPTER, ARDUPLANE, ARDUROVER, PX4, Home, VehicleSpec, check, kind_of

KINDS = {
    "copter": VehicleSpec(autopilot=ARDUCOPTER),
    "hexa": VehicleSpec(autopilot=ARDUCOPTER, airframe="hexa"),
    "rover": VehicleSpec(autopilot=ARDUROVER),
    "plane": VehicleSpec(autopilot=ARDUPLANE),
    "px4": VehicleSpec(autopilot=PX4),
}
CALLED = {"copter": "quad"}
"""of kinds, where not by the kind's own word"""
MOST_VEHICLES = 255
ROVERS_SOUTH = 2.0  # of the spacing, between the rows
RUNWAY_ASIDE, RUNWAY_WIDTH = 6.0, 3.0  # of the spacing: from the rows to the first plane, and between planes


def gather(vehicles: Sequence[VehicleSpec], counts: Mapping[str, int]) -> list[VehicleSpec]:
    """The vehicles named, and so many plain ones of each of :data:`KINDS`; one ArduCopter where nothing is asked for.
    :class:`BadConfig` for more than there are system ids.
    """
    specs = list(vehicles)
    for kind, count in counts.items():
        if count < 0:
            field = field_of(kind)
            raise BadConfig.wrong(field, count, "0 or more", f"{count} {field}")
        specs += [KINDS[kind]] * count
    specs = specs or [KINDS["copter"]]
    if len(specs) > MOST_VEHICLES:
        expected = f"1 to {MOST_VEHICLES}"
        text = f"{len(specs)} vehicles; expected {expected}: that is how many system ids there are"
        raise BadConfig(text, field="vehicles", value=len(specs), expected=expected)
    return specs


def field_of(kind: str) -> str:
    """What a count of that kind is called as an option."""
    return kind if kind == "px4" else f"{kind}s"


def line_up(specs: Sequence[VehicleSpec], home: Home, spacing_m: float) -> list[VehicleSpec]:
    """``specs`` with a name, a system id, an airframe, a start and a heading each. :class:`BadConfig` or
    :class:`BadKey` name what in them cannot be.
    """
    for i, spec in enumerate(specs):
        check(spec, spec.name or f"vehicle {i + 1}")
    names, sysids, starts = _names(specs), _sysids(specs), _starts(specs, home, spacing_m)
    return [
        msgspec.structs.replace(
            spec,
            name=name,
            sysid=sysid,
            start_ned_m=start,
            yaw_deg=home.yaw_deg if spec.yaw_deg is None else spec.yaw_deg,
        )
        for spec, name, sysid, start in zip(specs, names, sysids, starts, strict=True)
    ]


def _names(specs: Sequence[VehicleSpec]) -> list[str]:
    given = [spec.name for spec in specs if spec.name is not None]
    twice = next((name for name in given if given.count(name) > 1), None)
    if twice is not None:
        raise BadConfig.wrong("name", twice, "a name of its own for each", f"two vehicles are called {twice!r}")
    taken = set(given)
    numbers = dict.fromkeys(KINDS, 0)
    names = []
    for spec in specs:
        name, kind = spec.name, kind_of(spec)
        while name is None:
            numbers[kind] += 1
            word = CALLED.get(kind, kind)
            each = f"{word}-{numbers[kind]}" if word[-1].isdigit() else f"{word}{numbers[kind]}"
            name = None if each in taken else each
        names.append(name)
    return names


def _sysids(specs: Sequence[VehicleSpec]) -> list[int]:
    """Two that were given the same keep it: a clash is worth rehearsing."""
    taken = {spec.sysid for spec in specs if spec.sysid is not None}
    found = []
    for i, spec in enumerate(specs):
        sysid = spec.sysid
        if sysid is None:
            sysid = next(n for n in (i + 1, *range(1, MOST_VEHICLES + 1)) if n not in taken)
            taken.add(sysid)
        found.append(sysid)
    return found


def _starts(specs: Sequence[VehicleSpec], home: Home, spacing_m: float) -> list[Vector]:
    """On the ground, but for those that were told where."""
    yaw = math.radians(home.yaw_deg)
    # Planes roll and climb along the heading: beside the rows on the side where that leads past them, which is west of
    # the origin for a heading to the north or the south.
    side = 1.0 if math.cos(yaw) > -1e-9 else -1.0
    left = side * math.sin(yaw), -side * math.cos(yaw)
    places = {"rover": 0, "plane": 0, "multirotor": 0}
    starts: list[Vector] = []
    for spec in specs:
        row = kind_of(spec) if kind_of(spec) in ("rover", "plane") else "multirotor"
        place = places[row]
        places[row] += 1
        if row == "plane":
            aside = (RUNWAY_ASIDE + RUNWAY_WIDTH * place) * spacing_m
            north, east = aside * left[0], aside * left[1]
        else:
            north, east = -ROVERS_SOUTH * spacing_m if row == "rover" else 0.0, place * spacing_m
        starts.append(spec.start_ned_m or (north, east, 0.0))
    return starts


def equip(
    specs: Sequence[VehicleSpec], cameras: Mapping[str, CameraSpec], pads: Mapping[str, PadSpec]
) -> list[VehicleSpec]:
    """``specs``, which have names, with these cameras and pads, by vehicles' names. :class:`BadConfig` names a vehicle
    that is not there, or what is wrong with its camera or pad.
    """
    found = {spec.name or "": spec for spec in specs}
    for field, given in (("camera", cameras), ("pad", pads)):
        for name, each in given.items():
            if name not in found:
                expected = ", ".join(found)
                text = f"{field} for {name!r}, but there is no such vehicle; expected one of {expected}"
                raise BadConfig(text, field=field, value=name, expected=expected)
            found[name] = msgspec.structs.replace(found[name], **{field: each})
            check(found[name], name)
    return list(found.values())

"""Places as people type them: metres north and east of the fleet's origin and above it."""

from __future__ import annotations

import math
from typing import Any

import click

from zmav.wire import Vector, swarm


def numbers(text: str, least: int, most: int, form: str) -> list[float]:
    """Numbers with commas between them; raises click's error naming the form."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not least <= len(found) <= most or not all(map(math.isfinite, found)):
        raise click.BadParameter(f"{text!r} is not {form}")
    return found


class Place(click.ParamType[Any]):
    """``NORTH,EAST,HEIGHT`` -> NED."""

    name = "N,E,HEIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Vector:
        if not isinstance(value, str):
            return tuple(value)
        north, east, height = numbers(value, 3, 3, "N,E,HEIGHT: metres north and east of the origin and above it")
        return (north, east, -height)


class Offset(click.ParamType[Any]):
    """``FORWARD,RIGHT,UP`` (or north, east, up) -> with down."""

    name = "FORWARD,RIGHT,UP"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Vector:
        if not isinstance(value, str):
            return tuple(value)
        forward, right, up = numbers(value, 3, 3, "FORWARD,RIGHT,UP in metres")
        return (forward, right, -up)


class Ground(click.ParamType[Any]):
    """``NORTH,EAST``."""

    name = "N,E"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> swarm.Corner:
        if not isinstance(value, str):
            return tuple(value)
        north, east = numbers(value, 2, 2, "N,E: metres north and east of the origin")
        return (north, east)


class Polygon(click.ParamType[Any]):
    """``N,E N,E N,E``: three corners or more."""

    name = "N,E N,E ..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[swarm.Corner]:
        if not isinstance(value, str):
            return list(value)
        corners = [Ground().convert(part, param, ctx) for part in value.replace(";", " ").split()]
        if len(corners) < 3:
            raise click.BadParameter(f"a polygon has three corners or more: 'N,E N,E N,E', not {value!r}")
        return corners


def targets(arguments: tuple[str, ...]) -> tuple[list[str], list[Vector]]:
    """``quad1=10,20,15``: who, and where to; names without a place are only named."""
    names, places = [], []
    for argument in arguments:
        name, equals, place = argument.partition("=")
        names.append(name)
        if equals:
            places.append(Place().convert(place, None, None))
    if places and len(places) != len(names):
        raise click.UsageError("give each vehicle a place (quad1=10,20,15), or none and --to for each place")
    return names, places

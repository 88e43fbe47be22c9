"""Places as people type them: metres north and east of the fleet's origin and above it."""

from __future__ import annotations

import math

import click

from zmav.wire import Vector, swarm

PLACE, OFFSET, GROUND, POLYGON = "N,E,HEIGHT", "FORWARD,RIGHT,UP", "N,E", "'N,E N,E ...'"
"""what the options' help calls them"""


def place(text: str) -> Vector:
    """``NORTH,EAST,HEIGHT`` -> NED."""
    north, east, height = numbers(text, 3, f"{PLACE}: metres north and east of the origin and above it")
    return (north, east, -height)


def offset(text: str) -> Vector:
    """``FORWARD,RIGHT,UP`` (or north, east, up) -> the same with down."""
    forward, right, up = numbers(text, 3, f"{OFFSET} in metres")
    return (forward, right, -up)


def ground(text: str) -> swarm.Corner:
    """``NORTH,EAST``."""
    north, east = numbers(text, 2, f"{GROUND}: metres north and east of the origin")
    return (north, east)


def polygon(text: str) -> list[swarm.Corner]:
    """``N,E N,E N,E``: three corners or more."""
    corners = [ground(part) for part in text.replace(";", " ").split()]
    if len(corners) < 3:
        raise click.BadParameter(f"a polygon has three corners or more: 'N,E N,E N,E', not {text!r}")
    return corners


def numbers(text: str, count: int, form: str) -> list[float]:
    """So many numbers with commas between them; click's error names the form."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise click.BadParameter(f"{text!r} is not {form}")
    return found


def targets(arguments: tuple[str, ...]) -> tuple[list[str], list[Vector]]:
    """``quad1=10,20,15``: who, and where to; names without a place are only named."""
    names, places = [], []
    for argument in arguments:
        name, equals, where = argument.partition("=")
        names.append(name)
        if equals:
            places.append(place(where))
    if places and len(places) != len(names):
        raise click.UsageError("give each vehicle a place (quad1=10,20,15), or none and --to for each place")
    return names, places

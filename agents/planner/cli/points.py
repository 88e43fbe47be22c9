"""Places as people type them: metres north and east of the fleet's origin and above it."""

from __future__ import annotations

import click

from zmav.cli.places import numbers, place
from zmav.wire import Vector, swarm

GROUND, POLYGON = "N,E", "'N,E N,E ...'"
"""what the options' help calls them"""


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

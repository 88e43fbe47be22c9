"""Places and motions as people type them: metres north and east of the fleet's origin, and heights that count up."""

from __future__ import annotations

import math

import click

from zmav.wire import Vector

PLACE, MOTION, OFFSET = "N,E,ALT", "N,E,UP", "FORWARD,RIGHT,UP"
"""what the options' help calls them"""


def place(text: str) -> Vector:
    """``N,E,ALT`` -> NED."""
    return _downward(text, f"{PLACE}: metres north and east of the fleet's origin and above it, such as 20,0,10")


def motion(text: str) -> Vector:
    """``N,E,UP`` -> NED."""
    return _downward(text, f"{MOTION}: north, east and up with commas between them, such as 1,0,0.5")


def offset(text: str) -> Vector:
    """``FORWARD,RIGHT,UP`` -> forward, right, down."""
    return _downward(text, f"{OFFSET} in metres, such as -5,0,8")


def numbers(text: str, count: int, form: str) -> list[float]:
    """So many numbers with commas between them; click's error names the form."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise click.BadParameter(f"{text!r} is not {form}")
    return found


def _downward(text: str, form: str) -> Vector:
    north, east, up = numbers(text, 3, form)
    return (north, east, -up or 0.0)

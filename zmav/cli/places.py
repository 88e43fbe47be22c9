"""Places and motions as people type them: metres north and east of the fleet's origin, and heights that count up."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import click

from zmav.wire import Vector

F = TypeVar("F", bound=Callable[..., Any])
PLACE, MOTION, OFFSET = "N,E,ALT", "N,E,UP", "FORWARD,RIGHT,UP"
"""what the options' help calls them"""


def place(text: str) -> Vector:
    """``N,E,ALT`` -> NED."""
    return _downward(text, f"{PLACE}: metres north and east of the fleet's origin and above it, such as 20,0,10")


def motion(text: str) -> Vector:
    """``N,E,UP`` -> NED."""
    return _downward(text, f"{MOTION}: north, east and up with commas between them, such as 1,0,0.5")


def offset(text: str) -> Vector:
    """``FORWARD,RIGHT,UP`` (or north, east, up) -> the same with down."""
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


def renamed_option(name: str, nargs: int, instead: str) -> Callable[[F], F]:
    """A hidden option for what another tool, or an older habit, calls otherwise: it is refused with what to say."""

    def refuse(ctx: click.Context, param: click.Parameter, value: object) -> None:
        if value is not None:
            raise click.UsageError(f"there is no {name}: {instead}")

    return click.option(name, nargs=nargs, hidden=True, expose_value=False, callback=refuse, is_eager=True)


def _downward(text: str, form: str) -> Vector:
    north, east, up = numbers(text, 3, form)
    return (north, east, -up or 0.0)

"""Options that are numbers; apart, because what asks the planner loads the network."""

from __future__ import annotations

import math

import click


def refuse_endless(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Callback of an option: no range of click's leaves out NaN, and one without a greatest number takes infinity."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is no finite number.", context, parameter)
    return value

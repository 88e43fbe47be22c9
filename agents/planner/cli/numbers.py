"""Options that are numbers; apart, because what asks the planner loads the network."""

from __future__ import annotations

import math

import click


def refuse_nan(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Callback of an option: no range of click's leaves out NaN, and every comparison with it would pass or fail."""
    if value is not None and math.isnan(value):
        raise click.BadParameter(f"{value} is not a number.", context, parameter)
    return value

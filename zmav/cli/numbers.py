"""Options that are numbers; apart, because a verb that plans files loads no network."""

from __future__ import annotations

import math
from typing import Any

import click


class Between(click.FloatRange):
    """Numbers in a range. NaN, which is neither above nor below any, is none; nor is infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = super().convert(value, param, ctx)
        return found if math.isfinite(found) else self.fail(f"{value!r} is no finite number", param, ctx)

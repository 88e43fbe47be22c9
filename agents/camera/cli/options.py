"""What the verbs of ``zmav camera`` share: how sizes and rates are written, a camera's name."""

from __future__ import annotations

import re
from collections.abc import Callable

import click

from mesh.units import bits_per_second
from zmav.errors import BadInput

name_option = click.option(
    "--name", "camera", default="down", show_default=True, help="The camera's name on its vehicle."
)


def pair(sample: str) -> Callable[..., tuple[int, int]]:
    """An option's callback that reads two whole numbers: ``640x480``."""

    def read(ctx: click.Context, option: click.Parameter, text: str) -> tuple[int, int]:
        found = re.fullmatch(r"(\d{1,5})[x×](\d{1,5})", text.strip())
        if found is None:
            raise click.BadParameter(f"{text!r} is not like {sample}", ctx, option)
        return int(found[1]), int(found[2])

    return read


def triple(ctx: click.Context, option: click.Parameter, text: str | None) -> tuple[float, float, float] | None:
    """An option's callback that reads three numbers: ``0,90,0``."""
    if text is None:
        return None
    try:
        a, b, c = (float(each) for each in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not three numbers like 0,90,0", ctx, option) from None
    return a, b, c


def rate_bytes(ctx: click.Context, option: click.Parameter, text: str) -> float:
    """An option's callback that reads a rate, in B/s: ``60kB/s`` or ``480 kbit/s``."""
    try:
        return bits_per_second(text, option.name or "rate") / 8.0
    except BadInput as e:
        raise click.BadParameter(str(e), ctx, option) from e

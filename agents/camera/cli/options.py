"""What the verbs of ``zmav camera`` share: how sizes and rates are written, a line that changes, a camera's name."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable
from typing import Any

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


def amount(ctx: click.Context, option: click.Parameter, text: str) -> float:
    """An option's callback that reads a number of bytes: ``1GB``."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *(|k|M|G|T)B", text.strip())
    if found is None:
        raise click.BadParameter(f"{text!r} is not a number of bytes like 512MB", ctx, option)
    return float(found[1]) * {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}[found[2]]


class Line:
    """A line on standard output that changes, where there is a terminal; else a line each time."""

    def __init__(self) -> None:
        self._changes = sys.stdout.isatty()

    def show(self, text: str) -> None:
        if self._changes:
            width = shutil.get_terminal_size().columns - 1
            click.echo("\r\x1b[K" + text[:width], nl=False)
        else:
            click.echo(text)

    def end(self) -> None:
        if self._changes:
            click.echo("")


def words(value: Any, unit: str, form: str = ".0f") -> str:
    """A number with its unit; a dash for what is not known."""
    return "-" if value is None else f"{value:{form}} {unit}"

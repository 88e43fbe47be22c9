"""How ``zmav param`` shows values, differences and progress."""

from __future__ import annotations

import collections
import sys
from collections.abc import Sequence
from types import TracebackType

import click
from rich.table import Table

from zmav.mavlink.paramvalue import Value
from zmav.vehicle.params import Difference

MOST_COLUMNS = 6
"""vehicles side by side; more are gathered by their values"""
LACKS = "-"


def shown(value: Value) -> str:
    """A value for a person: 3 and not 3.0, nan for none."""
    if value is None:
        return "nan"
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def comparison(found: Sequence[Difference], columns: Sequence[str]) -> Table:
    """The names that differ, a column for each vehicle; of many vehicles who has which value, the commonest first."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("name", no_wrap=True)
    if len(columns) <= MOST_COLUMNS:
        for column in columns:
            table.add_column(column, justify="right", no_wrap=True)
        for each in found:
            table.add_row(each.name, *(shown(each.values[c]) if c in each.values else LACKS for c in columns))
        return table
    table.add_column(f"most of {len(columns)}", justify="right", no_wrap=True)
    table.add_column("the others")
    for each in found:
        table.add_row(each.name, *_gathered(each, columns))
    return table


def _gathered(each: Difference, columns: Sequence[str]) -> tuple[str, str]:
    holders = collections.defaultdict(list)
    for column in columns:
        holders[shown(each.values[column]) if column in each.values else LACKS].append(column)
    (most, who), *others = sorted(holders.items(), key=lambda pair: -len(pair[1]))
    return f"{most} ×{len(who)}", "; ".join(f"{value}: {' '.join(names)}" for value, names in others)


class Reading:
    """One line on a terminal's stderr that says how far each vehicle is."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._far: dict[str, str] = {}
        self._shows = sys.stderr.isatty()

    def tell(self, name: str, done: int | None, of: int | None) -> None:
        self._far[name] = f"{name} {done or 0}/{of or '?'}"
        if self._shows:
            click.echo(f"\r\x1b[K{self._what}: {', '.join(self._far.values())}"[:110], err=True, nl=False)

    def __enter__(self) -> Reading:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self._shows and self._far:
            click.echo("\r\x1b[K", err=True, nl=False)

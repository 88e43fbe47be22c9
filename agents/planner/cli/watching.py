"""Goals as a person follows them: a line for each change, and tables of goals and of previews."""

from __future__ import annotations

from typing import Any

import click
import msgspec
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

import zmav
from agents.planner.cli.asking import Planner, books
from zmav.cli.common import console, dump
from zmav.errors import TimedOut
from zmav.wire import swarm

ENDED = ("done", "failed", "cancelled")
SILENCE = 3.0
GIVE_UP = 60.0
"""s without a book after which nobody is waited for any more: a standby has taken over long before"""
COLOURS = {
    "queued": "dim",
    "planning": "cyan",
    "flying": "bold",
    "paused": "yellow",
    "done": "green",
    "failed": "bold red",
    "cancelled": "yellow",
}


async def until_ended(z: zmav.Client, ids: list[str], as_json: bool) -> list[swarm.GoalEntry]:
    """Say each change of the goals until all have ended; how they did.

    Raises :class:`TimedOut` when no planner is heard any more.
    """
    found: dict[str, swarm.GoalEntry] = {}
    silent = 0.0
    async for book in books(z, SILENCE):
        if book is None:
            silent += SILENCE
            if silent >= GIVE_UP:
                raise TimedOut(f"no planner was heard for {silent:.0f} s; the goals are in nobody's hands")
            click.echo(f"no planner heard for {silent:.0f} s", err=True)
            continue
        silent = 0.0
        for entry in (entry for entry in book.goals if entry.id in ids):
            before, found[entry.id] = found.get(entry.id), entry
            if before is None or (before.state, before.text) != (entry.state, entry.text):
                click.echo(dump(msgspec.to_builtins(entry), pretty=False) if as_json else line(entry))
        if len(found) == len(ids) and all(entry.state in ENDED for entry in found.values()):
            return list(found.values())
    raise AssertionError("books never end")


def line(entry: swarm.GoalEntry) -> str:
    figures = f" ({_figures(entry)})" if entry.makespan is not None else ""
    return f"{entry.id} {kind_of(entry.goal)}: {entry.state}, {100.0 * entry.progress:.0f} %: {entry.text}{figures}"


def kind_of(goal: swarm.Goal) -> str:
    return str(type(goal).__struct_config__.tag)


def _figures(entry: swarm.GoalEntry) -> str:
    span = f"{entry.makespan:.1f} s" if entry.makespan is not None else ""
    clear = f"{entry.clearance:.2f} m clear" if entry.clearance is not None else ""
    return ", ".join(filter(None, (span, clear)))


def table(entries: list[swarm.GoalEntry]) -> Table:
    """One line a goal."""
    view = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("goal", "kind", "vehicles", "state", "", "plan"):
        view.add_column(name, no_wrap=True)
    view.add_column("what", overflow="fold")
    for entry in entries:
        view.add_row(
            entry.id,
            kind_of(entry.goal),
            few(entry.goal.vehicles),
            Text(entry.state, COLOURS.get(entry.state, "")),
            ProgressBar(100.0, 100.0 * entry.progress, width=12),
            _figures(entry),
            Text(entry.text),
        )
    return view


def few(names: list[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (f" +{len(names) - most}" if len(names) > most else "")


def show(view: Table) -> None:
    console().print(view)


async def show_preview(planner: Planner, goal: swarm.Goal, as_json: bool) -> None:
    """Ask, and show a line a step; raises the typed error of a goal that cannot be."""
    result = await planner.order("preview", swarm.Preview(goal=goal))
    if as_json:
        click.echo(dump(result, pretty=False))
        return
    show(_steps(result))
    clear = result.get("clearance")
    words = f"{float(result['makespan']):.1f} s" + (f", {clear:.2f} m clear of each other" if clear is not None else "")
    click.echo(f"in all: {words}")


def _steps(result: dict[str, Any]) -> Table:
    view = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("step", "vehicles", "lasts", "clear", "what"):
        view.add_column(name, justify="right" if name in ("lasts", "clear") else "left")
    for step in result["steps"]:
        lasts, clear = step.get("makespan"), step.get("clearance")
        view.add_row(
            str(step["step"]),
            few(step["vehicles"]),
            "-" if lasts is None else f"{lasts:.1f} s",
            "-" if clear is None else f"{clear:.2f} m",
            str(step["text"]),
        )
    return view

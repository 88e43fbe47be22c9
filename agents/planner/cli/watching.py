"""Goals as a person follows them: a line for each change, and tables of goals and of previews."""

from __future__ import annotations

import math
import time
from typing import Any

import click
import msgspec

import zmav
from agents.planner.cli.asking import Planner, books
from agents.planner.live.ledger import ENDED, kind_of
from zmav.cli.common import dump, show_table, tell
from zmav.errors import TimedOut
from zmav.wire import swarm

SILENCE = 3.0
GIVE_UP = 60.0
"""s without a book after which nobody is waited for any more: a standby has taken over long before"""
MISSED = 5.0
"""s of books without the goal, after which nobody knows it: the first few may be older than it"""


async def until_ended(z: zmav.Client, name: str, as_json: bool) -> swarm.GoalEntry:
    """Say each change of the goal until it has ended; how it did.

    Raises :class:`TimedOut` when no planner is heard any more, or the one in charge does not have the goal.
    """
    before, silent, since = ("", ""), 0.0, math.inf
    async for book in books(z, SILENCE):
        if book is None:
            silent, since = silent + SILENCE, math.inf
            if silent >= GIVE_UP:
                raise TimedOut(f"no planner was heard for {silent:.0f} s; nobody flies the goal on")
            click.echo(f"no planner heard for {silent:.0f} s", err=True)
            continue
        silent, since = 0.0, min(since, time.monotonic())
        for entry in (entry for entry in book.goals if entry.id == name):
            since = math.inf
            if (entry.state, entry.text) != before:
                tell(as_json, msgspec.to_builtins(entry), line(entry))
            before = (entry.state, entry.text)
            if entry.state in ENDED:
                return entry
        if time.monotonic() - since >= MISSED:
            text = f"{name} is not in the book of {book.planner}, which is in charge: look at 'zmav swarm list --all'"
            raise TimedOut(f"{text}, and give the goal again if it was not flown", goal=name)
    raise AssertionError("books never end")


def line(entry: swarm.GoalEntry) -> str:
    figures = f" ({_figures(entry)})" if entry.makespan is not None else ""
    return f"{entry.id} {kind_of(entry.goal)}: {entry.state}, {100.0 * entry.progress:.0f} %: {entry.text}{figures}"


def _figures(entry: swarm.GoalEntry) -> str:
    span = f"{entry.makespan:.1f} s" if entry.makespan is not None else ""
    clear = f"{entry.clearance:.2f} m clear" if entry.clearance is not None else ""
    return ", ".join(filter(None, (span, clear)))


def show_goals(entries: list[swarm.GoalEntry]) -> None:
    """One line a goal."""
    rows = [
        (
            entry.id,
            kind_of(entry.goal),
            few(entry.goal.vehicles),
            entry.state,
            f"{100.0 * entry.progress:.0f} %",
            _figures(entry),
            entry.text,
        )
        for entry in entries
    ]
    show_table(("goal", "kind", "vehicles", "state", "done", "plan", ""), rows, right=("done",))


def few(names: list[str], most: int = 4) -> str:
    return ", ".join(names[:most]) + (f" +{len(names) - most}" if len(names) > most else "")


async def show_preview(planner: Planner, goal: swarm.Goal, as_json: bool) -> None:
    """Ask, and show a line a step; raises the typed error of a goal that cannot be."""
    result = await planner.order("preview", swarm.Preview(goal=goal))
    if as_json:
        click.echo(dump(result))
        return
    show_table(("step", "vehicles", "lasts", "clear", ""), map(_step, result["steps"]), right=("lasts", "clear"))
    parts = [each for step in result["steps"] for each in step.get("figures", {}).items()]
    pictures = {name: figures.get("pictures") for name, figures in parts}
    rows = [_battery(name, each, pictures.get(name)) for name, each in result["batteries"].items()]
    columns = ("vehicle", "flies", "way", "takes", "has", "lands with", "pictures")
    show_table(columns, rows, right=columns[1:])
    click.echo(result["positions"]["text"])
    clear = result.get("clearance")
    words = f"about {float(result['seconds']):.0f} s, {float(result['makespan']):.1f} s of them by plans"
    click.echo(f"in all: {words}" + (f", {clear:.2f} m clear of each other" if clear is not None else ""))
    if result.get("above_ground") is not None:
        click.echo(f"{result['above_ground']:.1f} m above the ground where it is least")
    if result["refused"]:
        click.echo(f"refused: {result['refused']}")


def _battery(name: str, each: dict[str, Any], pictures: float | None) -> tuple[str, ...]:
    """A line a vehicle: what it flies, and what that takes of its battery."""
    return (
        name,
        f"{each['seconds']:.0f} s",
        f"{each['metres']:.0f} m",
        _percent(each["battery"]),
        _percent(each["battery_left"]),
        _percent(each["landing"]),
        "-" if pictures is None else f"{pictures:.0f}",
    )


def _percent(share: float | None) -> str:
    return "?" if share is None else f"{100.0 * share:.0f} %"


def _step(step: dict[str, Any]) -> tuple[str, ...]:
    lasts, clear = step.get("seconds"), step.get("clearance")
    return (
        str(step["step"]),
        few(step["vehicles"]),
        f"{lasts:.1f} s" if lasts else "-",
        "-" if clear is None else f"{clear:.2f} m",
        str(step["text"]),
    )

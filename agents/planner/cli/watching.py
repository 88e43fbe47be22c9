"""Goals as a person follows them: a line for each change, and tables of goals and of previews."""

from __future__ import annotations

from typing import Any

import click
import msgspec

import zmav
from agents.planner.cli.asking import Planner, books
from zmav.cli.common import dump, show_table, tell
from zmav.errors import TimedOut
from zmav.wire import swarm

ENDED = ("done", "failed", "cancelled")
SILENCE = 3.0
GIVE_UP = 60.0
"""s without a book after which nobody is waited for any more: a standby has taken over long before"""


async def until_ended(z: zmav.Client, name: str, as_json: bool) -> swarm.GoalEntry:
    """Say each change of the goal until it has ended; how it did.

    Raises :class:`TimedOut` when no planner is heard any more.
    """
    before, silent = ("", ""), 0.0
    async for book in books(z, SILENCE):
        if book is None:
            silent += SILENCE
            if silent >= GIVE_UP:
                raise TimedOut(f"no planner was heard for {silent:.0f} s; nobody flies the goal on")
            click.echo(f"no planner heard for {silent:.0f} s", err=True)
            continue
        silent = 0.0
        for entry in (entry for entry in book.goals if entry.id == name):
            if (entry.state, entry.text) != before:
                tell(as_json, msgspec.to_builtins(entry), line(entry))
            before = (entry.state, entry.text)
            if entry.state in ENDED:
                return entry
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
    if rows := [row for step in result["steps"] for row in _parts(step.get("figures", {}))]:
        show_table(("vehicle", "flies", "way", "battery", "left", "pictures"), rows, right=("flies", "way", "battery"))
    if positions := result.get("positions"):
        click.echo(positions["text"])
    clear = result.get("clearance")
    words = f"{float(result['makespan']):.1f} s" + (f", {clear:.2f} m clear of each other" if clear is not None else "")
    click.echo(f"in all: {words}")


def _parts(figures: dict[str, dict[str, Any]]) -> list[tuple[str, ...]]:
    """A line a vehicle, of a search or a survey."""
    rows = list[tuple[str, ...]]()
    for name, each in figures.items():
        left, pictures = each.get("battery_left"), each.get("pictures")
        rows.append(
            (
                name,
                f"{each['seconds']:.0f} s",
                f"{each['metres']:.0f} m",
                f"{100.0 * each['battery']:.0f} %",
                "-" if left is None else f"{100.0 * left:.0f} %",
                "-" if pictures is None else f"{pictures:.0f}",
            )
        )
    return rows


def _step(step: dict[str, Any]) -> tuple[str, ...]:
    lasts, clear = step.get("makespan"), step.get("clearance")
    return (
        str(step["step"]),
        few(step["vehicles"]),
        "-" if lasts is None else f"{lasts:.1f} s",
        "-" if clear is None else f"{clear:.2f} m",
        str(step["text"]),
    )

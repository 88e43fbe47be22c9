"""What would be flown, shown: a line a step, or a picture."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click
from rich.progress import Progress, TextColumn
from rich.table import Table

from agents.planner.cli.asking import Planner
from agents.planner.cli.watching import few, show
from zmav.cli.common import dump
from zmav.errors import BadInput, missing_extra
from zmav.wire import swarm

KINDS = (".png", ".svg", ".pdf")


async def show_preview(planner: Planner, goal: swarm.Goal, picture: str | None, as_json: bool) -> None:
    """Ask, and show; raises the typed error of a goal that cannot be."""
    if picture is not None and Path(picture).suffix.lower() not in KINDS:
        text = f"a picture is {', '.join(KINDS)}, not {picture!r}"
        raise BadInput(text, field="picture", value=picture, expected=" or ".join(KINDS))
    with Progress(TextColumn("{task.description}"), disable=not sys.stderr.isatty(), transient=True) as bar:
        task = bar.add_task("asked")

        def progress(news: dict[str, Any]) -> None:
            bar.update(task, description=f"{news.get('stage', 'plans')} {100.0 * float(news.get('share', 0.0)):.0f} %")

        result = await planner.order("preview", swarm.Preview(goal=goal), progress)
    if picture is not None:
        draw(result, picture)
    if as_json:
        click.echo(dump(result, pretty=False))
        return
    show(table(result))
    clear = result.get("clearance")
    words = f"{float(result['makespan']):.1f} s" + (f", {clear:.2f} m clear of each other" if clear is not None else "")
    click.echo(f"in all: {words}" + (f"; drawn in {picture}" if picture else ""))


def table(result: dict[str, Any]) -> Table:
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


def draw(result: dict[str, Any], file: str) -> None:
    """From above, and heights over time. Raises :class:`BadConfig` where matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as e:
        raise missing_extra("a picture", "matplotlib", "planner") from e
    figure = Figure(figsize=(8.0, 8.5), layout="constrained")
    top, side = figure.subplots(2, 1, height_ratios=[3, 1])
    begin = 0.0
    colours: dict[str, str] = {}
    for step in result["steps"]:
        for name, track in step.get("tracks", {}).items():
            colour = colours.setdefault(name, f"C{len(colours) % 10}")
            times, north, east, down = zip(*track, strict=True)
            label = name if colours[name] and not any(line.get_label() == name for line in top.lines) else None
            top.plot(east, north, color=colour, label=label)
            top.plot(east[:1], north[:1], "o", color=colour, markersize=4)
            top.plot(east[-1:], north[-1:], "s", color=colour, markersize=5)
            side.plot([begin + t for t in times], [-d for d in down], color=colour)
        begin += float(step.get("makespan") or 0.0)
    top.set(xlabel="m east", ylabel="m north", aspect="equal", title=f"{begin:.1f} s; circles: starts, squares: goals")
    side.set(xlabel="s", ylabel="m above the origin")
    if 0 < len(colours) <= 12:
        top.legend(loc="upper right")
    for axes in (top, side):
        axes.grid(alpha=0.3)
    try:
        figure.savefig(file)
    except OSError as e:
        text = f"cannot write the picture {file}: {e.strerror or e}"
        raise BadInput(text, field="picture", value=file, expected="a file that can be written") from e

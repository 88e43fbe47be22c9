"""``zmav top``: the fleet in the terminal, live; or once, or as JSON for scripts."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import logging
import os
import shutil
import signal
import sys

import click
import msgspec
from rich.color import ColorSystem
from rich.console import Console
from rich.style import Style

from ground.top.columns import cells
from ground.top.report import Report
from ground.top.screen import Line, Ui, draw, table
from ground.top.terminal import Terminal
from ground.top.watch import Watch
from zmav.cli.common import Between, Work, connected, console
from zmav.client import Client
from zmav.doctor.words import clean
from zmav.waiting import alongside, until_any, within

ENDINGS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
PERIOD = 0.25
LEAST = 0.08
"""s between two frames, however fast keys come"""
SYSTEMS = {"standard": ColorSystem.STANDARD, "256": ColorSystem.EIGHT_BIT, "truecolor": ColorSystem.TRUECOLOR}


class Painter:
    """Lines of styled text as the bytes that show them on a terminal of this kind; NO_COLOR and TERM are heeded."""

    def __init__(self) -> None:
        console = Console(file=io.StringIO(), force_terminal=True, legacy_windows=False)
        name = console.color_system
        self._colors = SYSTEMS[name] if name else None
        self._plain = console.no_color
        self._styles: dict[str, Style] = {}

    def paint(self, lines: list[Line], width: int) -> str:
        """A whole frame, from the upper left corner; what was right of a line is cleared."""
        return "\x1b[H" + "\r\n".join(self._line(line, width) for line in lines)

    def _line(self, line: Line, width: int) -> str:
        text = "".join(self._style(style).render(text, color_system=self._colors) for text, style in line)
        # Behind the last column a terminal still stands on it: clearing from there would take the last character.
        return text if sum(cells(text) for text, _ in line) >= width else text + "\x1b[K"

    def _style(self, name: str) -> Style:
        if name not in self._styles:
            style = Style.parse(name)
            self._styles[name] = style.without_color if self._plain else style
        return self._styles[name]


class Live:
    """One run of the screen until the viewer leaves or the process is told to end."""

    def __init__(self, watch: Watch, fd: int) -> None:
        self._watch, self._fd = watch, fd
        self._ui, self._painter = Ui(), Painter()
        self._report: Report | None = None
        self._wake = asyncio.Event()
        self._shown = ""

    async def run(self) -> None:
        """Raises what ended the watching, once the terminal is given back."""
        await until_any(self._show(), self._watch.run())

    async def _show(self) -> None:
        loop = asyncio.get_running_loop()
        for number in ENDINGS:
            loop.add_signal_handler(number, self._end)
        logging.disable()  # printed, it would spoil the screen
        try:
            async with Terminal(self._fd, self._on_key, self._on_resize) as terminal:
                while not self._ui.over:
                    self._draw(terminal)
                    await asyncio.sleep(LEAST)
                    with contextlib.suppress(asyncio.TimeoutError):
                        await within(PERIOD - LEAST, self._wake.wait())
                    self._wake.clear()
        finally:
            logging.disable(logging.NOTSET)
            for number in ENDINGS:
                loop.remove_signal_handler(number)

    def _draw(self, terminal: Terminal) -> None:
        self._report = self._watch.report()
        width, height = terminal.size
        frame = self._painter.paint(draw(self._ui, self._report, width, height), width)
        if frame != self._shown and terminal.show(frame):
            self._shown = frame

    def _on_key(self, key: str) -> None:
        if self._report is not None:
            self._ui.press(key, self._report)
        self._wake.set()

    def _on_resize(self) -> None:
        self._shown = ""
        self._wake.set()

    def _end(self) -> None:
        self._ui.over = True
        self._wake.set()


def usable(fd: int) -> bool:
    """There is a terminal that a screen can be drawn on."""
    return os.isatty(fd) and os.environ.get("TERM", "") not in ("", "dumb", "unknown")


@click.command("top")
@click.option("--once", is_flag=True, help="Print the table once; with --json one document.")
@click.option("--json", "as_json", is_flag=True, help="One JSON document (implies --once).")
@click.option(
    "--wait",
    type=Between(0.1, 60.0),
    default=2.0,
    show_default=True,
    help="Seconds at most to listen before something is printed.",
)
@connected
def command(once: bool, as_json: bool, wait: float) -> Work:
    """Watch the fleet in the terminal: who is well, who is not, and why, in words.

    Keys: q quits, up and down select a vehicle, enter shows it in full, / filters by words (names, modes, STALE,
    reasons).

    For scripts: 'zmav top --json | jq ".vehicles[] | select(.level != \\"ok\\") | .name, .reasons[].text"'. It only
    listens and asks; any number of them may run.
    """

    async def show(z: Client) -> None:
        watch = Watch(z)
        if not (once or as_json) and usable(0) and usable(1):
            await Live(watch, 0).run()
            return
        async with alongside(watch.run()):
            await watch.settle(wait)
            report = watch.report()
        if as_json:
            click.echo(text(report))
        else:
            _print(report)
            if not once:
                click.echo("no terminal to draw on: shown once; 'zmav top --json' is for scripts", err=True)

    return show


def text(report: Report) -> str:
    """One line of JSON in ASCII: whatever a vehicle says, no terminal that it is printed on takes it for a command."""
    return json.dumps(msgspec.to_builtins(report), allow_nan=False)


def _print(report: Report) -> None:
    """The table, and below it every reason in full: on paper nothing can be scrolled to."""
    out = console()
    width = out.width if sys.stdout.isatty() else max(shutil.get_terminal_size((160, 24)).columns, 40)
    rows = Ui().rows(report)
    lines = table(rows, Ui(), width)
    for vehicle in rows:
        lines += [[(f"{clean(vehicle.name)}: {reason.text}", "")] for reason in vehicle.reasons]
    for agent in report.agents:
        silent = ", SILENT" if agent.stale else ""
        lines.append([(clean(f"agent {agent.name}@{agent.host}: {agent.state} {agent.text}{silent}"), "")])
    colors = out.color_system is not None and not out.no_color
    for line in lines:
        styled = "".join(Style.parse(style).render(piece) if colors else piece for piece, style in line)
        click.echo(styled if colors else styled.rstrip())

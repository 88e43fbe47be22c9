"""The live screen: draws four times a second, and at once when a key is pressed."""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
import os
import signal

from rich.color import ColorSystem
from rich.console import Console
from rich.style import Style

from ground.top.columns import cells
from ground.top.report import Report
from ground.top.screen import Line, Ui, draw
from ground.top.terminal import Terminal
from ground.top.watch import Watch
from zmav.waiting import within

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
        watching = asyncio.create_task(self._watch.run())
        watching.add_done_callback(self._end)
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
            watching.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await watching

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

    def _end(self, task: object = None) -> None:
        self._ui.over = True
        self._wake.set()


def usable(fd: int) -> bool:
    """There is a terminal that a screen can be drawn on."""
    return os.isatty(fd) and os.environ.get("TERM", "") not in ("", "dumb", "unknown")

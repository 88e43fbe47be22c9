"""What a running simulator shows of itself: one line that changes on a terminal, or a plain one now and then."""

from __future__ import annotations

import collections
import os
import threading
from collections.abc import Callable

from rich.console import Console
from rich.live import Live
from rich.text import Text

from zmav.sim.status import WorldStatus

PLAIN_EVERY_S = 10.0
REFRESH_HZ = 2
MODES_NAMED = 4


def clock_words(status: WorldStatus) -> str:
    """The clock, for a person: where it is, how fast it goes, and whether that is what was asked for."""
    asked = "max" if status.speed is None else f"×{status.speed:g}"
    if status.paused:
        return f"{status.time_s:.1f} s simulated, paused"
    words = f"{status.time_s:.0f} s simulated"
    if status.speed_reached:
        words += f" at ×{status.speed_reached:.1f}"
    elif status.speed is not None:
        words += f" at {asked}"
    if status.lockstep:
        words += ", in lock step"
    if status.behind:
        words += f", BEHIND the {asked} asked for"
    elif status.speed is None:
        words += " (max)"
    return words


def world_words(status: WorldStatus) -> str:
    """One line of everything."""
    kinds = collections.Counter(vehicle.kind for vehicle in status.vehicles)
    flying = sum(v.flying for v in status.vehicles)
    armed = sum(v.armed for v in status.vehicles)
    modes = collections.Counter(v.mode for v in status.vehicles).most_common()
    named = ", ".join(f"{mode} {count}" for mode, count in modes[:MODES_NAMED])
    faults = [f"{v.name}: {fault}" for v in status.vehicles for fault in v.faults]
    failed = [v.name for v in status.vehicles if v.failed]
    parts = [
        clock_words(status),
        ", ".join(f"{count} {kind}" for kind, count in kinds.items()),
        f"{armed} armed, {flying} flying",
        named + (", ..." if len(modes) > MODES_NAMED else ""),
        f"{status.clients} clients",
        *(
            [f"faults {', '.join(faults[:MODES_NAMED])}" + (" ..." if len(faults) > MODES_NAMED else "")]
            if faults
            else []
        ),
        *([f"FAILED {' '.join(failed)}"] if failed else []),
        f"CPU {100 * status.cpu_share:.0f} %, load {os.getloadavg()[0]:.1f}",
    ]
    return " | ".join(parts)


class StatusLine:
    """Shows ``status()`` while it lasts: ``with StatusLine(world.status, console): ...``."""

    def __init__(self, status: Callable[[], WorldStatus], console: Console) -> None:
        self._status = status
        self._console = console
        self._live: Live | None = None
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> StatusLine:
        if self._console.is_terminal:
            self._live = Live(
                get_renderable=self._line, console=self._console, refresh_per_second=REFRESH_HZ, transient=True
            )
            self._live.start()
        else:
            self._thread = threading.Thread(target=self._write, name="zmav-sim-line", daemon=True)
            self._thread.start()
        return self

    def _line(self) -> Text:
        return Text(world_words(self._status()), no_wrap=True, overflow="ellipsis")

    def _write(self) -> None:
        while not self._over.wait(PLAIN_EVERY_S):
            self._console.print(world_words(self._status()), soft_wrap=True, highlight=False)

    def say(self, text: str) -> None:
        """A line that stays."""
        self._console.print(text, soft_wrap=True, highlight=False, markup=False)

    def __exit__(self, *exc: object) -> None:
        self._over.set()
        if self._live is not None:
            self._live.stop()
        if self._thread is not None:
            self._thread.join()

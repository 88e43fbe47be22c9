"""What a running simulator shows of itself: one line that changes, on a terminal."""

from __future__ import annotations

import collections
import contextlib
import os
from collections.abc import Callable

from rich.console import Console
from rich.live import Live
from rich.text import Text

from zmav.sim.status import WorldStatus

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


def live_line(status: Callable[[], WorldStatus], console: Console) -> contextlib.AbstractContextManager[object]:
    """Shows ``status()`` while it lasts, where ``console`` is a terminal."""
    if not console.is_terminal:
        return contextlib.nullcontext()

    def line() -> Text:
        return Text(world_words(status()), no_wrap=True, overflow="ellipsis")

    return Live(get_renderable=line, console=console, refresh_per_second=REFRESH_HZ, transient=True)

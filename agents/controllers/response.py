"""How a controller answered what was injected: the report of a recorded step or doublet.

What is measured is the response to what was injected alone: the deviation of the measured value from the reference as
it would have been without, less what it was before. So the reference may move meanwhile. Angles go on past pi.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from agents.controllers.inject import CHANNELS, Inject, duration
from agents.controllers.types import Array
from zmav import wire
from zmav.errors import BadInput, needs
from zmav.figures import save
from zmav.rotation import wrap

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED, WRONG, MARK, GREY = "#1a73e8", "#d93025", "#e8710a", "#80868b"
PANELS = 3
"""of outputs in a picture, at most"""
LEAST = 20
"""samples while it is injected"""
MOST_LOST, MOST_GAP = 0.2, 0.5
"""share of the samples, and s between two of them, with which a response is still judged"""
END = 0.2
"""of a step's duration, at its end, in which it is what it settles at"""
FOLLOWS = 0.1
"""of the amplitude: less than that at the end is no response"""
UNREST = 0.05
"""of the amplitude: who moved more than that before it has that told"""
NOISE = 4.0
"""standard deviations of the noise before, within which it counts as settled where that is more than the band"""


@dataclass
class StepResponse:
    """A step's response, as the textbooks have it (K. Ogata, "Modern Control Engineering", 5-3), times in s after the
    step. Shares are of ``final``; None: that did not come within the step's duration.
    """

    final: float
    """what the response came to: its mean over the last fifth, in the channel's unit"""
    steady_error: float
    """amplitude less final"""
    noise: float
    """standard deviation before the step"""
    peak: float | None = None
    """the response's farthest"""
    t_peak: float | None = None
    overshoot: float | None = None
    """%, of final"""
    t10: float | None = None
    t90: float | None = None
    delay: float | None = None
    """to a half of final"""
    settle_5: float | None = None
    """after which it stays within 5 % of final"""
    settle_2: float | None = None

    @property
    def rise(self) -> float | None:
        """From 10 to 90 % of final."""
        return None if self.t10 is None or self.t90 is None else self.t90 - self.t10

    def rows(self, unit: str) -> list[tuple[str, str]]:
        """Each measure's name and its value with its unit."""
        peak = "none" if self.peak is None else f"{self.peak:.3g} {unit} at {_seconds(self.t_peak)}"
        over = "none" if self.overshoot is None else f"{self.overshoot:.1f} %"
        return [
            ("rise time (10-90 %)", _seconds(self.rise)),
            ("delay (to 50 %)", _seconds(self.delay)),
            ("overshoot", over),
            ("peak", peak),
            ("settling time (5 %)", _seconds(self.settle_5)),
            ("settling time (2 %)", _seconds(self.settle_2)),
            ("steady-state error", f"{self.steady_error:.2g} {unit}"),
        ]


@dataclass
class ResponseReport:
    """What was recorded, and what is to be said of it. Arrays (N,) without the samples that were no numbers."""

    args: Inject
    title: str
    t: Array
    """s since the injection began"""
    reference: Array
    """what was injected included"""
    measured: Array
    outputs: dict[str, Array]
    period: float
    """s between two samples"""
    lost: int
    """samples that are missing between others, as their times tell"""
    bad: int
    """samples left out: no numbers, or not later than the one before"""
    rms: float
    """of the error (reference less measured) during the injection"""
    peak_error: float
    found: StepResponse | None
    """None: of a doublet"""
    notes: list[str] = field(default_factory=list)
    """what to know before believing it"""

    @property
    def error(self) -> Array:
        """(N,) reference less measured."""
        return self.reference - self.measured

    @property
    def unit(self) -> str:
        return CHANNELS[self.args.channel].unit

    def text(self) -> str:
        """A table of a line a measure, for a terminal."""
        args, unit = self.args, self.unit
        what = f"{args.kind} of {args.amplitude:g} {unit} in {args.channel}"
        counts = f", {self.lost or 'none'} lost" + (f", {self.bad} no use" if self.bad else "")
        rows = [
            *(self.found.rows(unit) if self.found else ()),
            ("RMS error", f"{self.rms:.3g} {unit}"),
            ("peak error", f"{self.peak_error:.3g} {unit}"),
            ("recorded", f"{len(self.t)} samples at {1.0 / self.period:.0f} Hz{counts}"),
        ]
        width = max(len(name) for name, _ in rows)
        lines = [f"{self.title + ': ' if self.title else ''}{what}, {args.seconds:g} s"]
        lines += [f"  {name:<{width}}  {words}" for name, words in rows]
        return "\n".join([*lines, *(f"  ! {note}" for note in self.notes)])

    def numbers(self) -> dict[str, Any]:
        """The measures as JSON takes them, by name; what there is not is None. SI units; overshoot in %."""
        own = wire.Order.__struct_fields__
        asked = {name: value for name, value in msgspec.structs.asdict(self.args).items() if name not in own}
        step = {**asdict(self.found), "rise": self.found.rise} if self.found else {}
        names = ("unit", "period", "lost", "bad", "rms", "peak_error", "notes")
        return {**asked, **step, **{name: getattr(self, name) for name in names}}


def examine(
    args: Inject,
    t: Array,
    reference: Array,
    measured: Array,
    injected: Array,
    outputs: Mapping[str, Array] | None = None,
    title: str = "",
) -> ResponseReport:
    """The report of a recording of ``args``: ``t`` (N,) s and, of the channel injected into and in its unit, the
    ``reference`` as the controller was given it (what was injected included), what was ``measured`` and what was
    ``injected``, each (N,); ``outputs``: more of (N,), for the picture. It should begin a little before the injection.

    Raises :class:`~zmav.errors.BadInput` for what is too short or has too many gaps, and where nothing was injected;
    what is merely doubtful stands in the report's notes.
    """
    rows, bad = _clean({"t": t, "reference": reference, "measured": measured, "injected": injected, **(outputs or {})})
    t, reference, measured, injected = (rows.pop(name) for name in ("t", "reference", "measured", "injected"))
    within = np.flatnonzero(injected)
    if len(within) == 0:
        raise _short("injected", f"nothing was injected in {len(t)} samples", "what is not 0 at some time")
    first, last = int(within[0]), int(within[-1])
    t = t - t[first]
    period = float(np.median(np.diff(t)))
    during = slice(first, last + 1)
    lost = _gaps(t, period, during)
    unit = CHANNELS[args.channel].unit
    if unit == "rad":
        reference = np.unwrap(reference)
        measured = reference - wrap(reference - measured)
    response = measured - (reference - injected)
    noise, notes = 0.0, list[str]()
    if first >= 5:
        response = response - response[:first].mean()
        slope, at = np.polyfit(t[:first], response[:first], 1)
        noise, moved = float((response[:first] - slope * t[:first] - at).std()), abs(slope * t[0])
        if moved > UNREST * abs(args.amplitude):
            notes.append(f"it was not at rest before: it moved by {moved:.2g} {unit}")
    else:
        notes.append("nothing was recorded before it: an error that was there already counts as response")
    lasted = float(t[last]) + period
    if lasted < 0.98 * duration(args) - 2.0 * period:
        notes.append(f"it ended after {lasted:.2f} s of {duration(args):g} s")
    found = None
    if args.kind == "step":
        found = _step(args.amplitude, t[during], response[during], noise, notes)
        if found.rise is not None and found.rise < 4.0 * period:
            notes.append(f"it rose within {found.rise / period:.0f} samples: its times are rough")
    error = (reference - measured)[during]
    rms, peak = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return ResponseReport(args, title, t, reference, measured, rows, period, lost, bad, rms, peak, found, notes)


def _clean(columns: Mapping[str, Array]) -> tuple[dict[str, Array], int]:
    """The rows that are numbers and later than the one before, and how many are not. Outputs may be anything."""
    rows = {name: np.asarray(column, dtype=float) for name, column in columns.items()}
    size = len(rows["t"])
    names = ("t", "reference", "measured", "injected")
    good = np.flatnonzero(np.all([np.isfinite(rows[name]) for name in names], axis=0))
    times = rows["t"][good]
    if len(times):
        newest = np.maximum.accumulate(times)
        good = good[np.concatenate([[True], times[1:] > newest[:-1]])]
    if len(good) < LEAST:
        raise _short("t", f"{len(good)} samples of {size} are numbers in the order of time", f"{LEAST} at least")
    return {name: row[good] for name, row in rows.items()}, size - len(good)


def _gaps(t: Array, period: float, during: slice) -> int:
    """How many samples are missing; raises :class:`BadInput` where too many are while it was injected."""
    steps = np.diff(t)
    missing = np.maximum(np.round(steps / period) - 1.0, 0.0)
    inside = slice(max(during.start - 1, 0), during.stop - 1)
    count, lost = during.stop - during.start, int(missing[inside].sum())
    said = f"{lost} of {lost + count} samples were lost while it was injected"
    if count < LEAST:
        raise _short("t", f"{count} samples while it was injected ({lost} were lost)", f"{LEAST} at least")
    if lost > MOST_LOST * (lost + count):
        raise _short("t", said, f"{100.0 * MOST_LOST:g} % at most")
    longest = float(steps[inside].max())
    most = min(MOST_GAP, 0.1 * float(t[during.stop - 1] - t[during.start]))
    if longest > max(most, 2.5 * period):
        raise _short("t", f"{said}, for {longest:.2f} s at a time", f"{most:.2f} s at most")
    return int(missing.sum())


def _short(name: str, what: str, expected: str) -> BadInput:
    return BadInput.wrong(name, what, expected, f"response: {what}")


def _step(amplitude: float, t: Array, y: Array, noise: float, notes: list[str]) -> StepResponse:
    """``t``, ``y``: while the step lasted."""
    tail = y[t >= (1.0 - END) * t[-1]]
    final = float(tail.mean())
    found = StepResponse(final, amplitude - final, noise)
    if final / amplitude < FOLLOWS:
        notes.append("it does not follow: there is no response to judge")
        return found
    half = len(tail) // 2
    moved = abs(float(tail[half:].mean() - tail[:half].mean()))
    if moved > max(0.02 * abs(final), NOISE * noise / math.sqrt(half)):
        notes.append("it has not come to rest within the step: make that longer")
    share = y / final
    top = int(np.argmax(share))
    found.peak, found.t_peak = float(y[top]), float(t[top])
    found.overshoot = max(0.0, 100.0 * (float(share[top]) - 1.0))
    risen = int(np.argmax(share >= 0.9))
    found.t10, found.delay, found.t90 = (_crossing(t, share, risen, level) for level in (0.1, 0.5, 0.9))
    narrowest = NOISE * noise / abs(final)
    found.settle_5 = _settled(t, share - 1.0, max(0.05, narrowest))
    found.settle_2 = _settled(t, share - 1.0, max(0.02, narrowest))
    if narrowest > 0.02:
        notes.append(f"noise: settled is judged within {100.0 * narrowest:.1f} %")
    return found


def _crossing(t: Array, share: Array, risen: int, level: float) -> float:
    """When it came past ``level`` for good on its way up to 0.9, which it has at the sample ``risen``."""
    below = np.flatnonzero(share[: risen + 1] < level)
    if len(below) == 0:
        return float(t[0])
    k = int(below[-1])
    return float(np.interp(level, share[k : k + 2], t[k : k + 2]))


def _settled(t: Array, off: Array, band: float) -> float | None:
    """When it came into the band for good; None where that is only in the last tenth, or never."""
    outside = np.flatnonzero(np.abs(off) > band)
    if len(outside) == 0:
        return float(t[0])
    k = int(outside[-1])
    if k + 1 >= len(t) or t[k] > 0.9 * t[-1]:
        return None
    return float(np.interp(-band, -np.abs(off[k : k + 2]), t[k : k + 2]))


def _seconds(value: float | None) -> str:
    """A time for a person."""
    return "none" if value is None else f"{value:.3f} s" if value < 10.0 else f"{value:.2f} s"


def picture(report: ResponseReport, path: Path) -> None:
    """Draw it (PNG, or what the file's name says). Raises :class:`~zmav.errors.BadConfig` where matplotlib is not
    installed, and :class:`~zmav.errors.BadInput` for a file that cannot be.
    """
    needs("a picture", "planner", "matplotlib.figure")
    from matplotlib.figure import Figure

    groups: dict[str, list[str]] = {}  # outputs that share a panel: the parts of one vector
    for name in report.outputs:
        groups.setdefault(name.rpartition(".")[0] or name, []).append(name)
    panels = list(groups)[:PANELS]
    head, _, body = report.text().partition("\n")
    figure = Figure(figsize=(11.5, 5.6 + 1.05 * len(panels)), dpi=110, layout="constrained")
    figure.suptitle(head, weight="bold")
    left, beside = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.0, 0.6))[0]
    axes = left.subplots(2 + len(panels), 1, sharex=True, height_ratios=[3.2, 1.5] + [1.2] * len(panels))
    _draw_followed(axes[0], report)
    axes[1].plot(report.t, report.error, color=WRONG, linewidth=0.9)
    axes[1].set_ylabel(f"error ({report.unit})")
    for ax, group in zip(axes[2:], panels, strict=True):
        for name in groups[group]:
            ax.plot(report.t, report.outputs[name], linewidth=0.8, label=name.removeprefix(f"{group}."))
        ax.set_ylabel(group)
        if len(groups[group]) > 1:
            ax.legend(fontsize=7, loc="upper right")
    axes[-1].set(xlim=(report.t[0], report.t[-1]), xlabel=f"time since the {report.args.kind} (s)")
    for ax in axes:
        ax.grid(alpha=0.3)
    beside.text(0.02, 0.97, body, family="monospace", fontsize=7, va="top", wrap=True)
    save(figure, path)


def _draw_followed(ax: Axes, report: ResponseReport) -> None:
    name = report.args.channel + (", down" if report.args.channel in ("z", "vz") else "")
    ax.plot(report.t, report.reference, color="black", linewidth=0.9, label="reference")
    ax.plot(report.t, report.measured, color=MEASURED, linewidth=1.1, label="measured")
    if (found := report.found) is not None:
        if found.t10 is not None and found.t90 is not None:
            ax.axvspan(found.t10, found.t90, color=MARK, alpha=0.2, linewidth=0, label="rise")
        for words, value, shade in (("peak", found.t_peak, WRONG), ("settled within 2 %", found.settle_2, GREY)):
            if value is not None:
                ax.axvline(value, color=shade, linewidth=0.9, linestyle="--", label=words)
    ax.set_ylabel(f"{name} ({report.unit})")
    ax.legend(fontsize=8, loc="lower right")

"""How a controller answered what was injected: the report of a recorded step, doublet or chirp.

What is measured is the response to what was injected alone: the deviation of the measured value from the reference as
it would have been without, less what it was before. So the reference may move meanwhile. Angles go on past pi.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.controllers.frequency import Chirp, chirp_of
from agents.controllers.inject import CHANNELS, Inject, duration
from agents.controllers.types import Array
from zmav.errors import BadInput
from zmav.rotation import wrap

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
ALIKE = 0.3
"""correlation below which a doublet's delay means nothing"""


@dataclass
class Step:
    """A step's response, as the textbooks have it (K. Ogata, "Modern Control Engineering", 5-3), times in s after the
    step. Shares are of ``final``; None: that did not come within the step's duration.
    """

    final: float
    """what the response came to: its mean over the last fifth, in the channel's unit"""
    steady_error: float
    """amplitude less final"""
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
    noise: float = 0.0
    """standard deviation before the step"""

    @property
    def rise(self) -> float | None:
        """From 10 to 90 % of final."""
        return None if self.t10 is None or self.t90 is None else self.t90 - self.t10


@dataclass
class Doublet:
    """A doublet's response."""

    first: float
    """the farthest that it went the first way, as a share of the amplitude"""
    second: float
    """and then the other way"""
    delay: float | None
    """s by which it is most like what was injected; None: it is not like it"""
    correlation: float
    """how like it is then, 1 at most"""


@dataclass
class Report:
    """What was recorded, and what is to be said of it. Arrays (N,) without the samples that were no numbers."""

    args: Inject
    title: str
    t: Array
    """s since the injection began"""
    reference: Array
    """what was injected included"""
    measured: Array
    injected: Array
    outputs: dict[str, Array]
    response: Array
    """to what was injected alone"""
    seconds: float
    """that the injection lasted"""
    period: float
    """s between two samples"""
    lost: int
    """samples that are missing between others, as their times tell"""
    bad: int
    """samples left out: no numbers, or not later than the one before"""
    rms: float
    """of the error (reference less measured) during the injection"""
    peak_error: float
    found: Step | Doublet | Chirp
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
        args, lines = self.args, []
        what = f"{args.kind} of {args.amplitude:g} {self.unit} in {args.channel}"
        over = (
            f"{args.f0:g} to {args.f1:g} Hz over {args.seconds:g} s" if args.kind == "chirp" else f"{args.seconds:g} s"
        )
        lines.append(f"{self.title + ': ' if self.title else ''}{what}, {over}")
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        lines += [f"  {name:<{width}}  {words}" for name, words in rows]
        lines += [f"  ! {note}" for note in self.notes]
        return "\n".join(lines)

    def rows(self) -> list[tuple[str, str]]:
        """Each measure's name and its value with its unit."""
        unit = self.unit
        errors = [("RMS error", f"{self.rms:.3g} {unit}"), ("peak error", f"{self.peak_error:.3g} {unit}")]
        lost = f", {self.lost} lost" if self.lost else ", none lost"
        bad = f", {self.bad} no use" if self.bad else ""
        recorded = [("recorded", f"{len(self.t)} samples at {1.0 / self.period:.0f} Hz{lost}{bad}")]
        if isinstance(self.found, Step):
            return _step_rows(self.found, unit) + errors + recorded
        if isinstance(self.found, Doublet):
            return _doublet_rows(self.found) + errors + recorded
        return self.found.rows() + errors + recorded

    def numbers(self) -> dict[str, Any]:
        """The measures as JSON takes them, by name; what there is not is None. SI units; overshoot in %."""
        found: dict[str, Any] = {
            name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self.found).items()
        }
        if isinstance(self.found, Step):
            found["rise"] = self.found.rise
        args = self.args
        said = {name: getattr(args, name) for name in ("kind", "channel", "amplitude", "seconds")}
        if args.kind == "chirp":
            said |= {"f0": args.f0, "f1": args.f1, "feed": args.feed}
        own = {"samples": len(self.t), "hz": 1.0 / self.period, "lost": self.lost, "bad": self.bad}
        return {
            **said,
            "unit": self.unit,
            **own,
            "rms": self.rms,
            "peak_error": self.peak_error,
            **found,
            "notes": list(self.notes),
        }


def examine(
    args: Inject,
    t: Array,
    reference: Array,
    measured: Array,
    injected: Array,
    outputs: Mapping[str, Array] | None = None,
    title: str = "",
) -> Report:
    """The report of a recording of ``args``: ``t`` (N,) s and, of the channel injected into and in its unit, the
    ``reference`` as the controller was given it (what was injected included), what was ``measured`` and what was
    ``injected``, each (N,); ``outputs``: more of (N,), for the picture. It should begin a little before the injection.

    Raises :class:`~zmav.errors.BadInput` for arrays that do not fit, for what is too short or has too many gaps, and
    where nothing was injected; what is merely doubtful stands in the report's notes.
    """
    if args.channel not in CHANNELS:
        names = ", ".join(CHANNELS)
        text = f"response: channel is {args.channel!r}; expected one of {names}"
        raise BadInput(text, field="channel", value=args.channel, expected=names)
    columns = {"t": t, "reference": reference, "measured": measured, "injected": injected, **(outputs or {})}
    rows, bad = _clean(columns)
    t = rows.pop("t")
    reference, measured, injected = (rows.pop(name) for name in ("reference", "measured", "injected"))
    within = np.flatnonzero(injected)
    if len(within) == 0:
        raise _short("injected", f"nothing was injected in {len(t)} samples", "what is not 0 at some time")
    first, last = int(within[0]), int(within[-1])
    t = t - t[first]
    period = float(np.median(np.diff(t)))
    during = slice(first, last + 1)
    lost = _gaps(t, period, during)
    if CHANNELS[args.channel].unit == "rad":
        reference = np.unwrap(reference)
        measured = reference - wrap(reference - measured)
    response = measured - (reference - injected)
    noise = moved = 0.0
    if first >= 5:
        response = response - response[:first].mean()
        slope, at = np.polyfit(t[:first], response[:first], 1)
        noise, moved = float((response[:first] - slope * t[:first] - at).std()), abs(slope * t[0])
    error = (reference - measured)[during]
    notes = []
    if moved > UNREST * abs(args.amplitude):
        notes.append(f"it was not at rest before: it moved by {moved:.2g} {CHANNELS[args.channel].unit}")
    lasted = float(t[last]) + period
    if lasted < 0.98 * duration(args) - 2.0 * period:
        notes.append(f"it ended after {lasted:.2f} s of {duration(args):g} s")
    if first < 5:
        notes.append("nothing was recorded before it: an error that was there already counts as response")
    found: Step | Doublet | Chirp
    if args.kind == "step":
        found = _step(args.amplitude, t[during], response[during], noise, notes)
        if found.rise is not None and found.rise < 4.0 * period:
            notes.append(f"it rose within {found.rise / period:.0f} samples: its times are rough")
    elif args.kind == "doublet":
        found = _doublet(args, t, response, injected, period, notes)
    else:
        found = chirp_of(args, t, response, injected, period, notes)
    return Report(
        args,
        title,
        t,
        reference,
        measured,
        injected,
        rows,
        response,
        lasted,
        period,
        lost,
        bad,
        float(np.sqrt(np.mean(error**2))),
        float(np.abs(error).max()),
        found,
        notes,
    )


def _clean(columns: Mapping[str, Array]) -> tuple[dict[str, Array], int]:
    """The rows that are numbers and later than the one before, and how many are not. Outputs may be anything."""
    rows = {name: np.asarray(column, dtype=float) for name, column in columns.items()}
    size = len(rows["t"]) if rows["t"].ndim == 1 else -1
    for name, row in rows.items():
        if row.shape != (size,):
            text = f"response: {name} has the shape {row.shape}; expected one number for each time ({size})"
            raise BadInput(text, field=name, value=row.shape, expected=(size,))
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
    return BadInput(f"response: {what}; expected {expected}", field=name, value=what, expected=expected)


def _step(amplitude: float, t: Array, y: Array, noise: float, notes: list[str]) -> Step:
    """``t``, ``y``: while the step lasted."""
    tail = y[t >= (1.0 - END) * t[-1]]
    final = float(tail.mean())
    found = Step(final, amplitude - final, noise=noise)
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


def _doublet(args: Inject, t: Array, y: Array, injected: Array, period: float, notes: list[str]) -> Doublet:
    share = y / args.amplitude
    first, second = share[(t >= 0.0) & (t < 2.0 * args.seconds)], share[t >= args.seconds]
    ways = float(first.max()), float(max(0.0, -second.min())) if len(second) else 0.0
    grid = np.arange(t[0], t[-1], period)
    u, v = np.interp(grid, t, injected), np.interp(grid, t, y)
    size = 2 * len(grid)
    like = np.fft.irfft(np.fft.rfft(v, size) * np.conj(np.fft.rfft(u, size)), size)
    like /= max(float(np.linalg.norm(u) * np.linalg.norm(v)), 1e-12)
    most = min(len(grid) - 1, int(args.seconds / period))
    k = int(np.argmax(like[:most]))
    if like[k] < ALIKE:
        notes.append("it does not follow: the response is not like what was injected")
        return Doublet(*ways, None, float(like[k]))
    before, at, after = like[k - 1], like[k], like[k + 1]  # the one before lag 0 stands at the end
    bend = before - 2.0 * at + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return Doublet(*ways, max(0.0, (k + float(np.clip(shift, -0.5, 0.5))) * period), float(at))


def seconds(value: float | None) -> str:
    """A time for a person."""
    return "none" if value is None else f"{value:.3f} s" if value < 10.0 else f"{value:.2f} s"


def _step_rows(found: Step, unit: str) -> list[tuple[str, str]]:
    peak = "none" if found.peak is None else f"{found.peak:.3g} {unit} at {seconds(found.t_peak)}"
    over = "none" if found.overshoot is None else f"{found.overshoot:.1f} %"
    return [
        ("rise time (10-90 %)", seconds(found.rise)),
        ("delay (to 50 %)", seconds(found.delay)),
        ("overshoot", over),
        ("peak", peak),
        ("settling time (5 %)", seconds(found.settle_5)),
        ("settling time (2 %)", seconds(found.settle_2)),
        ("steady-state error", f"{found.steady_error:.2g} {unit}"),
    ]


def _doublet_rows(found: Doublet) -> list[tuple[str, str]]:
    return [
        ("delay (correlation)", "none" if found.delay is None else f"{seconds(found.delay)}"),
        ("correlation", f"{found.correlation:.3f}"),
        ("reached, one way", f"{100.0 * found.first:.0f} %"),
        ("and the other", f"{100.0 * found.second:.0f} %"),
    ]

"""A response as a picture: reference and measured value, error, outputs, and the marks of what was found."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from agents.controllers.frequency import TRUSTED, Chirp, decibel
from agents.controllers.response import Report, Step
from agents.controllers.types import Array
from zmav.figures import save

INK, GREY, PALE = "#202124", "#80868b", "#dadce0"
MEASURED, WRONG, MARK = "#1a73e8", "#d93025", "#e8710a"
SHADES = ("#188038", "#9334e6", "#e8710a", "#1a73e8", "#d93025", "#12858d", "#80868b", "#202124")
PANELS = 3
"""of outputs, at most"""
LEAST = 0.02
"""that an output's axis spans"""
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "grid.color": "#eceff1",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.labelcolor": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
}


def draw(report: Report, path: Path) -> None:
    """Write a picture (PNG, or what the file's name says). Raises :class:`BadInput` where that cannot be."""
    save(figure_of(report), path)


def figure_of(report: Report) -> Figure:
    """Over time on the left; on the right the measures, of a chirp the frequency response and the measures."""
    groups = _groups(report.outputs)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.5, 5.6 + 1.05 * len(groups)), dpi=110)
        FigureCanvasAgg(figure)
        heights = [3.2, 1.5] + [1.2] * len(groups)
        chirp = isinstance(report.found, Chirp)
        grid = GridSpec(
            len(heights),
            2,
            figure,
            height_ratios=heights,
            width_ratios=(1.0, 0.95 if chirp else 0.44),
            left=0.065,
            right=0.975,
            top=0.9,
            bottom=0.085,
            hspace=0.16,
            wspace=0.27 if chirp else 0.06,
        )
        axes = [figure.add_subplot(grid[0, 0])]
        axes += [figure.add_subplot(grid[k, 0], sharex=axes[0]) for k in range(1, len(heights))]
        _followed(axes[0], report)
        _error(axes[1], report)
        for ax, names in zip(axes[2:], groups, strict=True):
            _outputs(ax, report, names)
        for ax in axes:
            ax.set_xlim(float(report.t[0]), float(report.t[-1]))
            ax.tick_params(length=2, labelbottom=ax is axes[-1])
        axes[-1].set_xlabel(f"time since the {report.args.kind} (s)")
        figure.align_ylabels(axes)
        if isinstance(report.found, Chirp):
            _bode(figure, grid, report.found)
            words = "     ".join(f"{name} {value}" for name, value in report.found.rows()[:3])
            figure.text(0.975, 0.921, words, fontsize=8, color=INK, ha="right")
        else:
            _table(figure, grid, report)
        _title(figure, report)
    return figure


def _title(figure: Figure, report: Report) -> None:
    head, _, _ = report.text().partition("\n")
    figure.text(0.065, 0.985, head, fontsize=12, color=INK, weight="bold", va="top")
    if isinstance(report.found, Chirp) and report.notes:
        figure.text(0.975, 0.004, "; ".join(report.notes), fontsize=8, color=WRONG, va="bottom", ha="right")


def _groups(outputs: dict[str, Array]) -> list[list[str]]:
    """Outputs that share a panel: the parts of one vector."""
    found: dict[str, list[str]] = {}
    for name in outputs:
        found.setdefault(name.rpartition(".")[0] or name, []).append(name)
    return list(found.values())[:PANELS]


def _followed(ax: Axes, report: Report) -> None:
    name = report.args.channel + (", down" if report.args.channel in ("z", "vz") else "")
    fine = 0.6 if isinstance(report.found, Chirp) else 1.0
    ax.plot(report.t, report.reference, color=INK, linewidth=1.1 * fine, label="reference", zorder=3)
    ax.plot(report.t, report.measured, color=MEASURED, linewidth=1.5 * fine, label="measured", zorder=4)
    ax.set_ylabel(f"{name} ({report.unit})")
    ax.margins(y=0.12)
    if isinstance(report.found, Step):
        _marks(ax, report, report.found)
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, borderaxespad=0.1)


def _marks(ax: Axes, report: Report, found: Step) -> None:
    """Rise, overshoot and settling, where there are such, upon the curve itself."""
    if found.rise is None or found.t10 is None or found.t90 is None:
        return
    base = report.measured - report.response  # what would have been without the step

    def at(t: float, value: float) -> tuple[float, float]:
        return t, float(np.interp(t, report.t, base)) + value

    during = (report.t >= 0.0) & (report.t <= report.seconds)
    for band, strength in ((0.05, 0.10), (0.02, 0.16)):
        low, high = (base[during] + found.final * (1.0 + way * band) for way in (-1.0, 1.0))
        label = f"within {100 * band:.0f} %" if band == 0.05 else None
        ax.fill_between(
            report.t[during], low, high, color=SHADES[0], alpha=strength, linewidth=0, label=label, zorder=1
        )
    up = 1.0 if found.final > 0.0 else -1.0
    ends = [at(found.t10, 0.1 * found.final), at(found.t90, 0.9 * found.final)]
    ax.plot(*zip(*ends, strict=True), linestyle="none", marker="o", markersize=5, color=MARK, zorder=6)
    across = {"arrowstyle": "|-|,widthA=0.25,widthB=0.25", "color": MARK, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (found.t90, ends[0][1]), (found.t10, ends[0][1]), zorder=5, arrowprops=across)
    ax.plot((found.t90, found.t90), (ends[0][1], ends[1][1]), color=MARK, linewidth=0.8, linestyle=":", zorder=5)
    _say(ax, f"rise {found.rise:.3g} s", (found.t90, ends[0][1]), (8, 0), MARK, "left", "center")
    if found.overshoot is not None and found.overshoot >= 0.5 and found.t_peak is not None and found.peak is not None:
        top = at(found.t_peak, found.peak)
        ax.plot(*top, marker="o", markersize=5, color=WRONG, zorder=6)
        words = f"overshoot {found.overshoot:.1f} % at {found.t_peak:.3g} s"
        _say(ax, words, top, (8, 4 * up), WRONG, "left", "bottom" if up > 0 else "top")
    settled = [(found.settle_5, "within 5 %", 0.36), (found.settle_2, "within 2 %", 0.58)]
    if found.settle_5 == found.settle_2:
        settled = [(found.settle_2, "settled", 0.47)]
    for value, words, height in settled:
        if value is not None:
            level, head = at(value, height * found.final)[1], at(value, found.final)[1]
            ax.plot((value, value), (level, head), color=SHADES[0], linewidth=1.0, linestyle="--", zorder=2)
            _say(ax, f"{words} after {value:.3g} s", (value, level), (6, 0), SHADES[0], "left", "center")


def _say(
    ax: Axes, words: str, at: tuple[float, float], off: tuple[float, float], shade: str, across: str, up: str
) -> None:
    box: Any = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
    ax.annotate(
        words,
        at,
        xytext=off,
        textcoords="offset points",
        color=shade,
        fontsize=8.5,
        ha=across,
        va=up,
        zorder=7,
        bbox=box,
    )


def _error(ax: Axes, report: Report) -> None:
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    ax.plot(report.t, report.error, color=WRONG, linewidth=0.9)
    ax.fill_between(report.t, report.error, 0.0, color=WRONG, alpha=0.08, linewidth=0)
    ax.set_ylabel(f"error ({report.unit})")


def _outputs(ax: Axes, report: Report, names: list[str]) -> None:
    group = names[0].rpartition(".")[0]
    for name, shade in zip(names, SHADES, strict=False):
        label = name.removeprefix(group + ".") if group else None
        ax.plot(report.t, report.outputs[name], color=shade, linewidth=0.8, label=label)
    ax.set_ylabel(group or names[0])
    low, high = ax.get_ylim()
    if high - low < LEAST:  # the last bits of a number are nothing to look at
        ax.set_ylim((low + high - LEAST) / 2.0, (low + high + LEAST) / 2.0)
    if group:
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=1.0, borderaxespad=0.2)


def _table(figure: Figure, grid: GridSpec, report: Report) -> None:
    """The measures, and under them what to know before believing them."""
    ax = figure.add_subplot(grid[0, 1])
    ax.axis("off")
    step = 1.0 / 11.0
    place = 1.0
    for name, words in report.rows():
        if name == "recorded":
            continue
        ax.text(0.16, place, name, transform=ax.transAxes, va="top", color=GREY, fontsize=9.5)
        ax.text(1.0, place, words, transform=ax.transAxes, va="top", ha="right", color=INK, fontsize=9.5)
        place -= step
    ax.text(
        0.16, place - 0.02, dict(report.rows())["recorded"], transform=ax.transAxes, va="top", color=GREY, fontsize=8
    )
    said = "\n".join(_wrapped(each, 44) for each in report.notes)
    ax.text(0.16, place - 0.12, said, transform=ax.transAxes, va="top", color=WRONG, fontsize=8, linespacing=1.4)


def _wrapped(words: str, width: int) -> str:
    lines = [""]
    for word in words.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] += word + " "
    return "\n".join(line.rstrip() for line in lines)


def _bode(figure: Figure, grid: GridSpec, found: Chirp) -> None:
    inner = grid[:, 1].subgridspec(3, 1, height_ratios=(2.0, 2.0, 0.9), hspace=0.12)
    gain = figure.add_subplot(inner[0])
    phase, coherence = (figure.add_subplot(inner[k], sharex=gain) for k in (1, 2))
    good = found.trusted
    trusted = np.where(good, 1.0, np.nan)
    levels = np.array([decibel(float(each)) for each in found.gain])
    degrees = np.degrees(found.phase)
    gain.axhline(0.0, color=GREY, linewidth=0.8)
    gain.axhline(-3.0, color=MARK, linewidth=0.8, linestyle=":")
    for ax, values in ((gain, levels), (phase, degrees)):
        ax.plot(found.frequency, values * trusted, color=MEASURED, linewidth=1.6, zorder=4)
    gain.plot(found.frequency[~good], levels[~good], linestyle="none", marker=".", color=PALE, zorder=3)
    if good.any():
        gain.set_ylim(max(-40.0, float(levels[good].min()) - 3.0), max(3.0, float(levels[good].max()) + 3.0))
    if found.bandwidth is not None and found.phase_there is not None:
        for ax, value in ((gain, -3.0), (phase, math.degrees(found.phase_there))):
            ax.axvline(found.bandwidth, color=MARK, linewidth=0.9, linestyle="--", zorder=2)
            ax.plot(found.bandwidth, value, marker="o", markersize=5, color=MARK, zorder=6)
        across = "right"
        _say(gain, f"−3 dB at {found.bandwidth:.3g} Hz", (found.bandwidth, -3.0), (-8, -4), MARK, across, "top")
        _say(
            phase,
            f"{math.degrees(found.phase_there):.0f}°",
            (found.bandwidth, math.degrees(found.phase_there)),
            (-8, -4),
            MARK,
            across,
            "top",
        )
    peak = dict(found.rows())["resonance peak"]
    if found.peak is not None and found.peak_frequency is not None and peak not in ("none", "unknown"):
        gain.plot(found.peak_frequency, decibel(found.peak), marker="o", markersize=5, color=WRONG, zorder=6)
        _say(gain, peak, (found.peak_frequency, decibel(found.peak)), (0, 7), WRONG, "center", "bottom")
    coherence.plot(found.frequency, found.coherence, color=SHADES[0], linewidth=1.2)
    coherence.axhline(TRUSTED, color=GREY, linewidth=0.8, linestyle=":")
    coherence.set(ylim=(0.0, 1.05), ylabel="coherence", xlabel="frequency (Hz)")
    gain.set_ylabel("gain (dB)")
    phase.set_ylabel("phase (°)")
    _decades(gain, found)
    for ax in (gain, phase, coherence):
        ax.tick_params(which="both", length=2, labelbottom=ax is coherence)
    figure.align_ylabels([gain, phase, coherence])


def _decades(ax: Axes, found: Chirp) -> None:
    """Frequencies as people write them: 0.1, 0.2, 0.5, 1."""
    low, high = float(found.frequency[0]), float(found.frequency[-1])
    ax.set(xscale="log", xlim=(low, high))
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    marks = [n * 10.0**k for k in range(first, last + 1) for n in (1, 2, 5) if low <= n * 10.0**k <= high]
    ax.xaxis.set_major_locator(FixedLocator(marks))

    def told(value: Any, _place: Any) -> str:
        return f"{value:g}"

    ax.xaxis.set_major_formatter(FuncFormatter(told))
    ax.xaxis.set_minor_formatter(NullFormatter())

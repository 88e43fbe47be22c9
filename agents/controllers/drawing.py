"""A response as a picture: reference and measured value, error, outputs, and what was found, as the terminal has it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agents.controllers.response import Report
from zmav.errors import missing_extra
from zmav.figures import save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MEASURED, WRONG, MARK, GREY = "#1a73e8", "#d93025", "#e8710a", "#80868b"
PANELS = 3
"""of outputs, at most"""


def picture(report: Report, path: Path) -> None:
    """Draw it (PNG, or what the file's name says). Raises :class:`~zmav.errors.BadConfig` where matplotlib is not
    installed, and :class:`~zmav.errors.BadInput` for a file that cannot be.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as e:
        raise missing_extra("a picture", e.name, "planner") from e
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


def _draw_followed(ax: Axes, report: Report) -> None:
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

"""The two tracks of a followed rover over the ground, as the first paper's figure 8 has them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from zmav.errors import BadConfig, BadInput

if TYPE_CHECKING:
    from agents.demo.follow import Truth

ROVER, QUAD, HIDDEN = "#5f6368", "#1a73e8", "#e8710a"


def draw(truth: Truth, path: Path, title: str) -> None:
    """North over east, and the distance between the two over time. Raises :class:`BadInput` where it cannot be
    written, :class:`BadConfig` where matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as e:
        text = "the picture needs matplotlib: pip install 'zmav[planner]'"
        raise BadConfig(text, field="picture", value=e.name, expected="matplotlib") from e
    rows = truth.rows
    figure = Figure(figsize=(11.0, 5.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    over, beside = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    over.plot([r[5] for r in rows], [r[4] for r in rows], color=ROVER, lw=2.4, label="rover")
    over.plot([r[2] for r in rows], [r[1] for r in rows], color=QUAD, lw=1.1, label="quadrotor")
    unseen = [r for r in rows if r[6] in ("coast", "approach", "search")]
    over.plot([r[2] for r in unseen], [r[1] for r in unseen], ".", color=HIDDEN, ms=2.5, label="rover not seen")
    over.set(xlabel="east, m", ylabel="north, m", aspect="equal")
    over.legend(loc="best", fontsize=8)
    over.grid(alpha=0.3)
    for some, line, color in ((rows, "-", QUAD), (unseen, ".", HIDDEN)):
        off = [((r[1] - r[4]) ** 2 + (r[2] - r[5]) ** 2) ** 0.5 for r in some]
        beside.plot([r[0] for r in some], off, line, color=color, lw=1.0, ms=2.5)
    beside.set(xlabel="time, s", ylabel="between the two over the ground, m", ylim=(0.0, 4.0))
    beside.grid(alpha=0.3)
    height = beside.twinx()
    height.plot([r[0] for r in rows], [r[3] for r in rows], color="#188038", lw=0.8, ls="--")
    height.set_ylim(0.0, 1.2 * max((r[3] for r in rows), default=1.0))
    height.set_ylabel("height of the quadrotor, m (dashed)", color="#188038")
    figure.suptitle(title, fontsize=10)
    data = io.BytesIO()
    try:
        figure.savefig(data, format=path.suffix.lstrip(".").lower() or "png")
        path.write_bytes(data.getvalue())
    except ValueError as e:
        raise BadInput(f"cannot draw {path}: {e}", field="picture", value=str(path), expected="png, svg or pdf") from e
    except OSError as e:
        raise BadInput(f"cannot write {path}: {e.strerror}", field="picture", value=str(path)) from e

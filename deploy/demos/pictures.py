"""Draws the demos' pictures for the documents, by flying them: 'python deploy/demos/pictures.py' (some minutes)."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from agents.demo import picture
from agents.demo.watch import Row
from zmav.errors import BadInput

DOCS = Path(__file__).resolve().parents[2] / "docs"
PICTURES = {"swap": "tracks.gif", "lost-link": "tracks.png", "follow": "tracks.png"}
"""demo -> which of its pictures"""
FRAMES, PACE = 150, 0.08
"""of an animation: pictures, and s of each"""


def main() -> int:
    for name, picture_name in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "zmav", "demo", name, "--out", folder]
            code = subprocess.run(command).returncode
            if code != 0:
                return code
            if picture_name.endswith(".gif"):
                told = json.loads((Path(folder) / "summary.json").read_text())
                rows = msgspec.convert(told["tracks"], list[Row])
                names = [each["vehicle"] for each in told["vehicles"]]
                animate(names, rows, f"{name}: {told['title']}", Path(folder) / picture_name)
            shutil.copyfile(Path(folder) / picture_name, DOCS / f"demo-{name}{Path(picture_name).suffix}")
    return 0


def animate(names: Sequence[str], rows: Sequence[Row], title: str, path: Path, frames: int = FRAMES) -> None:
    """A .gif of the tracks from above and of the heights, from the first that moves on, faster than it was flown."""
    figure, *panels = picture.axes_of(title)
    from matplotlib.animation import FuncAnimation, PillowWriter

    rows = picture.without_rest(rows)
    picture.plot(names, rows, *panels)  # all of it: so wide are the axes of each frame
    picture.look_down(panels[0], rows)
    for axes in panels[1:]:
        axes.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())

    def show(frame: int) -> list[Any]:
        for axes in panels:
            for line in list(axes.lines):
                line.remove()
        picture.plot(names, rows[: 1 + round(frame * (len(rows) - 1) / (frames - 1))], *panels)
        return [line for axes in panels for line in axes.lines]

    figure.set_dpi(60)
    try:
        FuncAnimation(figure, show, frames=frames, blit=False).save(str(path), writer=PillowWriter(fps=round(1 / PACE)))
    except (OSError, ValueError) as e:
        raise BadInput(f"cannot draw {path}: {e}", field="animation", value=str(path), expected="a .gif") from e


if __name__ == "__main__":
    sys.exit(main())

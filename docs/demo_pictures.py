"""Draws the pictures of demo fleets: 'python docs/demo_pictures.py [follow] [lost-link] [swap]' (two minutes each).

Each is flown by 'zmav demo' in real time, and wants a core for itself; '--flown FOLDER' draws what one demo left there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from PIL import Image

from agents.demo.picture import draw_figure, without_rest
from agents.demo.play import Mark
from agents.demo.watch import Row
from zmav.figures import save

DOCS = Path(__file__).resolve().parent
PICTURES = {"follow": "demo-follow.png", "lost-link": "demo-lost-link.png", "swap": "demo-swap.gif"}
FRAMES, PACE_MS, DPI = 120, 90, 60
FAINT = 0.35


def figure_of(flown: Path, *, steps: bool) -> tuple[Figure, Sequence[Row]]:
    told = json.loads((flown / "summary.json").read_text(encoding="utf-8"))
    rows = [Row(t, tuple(map(tuple, places))) for t, places in told["tracks"]]
    marks = [Mark(each["t"], each["text"]) for each in told["marks"]] if steps else []
    names = [each["vehicle"] for each in told["vehicles"]]
    return draw_figure(names, rows, marks, f"{told['demo']}: {told['title']}"), without_rest(rows)


def still(flown: Path, path: Path) -> None:
    figure, _ = figure_of(flown, steps=True)
    save(figure, path)
    with Image.open(path) as drawn:
        colours = drawn.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    colours.save(path, optimize=True)


def moving(flown: Path, path: Path) -> None:
    """The whole flight, faint, and where everybody is at a time that goes through it."""
    figure, rows = figure_of(flown, steps=False)
    figure.set_dpi(DPI)
    above, heights, ways = figure.axes
    for line in above.lines:
        line.set_alpha(FAINT)
    many = len(rows[0].places)
    shades = [colormaps["turbo"]((i + 0.5) / many) for i in range(many)]
    pictures = []
    for row in rows[:: max(1, len(rows) // FRAMES)]:
        drawn = [
            above.scatter([e for _, e, _ in row.places], [n for n, _, _ in row.places], s=40, c=shades, zorder=5),
            *(axes.axvline(row.t, color="#202124", lw=1.0) for axes in (heights, ways)),
        ]
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]
        pictures.append(Image.fromarray(pixels).convert("RGB").quantize(64, dither=Image.Dither.NONE))
        for each in drawn:
            each.remove()
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=PACE_MS, loop=0, optimize=True)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("demo", nargs="*", choices=(*PICTURES, []), default=[])
    options.add_argument("--flown", type=Path, help="what a demo left: draw it, fly nothing")
    chosen = options.parse_args()
    if chosen.flown is not None and len(chosen.demo) != 1:
        options.error("--flown goes with one demo")
    for name in chosen.demo or PICTURES:
        with tempfile.TemporaryDirectory(prefix="zmav-pictures-") as scratch:
            flown = chosen.flown or Path(scratch)
            if chosen.flown is None:
                subprocess.run([sys.executable, "-m", "zmav", "demo", name, "--out", flown], check=True)
            path = DOCS / PICTURES[name]
            (moving if path.suffix == ".gif" else still)(flown, path)
            print(f"wrote docs/{path.name}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()

"""Routes from files: waypoints as TOML or CSV, in metres about the fleet's origin or about a place.

    rounding = 0.0
    [[waypoint]]
    pos = [0.0, 0.0, -5.0]
    [[waypoint]]
    pos = [10.0, 0.0, -5.0]
    speed = 0.5
    dwell = 2.0
    yaw = 1.57

A CSV file begins with ``north,east,down`` and those of ``speed,dwell,yaw`` that it has; empty fields are not given.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import msgspec
import numpy as np

from agents.navigator.path import turned
from agents.navigator.routes import FAR, Route, Waypoint, bad, check, through
from zmav.config.table import reading
from zmav.wire import Vector

NEEDED, OPTIONAL = ("north", "east", "down"), ("speed", "dwell", "yaw")
KINDS = (".toml", ".csv")


class Point(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pos: tuple[float, float, float]
    speed: float | None = None
    """m/s at most on the way to it"""
    dwell: float = 0.0
    """s"""
    yaw: float | None = None
    """rad"""


class RouteFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    waypoint: list[Point]
    rounding: float = 0.0
    """m before and behind a corner at which it is cut"""


def load(path: str | Path, centre: Vector = (0.0, 0.0, 0.0), heading: float = 0.0, rounding: float = 0.0) -> Route:
    """The route of a file, turned clockwise by ``heading`` (rad) and moved by ``centre`` (m NED); ``rounding`` (m)
    where the file says none. Raises :class:`~zmav.errors.BadInput` that names the file and the field.
    """
    path = Path(path)
    with reading(path, "the route"):
        if path.suffix == ".toml":
            read = msgspec.toml.decode(path.read_bytes(), type=RouteFile)
        elif path.suffix == ".csv":
            read = RouteFile(waypoint=_rows(path.read_text(encoding="utf-8")))
        else:
            raise bad("file", path.name, "a file that ends in " + " or ".join(KINDS))
        turn = turned(heading)
        for k, each in enumerate(read.waypoint):
            for axis, value in zip(NEEDED, each.pos, strict=True):
                check(f"waypoint[{k}].{axis}", value, -FAR, FAR, "m")
        waypoints = [_placed(each, turn @ np.array(each.pos) + np.array(centre), heading) for each in read.waypoint]
        return through(path.stem, waypoints, read.rounding or rounding)


def find(name: str, folder: str | Path) -> Path:
    """The file of a route by its name in a folder; raises :class:`~zmav.errors.BadInput` naming those there are."""
    files = {path.stem: path for path in sorted(Path(folder).iterdir()) if path.suffix in KINDS}
    if name not in files:
        raise bad("route", name, ", ".join(files) or f"a file in {folder}")
    return files[name]


def _placed(point: Point, place: np.ndarray[tuple[int, ...], np.dtype[np.float64]], heading: float) -> Waypoint:
    north, east, down = map(float, place)
    yaw = None if point.yaw is None else math.remainder(point.yaw + heading, math.tau)
    return Waypoint((north, east, down), math.inf if point.speed is None else point.speed, point.dwell, yaw)


def _rows(text: str) -> list[Point]:
    lines = csv.DictReader(text.splitlines(), restkey="more", skipinitialspace=True)
    names = [name.strip() for name in lines.fieldnames or ()]
    lines.fieldnames = names
    if missing := [name for name in NEEDED if name not in names]:
        raise bad("columns", ",".join(names), f"also {', '.join(missing)}")
    if unknown := [name for name in names if name not in (*NEEDED, *OPTIONAL)]:
        raise bad("columns", ", ".join(unknown), f"only {', '.join((*NEEDED, *OPTIONAL))}")
    return [_point(row, lines.line_num) for row in lines]


def _point(row: dict[str, str | None], line: int) -> Point:
    if "more" in row:
        raise bad(f"line {line}", row["more"], "no more fields than the first line names")
    given: dict[str, float] = {}
    for name, text in row.items():
        if not (text or "").strip():
            if name in NEEDED:
                raise bad(f"line {line}, {name}", text or "", "a number")
            continue
        try:
            given[name] = float(text or "")
        except ValueError:
            raise bad(f"line {line}, {name}", text, "a number") from None
    pos = (given["north"], given["east"], given["down"])
    return Point(pos=pos, speed=given.get("speed"), dwell=given.get("dwell", 0.0), yaw=given.get("yaw"))

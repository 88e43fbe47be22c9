"""``QGC WPL 110``: the plain-text mission files (``.waypoints``, ``.txt``) of Mission Planner and older QGroundControl.

Format: https://mavlink.io/en/file_formats/. A header, then one item a line in twelve columns, the first of them home.
Mission Planner keeps fences and rally points in such files, too: which kind a file holds is seen by its commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zmav.errors import BadInput
from zmav.formats import fence
from zmav.formats.items import Enums, Plan, command_name, command_number, frame_name, frame_number, numbers
from zmav.formats.plan import DO_JUMP, RALLY
from zmav.wire import MissionItem, MissionKind

HEADER = "QGC WPL 110"
PARAMS = ("param1", "param2", "param3", "param4")
COLUMNS = ("index", "current", "frame", "command", *PARAMS, "x", "y", "z", "autocontinue")
WAYPOINT = 16


def read(data: bytes, enums: Enums, name: str = "the file") -> Plan:
    """The plan in a file's bytes; raises :class:`BadInput` naming ``name``, the line, and what was expected."""
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as e:
        raise _bad(name, 1, f"not text: {e}") from None
    if not lines or lines[0].split() != HEADER.split():
        raise _bad(name, 1, f"expected {HEADER!r}")
    rows = [(n, line.split()) for n, line in enumerate(lines[1:], 2) if line.strip() and not line.startswith("#")]
    parsed = [_row(words, i, enums, name, line) for i, (line, words) in enumerate(rows)]
    if not parsed:
        return Plan(mission=[])
    home, items = parsed[0], parsed[1:]
    if home.command != command_name(WAYPOINT, enums):
        raise _bad(name, rows[0][0], f"the first row is home, a waypoint ({WAYPOINT}), not {home.command}")
    for (line, _), item in zip(rows[1:], items, strict=True):
        if item.command == DO_JUMP:
            given = item.params[0]
            target = (math.nan if given is None else given) - 1.0
            if target not in range(len(items)):
                raise _bad(name, line, f"param1: jumps to row {target + 1.0:g}, which there is not")
            item.params[0] = target
    plan = Plan(home=(home.x, home.y, home.z) if home.x or home.y else None)
    setattr(plan, kind_of(items), items)
    return plan


def write(plan: Plan, enums: Enums) -> bytes:
    """A file's bytes; raises :class:`BadInput` for a plan of more than one kind."""
    given: list[MissionKind] = [kind for kind in ("mission", "fence", "rally") if getattr(plan, kind)]
    if len(given) > 1:
        text = f"a .waypoints file holds one kind, not {' and '.join(given)}: choose one, or write a .plan"
        raise BadInput(text, field="kind", value=given, expected="one of mission, fence, rally")
    x, y, z = plan.home or (0.0, 0.0, 0.0)
    rows = [_line(0, MissionItem(command="MAV_CMD_NAV_WAYPOINT", frame="MAV_FRAME_GLOBAL", x=x, y=y, z=z), enums)]
    items: list[MissionItem] = getattr(plan, given[0]) if given else []
    rows += [_line(i, item, enums) for i, item in enumerate(items, 1)]
    return "\n".join([HEADER, *rows, ""]).encode()


def kind_of(items: Sequence[MissionItem]) -> MissionKind:
    """What these items are, by their commands."""
    if items and all(item.command.startswith(fence.PREFIX) for item in items):
        return "fence"
    return "rally" if items and all(item.command == RALLY for item in items) else "mission"


def _row(words: list[str], index: int, enums: Enums, name: str, line: int) -> MissionItem:
    if len(words) != len(COLUMNS):
        raise _bad(name, line, f"{len(words)} columns, expected {len(COLUMNS)}: {' '.join(COLUMNS)}")
    row = {column: _number(word, column, name, line) for column, word in zip(COLUMNS, words, strict=True)}
    for column in ("index", "current", "frame", "command", "autocontinue"):
        if row[column] != int(row[column]):
            raise _bad(name, line, f"{column}: {row[column]:g} is not a whole number")
    if row["index"] != index:
        raise _bad(name, line, f"index {row['index']:g}, expected {index}")
    try:
        command, frame = command_name(int(row["command"]), enums), frame_name(int(row["frame"]), enums)
    except BadInput as e:
        raise _bad(name, line, f"{e.detail['field']}: {e.message}") from None
    params = [None if math.isnan(row[param]) else row[param] for param in PARAMS]
    place = {axis: 0.0 if math.isnan(row[axis]) else row[axis] for axis in "xyz"}
    return MissionItem(command=command, frame=frame, params=params, autocontinue=row["autocontinue"] != 0, **place)


def _number(word: str, column: str, name: str, line: int) -> float:
    """A column's number; only a parameter may be NaN."""
    try:
        number = float(word)
    except ValueError:
        raise _bad(name, line, f"{column}: {word!r} is not a number") from None
    if not math.isfinite(number) and not (math.isnan(number) and column.startswith(("param", "x", "y", "z"))):
        raise _bad(name, line, f"{column}: {word!r} is not a number that it can be")
    return number


def _line(index: int, item: MissionItem, enums: Enums) -> str:
    params = [math.nan if value is None else value for value in numbers(item)]
    if item.command == DO_JUMP:
        params[0] += 1.0
    floats = [
        f"{value:g}" if value == float(f"{value:g}") else repr(value) for value in (*params, item.x, item.y, item.z)
    ]
    current = int(index == 0)
    whole = [index, current, frame_number(item.frame, enums), command_number(item.command, enums)]
    return "\t".join([*map(str, whole), *floats, str(int(item.autocontinue))])


def _bad(name: str, line: int, what: str) -> BadInput:
    return BadInput(f"{name}: line {line}: {what}", field=f"line {line}", value=name, expected=what)

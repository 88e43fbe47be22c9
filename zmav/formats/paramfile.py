"""Parameter files: QGroundControl's ``.params`` and Mission Planner's ``.param`` (``.parm``), told apart by content.

QGroundControl: vehicle id, component id, name, value and type (the number of a MAV_PARAM_TYPE), separated by tabs.
Mission Planner and MAVProxy: name and value, separated by a comma or blanks. In both, ``#`` begins a comment.
https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/parameters.html
"""

from __future__ import annotations

import math
import re
from pathlib import PurePath
from typing import Literal

import msgspec

from zmav.errors import BadInput
from zmav.wire import PARAM_TYPES

Format = Literal["qgc", "planner"]
SUFFIXES: dict[str, Format] = {".params": "qgc", ".param": "planner", ".parm": "planner"}

_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?\Z")
_HEX = re.compile(r"0[xX][0-9a-fA-F]{1,16}\Z")
_INTEGER = re.compile(r"[-+]?[0-9]{1,38}\Z")
_NAME = re.compile(r"[!-~]{1,16}\Z")
_REALS = ("REAL32", "REAL64")


class FileParam(msgspec.Struct, frozen=True):
    """One line; a value that is no number is None. ``type`` (:data:`zmav.wire.PARAM_TYPES`) is QGroundControl's."""

    name: str
    value: float | int | None
    type: str | None = None
    compid: int | None = None


class ParamFile(msgspec.Struct):
    """What a file says. ``sysid`` is QGroundControl's; what follows it is written into the header, and not read."""

    format: Format
    params: list[FileParam]
    sysid: int | None = None
    stack: str = ""
    vehicle: str = ""
    version: str = ""

    def values(self, compid: int = 1) -> dict[str, float | int | None]:
        """Those of one component, or of any where the file names none, by name."""
        return {p.name: p.value for p in self.params if p.compid in (None, compid)}


def format_of(path: str) -> Format:
    """The format to write, by the file's ending. Raises :class:`BadInput`."""
    found = SUFFIXES.get(PurePath(path).suffix.lower())
    if found is None:
        raise BadInput.wrong("path", path, ".params (QGroundControl), .param or .parm (Mission Planner) at its end")
    return found


def read(data: bytes, name: str = "the file") -> ParamFile:
    """What the file's bytes say; raises :class:`BadInput` with ``name``, the line and what was expected."""
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as e:
        line = data[: e.start].count(b"\n") + 1
        raise _bad(name, line, "is not UTF-8 text") from None
    rows = [(n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise BadInput(f"{name} holds no parameters", field="file", value=name, expected="lines of parameters")
    qgc = rows[0][1].count("\t") > 1
    found = ParamFile(format="qgc" if qgc else "planner", params=[])
    seen: dict[tuple[int | None, str], tuple[int, FileParam]] = {}
    for n, text in rows:
        param = _qgc_line(found, text, name, n) if qgc else _planner_line(text, name, n)
        first, other = seen.setdefault((param.compid, param.name), (n, param))
        if other != param:  # a name that comes twice is somebody's mistake, unless it says the same
            raise _bad(name, n, f"{param.name} has another value than in line {first}")
    found.params = [param for _, param in seen.values()]
    return found


def write(file: ParamFile) -> bytes:
    """The file's bytes in its format, by name; raises :class:`BadInput` where a line lacks what the format needs."""
    params = sorted(file.params, key=lambda p: (p.compid or 0, p.name))
    if file.format == "planner":
        lines = [f"{p.name},{shown(p.value)}" for p in params]
        about = " ".join(filter(None, (file.stack, file.vehicle, file.version)))
        return "\n".join([f"#NOTE: {about}" if about else "#NOTE: parameters", *lines, ""]).encode()
    header = [
        f"# Onboard parameters for Vehicle {file.sysid or 1}",
        "#",
        f"# Stack: {file.stack}",
        f"# Vehicle: {file.vehicle}",
        f"# Version: {file.version} ",
        "# Git Revision: ",
        "#",
        "# Vehicle-Id Component-Id Name Value Type",
    ]
    return "\n".join([*header, *(_qgc_row(file, p) for p in params), ""]).encode()


def _qgc_row(file: ParamFile, param: FileParam) -> str:
    if param.type not in PARAM_TYPES:
        text = f"{param.name}: its type is not known, and QGroundControl's format needs it"
        raise BadInput(text, field=param.name, value=param.type, expected=f"one of {', '.join(PARAM_TYPES)}")
    number = PARAM_TYPES.index(param.type) + 1
    sysid, compid = (1 if each is None else each for each in (file.sysid, param.compid))
    return f"{sysid}\t{compid}\t{param.name}\t{shown(param.value)}\t{number}"


def shown(value: float | int | None) -> str:
    """A value for a person, and in a file: 3 and not 3.0, nan for none."""
    if value is None:
        return "nan"
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(value)


def _qgc_line(file: ParamFile, line: str, name: str, n: int) -> FileParam:
    words = line.strip().split("\t")
    if len(words) != 5:
        raise _bad(name, n, f"has {len(words)} columns, not 5 separated by tabs: vehicle, component, name, value, type")
    sysid, compid = _whole(words[0], "vehicle", 255, name, n), _whole(words[1], "component", 255, name, n)
    kind = PARAM_TYPES[_whole(words[4], "type", len(PARAM_TYPES), name, n, least=1) - 1]
    if file.sysid not in (None, sysid):
        raise _bad(
            name, n, f"is of vehicle {sysid}, and lines before are of vehicle {file.sysid}: expected one vehicle"
        )
    file.sysid = sysid
    value = _number(words[3], name, n)
    if kind in _REALS:
        value = None if value is None else float(value)
    elif value is None or value != int(value):
        raise _bad(name, n, f"{words[2]}: {words[3]!r} is no integer, which its type {kind} expects")
    else:
        value = int(value)
    return FileParam(name=_named(words[2], name, n), value=value, type=kind, compid=compid)


def _planner_line(line: str, name: str, n: int) -> FileParam:
    words = line.partition("#")[0].replace(",", " ").split()
    if len(words) != 2:
        raise _bad(name, n, f"{line.strip()[:60]!r} is not NAME,VALUE")
    return FileParam(name=_named(words[0], name, n), value=_number(words[1], name, n))


def _named(word: str, name: str, n: int) -> str:
    if not _NAME.match(word):
        raise _bad(name, n, f"{word[:40]!r} cannot be a parameter's name: expected 1 to 16 printable characters")
    return word


def _whole(word: str, what: str, most: int, name: str, n: int, least: int = 0) -> int:
    if not _INTEGER.match(word) or not least <= int(word) <= most:
        raise _bad(name, n, f"{what} {word[:40]!r}: expected a number from {least} to {most}")
    return int(word)


def _number(word: str, name: str, n: int) -> float | int | None:
    if word.lower() == "nan":
        return None
    if _INTEGER.match(word):
        return int(word)
    if _HEX.match(word):  # MAVProxy's users write bit masks so
        return int(word, 16)
    if not _NUMBER.match(word) or not math.isfinite(float(word)):
        raise _bad(name, n, f"{word[:40]!r} is not a number")
    return float(word)


def _bad(name: str, line: int, why: str) -> BadInput:
    return BadInput(f"{name}, line {line}: {why}", field=f"line {line}", value=name, expected=why)

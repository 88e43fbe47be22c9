"""Plans in files: which format a file has is said by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from zmav.errors import BadInput
from zmav.formats import plan, waypoints
from zmav.formats.items import Enums, Plan

SUFFIXES = (".plan", ".waypoints", ".txt")


def load(path: str | Path, enums: Enums) -> Plan:
    """Read a ``.plan``, or a ``.waypoints`` or ``.txt``; raises :class:`BadInput` naming file, place and fault."""
    read = plan.read if _is_json(path) else waypoints.read
    try:
        data = Path(path).read_bytes()
    except OSError as e:
        raise BadInput(f"cannot read {path}: {e.strerror}", field="file", value=str(path), expected="a file") from e
    return read(data, enums, str(path))


def save(path: str | Path, what: Plan, enums: Enums) -> None:
    """Write it in the format that the name says; raises :class:`BadInput` where that cannot hold it."""
    write: Callable[[Plan, Enums], bytes] = plan.write if _is_json(path) else waypoints.write
    data = write(what, enums)
    try:
        Path(path).write_bytes(data)
    except OSError as e:
        raise BadInput(f"cannot write {path}: {e.strerror}", field="file", value=str(path), expected="a file") from e


def _is_json(path: str | Path) -> bool:
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        known = ", ".join(SUFFIXES)
        raise BadInput(f"{path}: its name must end in one of {known}", field="file", value=str(path), expected=known)
    return suffix == ".plan"

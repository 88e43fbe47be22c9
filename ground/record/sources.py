"""What is played: recordings as records in the order of their times, whichever format they are in."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from ground.record.folder import Record
from zmav import keys
from zmav.errors import BadConfig, BadInput, BadKey, needs
from zmav.links.tlog import TlogReader

_RECORDED = re.compile(r"(?:[a-z0-9_-]+\.)?(?P<vehicle>[a-z0-9_-]+)\.\d{3,}\Z")
"""how the recorder calls a .tlog, but for its ending"""
SESSION = re.compile(r"(?P<time>\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d)(?:\.(?P<number>\d+))?")
"""and a session's folder, of several within a second all but the first with a number"""


class Source(Protocol):
    """One recording, or the parts of one."""

    label: str
    """for a person"""

    def vehicles(self) -> list[str]:
        """Whose recording it is. Raises :class:`BadInput` where it is none."""

    def first(self) -> int | None:
        """When it begins, ns UTC; None: it holds nothing that can be played."""

    def last(self) -> int | None:
        """When it ends, as :meth:`first`."""

    def records(self, since: int = 0) -> Iterator[Record]:
        """Again at each call. Raises OSError where it cannot be read, :class:`BadInput` where it is damaged."""


class Tlogs:
    """The .tlog parts of one vehicle, one after the other."""

    def __init__(self, vehicle: str, paths: Sequence[Path]) -> None:
        self.vehicle, self._paths = vehicle, list(paths)
        self.label = ", ".join(map(str, paths))

    def vehicles(self) -> list[str]:
        try:
            none = self.first() is None and any(path.stat().st_size for path in self._paths)
        except OSError as e:
            raise BadInput(f"cannot play {self.label}: {e}", field="file", expected="a .tlog that can be read") from e
        if none:
            text = f"{self.label} holds no MAVLink: give a .tlog or an .mcap"
            raise BadInput(text, field="file", value=self.label, expected="a recording")
        return [self.vehicle]

    def first(self) -> int | None:
        return next((record.at for record in self.records()), None)

    def last(self) -> int | None:
        return max((record.at for record in self.records()), default=None)

    def records(self, since: int = 0) -> Iterator[Record]:
        for path in self._paths:
            with path.open("rb") as file:
                for micros, frame in TlogReader(file):
                    if since <= micros * 1000:
                        yield Record(micros * 1000, "", frame)


def check_mcap() -> None:
    """Raise :class:`BadConfig` where the package is missing."""
    needs("an .mcap (--no-mcap records without)", "ground", "mcap.writer")


def open_all(paths: Sequence[Path]) -> list[Source]:
    """The recordings in these files and folders: of a folder its newest session, else its own; of either the .mcap, if
    there is one, else the .tlog files. Raises :class:`BadConfig` for what is none of these, and for an .mcap where its
    package is missing.
    """
    tlogs: dict[str, list[Path]] = {}
    sources: list[Source] = []
    files = [file for path in paths for file in _files(path)]
    several = sum(file.suffix != ".mcap" for file in files) > 1
    for file in files:
        if file.suffix == ".mcap":
            check_mcap()
            from ground.record.mcapfile import Mcap

            sources.append(Mcap(file))
        else:
            tlogs.setdefault(_vehicle(file, several), []).append(file)
    return [*sources, *(Tlogs(vehicle, parts) for vehicle, parts in tlogs.items())]


def readable(sources: Sequence[Source], say: Callable[[str], None]) -> list[tuple[Source, list[str]]]:
    """Those that are recordings, and whose they are; ``say`` is told which are left out, and why.

    Raises :class:`BadInput` where that leaves nothing.
    """
    found, faults = list[tuple[Source, list[str]]](), list[BadInput]()
    for source in sources:
        try:
            found.append((source, source.vehicles()))
        except BadInput as e:
            faults.append(e)
    if faults and not found:
        raise faults[0]
    for fault in faults:
        say(f"left out: {fault}")
    return found


def _files(path: Path) -> list[Path]:
    try:
        if path.is_file():
            return [path]
        if found := next(filter(None, map(_recordings, (*_sessions(path), path))), []):
            return found
    except OSError:
        pass  # no name that a file can have
    text = f"{path}: no .mcap and no .tlog there: give a file, a session's folder, or the recorder's (--out)"
    raise BadConfig(text, field="file", value=str(path), expected="recordings")


def _recordings(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap")) or sorted(folder.glob("*.tlog"))


def _sessions(folder: Path) -> list[Path]:
    """The recorder's folders in its folder, the newest first: they are called by time."""
    named = [(found, each) for each in folder.glob("*") if (found := SESSION.fullmatch(each.name)) and each.is_dir()]
    return [each for _, each in sorted(named, key=lambda n: (n[0]["time"], int(n[0]["number"] or 1)), reverse=True)]


def _vehicle(file: Path, several: bool) -> str:
    """As its recorder called it; else ``replay``, or where there are several after the file."""
    recorded = _RECORDED.match(file.stem)
    if recorded:
        return recorded["vehicle"]
    return (re.sub(r"[^a-z0-9_-]+", "-", file.stem.lower()).strip("-") if several else "") or "replay"


def vehicle_of(key: str) -> tuple[keys.Channel | None, str | None]:
    """A key's channel (None: the registry has it no more) and vehicle (None: it is shared)."""
    with contextlib.suppress(BadKey):
        channel, parts = keys.match(key)
        return channel, parts.get("vehicle")
    return None, None

"""Frames to record, a folder to record to, and a writer in it."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader

from ground.record.folder import Folder
from ground.record.mcapfile import HOLDS
from ground.record.storage import RecordingSettings, Storage
from zmav.mavlink import Dialect, encode, load_dialect

PATIENCE_S = 30.0


@pytest.fixture(scope="session")
def dialect() -> Dialect:
    return load_dialect()


class Frames:
    """ATTITUDE frames of one system, each with its number as its time."""

    def __init__(self, sysid: int = 1) -> None:
        self._sysid, self._numbers = sysid, itertools.count()
        self.key = f"mav/rx/{sysid}/1/ATTITUDE"
        self.made: list[bytes] = []

    def __call__(self) -> bytes:
        number = next(self._numbers)
        angles = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.001 * number)
        fields = {"time_boot_ms": number, **angles}
        frame = encode(load_dialect(), "ATTITUDE", fields, sysid=self._sysid, compid=1, seq=number & 255)
        self.made.append(frame)
        return frame


@pytest.fixture
def frames() -> type[Frames]:
    return Frames


class Room(Folder):
    """A folder whose disk has as much room as the test says."""

    room: int | None = None

    def free(self) -> int:
        return super().free() if self.room is None else self.room


class Bench:
    """A writer, what it said, and waits for what it does."""

    def __init__(self, folder: Room, **settings: Any) -> None:
        self.folder, self.said = folder, list[str]()
        self._news = threading.Event()
        self.storage = Storage(
            folder, RecordingSettings(**{"keep_free": 0, "flush": 0.1, **settings}), load_dialect(), self._tell
        )
        self.storage.start()

    def _tell(self, line: str) -> None:
        self.said.append(line)
        self._news.set()

    def told(self, words: str) -> None:
        """Wait until it says so."""
        while not any(words in line for line in self.said):
            self._news.clear()
            if not any(words in line for line in self.said):
                assert self._news.wait(PATIENCE_S), f"{words!r} was not said; {self.said}"

    def until(self, what: str, least: int) -> None:
        """Wait until a count is so high."""
        for _ in range(int(PATIENCE_S * 50)):
            if getattr(self.storage.counts, what) >= least:
                return
            threading.Event().wait(0.02)
        raise AssertionError(f"{what} is not {least}: {self.storage.counts}")

    def files(self, ending: str) -> list[Path]:
        return sorted(self.storage.session.glob(f"*.{ending}"))


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Room]:
    folder = Room(tmp_path / "recordings")
    yield folder
    folder.close()


@pytest.fixture
def bench(folder: Room) -> Iterator[Any]:
    """Start a writer that flushes often: ``bench(split_size=...)``; closed at the test's end."""
    benches: list[Bench] = []

    def start(**settings: Any) -> Bench:
        benches.append(Bench(folder, **settings))
        return benches[-1]

    yield start
    for each in benches:
        each.storage.close()


def read(path: Path, holds: str) -> list[tuple[str, bytes]]:
    """Topic and payload of the messages in topics that hold such things, by the mcap package's own indexed reader."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [(c.topic, m.data) for _, c, m in reader.iter_messages() if c.metadata[HOLDS] == holds]


def read_cut(path: Path, holds: str) -> list[tuple[str, bytes]]:
    """The same of a file that may end anywhere, by its reader of streams."""
    found: list[tuple[str, bytes]] = []
    with path.open("rb") as file:
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if channel.metadata[HOLDS] == holds:
                    found.append((channel.topic, message.data))
        except Exception:  # whatever a torn end is taken for
            return found
    return found


def records(path: Path) -> list[Any]:
    with path.open("rb") as file:
        return list(StreamReader(file, validate_crcs=True).records)

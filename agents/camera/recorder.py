"""Pictures on a disk with the times they were taken: a folder of JPEGs or an .avi, and a table beside them."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import IO

from agents.camera.avi import Avi
from zmav.errors import BadConfig, BadInput
from zmav.vision.opencv import decode, encode, opencv
from zmav.vision.reader import Picture

COLUMNS = "file,seq,t,arrived,width,height\n"
LOOK_EVERY = 1.0
"""s between two looks at how much room is left"""
QUALITY = 90
"""of pictures that are made to fit into an .avi of another size"""


class Recorder:
    """Writes to ``target``: an .avi where it ends so, else a folder. Every line of the table names a whole picture.

    ``keep_free``: bytes that are left free on the disk. Raises :class:`BadConfig` where nobody may write, or something
    is there already. Once the disk is full, :attr:`full` says so and pictures are counted as ``unwritten``.
    """

    def __init__(self, target: Path, rate: float, keep_free: float) -> None:
        self.written = 0
        self.unwritten = 0
        self.bytes = 0
        self.full = ""
        """why nothing is written at present"""
        self._keep_free, self._looked = keep_free, -LOOK_EVERY
        film = target.suffix.lower() == ".avi"
        self._place = target.parent if film else target
        table = target.with_suffix(".csv") if film else target / "pictures.csv"
        try:
            self._place.mkdir(parents=True, exist_ok=True)
            if target.is_file() or table.exists():
                text = f"{target if target.is_file() else table} is there already: name another one"
                raise BadConfig(text, field="target", value=str(target), expected="a new file or folder")
            self._table: IO[str] = table.open("x", encoding="ascii")
            self._table.write(COLUMNS)
            self._table.flush()
        except OSError as e:
            text = f"cannot write to {target}: {e.strerror}"
            raise BadConfig(text, field="target", value=str(target), expected="a place to write to") from e
        self._store: _Film | _Folder = _Film(target, rate) if film else _Folder(target)
        if film:
            opencv()

    def add(self, picture: Picture) -> bool:
        """Write a picture; False where it was not: no room, or no picture."""
        if not self._room():
            self.unwritten += 1
            return False
        try:
            name = self._store.add(picture, self.written)
            p = picture
            self._table.write(f"{name},{p.seq},{p.t:.6f},{p.arrived:.6f},{p.width},{p.height}\n")
            self._table.flush()
        except (OSError, BadInput) as e:
            self.full, self.unwritten = str(e), self.unwritten + 1
            return False
        self.written += 1
        self.bytes += len(picture.jpeg)
        return True

    def close(self) -> None:
        try:
            self._store.close()
            self._table.close()
        except OSError as e:  # what was written before stays
            self.full = str(e)

    def _room(self) -> bool:
        now = time.monotonic()
        if now - self._looked >= LOOK_EVERY:
            self._looked = now
            free = shutil.disk_usage(self._place).free
            self.full = "" if free > self._keep_free else f"{free / 1e6:.0f} MB are free: nothing is written"
        return not self.full


class _Folder:
    """``add`` gives the name to be told in the table."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def add(self, picture: Picture, number: int) -> str:
        name = f"{number:08d}.jpg"
        part = self._path / f"{name}.part"
        part.write_bytes(picture.jpeg)
        part.replace(self._path / name)  # anyone who is killed meanwhile leaves no torn picture
        return name

    def close(self) -> None:
        """Nothing is open."""


class _Film:
    """Goes on in FILE-2.avi and so on when a file is full; all pictures get the first one's size."""

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self._rate = path, rate
        self._avi: Avi | None = None
        self._size = (0, 0)
        self._part = 1

    def add(self, picture: Picture, number: int) -> str:
        size = picture.width, picture.height
        if self._avi is not None and self._avi.full:
            self._avi.close()
            self._avi, self._part = None, self._part + 1
        if self._avi is None:
            self._size = self._size if any(self._size) else size
            self._avi = Avi(self._name(), *self._size, self._rate)
        jpeg = picture.jpeg
        if size != self._size:
            jpeg = encode(opencv().resize(decode(jpeg), self._size), QUALITY)
        self._avi.add(jpeg, picture.t)
        return self._name().name

    def _name(self) -> Path:
        return self._path if self._part == 1 else self._path.with_stem(f"{self._path.stem}-{self._part}")

    def close(self) -> None:
        if self._avi is not None:
            self._avi.close()

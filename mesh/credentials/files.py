"""Files that are whole or not there: a crash or a full disk leaves the old one as it was."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from zmav.errors import BadConfig

SECRET, PUBLIC = 0o600, 0o644


def write(path: Path, data: bytes, mode: int = PUBLIC) -> None:
    """Put ``data`` in the place of whatever ``path`` holds. Raises :class:`BadConfig` where it cannot be written."""
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)  # mode 0600
    except OSError as e:
        raise unwritable(path, e) from e
    try:
        with os.fdopen(handle, "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except OSError as e:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise unwritable(path, e) from e


def write_folder(folder: Path, contents: Mapping[str, tuple[bytes, int]], *, replace: bool = False) -> None:
    """A folder of files, each with its mode, that appears all at once.

    Raises :class:`BadConfig` where it cannot be written, or where there is something that :func:`check_place` refuses.
    """
    check_place(folder, contents, replace=replace)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))  # mode 0700
    except OSError as e:
        raise unwritable(folder, e) from e
    try:
        for name, (data, mode) in contents.items():
            write(fresh / name, data, mode)
        _put_in_place(fresh, folder)
    except OSError as e:
        raise unwritable(folder, e) from e
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def check_place(folder: Path, names: Iterable[str], *, replace: bool) -> None:
    """Raise :class:`BadConfig` where there is something: with ``replace``, anything but files of these ``names``."""
    if not folder.exists():
        return
    if not replace:
        text = f"{folder} is there already, and is not overwritten: name another with --out, or move it away"
        raise BadConfig(text, field="out", value=str(folder), expected="a folder that is not there yet")
    try:
        others = sorted({path.name for path in folder.iterdir()} - set(names))
    except OSError as e:
        raise unwritable(folder, e) from e
    if others:
        text = f"{folder} holds {others[0]!r}, too, and is not replaced: name another with --out"
        raise BadConfig(text, field="out", value=str(folder), expected="a member's folder")


def _put_in_place(fresh: Path, folder: Path) -> None:
    if not folder.exists():
        fresh.rename(folder)
        return
    aside = fresh.with_name(f"{fresh.name}.old")
    folder.rename(aside)
    fresh.rename(folder)
    shutil.rmtree(aside, ignore_errors=True)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """While it lasts, no other process that asks for it changes the folder."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as e:
        raise unwritable(folder, e) from e
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def unwritable(path: Path, error: OSError) -> BadConfig:
    return BadConfig(f"cannot write {path}: {error.strerror}", field="file", value=str(path), expected="room to write")

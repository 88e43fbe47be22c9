"""Numba's compiler, with types that a checker can follow, and the folder in which what it compiled is kept.

Numba looks only at a function's own file to see whether what it kept still holds, and calls of other files' functions
are compiled in. So the folder's name tells the sources of all kernels: a change in any of them has all compiled again.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])
PACKAGE = Path(__file__).resolve().parent.parent
COMPLETE = "complete"
KEPT = 3
"""How many older folders stay: those used last, for processes that still run them and for other numbas."""


def jit(function: F) -> F:
    """Compile for the types it is called with, once on this machine; no Python objects inside.

    Fast but exact where it matters: no reordering of sums, NaN compares as always.
    """
    kept, config = folder(), cast(Any, numba.config)
    usual, config.CACHE_DIR = config.CACHE_DIR, str(kept or "")
    try:
        return cast(F, numba.njit(cache=kept is not None, error_model="numpy", nogil=True)(function))
    finally:
        config.CACHE_DIR = usual


@functools.cache
def folder() -> Path | None:
    """Where compiled kernels are kept: beside the sources or else in the user's cache; None where neither can be.

    What ``NUMBA_CACHE_DIR`` names comes first.
    """
    name = f"kernels-{numba.__version__}-{fingerprint(PACKAGE)}"
    for place in _places():
        found = place / name
        try:
            fresh = not found.is_dir()
            found.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=found).close()
            os.utime(found)  # used now: see KEPT
        except OSError:
            continue
        if fresh:
            _tidy(place, found)
        return found
    return None


def interpreted() -> bool:
    """Whether kernels are not compiled in this process (``NUMBA_DISABLE_JIT``), but run as the Python that they are:
    a hundred times slower, and soon enough for a few vehicles in the open.
    """
    return bool(cast(Any, numba.config).DISABLE_JIT)


def compiled() -> bool:
    """Whether all kernels are there, or none is needed."""
    kept = folder()
    return interpreted() or (kept is not None and (kept / COMPLETE).exists())


@contextlib.contextmanager
def compiling() -> Iterator[bool]:
    """Whether everything is to be compiled within, for the first time on this machine.

    One process does, others wait for it here. Where nothing can be kept it is False: what is needed is compiled then.
    """
    kept = folder()
    if kept is None or compiled():
        yield False
        return
    with (kept / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # let go when the file is closed, also by a kill
        yield not compiled()
        (kept / COMPLETE).touch()


def fingerprint(package: Path) -> str:
    """What the sources of all kernels below a folder, and this one, come down to."""
    whole = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if re.search(rb"^@jit$", text, re.MULTILINE) or path == Path(__file__).resolve():
            whole.update(f"{path.relative_to(package)} {len(text)}\n".encode() + text)
    return whole.hexdigest()[:16]


def _places() -> list[Path]:
    told = os.environ.get("NUMBA_CACHE_DIR")
    users = Path(os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache"))  # noqa: PTH111 (never raises)
    places = [Path(told)] if told else []
    places.append(PACKAGE / "__pycache__")
    return [*places, users / "zmav"] if users.is_absolute() else places


def _tidy(place: Path, new: Path) -> None:
    """Remove older folders but those used last."""
    others = [each for each in place.glob("kernels-*") if each != new]
    with contextlib.suppress(OSError):  # another process tidies, too
        for each in sorted(others, key=lambda each: each.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(each, ignore_errors=True)

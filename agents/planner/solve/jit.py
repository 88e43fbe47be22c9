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
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])
PACKAGE = Path(__file__).resolve().parent.parent
KERNEL = re.compile(rb"^@jit$", re.MULTILINE)
COMPLETE = "complete"
NOT_KEPT = "each time again, as nothing can be kept: name a folder that can be written to in NUMBA_CACHE_DIR"
KEPT = 3
"""How many older folders stay: those used last, for processes that still run them and for other numbas."""


def jit(function: F) -> F:
    """Compile for the types it is called with, once on this machine; no Python objects inside.

    Fast but exact where it matters: no reordering of sums, NaN compares as always.
    """
    if interpreted():
        return function  # numba itself need not be there
    import numba

    kept, config, njit = folder(), cast(Any, numba.config), cast(Any, numba.njit)
    usual, config.CACHE_DIR = config.CACHE_DIR, str(kept or "")
    try:
        made = njit(cache=kept is not None, error_model="numpy", nogil=True, no_cfunc_wrapper=True)(function)
    finally:
        config.CACHE_DIR = usual
    if made is not function:
        _by_type(made)
        if kept is not None:
            _one_at_a_time(made, kept)
    return cast(F, made)


def _by_type(made: Any) -> None:
    """Compile it once for all integers that other kernels call it with; numba would for each constant."""
    from numba.core import types

    usual, plain = made.get_call_template, cast(Any, types.unliteral)

    def by_type(args: Iterable[Any], named: Mapping[str, Any]) -> Any:
        return usual(tuple(map(plain, args)), {name: plain(kind) for name, kind in named.items()})

    made.get_call_template = by_type


def _one_at_a_time(made: Any, kept: Path) -> None:
    """Of two processes that keep what they compiled of one kernel, numba would have one lose, or take, the other's."""
    usual = made._cache.save_overload

    def save(*what: Any) -> None:
        with _locked(kept / "index.lock"):
            usual(*what)

    made._cache.save_overload = save


@functools.cache
def folder() -> Path | None:
    """Where compiled kernels are kept: beside the sources or else in the user's cache; None where neither can be.

    What ``NUMBA_CACHE_DIR`` names comes first.
    """
    import numba

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
    return os.environ.get("NUMBA_DISABLE_JIT", "") not in ("", "0")


def compiled() -> bool:
    """Whether all kernels are there, or none is needed."""
    if interpreted():
        return True
    kept = folder()
    return kept is not None and (kept / COMPLETE).exists()


@contextlib.contextmanager
def compiling(part: str, wait: bool = True) -> Iterator[bool]:
    """Whether a part of the kernels is to be compiled within, for the first time on this machine.

    One process does. Others ``wait`` for it here, or leave it to that one. Where nothing can be kept it is False: what
    is needed is compiled then.
    """
    kept = folder()
    done = kept / f"{part}.done" if kept is not None else None
    if kept is None or done is None or done.exists():
        yield False
        return
    with _locked(kept / f"{part}.lock", wait) as ours:
        yield ours and not done.exists()
        if ours:
            done.touch()


def done(part: str) -> bool:
    """Whether a part of the kernels is compiled."""
    kept = folder()
    return kept is not None and (kept / f"{part}.done").exists()


def wait_for(part: str) -> None:
    """Wait while another process compiles a part: that costs this one no processor time."""
    kept = None if interpreted() else folder()
    if kept is not None and not done(part):
        with _locked(kept / f"{part}.lock"):
            pass


def complete() -> None:
    """All parts are there."""
    if kept := folder():
        (kept / COMPLETE).touch()


def progress() -> tuple[int, int]:
    """How many kernels are compiled, by any process, and of how many."""
    kept = folder()
    return len(list(kept.rglob("*.nbi"))) if kept is not None else 0, count(PACKAGE)


@functools.cache
def count(package: Path) -> int:
    """How many kernels there are below a folder."""
    return sum(len(KERNEL.findall(path.read_bytes())) for path in package.rglob("*.py"))


@contextlib.contextmanager
def _locked(path: Path, wait: bool = True) -> Iterator[bool]:
    """No other process has it within; False where one has and it is not waited for."""
    with path.open("w") as lock:
        ours = True
        try:
            fcntl.flock(lock, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            ours = False
        except OSError:  # some file systems know no locks: each compiles for itself then
            pass
        yield ours  # let go when the file is closed, also by a kill


def fingerprint(package: Path) -> str:
    """What the sources of all kernels below a folder, and this one, come down to."""
    whole = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if KERNEL.search(text) or path == Path(__file__).resolve():
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

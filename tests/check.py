"""Run the unit tests, and those whose import closure holds what changed: ``python tests/check.py -n 2 ...``

Of the unit tests those that never took less than ``LONG_S`` here run only where something that they import changed: it
is one in twenty, and they take three quarters of the time. All of them run where data of the product changed, which
nobody imports, and those whose file reads the tree always do.

Changed is what differs from the merge base with the branch that this one is for: ``$BASE``, or else the remote's own
branch, ``main`` or ``master``; new files count.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.imports import CACHE, Sources, keep  # noqa: E402

EVERYWHERE = {"pyproject.toml", "requirements.lock"}
"""after a change of these everything runs"""
DURATIONS = CACHE.with_name("durations.json")
LONG_S = 0.5
PRODUCT = ("zmav/", "agents/", "mesh/", "ground/")


class Durations:
    """A plugin of pytest: the seconds that each test took at least, kept in a file from one run to the next. A test
    that failed has none: it runs again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.least_s: dict[str, float] = {}
        with contextlib.suppress(OSError, msgspec.MsgspecError):  # none yet, or it is none of ours
            self.least_s = msgspec.json.decode(path.read_bytes(), type=dict[str, float])
        self._took_s: dict[str, float] = {}
        self._passed: set[str] = set()
        self._failed: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed.add(report.nodeid)
        if isinstance(report, pytest.SubtestReport):  # its time is its test's, which it does not end
            return
        self._took_s[report.nodeid] = self._took_s.get(report.nodeid, 0.0) + report.duration
        if report.when == "call" and report.passed:
            self._passed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        least = {each: min(self._took_s[each], self.least_s.get(each, math.inf)) for each in self._passed}
        keep(self._path, {each: s for each, s in (self.least_s | least).items() if each not in self._failed})


def long_tests(root: Path, least_s: dict[str, float], files: Iterable[str]) -> list[str]:
    """Those that may be left out where these files changed. A test file that names ``ROOT`` reads the tree."""
    if any(each.startswith(PRODUCT) and not each.endswith(".py") for each in files):
        return []
    found = [each for each, least in least_s.items() if least > LONG_S]
    paths = {path for each in found if (path := root / each.partition("::")[0]).is_file()}
    reading = {path for path in paths if "ROOT" in path.read_text("utf-8")}
    return sorted(each for each in found if root / each.partition("::")[0] not in reading)


def changed_files(root: Path, base: str = "") -> list[str]:
    """The paths of what differs from the merge base, uncommitted and untracked files included."""
    wanted = [base] if base else ["origin/HEAD", "main", "master"]
    start = next((found for each in wanted if (found := _git(root, "merge-base", "HEAD", each).strip())), "HEAD")
    listed = _git(root, "diff", "--name-only", start) + _git(root, "ls-files", "--others", "--exclude-standard")
    return sorted(set(listed.splitlines()))


def affected_modules(root: Path, files: Iterable[str], cache: Path | None = None) -> set[str]:
    """The modules whose import closure holds one of the files.

    Of the tests' own only those that changed: whether a test uses what another module offers is asked test by test.
    """
    files, sources = set(files), Sources(root, cache=cache)
    changed = {each for path in files if (each := sources.modules.get((root / path).resolve()))}
    affected = sources.affected(changed)
    if cache is not None:
        sources.save()
    if files & EVERYWHERE:
        return set(sources.paths)
    return {each for each in affected if each in changed or not each.startswith("tests.")}


def main(arguments: list[str]) -> int:
    """The exit status of pytest."""
    files = changed_files(ROOT, os.environ.get("BASE", ""))
    modules = affected_modules(ROOT, files, ROOT / CACHE)
    durations = Durations(ROOT / DURATIONS)
    long = long_tests(ROOT, durations.least_s, files)
    print(
        f"==> pytest: the unit tests but {len(long)} that take over {LONG_S} s, and those of {len(modules)} modules "
        f"that use {len(files)} changed files",
        flush=True,
    )
    with tempfile.NamedTemporaryFile("w", suffix=".affected") as file:
        json.dump({"modules": sorted(modules), "long": long}, file)
        file.flush()
        # In one argument: a path alone would be the root.
        return int(pytest.main(["-m", "not alone", *arguments, f"--affected={file.name}"], plugins=[durations]))


def _git(root: Path, *arguments: str) -> str:
    """What it says; nothing where it fails, as for a branch that is not there."""
    return subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=False).stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Run pytest: what may run beside other tests, then what may not: ``python tests/run.py -n 3 ...``

Tests marked ``alone`` fly something whose deadlines are the real clock's, such as a controller that has 100 ms for each
step: they run last, two files at a time where others ran side by side. Few of them need half a core.

What failed beside other tests runs once more, alone. On a busy machine a test that races with time fails now and then.
It must be mended, so it is named; it says nothing of the code, so it fails no run. Exits as pytest does, and with 0
where all that failed passed alone.

``--beside "COMMAND"`` first: that runs beside the tests at the lowest priority, as many of them wait for something.
What it said comes after them, and where it failed, so does the run.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

MOST = 5
"""failures that may be the machine's fault; more are the code's"""
NONE = int(pytest.ExitCode.NO_TESTS_COLLECTED)
ALONE, BY_ITSELF, BESIDE = "--alone", "--by-itself", "--beside"
"""before the arguments of a second run: of what failed, and of what is marked ``alone``; and before a command"""


class Heard:
    """A plugin of pytest: which tests failed, or were skipped, whether all ran that should, where to look, and how
    many at a time. ``places``: as they were given; ``roots``: those, or the usual ones.

    ``only`` is added to what ``-m`` asks for.
    """

    def __init__(self, only: str) -> None:
        self._only = only
        self.names: list[str] = []
        self.skipped = False
        self.places: list[str] = []
        self.roots: list[str] = []
        self.jobs = 0
        self.whole = True

    @pytest.hookimpl(tryfirst=True)
    def pytest_configure(self, config: pytest.Config) -> None:
        given = config.option.markexpr
        if self._only:
            config.option.markexpr = wanted = f"({given}) and {self._only}" if given else self._only
            # Workers of xdist parse the arguments of this run again, and know nothing of the option.
            told = config.invocation_params
            config.invocation_params = pytest.Config.InvocationParams(
                args=(*told.args, "-m", wanted), plugins=told.plugins, dir=told.dir
            )

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:  # a file whose tests nobody knows
            self.whole = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and report.nodeid not in self.names:
            self.names.append(report.nodeid)
        if report.when not in ("setup", "call", "teardown"):  # its process crashed, which no busy machine excuses
            self.whole = False
        self.skipped |= report.skipped and not hasattr(report, "wasxfail")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self.places = session.config.option.file_or_dir
        self.roots = session.config.args
        self.jobs = int(session.config.option.numprocesses or 0)
        if session.shouldfail or session.shouldstop:  # -x, or interrupted
            self.whole = False


def main(args: list[str]) -> int:
    """The exit status: of the first run, or of the second where there is one."""
    if args[:1] == [BESIDE]:
        return _beside(shlex.split(args[1]), args[2:])
    if args[:1] == [ALONE]:
        heard = Heard("")
        status = int(pytest.main(args[1:], plugins=[heard]))
        return status or int(pytest.ExitCode.TESTS_FAILED if heard.skipped else 0)  # a skipped test did not pass
    if args[:1] == [BY_ITSELF]:
        return _with_second_run(args[1:], Heard("alone"))
    heard = Heard("not alone")
    first = _with_second_run(args, heard)
    if not heard.whole or first not in (0, pytest.ExitCode.TESTS_FAILED, NONE):
        return first
    places = _with_alone(heard.roots)
    few = ["-n", "2", "--dist", "loadfile"] if heard.jobs > 1 else ["-n", "0"]
    print(f"\n==> those that run alone, {'two files at a time' if heard.jobs > 1 else 'one after another'}", flush=True)
    last = _run([BY_ITSELF, *_options(args, heard.places), *few, *places]) if places else NONE
    if first == pytest.ExitCode.TESTS_FAILED:
        print("==> FAILED: those above that run beside others", flush=True)
    return last if first == NONE else first or (0 if last == NONE else last)


def _beside(command: list[str], args: list[str]) -> int:
    with tempfile.TemporaryFile("w+") as said:
        other = subprocess.Popen(["nice", "-n", "19", *command], stdout=said, stderr=subprocess.STDOUT)
        try:
            if (tested := main(args)) == pytest.ExitCode.INTERRUPTED:
                return tested
            failed = other.wait()
        finally:
            other.terminate()
        said.seek(0)
        print(f"\n==> {shlex.join(command)}: {'FAILED' if failed else 'good'}\n{said.read()}", end="", flush=True)
    return tested or int(failed and pytest.ExitCode.TESTS_FAILED)


def _with_alone(roots: list[str]) -> list[str]:
    """Of what was asked for the files that may have tests which run alone: to read all the others again takes each
    worker ten seconds.
    """
    found: list[str] = []
    for root in roots:
        if Path(root).is_dir():
            files = sorted(Path(root).rglob("test_*.py"))
            found += [str(file) for file in files if "mark.alone" in file.read_text("utf-8")]
        else:
            found.append(root)
    return found


def _with_second_run(args: list[str], heard: Heard) -> int:
    """Run pytest with these arguments, and what failed once more."""
    status, names = int(pytest.main(args, plugins=[heard])), heard.names
    if status != pytest.ExitCode.TESTS_FAILED or not heard.whole or not 0 < len(names) <= MOST:
        return status
    print(f"\n==> once more, alone and one after another: the {len(names)} that failed", flush=True)
    again = _run([ALONE, *_options(args, heard.places), "-n", "0", *names])
    if again:
        print(f"==> FAILED, or skipped, alone too (pytest ended with {again})", flush=True)
        return again
    print(f"==> FLAKY, {len(names)}: failed beside others, passed alone. They do not fail this run; mend them:")
    for name in names:
        print(f"      {name}")
    return 0


def _run(arguments: list[str]) -> int:
    """The exit status of this file in a process of its own."""
    try:
        return subprocess.run([sys.executable, __file__, *arguments], check=False).returncode
    except KeyboardInterrupt:
        return int(pytest.ExitCode.INTERRUPTED)


def _options(args: list[str], places: list[str]) -> list[str]:
    """The arguments without the places, which mostly come last: ``-k tests tests`` is ``-k tests``."""
    options = args[::-1]
    for place in places:
        if place in options:  # else it is from the environment
            options.remove(place)
    return options[::-1]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Run pytest: what may run beside other tests, then what may not: ``python tests/run.py -n 3 ...``

Tests marked ``alone`` fly something whose deadlines are the real clock's, such as a controller that has 100 ms for each
step: they run last, one after another.

What failed beside other tests runs once more, alone. On a busy machine a test that races with time fails now and then.
It must be mended, so it is named; it says nothing of the code, so it fails no run. Exits as pytest does, and with 0
where all that failed passed alone.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

MOST = 5
"""failures that may be the machine's fault; more are the code's"""
ALONE = "--alone"
"""before the arguments of the second run"""
BESIDE, BY_ITSELF = "not alone", "alone"
"""what ``-m`` is where the arguments have none: first the one, then the other"""


class Heard:
    """A plugin of pytest: which tests failed, or were skipped, whether all ran that should, and where to look."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.skipped = False
        self.places: list[str] = []
        self.whole = True

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
        if session.shouldfail or session.shouldstop:  # -x, or interrupted
            self.whole = False


def main(args: list[str]) -> int:
    """The exit status: of the first run, or of the second where there is one."""
    heard = Heard()
    if args[:1] == [ALONE]:
        status = int(pytest.main(args[1:], plugins=[heard]))
        return status or int(pytest.ExitCode.TESTS_FAILED if heard.skipped else 0)  # a skipped test did not pass
    if "-m" in args:
        return _with_second_run(args, args, heard)
    status = _with_second_run([*args, "-m", BESIDE], args, heard)
    if not heard.whole:
        return status
    print("\n==> those that run alone, one after another", flush=True)
    last = _run([*_options(args, heard.places), "-n", "0", "-m", BY_ITSELF, *heard.places])
    none = int(pytest.ExitCode.NO_TESTS_COLLECTED)
    return last if status == none else status or (0 if last == none else last)


def _with_second_run(args: list[str], plain: list[str], heard: Heard) -> int:
    """Run pytest with these arguments; what failed once more with the plain ones."""
    status, names = int(pytest.main(args, plugins=[heard])), heard.names
    if status != pytest.ExitCode.TESTS_FAILED or not heard.whole or not 0 < len(names) <= MOST:
        return status
    print(f"\n==> once more, alone and one after another: the {len(names)} that failed", flush=True)
    again = _run([__file__, ALONE, *_options(plain, heard.places), "-n", "0", *names])
    if again:
        print(f"==> FAILED, or skipped, alone too (pytest ended with {again})", flush=True)
        return again
    print(f"==> FLAKY, {len(names)}: failed beside others, passed alone. They do not fail this run; mend them:")
    for name in names:
        print(f"      {name}")
    return 0


def _run(arguments: list[str]) -> int:
    """The exit status of a pytest, or of this file, in a process of its own."""
    start = [] if arguments[:1] == [__file__] else ["-m", "pytest"]
    try:
        return subprocess.run([sys.executable, *start, *arguments], check=False).returncode
    except KeyboardInterrupt:
        return int(pytest.ExitCode.INTERRUPTED)


def _options(args: list[str], places: list[str]) -> list[str]:
    """The arguments without the places, which mostly come last: ``-k tests tests`` is ``-k tests``."""
    options = args[::-1]
    for place in places:
        options.remove(place)
    return options[::-1]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

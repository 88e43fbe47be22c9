"""Run pytest, and what failed beside other tests once more, alone: ``python tests/run.py -n 3 ...``

On a busy machine a test that races with time fails now and then. It must be mended, so it is named; it says nothing of
the code, so it fails no run. Exits as pytest does, and with 0 where all that failed passed alone.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

MOST = 5
"""failures that may be the machine's fault; more are the code's"""
ALONE = "--alone"
"""before the arguments of the second run"""


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
    status, names = int(pytest.main(args, plugins=[heard])), heard.names
    if status != pytest.ExitCode.TESTS_FAILED or not heard.whole or not 0 < len(names) <= MOST:
        return status
    print(f"\n==> once more, alone and one after another: the {len(names)} that failed", flush=True)
    command = [sys.executable, __file__, ALONE, *_options(args, heard.places), "-n", "0", *names]
    try:
        again = subprocess.run(command, check=False).returncode
    except KeyboardInterrupt:
        return int(pytest.ExitCode.INTERRUPTED)
    if again:
        print(f"==> FAILED, or skipped, alone too (pytest ended with {again})", flush=True)
        return again
    print(f"==> FLAKY, {len(names)}: failed beside others, passed alone. They do not fail this run; mend them:")
    for name in names:
        print(f"      {name}")
    return 0


def _options(args: list[str], places: list[str]) -> list[str]:
    """The arguments without the places, which mostly come last: ``-k tests tests`` is ``-k tests``."""
    options = args[::-1]
    for place in places:
        options.remove(place)
    return options[::-1]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

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


class Failures:
    """A plugin of pytest: which tests failed, whether all ran that should, and where pytest was told to look."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.places: list[str] = []
        self.whole = True

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:  # a file whose tests nobody knows
            self.whole = False

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and report.nodeid not in self.names:
            self.names.append(report.nodeid)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self.places = session.config.args
        if session.shouldfail or session.shouldstop:  # -x, or interrupted
            self.whole = False


def main(args: list[str]) -> int:
    """The exit status: of the first run, or of the second where there is one."""
    failures = Failures()
    status = int(pytest.main(args, plugins=[failures]))
    names = failures.names
    if status != pytest.ExitCode.TESTS_FAILED or not failures.whole or not 0 < len(names) <= MOST:
        return status
    options = [arg for arg in args if arg not in failures.places]
    print(f"\n==> once more, alone and one after another: the {len(names)} that failed", flush=True)
    try:
        again = subprocess.run([sys.executable, "-m", "pytest", *options, "-n", "0", *names], check=False).returncode
    except KeyboardInterrupt:
        return int(pytest.ExitCode.INTERRUPTED)
    if again:
        print(f"==> FAILED, alone too (pytest ended with {again})", flush=True)
        return again
    print(f"==> FLAKY, {len(names)}: failed beside others, passed alone. They do not fail this run; mend them:")
    for name in names:
        print(f"      {name}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

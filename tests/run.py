"""Run pytest: what may run beside other tests, then what may not: ``python tests/run.py -n 3 ...``

Tests marked ``alone`` fly something whose deadlines are the real clock's, such as a controller that has 100 ms for each
step: they run last, three files at a time where others ran side by side. Few of them need half a core. No test is tried
a second time. Exits as pytest does.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FAILED, NONE = int(pytest.ExitCode.TESTS_FAILED), int(pytest.ExitCode.NO_TESTS_COLLECTED)


class Only:
    """A plugin of pytest that adds ``only`` to what ``-m`` asks for. Afterwards it knows where pytest looked
    (``roots``), which places it was given (``places``), how many tests ran at a time, and whether it was cut short.
    """

    def __init__(self, only: str) -> None:
        self._only = only
        self.places: list[str] = []
        self.roots: list[str] = []
        self.jobs = 0
        self.whole = True

    @pytest.hookimpl(tryfirst=True)
    def pytest_configure(self, config: pytest.Config) -> None:
        given = config.option.markexpr
        config.option.markexpr = wanted = f"({given}) and {self._only}" if given else self._only
        # Workers of xdist parse the arguments of this run again, and know nothing of the option.
        told = config.invocation_params
        config.invocation_params = pytest.Config.InvocationParams(
            args=(*told.args, "-m", wanted), plugins=told.plugins, dir=told.dir
        )

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        self.places = session.config.option.file_or_dir
        self.roots = session.config.args
        self.jobs = int(session.config.option.numprocesses or 0)
        self.whole = not (session.shouldfail or session.shouldstop)  # -x


def main(args: list[str]) -> int:
    """The exit status."""
    if args[:1] == ["--alone"]:
        return int(pytest.main(args[1:], plugins=[Only("alone")]))
    only = Only("not alone")
    first = int(pytest.main(args, plugins=[only]))
    places = _with_alone(only.roots)
    if not places or not only.whole or first not in (0, FAILED, NONE):
        return first
    many = only.jobs > 1
    print(f"\n==> those that run alone, {'three files at a time' if many else 'one after another'}", flush=True)
    options = args[::-1]  # the places mostly come last: "-k tests tests" is "-k tests"
    for place in only.places:
        if place in options:  # else it is from the environment
            options.remove(place)
    few = ["-n", "3", "--dist", "loadfile"] if many else ["-n", "0"]
    last = _run(["--alone", *options[::-1], *few, *places])
    if first == FAILED:
        print("==> FAILED: those above that run beside others", flush=True)
    return last if first == NONE else first or (0 if last == NONE else last)


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


def _run(arguments: list[str]) -> int:
    """The exit status of this file in a process of its own."""
    try:
        return subprocess.run([sys.executable, __file__, *arguments], check=False).returncode
    except KeyboardInterrupt:
        return int(pytest.ExitCode.INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""tests/run.py: what its second run finds, and how it exits."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

FLAKY = """
from pathlib import Path

def test_flaky():
    mark = Path(__file__).with_name("mark")
    there = mark.exists()
    mark.touch()
    assert there
"""
BAD = "def test_bad(): assert 0"
SKIPPED = "import pytest\n" + FLAKY.replace("assert there", "assert there and pytest.skip()")
CRASHES = "import os\n" + FLAKY.replace("assert there", "assert there or os._exit(3)")
SIX_BAD = "\n".join(f"def test_{n}(): assert 0" for n in range(6))
BROKEN = "import nothing_of_that_name"
GOOD = "def test_good(): pass"
BY_ITSELF = "import pytest\npytestmark = pytest.mark.alone\n" + BAD
GOOD_BY_ITSELF = BY_ITSELF.replace("assert 0", "pass")
FLAKY_BY_ITSELF = "import pytest\npytestmark = pytest.mark.alone\n" + FLAKY
MEETS = """
import time
from pathlib import Path
import pytest

@pytest.mark.alone
def test_meets():
    here = Path(__file__)
    here.with_suffix(".mark").touch()
    end = time.monotonic() + 60.0
    while len(list(here.parent.glob("*.mark"))) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    assert len(list(here.parent.glob("*.mark"))) == 2
"""
# Of all plugins, which take a fifth of the time of a start, these tests need one.
LEAN, XDIST = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}, "-p xdist.plugin"
ONCE_MORE, FLAKES, AGAIN = "==> once more, alone", "==> FLAKY, 1:", "==> FAILED, or skipped, alone too"


@pytest.mark.parametrize(
    ("files", "args", "status", "said", "unsaid"),
    [
        ([FLAKY], "-k .", 0, [ONCE_MORE, FLAKES, "      test_0.py::test_flaky"], [AGAIN]),
        ([FLAKY, BAD], "", 1, [ONCE_MORE, AGAIN], [FLAKES]),
        ([SKIPPED], "", 1, [ONCE_MORE, AGAIN, "1 skipped"], [FLAKES]),
        ([CRASHES], "-n 1", 1, ["crashed while running", "1 failed"], [ONCE_MORE]),
        ([SIX_BAD], "", 1, ["6 failed"], [ONCE_MORE]),
        ([FLAKY], "-x", 1, ["1 failed"], [ONCE_MORE]),
        ([FLAKY, BROKEN], "--continue-on-collection-errors", 1, ["1 failed", "1 error"], [ONCE_MORE]),
        ([GOOD, BY_ITSELF], "", 1, ["1 passed, 1 deselected", "1 failed in", ONCE_MORE, AGAIN], [FLAKES]),
        ([FLAKY, BY_ITSELF], "", 1, [FLAKES, "1 failed in", AGAIN], []),
        ([BAD, GOOD_BY_ITSELF], "", 1, [AGAIN, "1 passed in", "==> FAILED: those above"], [FLAKES]),
        ([GOOD_BY_ITSELF], "", 0, ["1 deselected", "1 passed"], [ONCE_MORE]),
        ([GOOD, GOOD_BY_ITSELF], "-n 1", 0, ["1 passed", "one after another", "1 passed in"], ["2 passed"]),
        ([GOOD, MEETS, MEETS], "-n 2", 0, ["1 passed", "two files at a time", "2 passed"], ["3 passed", ONCE_MORE]),
        ([GOOD, FLAKY_BY_ITSELF, GOOD_BY_ITSELF], "-n 2", 0, ["1 failed, 1 passed", ONCE_MORE, FLAKES], [AGAIN]),
        ([BAD, GOOD_BY_ITSELF], "-x", 1, ["1 failed"], [ONCE_MORE, "run alone", "passed"]),
        ([BAD, GOOD_BY_ITSELF], "-malone", 0, ["2 deselected", "1 passed"], ["failed"]),
        ([GOOD, GOOD_BY_ITSELF], "--no-such-option", 4, ["unrecognized arguments"], ["run alone"]),
        ([BAD], "-k nothing", 5, ["1 deselected"], [ONCE_MORE]),
    ],
    ids=[
        "flaky",
        "bad",
        "skipped",
        "crash",
        "many",
        "cut-short",
        "broken-file",
        "alone",
        "flaky-and-alone",
        "bad-and-alone",
        "only-alone",
        "alone-with-workers",
        "two-alone",
        "flaky-alone",
        "cut-short-alone",
        "marked",
        "unknown-option",
        "none",
    ],
)
def test_the_second_run(
    tmp_path: Path, root: Path, files: list[str], args: str, status: int, said: list[str], unsaid: list[str]
) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = alone\n")
    for number, source in enumerate(files):
        (tmp_path / f"test_{number}.py").write_text(source)
    command = [sys.executable, str(root / "tests" / "run.py"), *f"-n 0 {XDIST} {args} .".split()]
    ran = subprocess.run(command, cwd=tmp_path, env=LEAN, capture_output=True, text=True, timeout=100)
    assert ran.returncode == status, ran.stdout + ran.stderr
    for words in said:
        assert words in ran.stdout + ran.stderr
    for words in unsaid:
        assert words not in ran.stdout


@pytest.mark.parametrize(
    ("test", "beside", "status", "said"),
    [
        (GOOD, "print('no errors')", 0, ["1 passed", ": good\nno errors\n"]),
        (GOOD, "print('one error'); raise SystemExit(1)", 1, ["1 passed", ": FAILED\none error\n"]),
        (SIX_BAD, "print('no errors')", 1, ["6 failed", ": good\nno errors\n"]),
        (BROKEN, "import time; time.sleep(90)", 2, ["1 error", ""]),
    ],
    ids=["good", "beside-fails", "tests-fail", "cut-short"],
)
def test_what_runs_beside_is_told_of_after_the_tests_and_fails_the_run_too(
    tmp_path: Path, root: Path, test: str, beside: str, status: int, said: list[str]
) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = alone\n")
    (tmp_path / "test_0.py").write_text(test)
    other = shlex.join([sys.executable, "-c", beside])
    command = [sys.executable, str(root / "tests" / "run.py"), "--beside", other, *f"-n 0 {XDIST} .".split()]
    ran = subprocess.run(command, cwd=tmp_path, env=LEAN, capture_output=True, text=True, timeout=100)
    assert ran.returncode == status, ran.stdout + ran.stderr
    assert all(words in ran.stdout for words in said), ran.stdout
    assert ran.stdout.index(said[0]) < ran.stdout.rindex(said[1])

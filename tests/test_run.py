"""tests/run.py: what runs beside others, what alone, and how it exits."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BAD = "def test_bad(): assert 0"
CRASHES = "import os\ndef test_ends(): os._exit(3)"
BROKEN = "import nothing_of_that_name"
GOOD = "def test_good(): pass"
BY_ITSELF = "import pytest\npytestmark = pytest.mark.alone\n" + BAD
GOOD_BY_ITSELF = BY_ITSELF.replace("assert 0", "pass")
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
ALONE = "==> those that run alone"


@pytest.mark.parametrize(
    ("files", "args", "status", "said", "unsaid"),
    [
        ([BAD], "", 1, ["1 failed"], [ALONE]),
        ([CRASHES, GOOD_BY_ITSELF], "-n 1", 1, ["crashed while running", "1 failed", ALONE, "1 passed"], []),
        ([BAD, BROKEN], "--continue-on-collection-errors", 1, ["1 failed", "1 error"], [ALONE]),
        ([GOOD, BY_ITSELF], "", 1, ["1 passed, 1 deselected", "1 failed in"], ["==> FAILED"]),
        ([BAD, GOOD_BY_ITSELF], "", 1, ["1 failed", "1 passed in", "==> FAILED: those above"], []),
        ([GOOD_BY_ITSELF], "", 0, ["1 deselected", "1 passed"], []),
        ([GOOD, GOOD_BY_ITSELF], "-n 1", 0, ["1 passed", "one after another", "1 passed in"], ["2 passed"]),
        ([GOOD, MEETS, MEETS], "-n 2", 0, ["1 passed", "three files at a time", "2 passed"], ["3 passed"]),
        ([BAD, GOOD_BY_ITSELF], "-x", 1, ["1 failed"], [ALONE, "passed"]),
        ([BAD, GOOD_BY_ITSELF], "-malone", 0, ["2 deselected", "1 passed"], ["failed"]),
        ([GOOD, GOOD_BY_ITSELF], "--no-such-option", 4, ["unrecognized arguments"], [ALONE]),
        ([BAD], "-k nothing", 5, ["1 deselected"], [ALONE]),
    ],
    ids=[
        "bad",
        "crash",
        "broken-file",
        "alone",
        "bad-and-alone",
        "only-alone",
        "alone-with-workers",
        "two-alone",
        "cut-short",
        "marked",
        "unknown-option",
        "none",
    ],
)
def test_what_runs_alone(
    tmp_path: Path, root: Path, files: list[str], args: str, status: int, said: list[str], unsaid: list[str]
) -> None:
    (tmp_path / "pytest.ini").write_text("[pytest]\nasyncio_default_fixture_loop_scope = function\nmarkers = alone\n")
    for number, source in enumerate(files):
        (tmp_path / f"test_{number}.py").write_text(source)
    # Plugins that these tests do not need, and that take a while to load.
    lean = "-p no:hypothesispytest -p no:anyio -p no:randomly"
    command = [sys.executable, str(root / "tests" / "run.py"), *f"-n 0 {lean} {args} .".split()]
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert ran.returncode == status, ran.stdout + ran.stderr
    for words in said:
        assert words in ran.stdout + ran.stderr
    for words in unsaid:
        assert words not in ran.stdout

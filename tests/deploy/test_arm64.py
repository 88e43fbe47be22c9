"""What tries ARM: the parts of it that need neither QEMU nor an index. docs/arm.md tells what came of all of it."""

from __future__ import annotations

import runpy
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parent.parent.parent / "deploy" / "arm64"
TRY = FOLDER / "try.sh"


@pytest.fixture(scope="module")
def wheels() -> dict[str, Any]:
    return runpy.run_path(str(FOLDER / "wheels.py"))


def test_bash_can_read_it() -> None:
    assert subprocess.run(["bash", "-n", TRY], check=False).returncode == 0
    if shutil.which("shellcheck"):
        done = subprocess.run(["shellcheck", TRY], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [(["--help"], 0, "--mirror URL"), (["--root"], 1, "wants a value"), (["fly"], 2, "STEP")],
)
def test_usage(arguments: list[str], code: int, words: str) -> None:
    done = subprocess.run([TRY, *arguments], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == code
    assert words in done.stdout + done.stderr


def test_the_tests_that_are_run_there_are_in_the_tree() -> None:
    named = [word.strip("()") for word in TRY.read_text().replace("=(", " ").split() if word.startswith("tests/")]
    assert len(named) > 10
    assert not [each for each in named if not (FOLDER.parent.parent / each).exists()]


def test_what_the_lock_has_for_one_python_alone(wheels: dict[str, Any]) -> None:
    heads = list(wheels["lines"]())
    for python in wheels["PYTHONS"]:
        there = [head.split("==")[0] for head in heads if wheels["is_for"](head, python, "aarch64")]
        assert len(there) == len(set(there)), "two versions of a package for one Python"
        assert {"numpy", "msgspec", "eclipse-zenoh"} <= set(there)


@pytest.mark.parametrize(
    ("file", "wanted", "cell"),
    [
        (None, True, "**none**"),
        (None, False, "–"),
        ("numpy-2.4.6-cp311-cp311-manylinux_2_27_aarch64.manylinux_2_28_aarch64.whl", True, "cp311, glibc 2.27"),
        ("eclipse_zenoh-1.10.2-cp39-abi3-manylinux_2_28_aarch64.whl", True, "cp39-abi3, glibc 2.28"),
        ("fastcrc-0.5.0-cp311-cp311-manylinux2014_aarch64.whl", True, "cp311, glibc 2.17"),
        ("rich-15.0.0-py3-none-any.whl", True, "any"),
    ],
)
def test_a_cell_of_the_table(wheels: dict[str, Any], file: str | None, wanted: bool, cell: str) -> None:
    assert wheels["tell"](file, wanted) == cell

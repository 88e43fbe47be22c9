"""A short run of the fuzz target, and proof that it would find something."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from zmav.mavlink import Splitter, load_dialect

TARGET = Path(__file__).with_name("fuzz_splitter.py")


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(TARGET.parents[2])}
    command = [sys.executable, str(TARGET), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def target() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_splitter", TARGET)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("seed", [1, 2])
def test_a_short_run_finds_nothing(seed: int) -> None:
    done = run("--plain", "--runs", "1500", "--seed", str(seed))
    assert done.stdout == f"1500 inputs, nothing found (seed {seed})\n", done.stderr
    assert done.returncode == 0


def test_one_input_can_be_tried_again() -> None:
    done = run("--hex", "fd0900000001010000000400000002035104031234")
    assert (done.returncode, done.stdout) == (0, "nothing wrong with it\n"), done.stderr


def test_inputs_are_worth_something(target: ModuleType) -> None:
    """The mutations reach every verdict of the splitter."""
    import random

    dialect = load_dialect()
    mutator = target.Mutator(dialect, random.Random(5))
    splitter = Splitter(dialect)
    for _ in range(400):
        splitter.feed(mutator.stream())
    counters = splitter.counters
    assert counters.frames > 300
    assert min(counters.unknown, counters.bad_crc, counters.bad_length, counters.bad_flags, counters.lost) > 0


def test_a_fault_is_found_and_printed(
    target: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A splitter that forgets a torn frame depends on the chopping."""

    class Forgetful(Splitter):
        def feed(self, data: bytes):  # type: ignore[no-untyped-def]
            frames = super().feed(data)
            self._partial = b""
            return frames

    monkeypatch.setattr(target, "Splitter", Forgetful)
    with pytest.raises(AssertionError):
        target.run_plain(load_dialect(), 1, 200, None)
    assert "try it again with --hex" in capsys.readouterr().err

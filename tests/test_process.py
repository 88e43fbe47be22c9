"""How a process lives on when nobody reads what it says, and what it sets for numpy."""

from __future__ import annotations

import contextlib
import os
import signal
import sys

import pytest

from zmav.cli import main
from zmav.process import say


def test_what_nobody_reads_ends_nothing(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    say("a line")
    assert capsys.readouterr().err == "a line\n"
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w", buffering=1)
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(BrokenPipeError):
        print("a line", file=stream)
    say("a line")
    os.close(writer)
    say("a line")
    monkeypatch.undo()
    with pytest.raises(OSError, match="Bad file descriptor"):
        stream.close()


@pytest.mark.parametrize(("given", "found"), [(None, "1"), ("3", "3")])
def test_numpy_has_one_thread_unless_somebody_says_otherwise(
    monkeypatch: pytest.MonkeyPatch, given: str | None, found: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["zmav", "--help"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENBLAS_NUM_THREADS", given or "")
        if given is None:
            patch.delenv("OPENBLAS_NUM_THREADS")
        interrupted = signal.getsignal(signal.SIGINT)
        with contextlib.suppress(SystemExit):
            main()
        signal.signal(signal.SIGINT, interrupted)  # which it leaves to the kernel: its process ends
        assert os.environ["OPENBLAS_NUM_THREADS"] == found
